#include "server/config.h"

#include <ctype.h>
#include <errno.h>
#include <limits.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "common/base/buf.h"
#include "common/base/file.h"
#include "server/http/guard.h"

#define MAX_CONFIG_BYTES (64u << 10)
#define MIN_TOKEN 16

enum kind { KIND_TEXT, KIND_COUNT, KIND_SIZE, KIND_SECONDS, KIND_ROOT, KIND_FLAG };

struct option {
    const char *name; // flag "--name", variable RIPNERFD_NAME, file key "name"
    enum kind kind;
    size_t offset;
    const char *initial; // default; NULL: none
    double min, max;
    const char *value, *help;
};

#define AT(member) offsetof(struct rn_config, member)

static const struct option options[] = {
    {"data", KIND_TEXT, AT(data), NULL, 0, 0, "DIR", "where everything is kept (required)"},
    {"listen", KIND_TEXT, AT(listen), "127.0.0.1:7373", 0, 0, "ADDR:PORT",
     "port 0 takes a free one; an address other than loopback needs --token-file"},
    {"config", KIND_TEXT, AT(config), NULL, 0, 0, "FILE", "options, one 'name = value' a line"},
    {"dataset-root", KIND_ROOT, 0, NULL, 0, 0, "DIR",
     "datasets under DIR may be imported by path; repeatable"},
    {"token-file", KIND_TEXT, AT(token_file), NULL, 0, 0, "FILE",
     "holds the owner's bearer token in its first line; nobody is served without one then"},
    {"max-rate", KIND_COUNT, AT(max_rate), "100", 0, 1e6, "N",
     "requests a second of one token, on average; 0 is no limit"},
    {"quota-jobs", KIND_COUNT, AT(quota_jobs), "0", 0, 10000, "N",
     "unfinished jobs of one token that has no quota of its own; 0 is no limit"},
    {"quota-disk", KIND_SIZE, AT(quota_bytes), "0", 0, 1e15, "BYTES",
     "of what the jobs of such a token have made; 0 is no limit"},
    {"retain-pictures", KIND_SECONDS, AT(retain_pictures_s), "0", 0, 315360000, "TIME",
     "frames and films of paths are removed so long after they ended; 0 keeps them"},
    {"retain-space", KIND_SIZE, AT(retain_bytes), "0", 0, 1e15, "BYTES",
     "of frames and films together; beyond it the oldest are removed; 0 is no limit"},
    {"threads", KIND_COUNT, AT(threads), "0", 0, 1024, "N", "of each runner; 0 takes all cores"},
    {"memory-limit", KIND_SIZE, AT(memory_limit_bytes), "0", 0, 1e15, "BYTES",
     "of all runners together; 0 is no limit"},
    {"gpu-memory", KIND_SIZE, AT(gpu_memory_bytes), "0", 0, 1e15, "BYTES",
     "of all runners together on each GPU; 0 is what is free there"},
    {"gpu-deterministic", KIND_COUNT, AT(gpu_deterministic), "0", 0, 1, "0|1",
     "1: a GPU trains the same bytes every time, and is slower"},
    {"max-upload", KIND_SIZE, AT(max_upload_bytes), "16G", 1, 1e15, "BYTES",
     "largest uploaded dataset"},
    {"max-entries", KIND_COUNT, AT(max_upload_entries), "100000", 1, 1e7, "N",
     "most files in an uploaded dataset"},
    {"max-frames", KIND_COUNT, AT(max_frames), "100000", 1, 1e9, "N",
     "most frames that an imported dataset may name"},
    {"max-pixels", KIND_SIZE, AT(max_pixels), "64G", 1, 1e15, "N", "of all its frames together"},
    {"import-time", KIND_SECONDS, AT(import_time_s), "6h", 1, 31536000, "TIME",
     "an import that takes longer fails"},
    {"sandbox", KIND_COUNT, AT(sandbox), "1", 0, 1, "0|1",
     "1: runners may do only what their mode needs: no programs, no network, their own folders"},
    {"lpips", KIND_TEXT, AT(lpips), NULL, 0, 0, "FILE",
     "weights of LPIPS (VGG) as safetensors; evaluations then tell it"},
    {"executor", KIND_TEXT, AT(executor), "local", 0, 0, "NAME",
     "where scenes are trained and rendered: local, on this machine; slurm, on a cluster's nodes"},
    {"shared", KIND_TEXT, AT(shared), NULL, 0, 0, "DIR",
     "slurm: a folder that all nodes see at the same path; --data lies in it; without one, what "
     "nodes read and write is sent over their connection"},
    {"slurm-cache", KIND_TEXT, AT(slurm_cache), "/var/tmp", 0, 0, "DIR",
     "of each node's own, without --shared: where it keeps what it was sent"},
    {"slurm-cache-size", KIND_SIZE, AT(slurm_cache_bytes), "20G", 0, 1e15, "BYTES",
     "of it; what was used longest ago goes first"},
    {"slurm-listen", KIND_TEXT, AT(slurm_listen), NULL, 0, 0, "HOST:PORT",
     "where nodes reach this daemon; else by this machine's name, at any free port"},
    {"slurm-partition", KIND_TEXT, AT(slurm_partition), NULL, 0, 0, "NAME", "of sbatch"},
    {"slurm-account", KIND_TEXT, AT(slurm_account), NULL, 0, 0, "NAME", "of sbatch"},
    {"slurm-time", KIND_SECONDS, AT(slurm_time_s), "0", 0, 31536000, "TIME",
     "of a runner, in whole minutes; what is not done by then goes on in another; 0: the "
     "partition's"},
    {"slurm-gpus", KIND_COUNT, AT(slurm_gpus), "0", 0, 64, "N",
     "of a runner; one that is told to use a GPU asks for one at least, one told not to for none"},
    {"slurm-memory", KIND_SIZE, AT(slurm_memory_bytes), "0", 0, 1e15, "BYTES",
     "of a runner; 0: what the engine needs for its scene"},
    {"slurm-path-runners", KIND_COUNT, AT(slurm_path_runners), "8", 1, 128, "N",
     "at most, that make the frames of one path or the scores of one evaluation"},
    {"slurm-flags", KIND_TEXT, AT(slurm_flags), NULL, 0, 0, "FLAGS",
     "further ones of sbatch, by spaces, such as '--qos=long --constraint=avx512'"},
    {"training-slots", KIND_COUNT, AT(training_slots), "1", 1, 64, "N",
     "scenes that train at once; further ones queue"},
    {"max-queued", KIND_COUNT, AT(max_queued), "256", 1, 10000, "N", "unfinished jobs"},
    {"max-loaded", KIND_COUNT, AT(max_loaded), "8", 1, 128, "N", "scenes held ready for renders"},
    {"max-connections", KIND_COUNT, AT(max_connections), "448", 1, 10000, "N",
     "further ones are told to try again"},
    {"max-per-address", KIND_COUNT, AT(max_per_address), "0", 0, 10000, "N",
     "connections of one address; 0 is half of all, and any number on loopback"},
    {"header-timeout", KIND_SECONDS, AT(header_timeout_s), "10", 1, 3600, "TIME",
     "a connection must have sent its header after this long"},
    {"least-rate", KIND_SIZE, AT(least_rate), "1K", 1, 1e9, "BYTES",
     "a second, of a body or an answer, over --header-timeout; slower ones are cut off"},
    {"answer-memory", KIND_SIZE, AT(answer_bytes), "256M", 1e6, 1e12, "BYTES",
     "of answers that wait to be sent; further ones are told to try again"},
    {"keep-alive", KIND_SECONDS, AT(keep_alive_s), "10m", 0, 31536000, "TIME",
     "an idle scene is unloaded after this long"},
    {"curve-after", KIND_SECONDS, AT(curve_after_s), "30", 0, 31536000, "TIME",
     "of idleness, until what accuracy costs in time is measured for a scene that was trained; 0: "
     "only when asked for"},
    {"runner-timeout", KIND_SECONDS, AT(runner_timeout_s), "2m", 1, 86400, "TIME",
     "a runner that is busy and says nothing for so long is taken for hung and ended"},
    {"drain", KIND_SECONDS, AT(drain_s), "10", 0, 3600, "TIME",
     "how long SIGTERM waits for runners to save"},
    {"web", KIND_TEXT, AT(web), NULL, 0, 0, "DIR", "the page's files"},
    {"runner", KIND_TEXT, AT(runner), NULL, 0, 0, "FILE", "the ripnerf-runner program"},
    {"log-level", KIND_TEXT, AT(log_level), "info", 0, 0, "LEVEL", "error, warn, info or debug"},
    {"log-format", KIND_TEXT, AT(log_format), "text", 0, 0, "FORMAT",
     "text or json, a line an event"},
    {"audit", KIND_TEXT, AT(audit), NULL, 0, 0, "FILE",
     "a line of JSON is added for each write: time, request id, token, address, verb, path, "
     "status"},
    {"rebuild", KIND_FLAG, AT(rebuild), NULL, 0, 0, "",
     "make records that are missing anew from what lies under --data, then serve"},
    {"scrub", KIND_FLAG, AT(scrub), NULL, 0, 0, "",
     "check all that lies under --data by its digests, say what is damaged, and end"},
    {"scrub-interval", KIND_SECONDS, AT(scrub_interval_s), "168h", 1, 31536000, "TIME",
     "in idle time the same is done this often"},
    {"help", KIND_FLAG, AT(help), NULL, 0, 0, "", "print this text"},
    {"version", KIND_FLAG, AT(version), NULL, 0, 0, "", "print the version"},
};
#define OPTION_COUNT (sizeof options / sizeof options[0])

static const struct option *find(const char *name, size_t size) {
    for (size_t i = 0; i < OPTION_COUNT; i++)
        if (strlen(options[i].name) == size && strncmp(options[i].name, name, size) == 0)
            return &options[i];
    return NULL;
}

// 8, 1.5G (binary multiples), 90s, 10m, 2h.
static bool parse_number(const struct option *option, const char *text, int64_t *ret_value) {
    char *end;
    errno = 0;
    double value = strtod(text, &end), scale = 1;
    if (end == text || errno != 0 || isspace((unsigned char)text[0])) return false;
    if (option->kind == KIND_SIZE && *end != '\0') {
        static const char units[] = "KMGT";
        const char *unit = strchr(units, toupper((unsigned char)*end));
        if (unit == NULL) return false;
        for (const char *i = units; i <= unit; i++)
            scale *= 1024;
        end++;
    } else if (option->kind == KIND_SECONDS && *end != '\0') {
        if (*end != 's' && *end != 'm' && *end != 'h') return false;
        scale = *end == 'h' ? 3600 : *end == 'm' ? 60 : 1;
        end++;
    }
    value *= scale;
    if (*end != '\0' || !(value >= option->min && value <= option->max)) return false;
    *ret_value = (int64_t)value;
    return option->kind == KIND_SIZE || (double)*ret_value == value;
}

static enum rn_status set_text(char **target, const char *value, struct rn_error *err) {
    char *copy = strdup(value);
    if (copy == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "options", "no memory");
    free(*target);
    *target = copy;
    return RN_OK;
}

static enum rn_status add_root(struct rn_config *config, const char *value, const char *where,
                               struct rn_error *err) {
    if (config->root_count == RN_CONFIG_MAX_ROOTS)
        return rn_error_set(err, RN_ERROR_LIMIT, where, "more than %d dataset roots",
                            RN_CONFIG_MAX_ROOTS);
    char *path = realpath(value, NULL);
    if (path == NULL)
        return rn_error_set(err, RN_ERROR_NOT_FOUND, where, "cannot find the folder %s: %s", value,
                            strerror(errno));
    config->roots[config->root_count++] = path;
    return RN_OK;
}

static void clear_roots(struct rn_config *config) {
    while (config->root_count > 0)
        free(config->roots[--config->root_count]);
}

static enum rn_status set(struct rn_config *config, const struct option *option, const char *value,
                          const char *where, struct rn_error *err) {
    void *target = (char *)config + option->offset;
    switch (option->kind) {
    case KIND_TEXT:
        return set_text(target, value, err);
    case KIND_ROOT:
        return add_root(config, value, where, err);
    case KIND_FLAG:
        *(bool *)target = true;
        return RN_OK;
    default:
        break;
    }
    if (parse_number(option, value, target)) return RN_OK;
    return rn_error_set(err, RN_ERROR_INVALID, where, "'%s' is not a %s between %.0f and %.0f",
                        value,
                        option->kind == KIND_SECONDS ? "time (90s, 10m, 2h)"
                        : option->kind == KIND_SIZE  ? "size (512M, 8G)"
                                                     : "whole number",
                        option->min, option->max);
}

static enum rn_status set_defaults(struct rn_config *config, struct rn_error *err) {
    enum rn_status status = RN_OK;
    for (size_t i = 0; status == RN_OK && i < OPTION_COUNT; i++)
        if (options[i].initial != NULL)
            status = set(config, &options[i], options[i].initial, options[i].name, err);
    return status;
}

static char *trim(char *text) {
    while (isspace((unsigned char)*text))
        text++;
    char *end = text + strlen(text);
    while (end > text && isspace((unsigned char)end[-1]))
        *--end = '\0';
    return text;
}

static enum rn_status read_line(struct rn_config *config, char *line, const char *where,
                                bool *has_roots, struct rn_error *err) {
    line = trim(line);
    if (*line == '\0' || *line == '#') return RN_OK;
    char *equals = strchr(line, '=');
    if (equals == NULL) return rn_error_set(err, RN_ERROR_INVALID, where, "write 'name = value'");
    *equals = '\0';
    char *name = trim(line), *value = trim(equals + 1);
    const struct option *option = find(name, strlen(name));
    if (option == NULL || option->kind == KIND_FLAG || strcmp(name, "config") == 0)
        return rn_error_set(err, RN_ERROR_INVALID, where, "unknown option '%.40s'", name);
    if (option->kind == KIND_ROOT && !*has_roots) {
        clear_roots(config);
        *has_roots = true;
    }
    return set(config, option, value, where, err);
}

static enum rn_status read_file(struct rn_config *config, const char *path, struct rn_error *err) {
    uint8_t *bytes = NULL;
    size_t size;
    bool has_roots = false;
    enum rn_status status = rn_file_read(path, MAX_CONFIG_BYTES, &bytes, &size, err);
    char *line = (char *)bytes;
    for (int number = 1; status == RN_OK && line != NULL; number++) {
        char *next = strchr(line, '\n'), where[256];
        if (next != NULL) *next++ = '\0';
        snprintf(where, sizeof where, "%.240s:%d", path, number);
        status = read_line(config, line, where, &has_roots, err);
        line = next;
    }
    free(bytes);
    return status;
}

static void variable_name(const struct option *option, char name[64]) {
    int size = snprintf(name, 64, "RIPNERFD_%s", option->name);
    for (int i = 0; i < size; i++)
        name[i] = name[i] == '-' ? '_' : (char)toupper((unsigned char)name[i]);
}

static enum rn_status read_roots(struct rn_config *config, const char *value, const char *where,
                                 struct rn_error *err) {
    char *copy = strdup(value), *rest = copy, *root;
    if (copy == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, where, "no memory");
    enum rn_status status = RN_OK;
    clear_roots(config);
    while (status == RN_OK && (root = strsep(&rest, ":")) != NULL)
        if (*root != '\0') status = add_root(config, root, where, err);
    free(copy);
    return status;
}

static enum rn_status read_environment(struct rn_config *config,
                                       const char *(*get_env)(const char *), struct rn_error *err) {
    enum rn_status status = RN_OK;
    for (size_t i = 0; status == RN_OK && i < OPTION_COUNT; i++) {
        char name[64];
        variable_name(&options[i], name);
        const char *value = get_env(name);
        if (value == NULL || options[i].kind == KIND_FLAG) continue;
        status = options[i].kind == KIND_ROOT ? read_roots(config, value, name, err)
                                              : set(config, &options[i], value, name, err);
    }
    return status;
}

// One flag at argv[*i], its value in the same word or the next.
static enum rn_status read_flag(struct rn_config *config, int argc, char **argv, int *i,
                                bool *has_roots, struct rn_error *err) {
    const char *word = argv[*i];
    if (strncmp(word, "--", 2) != 0)
        return rn_error_set(err, RN_ERROR_INVALID, word, "not an option; see ripnerfd --help");
    size_t size = strcspn(word + 2, "=");
    const struct option *option = find(word + 2, size);
    if (option == NULL)
        return rn_error_set(err, RN_ERROR_INVALID, word, "unknown option; see ripnerfd --help");
    const char *value = word[2 + size] == '=' ? word + 3 + size : NULL;
    if (option->kind == KIND_FLAG && value != NULL)
        return rn_error_set(err, RN_ERROR_INVALID, word, "this option takes no value");
    if (option->kind != KIND_FLAG && value == NULL) {
        if (*i + 1 == argc)
            return rn_error_set(err, RN_ERROR_INVALID, word, "the value %s is missing",
                                option->value);
        value = argv[++*i];
    }
    if (option->kind == KIND_ROOT && !*has_roots) {
        clear_roots(config);
        *has_roots = true;
    }
    return set(config, option, value, word, err);
}

static enum rn_status read_flags(struct rn_config *config, int argc, char **argv,
                                 struct rn_error *err) {
    enum rn_status status = RN_OK;
    bool has_roots = false;
    for (int i = 1; status == RN_OK && i < argc; i++)
        status = read_flag(config, argc, argv, &i, &has_roots, err);
    return status;
}

static enum rn_status split_listen(struct rn_config *config, struct rn_error *err) {
    const char *colon = strrchr(config->listen, ':');
    char *end = NULL;
    unsigned long port = colon != NULL ? strtoul(colon + 1, &end, 10) : 0;
    const char *start = config->listen;
    size_t size = colon != NULL ? (size_t)(colon - start) : 0;
    if (size >= 2 && start[0] == '[' && start[size - 1] == ']') {
        start++;
        size -= 2;
    }
    if (colon == NULL || end == colon + 1 || *end != '\0' || port > 65535 || size == 0 ||
        size >= sizeof config->address)
        return rn_error_set(err, RN_ERROR_INVALID, "listen",
                            "'%s' is not ADDR:PORT, such as 127.0.0.1:7400", config->listen);
    memcpy(config->address, start, size);
    config->address[size] = '\0';
    config->port = (uint16_t)port;
    return RN_OK;
}

static enum rn_status read_token(struct rn_config *config, struct rn_error *err) {
    if (config->token_file == NULL) {
        if (rn_guard_address_is_loopback(config->address)) return RN_OK;
        return rn_error_set(err, RN_ERROR_INVALID, "listen",
                            "%s is not loopback: give a token with --token-file", config->address);
    }
    struct stat about;
    if (stat(config->token_file, &about) == 0 && (about.st_mode & S_IROTH))
        return rn_error_set(err, RN_ERROR_INVALID, config->token_file,
                            "everyone can read the token; chmod 600 the file");
    uint8_t *bytes = NULL;
    size_t size;
    enum rn_status status = rn_file_read(config->token_file, 4096, &bytes, &size, err);
    if (status != RN_OK) return status;
    char *text = (char *)bytes;
    text[strcspn(text, "\r\n")] = '\0';
    if (strlen(text) < MIN_TOKEN || text[strspn(text, "!\"#$%&'()*+,-./0123456789:;<=>?@"
                                                      "ABCDEFGHIJKLMNOPQRSTUVWXYZ[\\]^_`"
                                                      "abcdefghijklmnopqrstuvwxyz{|}~")] != '\0')
        status = rn_error_set(err, RN_ERROR_INVALID, config->token_file,
                              "the first line must be a token of at least %d printable ASCII "
                              "characters without spaces",
                              MIN_TOKEN);
    else
        status = set_text(&config->token, text, err);
    free(bytes);
    return status;
}

// The file's name comes from the flags or the environment, its options count least.
static enum rn_status read_all(struct rn_config *config, int argc, char **argv,
                               const char *(*get_env)(const char *), struct rn_error *err) {
    enum rn_status status = read_flags(config, argc, argv, err);
    const char *path = config->config != NULL ? config->config : get_env("RIPNERFD_CONFIG");
    char *file = path != NULL ? strdup(path) : NULL;
    if (status == RN_OK && file != NULL) {
        rn_config_finish(config);
        status = set_defaults(config, err);
        if (status == RN_OK) status = read_file(config, file, err);
        if (status == RN_OK) status = read_environment(config, get_env, err);
        if (status == RN_OK) status = read_flags(config, argc, argv, err);
    } else if (status == RN_OK) {
        status = read_environment(config, get_env, err);
        if (status == RN_OK) status = read_flags(config, argc, argv, err);
    }
    free(file);
    return status;
}

enum rn_status rn_config_load(int argc, char **argv, const char *(*get_env)(const char *name),
                              struct rn_config *ret_config, struct rn_error *err) {
    struct rn_config config = {0};
    enum rn_status status = set_defaults(&config, err);
    if (status == RN_OK) status = read_all(&config, argc, argv, get_env, err);
    if (status == RN_OK && !config.help && !config.version) {
        if (config.data == NULL || config.data[0] == '\0')
            status = rn_error_set(err, RN_ERROR_INVALID, "data", "give a folder with --data DIR");
        if (status == RN_OK) status = split_listen(&config, err);
        if (status == RN_OK) status = read_token(&config, err);
    }
    if (status == RN_OK)
        *ret_config = config;
    else
        rn_config_finish(&config);
    return status;
}

void rn_config_finish(struct rn_config *config) {
    clear_roots(config);
    for (size_t i = 0; i < OPTION_COUNT; i++)
        if (options[i].kind == KIND_TEXT)
            free(*(char **)(void *)((char *)config + options[i].offset));
    free(config->token);
    *config = (struct rn_config){0};
}

enum { LEFT = 24, COLUMN = LEFT + 4, WIDTH = 80 };

// Words in 80 columns, from `column` on; further lines begin at `indent`.
static void put_words(struct rn_buf *text, const char *words, int column, int indent) {
    for (const char *word = words; *word;) {
        int size = (int)strcspn(word, " ");
        bool first = word == words, wraps = !first && column + 1 + size > WIDTH;
        rn_buf_printf(text, "%s%*s%.*s", wraps ? "\n" : "", wraps ? indent : !first, "", size,
                      word);
        column = wraps ? indent + size : column + !first + size;
        word += size + (word[size] == ' ');
    }
    rn_buf_printf(text, "\n");
}

char *rn_config_help(void) {
    struct rn_buf text;
    size_t size;
    rn_buf_init(&text, 64u << 10);
    rn_buf_printf(&text, "usage: ripnerfd --data DIR [OPTION]...\n\n"
                         "Trains and renders radiance fields; HTTP/JSON on --listen.\n\n");
    for (size_t i = 0; i < OPTION_COUNT; i++) {
        const struct option *option = &options[i];
        const char *initial = option->initial;
        char flag[64], help[256];
        snprintf(flag, sizeof flag, "--%s %s", option->name, option->value);
        snprintf(help, sizeof help, "%s%s%s%s", option->help, initial ? " (" : "",
                 initial ? initial : "", initial ? ")" : "");
        rn_buf_printf(&text, "  %-*s  ", LEFT, flag);
        put_words(&text, help, COLUMN, COLUMN);
    }
    rn_buf_printf(&text, "\n");
    put_words(&text,
              "Every option may also stand in the --config file (name = value) or in the "
              "environment (RIPNERFD_NAME); flags win over the environment, that over the file.",
              0, 0);
    return (char *)rn_buf_take(&text, &size);
}

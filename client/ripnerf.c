// ripnerf: the command line of a ripnerfd.

#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "client/client.h"
#include "client/completion.h"
#include "client/nearest.h"
#include "common/base/file.h"

#define TOKEN_MAX 4096

struct globals {
    const char *host, *token_file;
    bool json, help, version;
};

static const struct rn_option global_table[] = {
    {.name = "host",
     .kind = RN_OPTION_TEXT,
     .offset = offsetof(struct globals, host),
     .value = "HOST",
     .help = "the daemon's URL or HOST[:PORT]; else RIPNERF_HOST, else " RN_HTTP_DEFAULT_HOST},
    {.name = "token-file",
     .kind = RN_OPTION_TEXT,
     .offset = offsetof(struct globals, token_file),
     .value = "FILE",
     .help = "holds the daemon's token; else RIPNERF_TOKEN is the token"},
    {.name = "json",
     .kind = RN_OPTION_FLAG,
     .offset = offsetof(struct globals, json),
     .help = "results as JSON on standard output, errors on standard error"},
    {.name = "help",
     .letter = 'h',
     .kind = RN_OPTION_FLAG,
     .offset = offsetof(struct globals, help),
     .help = "explain the verb"},
    {.name = "version",
     .kind = RN_OPTION_FLAG,
     .offset = offsetof(struct globals, version),
     .help = "this program's version"},
    {0}};

extern const struct rn_verb rn_verbs_completion[];
static const struct rn_verb *const groups[] = {
    rn_verbs_dataset, rn_verbs_job,     rn_verbs_scene,  rn_verbs_render,    rn_verbs_path,
    rn_verbs_curve,   rn_verbs_effects, rn_verbs_ladder, rn_verbs_export,    rn_verbs_token,
    rn_verbs_backup,  rn_verbs_bench,   rn_verbs_doctor, rn_verbs_completion};
#define GROUP_COUNT (sizeof groups / sizeof *groups)

static enum rn_exit run_completion(struct rn_client *client, const void *options,
                                   const char **args) {
    (void)client;
    (void)options;
    if (rn_completion_print(args[0], groups, GROUP_COUNT, global_table)) return RN_EXIT_OK;
    return rn_client_usage(args[0], "must be bash, zsh or fish");
}

static const struct rn_option no_options[] = {{0}};
const struct rn_verb rn_verbs_completion[] = {
    {.name = "completion",
     .arguments = "bash|zsh|fish",
     .summary = "a shell's completions of verbs and options",
     .details =
         "For bash: source <(ripnerf completion bash). For zsh: write it to _ripnerf in a folder "
         "of $fpath. For fish: ripnerf completion fish | source.",
     .args_min = 1,
     .args_max = 1,
     .table = no_options,
     .local = true,
     .run = run_completion},
    {0}};

static const struct rn_verb *find_verb(const char *name) {
    for (size_t i = 0; i < GROUP_COUNT; i++)
        for (const struct rn_verb *verb = groups[i]; verb->name; verb++)
            if (strcmp(verb->name, name) == 0) return verb;
    return NULL;
}

static enum rn_exit complain_of_verb(const char *name) {
    struct rn_nearest nearest = {.word = name, .size = strlen(name)};
    for (size_t i = 0; i < GROUP_COUNT; i++)
        for (const struct rn_verb *verb = groups[i]; verb->name; verb++)
            rn_nearest_try(&nearest, verb->name);
    rn_nearest_try(&nearest, "help");
    if (nearest.name)
        return rn_client_usage(name, "there is no such verb; did you mean %s?", nearest.name);
    return rn_client_usage(name, "there is no such verb; see ripnerf help");
}

// "NAME and DIR": the words of a verb's arguments that `count` of them leave open.
static enum rn_exit complain_of_missing(const struct rn_verb *verb, size_t count) {
    char text[80] = "";
    const char *word = verb->arguments;
    for (size_t i = 0; i < verb->args_min && *word; i++) {
        size_t used = strlen(text), size = strcspn(word, " ");
        if (i >= count)
            snprintf(text + used, sizeof text - used, "%s%.*s", used ? " and " : "", (int)size,
                     word);
        word += size + strspn(word + size, " ");
    }
    return rn_client_usage(verb->name, "needs %s: ripnerf %s %s", text, verb->name,
                           verb->arguments);
}

static void print_overview(void) {
    puts("ripnerf: radiance fields from posed photographs, made and shown by ripnerfd\n\n"
         "usage: ripnerf [options] VERB ...\n");
    for (size_t i = 0; i < GROUP_COUNT; i++) {
        for (const struct rn_verb *verb = groups[i]; verb->name; verb++) {
            char left[48];
            snprintf(left, sizeof left, "%s %s", verb->name, verb->arguments);
            printf("  %-26s  ", left);
            rn_options_print_text(verb->summary, 30, 30);
        }
        putchar('\n');
    }
    puts("  help VERB                   what a verb does and its options\n\noptions");
    rn_options_print(global_table);
    putchar('\n');
    rn_options_print_text(
        "Datasets, scenes and jobs go by id; datasets and scenes also by name. A verb "
        "for a job takes a scene too and means the job that trains it.\n\n"
        "Exit codes: 0 ok, 1 failed, 2 usage, 3 not found, 4 validation failed, "
        "5 cancelled, 6 daemon unreachable, 7 unauthorised.",
        0, 0);
}

static void print_verb(const struct rn_verb *verb) {
    printf("usage: ripnerf %s%s%s%s\n\n", verb->name, *verb->arguments ? " " : "", verb->arguments,
           verb->table->name ? " [options]" : "");
    rn_options_print_text(verb->summary, 0, 0);
    if (verb->details) {
        putchar('\n');
        rn_options_print_text(verb->details, 0, 0);
    }
    if (verb->table->name) {
        puts("\noptions");
        rn_options_print(verb->table);
    }
    puts("\noptions of every verb");
    rn_options_print(global_table);
}

static enum rn_exit help(const char *name) {
    const struct rn_verb *verb = name ? find_verb(name) : NULL;
    if (name && !verb && strcmp(name, "help") != 0) return complain_of_verb(name);
    if (verb)
        print_verb(verb);
    else
        print_overview();
    return RN_EXIT_OK;
}

// The token of --token-file (its first line) or of RIPNERF_TOKEN, into a buffer of TOKEN_MAX.
static enum rn_status read_token(const char *file, char *ret_token, struct rn_error *err) {
    const char *environment = getenv("RIPNERF_TOKEN");
    if (!file) {
        if (environment && strlen(environment) >= TOKEN_MAX)
            return rn_error_set(err, RN_ERROR_LIMIT, "RIPNERF_TOKEN", "is too long");
        snprintf(ret_token, TOKEN_MAX, "%s", environment ? environment : "");
        return RN_OK;
    }
    uint8_t *bytes = NULL;
    size_t size = 0;
    enum rn_status status = rn_file_read(file, TOKEN_MAX - 1, &bytes, &size, err);
    if (status != RN_OK) return status;
    size_t end = strcspn((char *)bytes, "\r\n");
    memcpy(ret_token, bytes, end);
    ret_token[end] = '\0';
    free(bytes);
    if (!end) return rn_error_set(err, RN_ERROR_INVALID, file, "holds no token in its first line");
    return RN_OK;
}

static enum rn_exit run_verb(const struct rn_verb *verb, const struct globals *globals,
                             const void *options, const char **args) {
    struct rn_error err = {0};
    struct rn_client client = {.json = globals->json};
    rn_client_errors_of(verb);
    const char *host = globals->host ? globals->host : getenv("RIPNERF_HOST");
    char token[TOKEN_MAX];
    if (!verb->local) {
        // A token that cannot be read is the command line's mistake, whatever the file's trouble.
        if (read_token(globals->token_file, token, &err) != RN_OK ||
            rn_http_create(host && *host ? host : RN_HTTP_DEFAULT_HOST, *token ? token : NULL,
                           &client.http, &err) != RN_OK)
            return rn_client_usage(err.where, "%s", err.text);
    }
    enum rn_exit code = verb->run(&client, options, args);
    rn_http_destroy(&client.http);
    return code;
}

// Also where the rest of the command line is not understood.
static bool wants_json(int argc, char **argv) {
    for (int i = 1; i < argc && strcmp(argv[i], "--") != 0; i++)
        if (strcmp(argv[i], "--json") == 0) return true;
    return false;
}

// The verb is the first argument that is neither an option nor a global option's value.
static int find_verb_word(int argc, char **argv) {
    for (int i = 1; i < argc; i++) {
        if (argv[i][0] != '-') return i;
        if (strcmp(argv[i], "--host") == 0 || strcmp(argv[i], "--token-file") == 0) i++;
    }
    return argc;
}

// `verb`: which argument `word` names, or NULL; `options`: room for its options.
static enum rn_exit run(int argc, char **argv, int word, const struct rn_verb *verb,
                        void *options) {
    struct globals globals = {0};
    struct rn_error err = {0};
    static const struct rn_option none[] = {{0}};
    const char *args[RN_VERB_MAX_ARGS + 2];
    size_t count = 0;
    bool is_help = word < argc && strcmp(argv[word], "help") == 0;
    if (word < argc && !verb && !is_help) return complain_of_verb(argv[word]);
    // What stands before the verb are global options; the verb's own follow it.
    struct rn_option_tables tables = {.table = verb ? verb->table : none,
                                      .global_table = global_table,
                                      .options = options,
                                      .globals = &globals};
    rn_options_clear(tables.table, options);
    memmove(argv + 1 + (word < argc), argv + 1, (size_t)(word - 1) * sizeof *argv);
    if (rn_options_parse(&tables, argc - 1 - (word < argc), argv + 1 + (word < argc),
                         verb ? verb->args_max : 1, args, &count, &err) != RN_OK)
        return rn_client_usage(err.where, "%s", err.text);
    if (globals.version) {
        puts("ripnerf " RN_VERSION);
        return RN_EXIT_OK;
    }
    if (!verb && !is_help && !globals.help && globals.json)
        return rn_client_usage("ripnerf", "needs a verb; see ripnerf help");
    if (is_help || globals.help || !verb)
        return is_help || globals.help ? help(verb ? verb->name : args[0])
                                       : (print_overview(), RN_EXIT_USAGE);
    if (count < verb->args_min) return complain_of_missing(verb, count);
    return run_verb(verb, &globals, options, args);
}

// A standard stream that is closed would be the next socket, and what is printed go there.
static void fill_standard_streams(void) {
    int fd;
    while ((fd = open("/dev/null", O_RDONLY)) >= 0 && fd <= STDERR_FILENO)
        continue;
    if (fd >= 0) close(fd);
}

int main(int argc, char **argv) {
    fill_standard_streams();
    signal(SIGPIPE, SIG_IGN);
    if (wants_json(argc, argv)) rn_client_errors_as_json();
    int word = find_verb_word(argc, argv);
    const struct rn_verb *verb = word < argc ? find_verb(argv[word]) : NULL;
    void *options = calloc(1, verb && verb->options_size ? verb->options_size : 1);
    if (!options) return rn_client_error(RN_EXIT_FAILED, "", "out of memory");
    enum rn_exit code = run(argc, argv, word, verb, options);
    free(options);
    if (fflush(stdout) == 0 && !ferror(stdout)) return code;
    return rn_client_error(code == RN_EXIT_OK ? RN_EXIT_FAILED : code, "standard output",
                           "cannot be written");
}

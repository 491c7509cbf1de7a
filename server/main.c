// ripnerfd: the control plane. Start: options, records, supervision, HTTP. Stop, on SIGTERM or
// SIGINT: refuse requests, let runners save, close; a second signal ends the process at once.
#include <errno.h>
#include <libgen.h>
#include <limits.h>
#include <signal.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/log.h"
#include "common/image/lpips.h"
#include "server/api/app.h"
#include "server/config.h"
#include "server/slurm/slurm.h"
#include "server/store/scrub.h"

#define HTTP_DRAIN_MS 1000

struct server {
    struct rn_config config;
    struct rn_store *store;
    struct rn_executor *executor;
    struct rn_control *control;
    struct rn_scrubber *scrubber;
    struct rn_app app;
    char web[PATH_MAX], runner[PATH_MAX];
};

static const char *get_env(const char *name) {
    return getenv(name);
}

static void exit_now(int signal_number) {
    _exit(128 + signal_number);
}

static void block_signals(sigset_t *ret_set) {
    sigemptyset(ret_set);
    sigaddset(ret_set, SIGTERM);
    sigaddset(ret_set, SIGINT);
    pthread_sigmask(SIG_BLOCK, ret_set, NULL);
    signal(SIGPIPE, SIG_IGN);
}

// From here on a signal ends the process.
static void arm_second_signal(const sigset_t *set) {
    struct sigaction action = {.sa_handler = exit_now};
    sigaction(SIGTERM, &action, NULL);
    sigaction(SIGINT, &action, NULL);
    pthread_sigmask(SIG_UNBLOCK, set, NULL);
}

// A connection, a spooled body and a picture may each hold a descriptor.
static void raise_file_limit(void) {
    struct rlimit limit;
    if (getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
    limit.rlim_cur = limit.rlim_max;
    if (setrlimit(RLIMIT_NOFILE, &limit) != 0)
        rn_log(RN_LOG_WARN, "the limit of open files stays low: %s", strerror(errno));
}

static bool own_folder(char folder[PATH_MAX]) {
    ssize_t size = readlink("/proc/self/exe", folder, PATH_MAX - 1);
    if (size <= 0) return false;
    folder[size] = '\0';
    dirname(folder);
    return true;
}

// The first of the candidates that is there; `target` holds the last one otherwise.
static void find_file(const char *given, const char *const *candidates, char target[PATH_MAX]) {
    char folder[PATH_MAX] = "";
    if (given != NULL) {
        snprintf(target, PATH_MAX, "%s", given);
        return;
    }
    if (!own_folder(folder)) folder[0] = '\0';
    for (; *candidates != NULL; candidates++) {
        bool absolute = (*candidates)[0] == '/';
        int size = snprintf(target, PATH_MAX, "%s%s%s", absolute ? "" : folder, absolute ? "" : "/",
                            *candidates);
        if (size < PATH_MAX && access(target, F_OK) == 0) return;
    }
}

static void find_files(struct server *server) {
    static const char *const runners[] = {"ripnerf-runner", "../libexec/ripnerf/ripnerf-runner",
                                          NULL};
    static const char *const webs[] = {"../share/ripnerf/web/index.html",
                                       RN_SOURCE_WEB "/index.html", NULL};
    find_file(server->config.runner, runners, server->runner);
    find_file(NULL, webs, server->web);
    dirname(server->web);
    if (server->config.web != NULL)
        snprintf(server->web, sizeof server->web, "%s", server->config.web);
}

// Of --web; where the page is not found by itself, the daemon goes without.
static enum rn_status check_web(const struct server *server, struct rn_error *err) {
    char page[PATH_MAX + 16];
    snprintf(page, sizeof page, "%s/index.html", server->web);
    if (server->config.web == NULL || access(page, R_OK) == 0) return RN_OK;
    return rn_error_set(err, RN_ERROR_NOT_FOUND, "web",
                        "there is no %s; leave --web out for the page "
                        "that came with the daemon",
                        page);
}

static enum rn_status set_log_level(const char *name, struct rn_error *err) {
    static const char *const names[] = {"error", "warn", "info", "debug", NULL};
    int level = rn_name_index(names, name);
    if (level < 0)
        return rn_error_set(err, RN_ERROR_INVALID, "log-level",
                            "'%s' is not error, warn, info or debug", name);
    rn_log_set_level((enum rn_log_level)level);
    return RN_OK;
}

static enum rn_status set_log_format(const char *name, struct rn_error *err) {
    if (strcmp(name, "json") == 0)
        rn_log_set_json();
    else if (strcmp(name, "text") != 0)
        return rn_error_set(err, RN_ERROR_INVALID, "log-format", "'%s' is not text or json", name);
    return RN_OK;
}

// Tells the service manager that started this process, if one did (sd_notify(3)).
static void notify(const char *state) {
    const char *path = getenv("NOTIFY_SOCKET");
    struct sockaddr_un address = {.sun_family = AF_UNIX};
    size_t size = path != NULL ? strlen(path) : 0;
    if (size < 2 || size >= sizeof address.sun_path) return;
    memcpy(address.sun_path, path, size);
    if (address.sun_path[0] == '@') address.sun_path[0] = '\0'; // an abstract one
    int fd = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    socklen_t length = (socklen_t)(offsetof(struct sockaddr_un, sun_path) + size);
    if (fd < 0 ||
        sendto(fd, state, strlen(state), MSG_NOSIGNAL, (struct sockaddr *)&address, length) < 0)
        rn_log(RN_LOG_WARN, "the service manager cannot be told: %s", strerror(errno));
    if (fd >= 0) close(fd);
}

static bool is_idle(void *context) {
    struct rn_control_stats stats;
    rn_control_stats(context, &stats);
    return stats.jobs_open[RN_JOB_RUNNING] == 0 && stats.renders_waiting == 0;
}

// Names the weights of LPIPS to the runners, after a look at the file.
static enum rn_status offer_lpips(const char *path, struct rn_error *err) {
    struct rn_lpips *lpips;
    if (!path) return RN_OK;
    enum rn_status status = rn_lpips_open(path, &lpips, err);
    if (status) return status;
    rn_lpips_close(&lpips);
    char *whole = realpath(path, NULL);
    if (!whole || setenv(RN_LPIPS_VARIABLE, whole, 1) != 0)
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, path, "out of memory");
    free(whole);
    return status;
}

static enum rn_status create_executor(struct server *server, struct rn_error *err) {
    const struct rn_config *config = &server->config;
    bool is_slurm = strcmp(config->executor, "slurm") == 0, sandbox = config->sandbox != 0;
    if (!is_slurm && strcmp(config->executor, "local") != 0)
        return rn_error_set(err, RN_ERROR_INVALID, "executor", "'%s' is not local or slurm",
                            config->executor);
    enum rn_status status =
        rn_local_executor_create(server->runner, sandbox, &server->executor, err);
    if (status != RN_OK || !is_slurm) return status;
    const struct rn_slurm_options options = {.data = config->data,
                                             .shared = config->shared,
                                             .cache = config->slurm_cache,
                                             .cache_bytes = config->slurm_cache_bytes,
                                             .runner = server->runner,
                                             .listen = config->slurm_listen,
                                             .partition = config->slurm_partition,
                                             .account = config->slurm_account,
                                             .flags = config->slurm_flags,
                                             .time_s = config->slurm_time_s,
                                             .gpus = config->slurm_gpus,
                                             .memory_bytes = config->slurm_memory_bytes,
                                             .threads = (int)config->threads,
                                             .sandbox = sandbox};
    return rn_slurm_executor_create(&options, server->executor, &server->executor, err);
}

static enum rn_status start_control(struct server *server, struct rn_error *err) {
    const struct rn_config *config = &server->config;
    struct rn_control_options options = {
        .training_slots = (int)config->training_slots,
        .max_queued = (int)config->max_queued,
        .max_loaded = (int)config->max_loaded,
        .memory_limit_bytes = config->memory_limit_bytes,
        .gpu_memory_bytes = config->gpu_memory_bytes,
        .gpu_deterministic = config->gpu_deterministic != 0,
        .keep_alive_s = config->keep_alive_s,
        .curve_after_s = config->curve_after_s,
        .runner_timeout_s = config->runner_timeout_s,
        .retain_pictures_s = config->retain_pictures_s,
        .retain_bytes = config->retain_bytes,
        .threads = (int)config->threads,
        .path_runners = (int)config->slurm_path_runners,
        .max_upload_bytes = config->max_upload_bytes,
        .max_upload_entries = config->max_upload_entries,
        .max_frames = config->max_frames,
        .max_pixels = config->max_pixels,
        .import_time_s = config->import_time_s,
        .version = RN_VERSION,
    };
    enum rn_status status = offer_lpips(config->lpips, err);
    if (status == RN_OK) status = rn_store_open(config->data, config->rebuild, &server->store, err);
    if (status == RN_OK) status = rn_store_sweep(server->store, err);
    if (status == RN_OK) status = create_executor(server, err);
    if (status == RN_OK)
        status =
            rn_control_create(&options, server->store, server->executor, &server->control, err);
    if (status == RN_OK)
        status = rn_scrubber_start(config->data, config->scrub_interval_s, is_idle, server->control,
                                   &server->scrubber, err);
    return status;
}

static enum rn_status start_http(struct server *server, struct rn_error *err) {
    const struct rn_config *config = &server->config;
    server->app = (struct rn_app){
        .store = server->store,
        .control = server->control,
        .scrubber = server->scrubber,
        .web = server->web,
        .roots = (const char *const *)config->roots,
        .root_count = (size_t)config->root_count,
        .memory_limit_bytes = config->memory_limit_bytes,
        .max_upload_bytes = config->max_upload_bytes,
        .max_upload_entries = config->max_upload_entries,
        .training_slots = config->training_slots,
        .max_queued = config->max_queued,
        .max_loaded = config->max_loaded,
        .max_streams = config->max_connections > 512 ? (unsigned)config->max_connections / 2 : 256,
        .start_ns = rn_clock_ns(),
    };
    const struct rn_access_options access = {.own_token = config->token,
                                             .max_rate = config->max_rate,
                                             .quota_jobs = config->quota_jobs,
                                             .quota_bytes = config->quota_bytes};
    struct rn_http_options options = {
        .address = config->address,
        .port = config->port,
        .token_needed = config->token != NULL,
        .authorise = rn_access_authorise,
        .stays = rn_access_stays,
        .routes = rn_api_routes,
        .context = &server->app,
        .max_connections = (unsigned)config->max_connections,
        .max_per_address = (unsigned)config->max_per_address,
        .header_timeout_s = (int)config->header_timeout_s,
        .least_rate = config->least_rate,
        .max_answer_bytes = (uint64_t)config->answer_bytes,
        .audit = config->audit,
    };
    enum rn_status status = rn_access_create(&access, server->store, &server->app.access, err);
    return status == RN_OK ? rn_http_start(&options, &server->app.http, err) : status;
}

static void stop(struct server *server) {
    rn_scrubber_stop(&server->scrubber);
    if (server->app.http != NULL) rn_http_drain(server->app.http, HTTP_DRAIN_MS);
    if (server->control != NULL) rn_control_drain(server->control, server->config.drain_s * 1000);
    rn_backup_settle(&server->app);
    rn_adoption_stop(&server->app);
    rn_http_destroy(&server->app.http);
    rn_backup_stop(&server->app);
    if (server->control != NULL) rn_control_destroy(&server->control);
    if (server->executor != NULL) server->executor->destroy(server->executor);
    rn_store_close(&server->store);
    rn_app_finish(&server->app);
    rn_config_finish(&server->config);
}

static void announce(const struct server *server) {
    bool v6 = strchr(server->config.address, ':') != NULL;
    printf("ripnerfd: listening on http://%s%s%s:%u\n", v6 ? "[" : "", server->config.address,
           v6 ? "]" : "", rn_http_port(server->app.http));
    fflush(stdout);
    notify("READY=1");
}

static int print_help(void) {
    char *text = rn_config_help();
    if (text != NULL) fputs(text, stdout);
    free(text);
    return text == NULL;
}

static int complain(const struct rn_error *err) {
    fprintf(stderr, "ripnerfd: %s%s%s\n", err->where, err->where[0] != '\0' ? ": " : "", err->text);
    return err->status == RN_ERROR_INVALID ? 2 : 1;
}

// By hand, beside a daemon or without one: 0 when all is as it was written.
static int scrub(struct server *server) {
    struct rn_scrub_result result;
    struct rn_error err;
    char layout[PATH_MAX];
    snprintf(layout, sizeof layout, "%s/layout", server->config.data);
    if (access(layout, F_OK) != 0) {
        rn_error_set(&err, RN_ERROR_NOT_FOUND, server->config.data,
                     "there is no data folder of ripnerfd: nothing was checked");
        return complain(&err);
    }
    rn_scrub(server->config.data, NULL, NULL, &result);
    printf("%llu checked, %llu damaged", (unsigned long long)result.checked,
           (unsigned long long)result.damaged);
    if (result.unread > 0) printf(", %llu cannot be read", (unsigned long long)result.unread);
    puts("");
    return result.damaged + result.unread > 0;
}

int main(int argc, char **argv) {
    static struct server server;
    struct rn_error err = {0};
    sigset_t signals;
    int signal_number = 0;
    if (rn_config_load(argc, argv, get_env, &server.config, &err) != RN_OK) return complain(&err);
    if (server.config.help) return print_help();
    if (server.config.version) {
        puts("ripnerfd " RN_VERSION);
        return 0;
    }
    umask(0077); // what is stored is the daemon's alone
    if (server.config.scrub) return scrub(&server);
    block_signals(&signals);
    raise_file_limit();
    find_files(&server);
    enum rn_status status = check_web(&server, &err);
    if (status == RN_OK) status = set_log_level(server.config.log_level, &err);
    if (status == RN_OK) status = set_log_format(server.config.log_format, &err);
    if (status == RN_OK) status = start_control(&server, &err);
    if (status == RN_OK) status = start_http(&server, &err);
    if (status != RN_OK) {
        stop(&server);
        return complain(&err);
    }
    announce(&server);
    sigwait(&signals, &signal_number);
    rn_log(RN_LOG_INFO, "stopping: %s", strsignal(signal_number));
    notify("STOPPING=1");
    arm_second_signal(&signals);
    stop(&server);
    return 0;
}

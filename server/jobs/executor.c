#include "server/jobs/executor.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

extern char **environ;

#define CHILD_FD 3
#define CHILD_FD_TEXT "3"
// How long a runner that closed its connection may take to end by itself.
#define GRACE_MS 200

struct local {
    struct rn_executor base;
    char *program;
    bool sandbox;
};

// What a runner may know of the daemon's environment: settings of ours, of GPUs, of the loader and
// of sanitizers. A client's token is none.
static bool is_passed_on(const char *variable) {
    static const char *const prefixes[] = {"RIPNERF_", "CUDA_", "NVIDIA_", "LD_",     "ASAN_",
                                           "UBSAN_",   "TSAN_", "LSAN_",   "MALLOC_", "PATH="};
    if (strncmp(variable, "RIPNERF_TOKEN", 13) == 0) return false;
    for (size_t i = 0; i < sizeof prefixes / sizeof prefixes[0]; i++)
        if (strncmp(variable, prefixes[i], strlen(prefixes[i])) == 0) return true;
    return false;
}

static char **make_environment(void) {
    size_t count = 0, kept = 0;
    while (environ[count] != NULL)
        count++;
    char **made = calloc(count + 1, sizeof *made);
    for (size_t i = 0; made != NULL && i < count; i++)
        if (is_passed_on(environ[i])) made[kept++] = environ[i];
    return made;
}

static int spawn(const struct local *local, const char *mode, const char *log_path, int fd,
                 pid_t *ret_pid) {
    const char *program = local->program;
    char *argv[] = {(char *)program,
                    "--mode",
                    (char *)mode,
                    "--fd",
                    CHILD_FD_TEXT,
                    local->sandbox ? "--sandbox" : NULL,
                    NULL};
    char **environment = make_environment();
    if (environment == NULL) return ENOMEM;
    posix_spawn_file_actions_t actions;
    posix_spawnattr_t attributes;
    sigset_t none, all;
    sigemptyset(&none);
    sigfillset(&all);
    posix_spawn_file_actions_init(&actions);
    posix_spawnattr_init(&attributes);
    posix_spawnattr_setsigmask(&attributes, &none);
    posix_spawnattr_setsigdefault(&attributes, &all);
    // Its own process group: a Ctrl-C at the terminal is for the daemon alone.
    posix_spawnattr_setpgroup(&attributes, 0);
    posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF |
                                              POSIX_SPAWN_SETPGROUP);
    int errnum = posix_spawn_file_actions_addopen(&actions, 0, "/dev/null", O_RDONLY, 0);
    if (errnum == 0) errnum = posix_spawn_file_actions_adddup2(&actions, 2, 1);
    if (errnum == 0 && log_path != NULL) {
        errnum = posix_spawn_file_actions_addopen(&actions, 2, log_path,
                                                  O_WRONLY | O_CREAT | O_APPEND, 0600);
        if (errnum == 0) errnum = posix_spawn_file_actions_adddup2(&actions, 2, 1);
    }
    if (errnum == 0) errnum = posix_spawn_file_actions_adddup2(&actions, fd, CHILD_FD);
    if (errnum == 0)
        errnum = posix_spawn(ret_pid, program, &actions, &attributes, argv, environment);
    posix_spawn_file_actions_destroy(&actions);
    posix_spawnattr_destroy(&attributes);
    free(environment);
    return errnum;
}

static enum rn_status local_start(struct rn_executor *executor, const struct rn_order *order,
                                  struct rn_process *ret_process, struct rn_error *err) {
    struct local *local = (struct local *)executor;
    int pair[2];
    if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair) != 0)
        return rn_error_from_errno(err, errno, local->program, "open a socket pair");
    // The child's end must not be CHILD_FD itself: dup2 to the same number keeps close-on-exec.
    int child = fcntl(pair[1], F_DUPFD_CLOEXEC, CHILD_FD + 1);
    int errnum = child < 0 ? errno : 0;
    pid_t pid = 0;
    if (errnum == 0 && fcntl(pair[0], F_SETFL, O_NONBLOCK) != 0) errnum = errno;
    if (errnum == 0) errnum = spawn(local, order->mode, order->log_path, child, &pid);
    close(pair[1]);
    if (child >= 0) close(child);
    if (errnum != 0) {
        close(pair[0]);
        return rn_error_from_errno(err, errnum, local->program, "start a runner");
    }
    *ret_process = (struct rn_process){.pid = pid, .fd = pair[0]};
    return RN_OK;
}

static void local_end(struct rn_executor *executor, const struct rn_process *process, bool now,
                      struct rn_ending *ret_ending) {
    char *ret_how = ret_ending->how;
    const size_t how_size = sizeof ret_ending->how;
    int status = 0;
    pid_t pid = 0;
    ret_ending->taken = false;
    for (int i = 0; !now && i < GRACE_MS / 5 && pid == 0; i++) {
        pid = waitpid(process->pid, &status, WNOHANG);
        if (pid == 0) nanosleep(&(struct timespec){.tv_nsec = 5000000}, NULL);
    }
    bool by_us = pid == 0;
    if (by_us) {
        kill(process->pid, SIGKILL);
        do
            pid = waitpid(process->pid, &status, 0);
        while (pid < 0 && errno == EINTR);
    }
    kill(-process->pid, SIGKILL); // programs that it started: its process group
    if (pid < 0)
        snprintf(ret_how, how_size, "lost: %s", strerror(errno));
    else if (WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL && !by_us)
        snprintf(ret_how, how_size,
                 "killed by signal 9 (Killed), as the kernel does where memory runs out: "
                 "ripnerfd --memory-limit refuses what is too large");
    else if (WIFSIGNALED(status))
        snprintf(ret_how, how_size, "killed by signal %d (%s)", WTERMSIG(status),
                 strsignal(WTERMSIG(status)));
    else
        snprintf(ret_how, how_size, "exit code %d", WEXITSTATUS(status));
}

// The resident set, as the kernel counts it.
static int64_t local_memory(struct rn_executor *executor, const struct rn_process *process) {
    char path[64];
    long long pages = 0, resident = 0;
    snprintf(path, sizeof path, "/proc/%d/statm", (int)process->pid);
    FILE *file = fopen(path, "re");
    if (file == NULL) return 0;
    if (fscanf(file, "%lld %lld", &pages, &resident) != 2) resident = 0;
    fclose(file);
    return (int64_t)resident * sysconf(_SC_PAGESIZE);
}

// From the state on, "R (running), parent, ...", of a process or thread: what its name may hold, a
// bracket too, comes before. False: it is gone.
static bool read_stat(const char *path, char *ret_state, int64_t *ret_used_ns) {
    char text[1024];
    unsigned long long user = 0, system = 0;
    FILE *file = fopen(path, "re");
    size_t size = file != NULL ? fread(text, 1, sizeof text - 1, file) : 0;
    if (file != NULL) fclose(file);
    text[size] = '\0';
    const char *rest = strrchr(text, ')');
    if (rest == NULL || sscanf(rest, ") %c %*d %*d %*d %*d %*d %*u %*u %*u %*u %*u %llu %llu",
                               ret_state, &user, &system) != 3)
        return false;
    *ret_used_ns =
        (int64_t)((user + system) * (1000000000ull / (unsigned long)sysconf(_SC_CLK_TCK)));
    return true;
}

static bool is_ready(pid_t pid) {
    char path[320];
    int64_t used_ns;
    bool ready = false;
    struct dirent *entry;
    snprintf(path, sizeof path, "/proc/%d/task", (int)pid);
    DIR *threads = opendir(path);
    while (threads != NULL && !ready && (entry = readdir(threads)) != NULL) {
        char state = '\0';
        snprintf(path, sizeof path, "/proc/%d/task/%s/stat", (int)pid, entry->d_name);
        ready = entry->d_name[0] != '.' && read_stat(path, &state, &used_ns) && state == 'R';
    }
    if (threads != NULL) closedir(threads);
    return ready;
}

static int64_t local_used(struct rn_executor *executor, const struct rn_process *process,
                          bool *ret_ready) {
    char path[64], state;
    int64_t used_ns;
    snprintf(path, sizeof path, "/proc/%d/stat", (int)process->pid);
    if (ret_ready != NULL) *ret_ready = is_ready(process->pid);
    return read_stat(path, &state, &used_ns) ? used_ns : -1;
}

static void local_hold(struct rn_executor *executor, const struct rn_process *process, bool held) {
    kill(process->pid, held ? SIGSTOP : SIGCONT);
}

static void local_destroy(struct rn_executor *executor) {
    struct local *local = (struct local *)executor;
    free(local->program);
    free(local);
}

enum rn_status rn_local_executor_create(const char *program, bool sandbox,
                                        struct rn_executor **ret_executor, struct rn_error *err) {
    struct local *local = calloc(1, sizeof *local);
    char *copy = strdup(program);
    if (local == NULL || copy == NULL) {
        free(local);
        free(copy);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "executor", "no memory");
    }
    local->base = (struct rn_executor){.start = local_start,
                                       .end = local_end,
                                       .hold = local_hold,
                                       .memory = local_memory,
                                       .used = local_used,
                                       .destroy = local_destroy};
    local->program = copy;
    local->sandbox = sandbox;
    *ret_executor = &local->base;
    return RN_OK;
}

#include "client/local.h"

#include <errno.h>
#include <fcntl.h>
#include <libgen.h>
#include <limits.h>
#include <spawn.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

extern char **environ;

#define REPORT_MAX (1 << 20)
#define COMPLAINT "ripnerf-runner: "

// The runner lies where the daemon looks for it: beside the programs of a build, or installed.
static enum rn_status find_runner(char ret_path[PATH_MAX], struct rn_error *err) {
    static const char *const places[] = {"../server/ripnerf-runner", "ripnerf-runner",
                                         "../libexec/ripnerf/ripnerf-runner"};
    char folder[PATH_MAX];
    ssize_t size = readlink("/proc/self/exe", folder, sizeof folder - 1);
    if (size <= 0) return rn_error_from_errno(err, errno, "/proc/self/exe", "read");
    folder[size] = '\0';
    dirname(folder);
    for (size_t i = 0; i < sizeof places / sizeof *places; i++)
        if (snprintf(ret_path, PATH_MAX, "%s/%s", folder, places[i]) < PATH_MAX &&
            access(ret_path, X_OK) == 0)
            return RN_OK;
    return rn_error_set(err, RN_ERROR_NOT_FOUND, "ripnerf-runner",
                        "is neither beside ripnerf nor in ../server or ../libexec/ripnerf");
}

// Starts the runner with its standard output in a pipe, its standard error in `said` unless < 0.
static enum rn_status start(const char *const *argv, int said, pid_t *ret_pid, int *ret_fd,
                            struct rn_error *err) {
    const char *runner = argv[0];
    posix_spawn_file_actions_t actions;
    int ends[2];
    if (pipe2(ends, O_CLOEXEC) != 0) return rn_error_from_errno(err, errno, runner, "make a pipe");
    posix_spawn_file_actions_init(&actions);
    int errnum = posix_spawn_file_actions_adddup2(&actions, ends[1], STDOUT_FILENO);
    if (errnum == 0 && said >= 0)
        errnum = posix_spawn_file_actions_adddup2(&actions, said, STDERR_FILENO);
    if (errnum == 0)
        errnum = posix_spawn(ret_pid, runner, &actions, NULL, (char *const *)argv, environ);
    posix_spawn_file_actions_destroy(&actions);
    close(ends[1]);
    if (errnum != 0) {
        close(ends[0]);
        return rn_error_from_errno(err, errnum, runner, "start");
    }
    *ret_fd = ends[0];
    return RN_OK;
}

static enum rn_status read_all(int fd, struct rn_buf *report, struct rn_error *err) {
    char part[4096];
    ssize_t size;
    while ((size = read(fd, part, sizeof part)) != 0) {
        if (size < 0 && errno == EINTR) continue;
        if (size < 0) return rn_error_from_errno(err, errno, "ripnerf-runner", "read");
        rn_buf_append(report, part, (size_t)size);
    }
    if (report->failed) return rn_error_set(err, RN_ERROR_LIMIT, "ripnerf-runner", "says too much");
    return RN_OK;
}

static enum rn_exit wait_for(pid_t pid) {
    int status = 0;
    while (waitpid(pid, &status, 0) < 0)
        if (errno != EINTR) return RN_EXIT_FAILED;
    if (!WIFEXITED(status))
        return rn_client_error(RN_EXIT_FAILED, "ripnerf-runner", "was killed by signal %d",
                               WTERMSIG(status));
    int code = WEXITSTATUS(status); // this program's
    return code <= RN_EXIT_INVALID ? (enum rn_exit)code : RN_EXIT_FAILED;
}

// What the runner complained of last, "ripnerf-runner: WHERE: TEXT", as an error of this program.
static void complain(int said, enum rn_exit code) {
    char text[4096], *line, *rest = text, *where = NULL;
    off_t end = lseek(said, 0, SEEK_END), begin = end - (off_t)sizeof text + 1;
    ssize_t size = pread(said, text, sizeof text - 1, begin > 0 ? begin : 0);
    text[size > 0 ? size : 0] = '\0';
    while ((line = strsep(&rest, "\n")))
        if (strncmp(line, COMPLAINT, strlen(COMPLAINT)) == 0) where = line + strlen(COMPLAINT);
    char *colon = where ? strstr(where, ": ") : NULL;
    if (!colon) return;
    *colon = '\0';
    rn_client_error(code, where, "%s", colon + 2);
}

static enum rn_exit run(const char *const *argv, int said, struct rn_buf *report) {
    struct rn_error err = {0};
    pid_t pid = 0;
    int fd = -1;
    enum rn_status status = start(argv, said, &pid, &fd, &err);
    if (status != RN_OK) return rn_client_fail(&err);
    status = read_all(fd, report, &err);
    close(fd);
    enum rn_exit code = wait_for(pid);
    if (code != RN_EXIT_OK && said >= 0) complain(said, code);
    if (status == RN_OK) return code;
    report->size = 0;
    return rn_client_fail(&err);
}

enum rn_exit rn_local_run(const char **argv, bool quiet, struct rn_buf *report) {
    char runner[PATH_MAX];
    struct rn_error err = {0};
    rn_buf_init(report, REPORT_MAX);
    if (find_runner(runner, &err) != RN_OK) return rn_client_fail(&err);
    argv[0] = runner;
    int said = quiet ? memfd_create("said", MFD_CLOEXEC) : -1;
    enum rn_exit code = run(argv, said, report);
    if (said >= 0) close(said);
    return code;
}

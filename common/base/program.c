#include "common/base/program.h"

#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#define MAX_ARGUMENTS 64
#define POLL_MS 100
#define LINE_BYTES 512

const char *rn_program_find(const char *name) {
    static const char *const folders[] = {"/usr/local/bin", "/usr/bin", "/bin", NULL};
    static char path[PATH_MAX];
    char variable[64];
    if (strchr(name, '/')) return access(name, X_OK) == 0 ? name : NULL;
    snprintf(variable, sizeof variable, "RIPNERF_%s", name);
    for (char *c = variable; *c; c++)
        *c = (char)toupper((unsigned char)*c);
    const char *given = getenv(variable);
    if (given) return access(given, X_OK) == 0 ? given : NULL;
    for (size_t i = 0; folders[i]; i++) {
        snprintf(path, sizeof path, "%s/%s", folders[i], name);
        if (access(path, X_OK) == 0) return path;
    }
    return NULL;
}

// A stream of the program's, cut into lines.
struct stream {
    int fd;
    char line[LINE_BYTES];
    size_t size;
};

struct run {
    const struct rn_program *program;
    struct stream output, errors;
    char last[RN_PROGRAM_LAST_WORDS]; // the last line that says something
};

static void end_line(struct run *run, struct stream *stream) {
    stream->line[stream->size] = '\0';
    stream->size = 0;
    const char *text = stream->line + strspn(stream->line, " \t=");
    if (*text) snprintf(run->last, sizeof run->last, "%.*s", (int)sizeof run->last - 1, text);
    if (run->program->line) run->program->line(run->program->context, stream->line);
}

static void take_lines(struct run *run, struct stream *stream, const char *bytes, size_t size) {
    for (size_t i = 0; i < size; i++) {
        if (bytes[i] == '\n' || bytes[i] == '\r' || stream->size == LINE_BYTES - 1)
            end_line(run, stream);
        if (bytes[i] == '\n' || bytes[i] == '\r') continue;
        bool printable = (unsigned char)bytes[i] >= 0x20 && (unsigned char)bytes[i] < 0x7f;
        stream->line[stream->size++] = printable ? bytes[i] : ' ';
    }
}

// What has arrived; closes the stream at its end. False when the taker of bytes wants no more.
static bool drain(struct run *run, struct stream *stream) {
    char bytes[65536];
    ssize_t size = read(stream->fd, bytes, sizeof bytes);
    if (size < 0 && (errno == EINTR || errno == EAGAIN)) return true;
    if (size <= 0) {
        if (stream->size) end_line(run, stream);
        close(stream->fd);
        stream->fd = -1;
        return true;
    }
    if (stream == &run->output && run->program->bytes)
        return run->program->bytes(run->program->context, bytes, (size_t)size);
    take_lines(run, stream, bytes, (size_t)size);
    return true;
}

// Until both streams have ended; false when the work is to end.
static bool follow(struct run *run) {
    const struct rn_program *program = run->program;
    while (run->output.fd >= 0 || run->errors.fd >= 0) {
        struct pollfd fds[2] = {{.fd = run->output.fd, .events = POLLIN},
                                {.fd = run->errors.fd, .events = POLLIN}};
        if (poll(fds, 2, POLL_MS) < 0 && errno != EINTR) return false;
        if (fds[0].revents && !drain(run, &run->output)) return false;
        if (fds[1].revents && !drain(run, &run->errors)) return false;
        if (program->keep_going && !program->keep_going(program->context)) return false;
    }
    return true;
}

static void become(const char *file, const char *const *argv, const int output[2],
                   const int errors[2]) {
    char *words[MAX_ARGUMENTS + 2] = {(char *)file};
    for (size_t i = 0; argv[i] && i < MAX_ARGUMENTS; i++)
        words[i + 1] = (char *)argv[i];
    int nothing = open("/dev/null", O_RDONLY);
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    signal(SIGINT, SIG_DFL);
    signal(SIGPIPE, SIG_DFL);
    if (nothing < 0 || dup2(nothing, 0) < 0 || dup2(output[1], 1) < 0 || dup2(errors[1], 2) < 0)
        _exit(126);
    execv(file, words);
    _exit(errno == ENOENT ? 127 : 126);
}

static enum rn_status start(struct run *run, const char *file, const char *const *argv,
                            pid_t *ret_pid, struct rn_error *err) {
    int output[2], errors[2];
    if (pipe2(output, O_CLOEXEC) != 0) return rn_error_from_errno(err, errno, file, "start");
    if (pipe2(errors, O_CLOEXEC) != 0) {
        close(output[0]);
        close(output[1]);
        return rn_error_from_errno(err, errno, file, "start");
    }
    pid_t pid = fork();
    if (pid == 0) become(file, argv, output, errors);
    int errnum = errno;
    close(output[1]);
    close(errors[1]);
    run->output.fd = output[0];
    run->errors.fd = errors[0];
    if (pid > 0) {
        *ret_pid = pid;
        return RN_OK;
    }
    close(output[0]);
    close(errors[0]);
    return rn_error_from_errno(err, errnum, file, "start");
}

static enum rn_status judge(const struct run *run, const char *file, int ended,
                            struct rn_error *err) {
    if (WIFSIGNALED(ended))
        return rn_error_set(err, RN_ERROR_IO, file, "was ended by signal %d (%s); it said last: %s",
                            WTERMSIG(ended), strsignal(WTERMSIG(ended)),
                            run->last[0] ? run->last : "nothing");
    if (WEXITSTATUS(ended) == 126 || WEXITSTATUS(ended) == 127)
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, file, "cannot be started: %s",
                            run->last[0] ? run->last : "the sandbox or the file forbids it");
    if (WEXITSTATUS(ended) != 0)
        return rn_error_set(err, RN_ERROR_INVALID, file, "failed (exit code %d): %s",
                            WEXITSTATUS(ended), run->last[0] ? run->last : "it said nothing");
    return RN_OK;
}

enum rn_status rn_program_run(const struct rn_program *program, const char *const *argv,
                              struct rn_error *err) {
    const char *file = rn_program_find(program->name);
    struct run run = {.program = program, .output.fd = -1, .errors.fd = -1};
    pid_t pid = 0;
    int ended = 0;
    if (!file)
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, program->name,
                            "is not installed on the daemon's machine: apt-get install %s",
                            program->package);
    enum rn_status status = start(&run, file, argv, &pid, err);
    if (status) return status;
    bool whole = follow(&run);
    if (!whole) kill(pid, SIGKILL);
    while (waitpid(pid, &ended, 0) < 0 && errno == EINTR) {
    }
    if (run.output.fd >= 0) close(run.output.fd);
    if (run.errors.fd >= 0) close(run.errors.fd);
    if (!whole) return rn_error_set(err, RN_ERROR_CANCELLED, program->name, "was told to end");
    return judge(&run, program->name, ended, err);
}

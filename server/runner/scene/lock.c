#include "server/runner/scene/lock.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/pidfd.h>
#include <unistd.h>

#include "common/base/log.h"

enum { WAIT_MS = 15000, POLL_MS = 50, GRACE_MS = 3000 };

// A process: ids are used again, but not with the same start on the same boot.
struct holder {
    long pid, parent;
    unsigned long long start; // clock ticks after boot
    char boot[40];
};

static bool read_line(const char *path, char *line, size_t size) {
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    ssize_t got = fd < 0 ? -1 : read(fd, line, size - 1);
    if (fd >= 0) close(fd);
    if (got <= 0) return false;
    line[got] = '\0';
    return true;
}

// What the system knows of a process; false when there is none.
static bool look_up(long pid, struct holder *ret) {
    char path[64], line[1024];
    snprintf(path, sizeof path, "/proc/%ld/stat", pid);
    if (!read_line(path, line, sizeof line)) return false;
    const char *rest = strrchr(line, ')'); // the name before it may hold anything
    *ret = (struct holder){.pid = pid};
    return rest != NULL &&
           sscanf(rest + 1,
                  " %*c %ld %*d %*d %*d %*d %*u %*u %*u %*u %*u %*u %*u %*d %*d %*d %*d "
                  "%*d %*d %llu",
                  &ret->parent, &ret->start) == 2 &&
           read_line("/proc/sys/kernel/random/boot_id", ret->boot, sizeof ret->boot - 1);
}

static void sign(int fd) {
    struct holder self;
    char text[128];
    if (!look_up((long)getpid(), &self)) return;
    int size = snprintf(text, sizeof text, "%ld %llu %.36s\n", self.pid, self.start, self.boot);
    if (ftruncate(fd, 0) != 0 || pwrite(fd, text, (size_t)size, 0) != size)
        rn_log(RN_LOG_WARN, "the scene's lock cannot be signed: %s", strerror(errno));
}

// The runner that signed the lock, when it still lives and its daemon does not: it is not one of
// this runner's siblings.
static bool find_orphan(const char *path, struct holder *ret) {
    struct holder said = {0}, sibling;
    char line[128];
    if (!read_line(path, line, sizeof line)) return false;
    if (sscanf(line, "%ld %llu %36s", &said.pid, &said.start, said.boot) != 3) return false;
    if (said.pid <= 1 || said.pid == (long)getpid() || !look_up(said.pid, ret)) return false;
    if (ret->start != said.start || strncmp(ret->boot, said.boot, 36) != 0) return false;
    return look_up((long)getpid(), &sibling) && sibling.parent != ret->parent;
}

// The pidfd keeps the number from meaning another process between the look and the signal.
static void fence(const char *path) {
    struct holder orphan, again;
    if (!find_orphan(path, &orphan)) return;
    int fd = pidfd_open((pid_t)orphan.pid, 0);
    if (fd < 0) return;
    if (look_up(orphan.pid, &again) && again.start == orphan.start) {
        rn_log(RN_LOG_WARN, "runner %ld of a daemon that is gone still holds the scene: killed",
               orphan.pid);
        if (pidfd_send_signal(fd, SIGKILL, NULL, 0) != 0)
            rn_log(RN_LOG_WARN, "it cannot be killed: %s", strerror(errno));
    }
    close(fd);
}

enum rn_status rn_lock_scene(const char *folder, struct rn_link *link, int *ret_fd,
                             struct rn_error *err) {
    char path[PATH_MAX];
    if (snprintf(path, sizeof path, "%s/lock", folder) >= (int)sizeof path)
        return rn_error_set(err, RN_ERROR_LIMIT, folder, "the path is too long");
    int fd = *ret_fd = open(path, O_RDWR | O_CREAT | O_CLOEXEC, 0666);
    if (fd < 0) return rn_error_from_errno(err, errno, path, "open the lock");
    for (int waited_ms = 0; flock(fd, LOCK_EX | LOCK_NB) < 0; waited_ms += POLL_MS) {
        if (errno != EWOULDBLOCK && errno != EINTR)
            return rn_error_from_errno(err, errno, path, "lock the scene");
        rn_link_pump(link, 0);
        if (waited_ms >= WAIT_MS || rn_link_must_stop(link))
            return rn_error_set(err, RN_ERROR_BUSY, path, "another runner holds the scene");
        if (waited_ms >= GRACE_MS && waited_ms % 1000 == 0) fence(path);
        usleep(POLL_MS * 1000);
    }
    sign(fd);
    return RN_OK;
}

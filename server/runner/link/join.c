#include "server/runner/link/join.h"

#include <errno.h>
#include <libgen.h>
#include <limits.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "proto/join.h"

// How long a secret is waited for: a daemon may be started anew, and nodes that wait cost others.
#define WAIT_NS (600 * 1000000000ll)
#define LOOK_US 200000
#define CONNECT_NS (60 * 1000000000ll)
#define ANSWER_S 20
// A daemon whose machine is gone is missed after so long.
#define SILENCE_MS 45000

static int connection = -1;

static void hang_up(int signal_number) {
    shutdown(connection, SHUT_RD);
}

static enum rn_status wait_for_secret(const char *folder, struct rn_join *ret_join,
                                      struct rn_error *err) {
    int64_t begin_ns = rn_clock_ns();
    enum rn_status status = rn_join_take(folder, ret_join, err);
    while (status == RN_ERROR_BUSY && rn_clock_ns() - begin_ns < WAIT_NS) {
        usleep(LOOK_US);
        status = rn_join_take(folder, ret_join, err);
    }
    if (status == RN_ERROR_BUSY)
        return rn_error_set(err, RN_ERROR_NOT_FOUND, folder,
                            "no daemon wanted this runner in %lld s", WAIT_NS / 1000000000ll);
    return status;
}

static int try_addresses(const struct addrinfo *address) {
    int errnum = EHOSTUNREACH;
    for (; address != NULL; address = address->ai_next) {
        int fd = socket(address->ai_family, SOCK_STREAM | SOCK_CLOEXEC, 0);
        if (fd >= 0 && connect(fd, address->ai_addr, address->ai_addrlen) == 0) return fd;
        errnum = errno;
        if (fd >= 0) close(fd);
    }
    errno = errnum;
    return -1;
}

static enum rn_status connect_to(const struct rn_join *join, int *ret_fd, struct rn_error *err) {
    const struct addrinfo hints = {.ai_family = AF_UNSPEC, .ai_socktype = SOCK_STREAM};
    int64_t begin_ns = rn_clock_ns();
    char port[8], where[300];
    snprintf(port, sizeof port, "%u", join->port);
    snprintf(where, sizeof where, "%s:%s", join->host, port);
    for (;;) {
        struct addrinfo *found = NULL;
        int failed = getaddrinfo(join->host, port, &hints, &found);
        int fd = failed ? -1 : try_addresses(found), errnum = errno;
        if (!failed) freeaddrinfo(found);
        if (fd >= 0) {
            *ret_fd = fd;
            return RN_OK;
        }
        if (rn_clock_ns() - begin_ns > CONNECT_NS)
            return rn_error_set(err, RN_ERROR_UNAVAILABLE, where,
                                "the daemon cannot be reached from this machine: %s; "
                                "--slurm-listen says where it is",
                                failed ? gai_strerror(failed) : strerror(errnum));
        usleep(LOOK_US);
    }
}

void rn_machine_name(char ret_name[64]) {
    const char *node = getenv("SLURMD_NODENAME"); // a machine may be several nodes
    if (node)
        snprintf(ret_name, 64, "%.63s", node);
    else if (gethostname(ret_name, 63) != 0)
        snprintf(ret_name, 64, "unknown");
    ret_name[63] = '\0';
}

void rn_machine_text(const char *processor, char *ret_text, size_t size) {
    const char *node = getenv("SLURMD_NODENAME");
    if (node)
        snprintf(ret_text, size, "%.63s (%s)", node, processor);
    else
        snprintf(ret_text, size, "%s", processor);
}

static enum rn_status greet(int fd, const char *name, const struct rn_join *join,
                            struct rn_error *err) {
    char bytes[RN_JOIN_GREETING], answer[RN_JOIN_ANSWER + 1] = "";
    struct rn_greeting greeting = {.machine = ""};
    snprintf(greeting.name, sizeof greeting.name, "%.31s", name);
    memcpy(greeting.said, join->said, sizeof greeting.said);
    rn_machine_name(greeting.machine);
    rn_join_write_greeting(bytes, &greeting);
    const struct timeval patience = {.tv_sec = ANSWER_S};
    setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
    if (send(fd, bytes, sizeof bytes, MSG_NOSIGNAL) != (ssize_t)sizeof bytes ||
        recv(fd, answer, RN_JOIN_ANSWER, MSG_WAITALL) != RN_JOIN_ANSWER)
        return rn_error_set(err, RN_ERROR_UNAVAILABLE, join->host, "the daemon hung up");
    if (!rn_join_is(answer, join->heard))
        return rn_error_set(err, RN_ERROR_UNAUTHORISED, join->host,
                            "what answers there is not the daemon that left the secret");
    return RN_OK;
}

static void set_options(int fd) {
    const int yes = 1, idle_s = 15, silence_ms = SILENCE_MS;
    const struct timeval none = {.tv_sec = 0};
    setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &none, sizeof none);
    setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
    setsockopt(fd, SOL_SOCKET, SO_KEEPALIVE, &yes, sizeof yes);
    setsockopt(fd, IPPROTO_TCP, TCP_KEEPIDLE, &idle_s, sizeof idle_s);
    setsockopt(fd, IPPROTO_TCP, TCP_KEEPINTVL, &idle_s, sizeof idle_s);
    setsockopt(fd, IPPROTO_TCP, TCP_USER_TIMEOUT, &silence_ms, sizeof silence_ms);
}

// Forgets the secret, which serves once.
static enum rn_status join_by(struct rn_join *join, const char *name, int *ret_fd,
                              struct rn_error *err) {
    int fd = -1;
    enum rn_status status = connect_to(join, &fd, err);
    if (!status) status = greet(fd, name, join, err);
    explicit_bzero(join, sizeof *join);
    if (status) {
        if (fd >= 0) close(fd);
        return status;
    }
    set_options(fd);
    *ret_fd = fd;
    return RN_OK;
}

enum rn_status rn_join_daemon_by(int from, const char *name, int *ret_fd, struct rn_error *err) {
    struct rn_join join;
    enum rn_status status = rn_join_read(from, &join, err);
    return status ? status : join_by(&join, name, ret_fd, err);
}

enum rn_status rn_join_daemon(const char *folder, int *ret_fd, struct rn_error *err) {
    struct rn_join join;
    char path[PATH_MAX];
    struct sigaction action = {.sa_handler = hang_up};
    snprintf(path, sizeof path, "%s", folder);
    enum rn_status status = wait_for_secret(folder, &join, err);
    if (!status) status = join_by(&join, basename(path), &connection, err);
    if (status) return status;
    sigaction(SIGTERM, &action, NULL);
    sigaction(SIGUSR1, &action, NULL); // what srun passes on
    *ret_fd = connection;
    return RN_OK;
}

// The thread that lets runners in: it listens, and knows one by its name and secret.
#include <errno.h>
#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/log.h"
#include "server/slurm/inside.h"

#define MAX_GUESTS 64
#define GREETING_NS (10 * 1000000000ll)
#define BACKLOG 64

// A connection that has not said who it is.
struct guest {
    int fd;
    size_t have;
    int64_t deadline_ns;
    char greeting[RN_JOIN_GREETING];
    char address[64];
};

// ---- where it listens ---------------------------------------------------------------------------

static enum rn_status split(const char *listen, char host[256], char port[8],
                            struct rn_error *err) {
    const char *colon = listen != NULL ? strrchr(listen, ':') : NULL;
    size_t size = colon != NULL ? (size_t)(colon - listen) : 0;
    char *end = NULL;
    if (listen == NULL) {
        snprintf(port, 8, "0");
        if (gethostname(host, 255) == 0) return RN_OK;
        return rn_error_from_errno(err, errno, "slurm-listen", "look up this machine's name");
    }
    unsigned long number = colon != NULL ? strtoul(colon + 1, &end, 10) : 0;
    if (size == 0 || size > 255 || end == colon + 1 || *end != '\0' || number > 65535)
        return rn_error_set(err, RN_ERROR_INVALID, "slurm-listen",
                            "'%s' is not HOST:PORT, such as head.cluster:7374", listen);
    if (listen[0] == '[' && listen[size - 1] == ']') {
        listen++;
        size -= 2;
    }
    snprintf(host, 256, "%.*s", (int)size, listen);
    snprintf(port, 8, "%lu", number);
    return RN_OK;
}

static int listen_at(const struct addrinfo *address) {
    const int yes = 1;
    int errnum = EADDRNOTAVAIL;
    for (; address != NULL; address = address->ai_next) {
        int fd = socket(address->ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
        if (fd >= 0) setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
        if (fd >= 0 && bind(fd, address->ai_addr, address->ai_addrlen) == 0 &&
            listen(fd, BACKLOG) == 0)
            return fd;
        errnum = errno;
        if (fd >= 0) close(fd);
    }
    errno = errnum;
    return -1;
}

static uint16_t port_of(int fd) {
    struct sockaddr_storage address;
    socklen_t size = sizeof address;
    if (getsockname(fd, (struct sockaddr *)&address, &size) != 0) return 0;
    return ntohs(address.ss_family == AF_INET6 ? ((struct sockaddr_in6 *)&address)->sin6_port
                                               : ((struct sockaddr_in *)&address)->sin_port);
}

// Without --slurm-listen at every address of this machine, under the name that it has.
enum rn_status rn_door_open(struct rn_slurm *slurm, const char *where, struct rn_error *err) {
    struct addrinfo hints = {.ai_socktype = SOCK_STREAM, .ai_flags = AI_PASSIVE}, *found = NULL;
    char host[256] = "", port[8];
    enum rn_status status = split(where, host, port, err);
    if (status != RN_OK) return status;
    int failed = getaddrinfo(where != NULL ? host : NULL, port, &hints, &found);
    if (failed)
        return rn_error_set(err, RN_ERROR_INVALID, "slurm-listen", "%s: %s", host,
                            gai_strerror(failed));
    slurm->listener = listen_at(found);
    int errnum = errno;
    freeaddrinfo(found);
    if (slurm->listener < 0) return rn_error_from_errno(err, errnum, "slurm-listen", "listen");
    slurm->port = port_of(slurm->listener);
    slurm->host = strdup(host);
    if (slurm->host == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "slurm", "no memory");
    rn_log(RN_LOG_INFO, "runners connect to %s:%u", slurm->host, slurm->port);
    return RN_OK;
}

// ---- guests -------------------------------------------------------------------------------------

static void close_guest(struct guest *guest) {
    close(guest->fd);
    guest->fd = -1;
}

static void refuse(struct guest *guest, const char *why) {
    rn_log(RN_LOG_WARN, "a connection from %s is refused: %s", guest->address, why);
    close_guest(guest);
}

static struct rn_place *find_place(struct rn_slurm *slurm, const char *name) {
    for (struct rn_place *place = slurm->places; place != NULL; place = place->next)
        if (strcmp(place->name, name) == 0 && !place->given_up) return place;
    return NULL;
}

// It is the control's from here on, or a porter's that speaks with the control.
static bool take_connection(struct rn_slurm *slurm, struct rn_place *place,
                            const struct guest *guest) {
    struct rn_error err = {0};
    if (slurm->cache == NULL) {
        place->fd = guest->fd;
        return true;
    }
    char *scene = rn_place_path(slurm, place, "scene");
    enum rn_status status = scene != NULL ? rn_porter_start(guest->fd, scene, place->log,
                                                            &place->fd, &place->porter, &err)
                                          : RN_ERROR_NO_MEMORY;
    if (status != RN_OK) rn_log(RN_LOG_ERROR, "%s: %s", err.where, err.text);
    free(scene);
    return status == RN_OK;
}

// Takes the connection over, when name and secret are a place's that is waited for.
static const char *admit(struct rn_slurm *slurm, struct guest *guest) {
    struct rn_greeting greeting;
    const int yes = 1;
    if (!rn_join_read_greeting(guest->greeting, &greeting)) return "it is no runner's greeting";
    struct rn_place *place = find_place(slurm, greeting.name);
    if (place == NULL) return "a runner that nobody waits for";
    if (!rn_join_is(greeting.said, place->join.said))
        return "the secret is wrong, or was used before";
    if (send(guest->fd, place->join.heard, RN_JOIN_ANSWER, MSG_NOSIGNAL) != RN_JOIN_ANSWER)
        return "it hung up";
    setsockopt(guest->fd, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
    setsockopt(guest->fd, SOL_SOCKET, SO_KEEPALIVE, &yes, sizeof yes);
    explicit_bzero(place->join.said, sizeof place->join.said);
    memcpy(place->machine, greeting.machine, sizeof place->machine);
    if (!take_connection(slurm, place, guest)) return "it cannot be served";
    place->joined = true;
    guest->fd = -1;
    return NULL;
}

static void hear(struct rn_slurm *slurm, struct guest *guest) {
    ssize_t got = recv(guest->fd, guest->greeting + guest->have, RN_JOIN_GREETING - guest->have,
                       MSG_DONTWAIT);
    if (got < 0 && (errno == EAGAIN || errno == EINTR)) return;
    if (got <= 0) {
        refuse(guest, "it hung up");
        return;
    }
    guest->have += (size_t)got;
    if (guest->have < RN_JOIN_GREETING) return;
    pthread_mutex_lock(&slurm->lock);
    const char *wrong = admit(slurm, guest);
    pthread_mutex_unlock(&slurm->lock);
    explicit_bzero(guest->greeting, sizeof guest->greeting);
    if (wrong != NULL)
        refuse(guest, wrong);
    else
        rn_slurm_tell(slurm);
}

// The one that has waited longest makes room.
static struct guest *make_seat(struct guest guests[MAX_GUESTS]) {
    struct guest *oldest = &guests[0];
    for (int i = 0; i < MAX_GUESTS; i++) {
        if (guests[i].fd < 0) return &guests[i];
        if (guests[i].deadline_ns < oldest->deadline_ns) oldest = &guests[i];
    }
    refuse(oldest, "too many connections");
    return oldest;
}

static void welcome(struct rn_slurm *slurm, struct guest guests[MAX_GUESTS]) {
    struct sockaddr_storage address;
    socklen_t size = sizeof address;
    int fd =
        accept4(slurm->listener, (struct sockaddr *)&address, &size, SOCK_CLOEXEC | SOCK_NONBLOCK);
    if (fd < 0) return;
    struct guest *guest = make_seat(guests);
    *guest = (struct guest){.fd = fd, .deadline_ns = rn_clock_ns() + GREETING_NS};
    if (getnameinfo((struct sockaddr *)&address, size, guest->address, sizeof guest->address, NULL,
                    0, NI_NUMERICHOST) != 0)
        snprintf(guest->address, sizeof guest->address, "an unknown address");
}

void *rn_door_serve(void *context) {
    struct rn_slurm *slurm = context;
    struct guest guests[MAX_GUESTS];
    struct pollfd polls[MAX_GUESTS + 2];
    for (int i = 0; i < MAX_GUESTS; i++)
        guests[i] = (struct guest){.fd = -1};
    for (;;) {
        polls[MAX_GUESTS] = (struct pollfd){.fd = slurm->listener, .events = POLLIN};
        polls[MAX_GUESTS + 1] = (struct pollfd){.fd = slurm->wake_fd, .events = POLLIN};
        int waiting = 0;
        for (int i = 0; i < MAX_GUESTS; i++) {
            polls[i] = (struct pollfd){.fd = guests[i].fd, .events = POLLIN};
            waiting += guests[i].fd >= 0;
        }
        poll(polls, MAX_GUESTS + 2, waiting > 0 ? 1000 : -1);
        if (polls[MAX_GUESTS + 1].revents != 0) break;
        for (int i = 0; i < MAX_GUESTS; i++) {
            if (guests[i].fd >= 0 && polls[i].revents != 0) hear(slurm, &guests[i]);
            if (guests[i].fd >= 0 && rn_clock_ns() > guests[i].deadline_ns)
                refuse(&guests[i], "it did not say who it is");
        }
        if (polls[MAX_GUESTS].revents != 0) welcome(slurm, guests);
    }
    for (int i = 0; i < MAX_GUESTS; i++)
        if (guests[i].fd >= 0) close_guest(&guests[i]);
    return NULL;
}

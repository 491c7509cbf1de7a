// Sockets and their pace. A client may be slow, but not so slow that it keeps others out: a header
// has a deadline, a body and an answer a least rate, and who waits longest makes room when all
// places are taken.
#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/sockios.h>
#include <linux/tcp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/log.h"
#include "server/http/exchange.h"

#define SECOND 1000000000ll
#define LOOK_NS (SECOND / 2)
#define DRAIN_NS (SECOND / 50)
// How long a closed connection is read on: in all, and without a byte.
#define LINGER_NS (30 * SECOND)
#define LINGER_QUIET_NS (3 * SECOND)
#define DRAIN_BLOCKS 32
#define MAX_DRAINED (64u << 20)

// ---- from accept to close ---------------------------------------------------------------------

static void read_address(const struct sockaddr *from, uint8_t address[16]) {
    memset(address, 0, 16);
    if (from != NULL && from->sa_family == AF_INET6) {
        memcpy(address, &((const struct sockaddr_in6 *)(const void *)from)->sin6_addr, 16);
    } else if (from != NULL) {
        address[10] = address[11] = 0xff;
        memcpy(address + 12, &((const struct sockaddr_in *)(const void *)from)->sin_addr, 4);
    }
}

static bool is_loopback(const uint8_t address[16]) {
    static const uint8_t mapped[12] = {[10] = 0xff, [11] = 0xff};
    return (memcmp(address, mapped, 12) == 0 && address[12] == 127) ||
           memcmp(address, &in6addr_loopback, 16) == 0;
}

// From here on it does not count; the library closes it in a moment.
static void cut(struct rn_http *http, struct rn_connection *connection) {
    connection->cut = true;
    http->stats.connections--;
    shutdown(connection->fd, SHUT_RDWR);
}

// The connection that has waited longest for a header; `address` NULL: of anyone. The newest one
// is spared: it is told that there is no room.
static struct rn_connection *longest_wait(struct rn_http *http, const uint8_t *address) {
    struct rn_connection *found = NULL;
    for (struct rn_connection *at = http->connections; at != NULL; at = at->next) {
        if (at->request != NULL || at->cut || at == http->connections) continue;
        if (address != NULL && memcmp(at->address, address, 16) != 0) continue;
        if (found == NULL || at->since_ns < found->since_ns) found = at;
    }
    return found;
}

static bool evict(struct rn_http *http, const uint8_t *address) {
    struct rn_connection *longest = longest_wait(http, address);
    if (longest == NULL) return false;
    http->stats.evicted++;
    cut(http, longest);
    return true;
}

static unsigned count_address(const struct rn_http *http, const uint8_t *address) {
    unsigned count = 0;
    for (const struct rn_connection *at = http->connections; at != NULL; at = at->next)
        count += !at->cut && memcmp(at->address, address, 16) == 0;
    return count;
}

static void make_room(struct rn_http *http, struct rn_connection *fresh) {
    unsigned most = http->options.max_per_address;
    bool any = most == 0 && is_loopback(fresh->address);
    if (most == 0) most = http->options.max_connections / 2;
    if (!any && count_address(http, fresh->address) > most && !evict(http, fresh->address))
        cut(http, fresh);
    if (http->stats.connections > http->options.max_connections) (void)evict(http, NULL);
}

static void started(struct rn_http *http, struct MHD_Connection *connection, void **state) {
    struct rn_connection *fresh = calloc(1, sizeof *fresh);
    const union MHD_ConnectionInfo *info =
        MHD_get_connection_info(connection, MHD_CONNECTION_INFO_CONNECTION_FD);
    pthread_mutex_lock(&http->lock);
    http->stats.connections++;
    if (fresh != NULL && info != NULL) {
        fresh->fd = info->connect_fd;
        info = MHD_get_connection_info(connection, MHD_CONNECTION_INFO_CLIENT_ADDRESS);
        read_address(info != NULL ? info->client_addr : NULL, fresh->address);
        fresh->since_ns = rn_clock_ns();
        fresh->next = http->connections;
        if (fresh->next != NULL) fresh->next->previous = fresh;
        http->connections = fresh;
        *state = fresh;
        make_room(http, fresh);
        pthread_cond_signal(&http->changed);
    } else {
        free(fresh);
    }
    pthread_mutex_unlock(&http->lock);
}

// The library closes its descriptor; a copy of it is read on until the peer has had its answer.
static void linger(struct rn_http *http, const struct rn_connection *connection) {
    for (int i = 0; i < RN_MAX_LINGERING; i++) {
        struct rn_lingering *place = &http->lingering[i];
        if (place->fd >= 0) continue;
        place->fd = fcntl(connection->fd, F_DUPFD_CLOEXEC, 0);
        place->drained = 0;
        place->quiet_ns = rn_clock_ns() + LINGER_QUIET_NS;
        place->end_ns = rn_clock_ns() + LINGER_NS;
        http->lingering_count += place->fd >= 0;
        pthread_cond_signal(&http->changed);
        return;
    }
}

static void closed(struct rn_http *http, struct rn_connection *connection) {
    pthread_mutex_lock(&http->lock);
    if (connection == NULL || !connection->cut) http->stats.connections--;
    if (connection != NULL) {
        if (connection->previous != NULL) connection->previous->next = connection->next;
        if (connection->next != NULL) connection->next->previous = connection->previous;
        if (http->connections == connection) http->connections = connection->next;
        if (connection->lingers) linger(http, connection);
    }
    pthread_mutex_unlock(&http->lock);
    free(connection);
}

void rn_socket_notify(void *context, struct MHD_Connection *connection, void **state,
                      enum MHD_ConnectionNotificationCode code) {
    if (code == MHD_CONNECTION_NOTIFY_STARTED)
        started(context, connection, state);
    else
        closed(context, *state);
}

// ---- exchanges --------------------------------------------------------------------------------

// Bytes that the peer has sent and taken since the connection began.
static uint64_t moved_bytes(int fd) {
    struct tcp_info info = {0};
    socklen_t size = sizeof info;
    if (getsockopt(fd, IPPROTO_TCP, TCP_INFO, &info, &size) != 0) return 0;
    return info.tcpi_bytes_acked + info.tcpi_bytes_received;
}

static void begin_window(struct rn_connection *connection, int64_t now_ns) {
    connection->window_ns = now_ns;
    connection->window_bytes = moved_bytes(connection->fd);
}

void rn_socket_begin(struct rn_request *request) {
    const union MHD_ConnectionInfo *info =
        MHD_get_connection_info(request->connection, MHD_CONNECTION_INFO_SOCKET_CONTEXT);
    struct rn_connection *connection = info != NULL ? info->socket_context : NULL;
    request->socket = connection;
    if (connection == NULL) return;
    pthread_mutex_lock(&request->http->lock);
    connection->request = request;
    connection->window_ns = 0;
    pthread_mutex_unlock(&request->http->lock);
}

void rn_socket_end(struct rn_request *request) {
    if (request->socket == NULL) return;
    pthread_mutex_lock(&request->http->lock);
    request->socket->request = NULL;
    request->socket->served = true;
    request->socket->since_ns = rn_clock_ns();
    pthread_mutex_unlock(&request->http->lock);
    request->socket = NULL;
}

static const char *reason_of(int status) {
    return status == 400   ? "Bad Request"
           : status == 413 ? "Content Too Large"
           : status == 507 ? "Insufficient Storage"
                           : "Error";
}

void rn_answer_raw(struct rn_http *http, struct rn_connection *connection, struct rn_reply *reply) {
    char head[256];
    if (connection != NULL && !connection->answered && reply->body == RN_BODY_BYTES) {
        int size =
            snprintf(head, sizeof head,
                     "HTTP/1.1 %d %s\r\nContent-Type: %s\r\nContent-Length: %zu\r\n"
                     "Cache-Control: no-store\r\nConnection: close\r\n\r\n",
                     reply->status, reason_of(reply->status), reply->content_type, reply->size);
        struct iovec parts[] = {{head, (size_t)size}, {reply->bytes, reply->size}};
        struct msghdr message = {.msg_iov = parts, .msg_iovlen = 2};
        if (sendmsg(connection->fd, &message, MSG_NOSIGNAL | MSG_DONTWAIT) < 0)
            rn_log(RN_LOG_DEBUG, "http: an answer was not sent: %s", strerror(errno));
        shutdown(connection->fd, SHUT_WR);
        pthread_mutex_lock(&http->lock);
        connection->answered = connection->lingers = true;
        connection->since_ns = 0; // when no request has begun, it is ended at the next look
        pthread_cond_signal(&http->changed);
        if (reply->status < 600) http->stats.by_status[reply->status]++;
        pthread_mutex_unlock(&http->lock);
    }
    rn_reply_finish(reply);
}

// ---- watching ---------------------------------------------------------------------------------

// Whether an exchange has moved less than the least rate over as long as a header may take. An
// answer that waits for us, not for the peer, has nothing in its queue.
static bool is_slow(struct rn_http *http, struct rn_connection *connection, int64_t now_ns) {
    const struct rn_request *request = connection->request;
    int unsent = 0;
    if (request->suspended || connection->window_ns == 0) {
        begin_window(connection, now_ns);
        return false;
    }
    if (now_ns - connection->window_ns < http->options.header_timeout_s * SECOND) return false;
    uint64_t moved = moved_bytes(connection->fd) - connection->window_bytes;
    bool sends = request->handled;
    if (sends && ioctl(connection->fd, SIOCOUTQ, &unsent) == 0 && unsent == 0) moved = UINT64_MAX;
    double seconds = (double)(now_ns - connection->window_ns) / SECOND;
    begin_window(connection, now_ns);
    return (double)moved < seconds * (double)http->options.least_rate;
}

static bool is_late(const struct rn_http *http, const struct rn_connection *connection,
                    int64_t now_ns) {
    int seconds =
        connection->served ? http->options.idle_timeout_s : http->options.header_timeout_s;
    return now_ns - connection->since_ns > seconds * SECOND;
}

static void drain(struct rn_http *http, struct rn_lingering *place, int64_t now_ns) {
    char bytes[65536];
    ssize_t got = 1;
    for (int i = 0; i < DRAIN_BLOCKS && got > 0; i++) {
        got = recv(place->fd, bytes, sizeof bytes, MSG_DONTWAIT);
        if (got > 0) place->drained += (uint64_t)got;
        if (got > 0) place->quiet_ns = now_ns + LINGER_QUIET_NS;
    }
    if (place->drained > MAX_DRAINED) got = 0;
    bool waits = got > 0 || (got < 0 && (errno == EAGAIN || errno == EINTR));
    if (waits && now_ns < place->end_ns && now_ns < place->quiet_ns) return;
    close(place->fd);
    place->fd = -1;
    http->lingering_count--;
}

int64_t rn_sockets_watch(struct rn_http *http, int64_t now_ns) {
    for (struct rn_connection *at = http->connections; at != NULL; at = at->next) {
        if (at->cut) continue;
        bool slow = at->request != NULL ? is_slow(http, at, now_ns) : is_late(http, at, now_ns);
        if (!slow) continue;
        http->stats.slow += at->request != NULL || !at->served;
        cut(http, at);
    }
    for (int i = 0; i < RN_MAX_LINGERING; i++)
        if (http->lingering[i].fd >= 0) drain(http, &http->lingering[i], now_ns);
    return http->lingering_count > 0 ? DRAIN_NS : http->connections != NULL ? LOOK_NS : 10 * SECOND;
}

void rn_sockets_finish(struct rn_http *http) {
    for (int i = 0; i < RN_MAX_LINGERING; i++)
        if (http->lingering[i].fd >= 0) close(http->lingering[i].fd);
}

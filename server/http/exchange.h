// Inside of server/http: one request from its first header to its last byte.
//
// Locks: http->lock guards the fields marked so. A ring's lock may be held when it is taken,
// never the other way round; handlers and on_gone are called without it.
#ifndef RN_SERVER_HTTP_EXCHANGE_H
#define RN_SERVER_HTTP_EXCHANGE_H

#include <microhttpd.h>
#include <pthread.h>
#include <stdatomic.h>

#include "common/base/buf.h"
#include "common/base/trace.h"
#include "server/http/ring.h"
#include "server/http/server.h"

struct rn_parked {
    struct rn_request *request;
    void (*on_gone)(void *context, struct rn_parked *parked);
    void *context;
    int64_t deadline_ns;
};

// Where the body goes. An error is kept for the answer.
struct rn_sink {
    struct rn_buf memory;
    int fd;     // -1: memory
    char *path; // of the spooled file
    bool stays; // which is not removed with the request
    uint64_t size, max;
    struct rn_error error;
};

struct rn_event_stream {
    struct rn_ring_reader reader;
    bool attached;
    char *text; // being sent
    size_t size, sent;
    int64_t next_beat_ns; // http->lock
    bool beat;            // http->lock: a heartbeat is due
};

// One socket, from accept to close. http->lock guards it.
struct rn_connection {
    struct rn_connection *previous, *next;
    int fd;
    uint8_t address[16];        // IPv4 as mapped into IPv6
    struct rn_request *request; // NULL: a header is awaited
    int64_t since_ns;           // of the wait
    int64_t window_ns;          // of the exchange: where the measured stretch began
    uint64_t window_bytes;
    bool served;   // has had an answer: kept alive
    bool cut;      // was shut down
    bool lingers;  // its answer stands before bytes that are still coming
    bool answered; // by rn_answer_raw: nothing more is to be sent
};

// A closed connection whose peer is still sending: read until it has seen its answer.
struct rn_lingering {
    int fd; // -1: free
    uint64_t drained;
    int64_t end_ns, quiet_ns;
};
#define RN_MAX_LINGERING 64

struct rn_request {
    struct rn_http *http;
    struct MHD_Connection *connection;
    struct rn_connection *socket; // NULL when memory was short
    enum rn_method method;
    char *path;
    struct rn_match match;
    struct rn_caller caller;
    struct rn_sink sink;
    bool begun, is_head;
    atomic_bool handled; // nothing more is taken from the peer; the keeper thread asks, too
    size_t answer_bytes; // http->lock: held for the answer
    struct rn_event_stream events;
    int64_t begin_ns;
    void (*on_sent)(void *context, int64_t number, int64_t sent_ns); // of the answer
    void *sent_context;
    int64_t sent_number;
    // Of the answering, in the caller's trace (its header traceparent) or a new one; and that
    // trace's id.
    char traceparent[RN_TRACE_MAX], trace[RN_TRACE_ID_MAX];
    unsigned status; // of the answer, 0 before
    // http->lock:
    struct rn_reply reply;
    struct rn_parked parked;
    bool is_parked; // a handle is out
    bool answered;  // `reply` is what the client shall get
    bool suspended;
    bool gone;     // the client has left
    bool finished; // MHD has forgotten the connection
    int references;
    struct rn_request *previous, *next;
};

struct rn_http {
    struct rn_http_options options;
    char *address;
    uint16_t port;
    bool loopback;
    int audit_fd; // -1: none
    struct MHD_Daemon *daemon;
    pthread_t keeper;
    bool keeper_runs;
    pthread_mutex_t lock;
    pthread_cond_t changed;
    // lock:
    struct rn_request *requests;
    struct rn_connection *connections;
    struct rn_lingering lingering[RN_MAX_LINGERING];
    unsigned lingering_count;
    uint64_t answer_bytes; // of all answers that are being sent
    int64_t guesses_since_ns;
    unsigned guesses; // wrong tokens since then
    unsigned request_count, parked_count, suspended_count;
    bool stopping;
    struct rn_http_stats stats;
};

// body.c
void rn_sink_init(struct rn_sink *sink, uint64_t max_bytes);
// False when it failed: sink->error says why, and the rest of the body is not wanted.
bool rn_sink_write(struct rn_sink *sink, const char *bytes, size_t size);
enum rn_status rn_sink_close(struct rn_sink *sink, struct rn_error *err) RN_MUST_CHECK;
void rn_sink_finish(struct rn_sink *sink);

// respond.c: sends a reply (taken and zeroed).
enum MHD_Result rn_respond(struct rn_request *request, struct rn_reply *reply);

// park.c; http->lock is held
void rn_exchange_suspend(struct rn_request *request);
void rn_exchange_wake(struct rn_request *request);
void rn_exchange_unref(struct rn_request *request);
void *rn_keeper_main(void *http);

// sockets.c
void rn_socket_notify(void *http, struct MHD_Connection *connection, void **state,
                      enum MHD_ConnectionNotificationCode code);
void rn_socket_begin(struct rn_request *request); // its header is here
void rn_socket_end(struct rn_request *request);   // its answer is sent, or the client is gone
// Sends a short answer past the library, where that takes none any more: in the midst of a body,
// or before the header is read. The caller lets the library close the connection.
void rn_answer_raw(struct rn_http *http, struct rn_connection *connection, struct rn_reply *reply);
// Ends connections that are too slow; http->lock is held. The time until it wants to look again.
int64_t rn_sockets_watch(struct rn_http *http, int64_t now_ns);
void rn_sockets_finish(struct rn_http *http);

// audit.c
enum rn_status rn_audit_open(struct rn_http *http, struct rn_error *err) RN_MUST_CHECK;
// Who asked for what, and what came of it, to the log and, of a write, to the audit.
void rn_access_tell(const struct rn_request *request);

// admit.c: fills `reply` when the request is refused from its headers.
uint64_t rn_body_size(const struct rn_request *request); // as announced; 0: none, or not known
bool rn_has_body(const struct rn_request *request);
void rn_admit(struct rn_request *request, const char *method, struct rn_reply *reply);

#define RN_BEAT_NS (15 * 1000000000ll)

#endif

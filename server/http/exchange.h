// Inside of server/http: one request from its first header to its last byte.
//
// Locks: http->lock guards the fields marked so. A ring's lock may be held when it is taken,
// never the other way round; handlers and on_gone are called without it.
#ifndef RN_SERVER_HTTP_EXCHANGE_H
#define RN_SERVER_HTTP_EXCHANGE_H

#include <microhttpd.h>
#include <pthread.h>

#include "common/base/buf.h"
#include "server/http/ring.h"
#include "server/http/server.h"

struct rn_parked {
    struct rn_request *request;
    void (*on_gone)(void *context, struct rn_parked *parked);
    void *context;
    int64_t deadline_ns;
};

// Where the body goes. An error is kept until the body's end: no reply can be sent before it.
struct rn_sink {
    struct rn_buf memory;
    int fd;     // -1: memory
    char *path; // of the spooled file
    uint64_t size, max, discarded;
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

struct rn_request {
    struct rn_http *http;
    struct MHD_Connection *connection;
    enum rn_method method;
    char *path;
    struct rn_match match;
    struct rn_sink sink;
    bool begun, handled;
    struct rn_event_stream events;
    int64_t begin_ns;
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
    char *address, *token;
    uint16_t port;
    bool loopback;
    struct MHD_Daemon *daemon;
    pthread_t keeper;
    bool keeper_runs;
    pthread_mutex_t lock;
    pthread_cond_t changed;
    // lock:
    struct rn_request *requests;
    unsigned request_count, parked_count, suspended_count;
    bool stopping;
    struct rn_http_stats stats;
};

// body.c
enum rn_status rn_sink_init(struct rn_sink *sink, uint64_t max_bytes);
// False when the connection has to be cut: far more came than was allowed.
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

// admit.c: fills `reply` when the request is refused from its headers.
void rn_admit(struct rn_request *request, const char *method, struct rn_reply *reply);

#define RN_BEAT_NS (15 * 1000000000ll)

#endif

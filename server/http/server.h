// The HTTP front: one thread that never blocks on anything but its sockets and short disk writes.
#ifndef RN_SERVER_HTTP_SERVER_H
#define RN_SERVER_HTTP_SERVER_H

#include "server/http/router.h"

// Thread-safety: any thread may call; start and stop belong to one.
struct rn_http;

struct rn_http_options {
    const char *address; // IPv4 or IPv6, numeric, or "localhost"
    uint16_t port;       // 0: any free one
    bool token_needed;   // else requests to a loopback name are served without one, as the owner's
    const struct rn_route *routes; // outlives the server
    void *context;                 // given to the handlers and to `authorise`
    // Who has this token, and whether the request's route is for them: a reply that is filled here
    // refuses. False when nobody has it. NULL: nobody has any.
    bool (*authorise)(void *context, struct rn_request *request, const char *token,
                      struct rn_caller *ret_caller, struct rn_reply *reply);
    // Whether who was let in still may be: asked before each event of a stream, on the HTTP thread.
    // NULL: always.
    bool (*stays)(void *context, const struct rn_caller *caller);
    unsigned max_connections;  // further ones are told 503; 0: 448
    unsigned max_parked;       // 0: 64
    unsigned max_per_address;  // connections of one address; 0: half of all, any on loopback
    int idle_timeout_s;        // a connection without progress is closed; 0: 30
    int header_timeout_s;      // for a whole header, from the connection's begin; 0: 10
    int64_t least_rate;        // bytes a second of a body or an answer; 0: 1024
    uint64_t max_answer_bytes; // of all answers that wait to be sent; 0: 256 MiB
    const char *audit;         // a file to which a line is added for each write; NULL: none
};

// Status codes 200..599 and how often they were sent.
struct rn_http_stats {
    uint64_t by_status[600];
    uint64_t refused;      // over the admission limit
    uint64_t gone;         // clients that left before their answer
    uint64_t slow;         // connections ended for being too slow
    uint64_t evicted;      // connections that waited idly while others wanted in
    uint64_t answer_bytes; // of answers that are being sent now
    uint64_t body_bytes;   // received
    uint64_t uploads;      // bodies that were spooled whole
    unsigned connections;  // open now
    unsigned streams;      // event streams open now
};

// Strings in `options` are copied. RN_ERROR_UNAVAILABLE when the address cannot be bound.
enum rn_status rn_http_start(const struct rn_http_options *options, struct rn_http **ret_http,
                             struct rn_error *err) RN_MUST_CHECK;
uint16_t rn_http_port(const struct rn_http *http);
void rn_http_stats(struct rn_http *http, struct rn_http_stats *ret_stats);
// Stops accepting, answers every parked request with 503, ends event streams, gives running
// exchanges up to timeout_ms, then closes everything. Handles of parked requests must still be
// answered by their owners before or after; the memory lives as long as they do.
void rn_http_drain(struct rn_http *http, int64_t timeout_ms);
void rn_http_destroy(struct rn_http **http);

#endif

// HTTP to one daemon, over libcurl.
#ifndef RN_CLIENT_HTTP_H
#define RN_CLIENT_HTTP_H

#include <stddef.h>
#include <stdint.h>

#include "common/base/buf.h"
#include "common/base/status.h"

#define RN_HTTP_DEFAULT_PORT "7373"
#define RN_HTTP_DEFAULT_HOST "http://127.0.0.1:" RN_HTTP_DEFAULT_PORT
#define RN_HTTP_MAX_BODY (256u << 20) // bytes of an answer that is kept in memory

// A connection to a daemon, kept open between requests. Thread-safety: one thread at a time.
struct rn_http;

// `host` is a URL, or a daemon's address for http, with the default port where it names none;
// `token` (NULL: none) goes into every request. Proxies of the environment are not used.
// RN_ERROR_INVALID for a URL of another scheme, or none.
enum rn_status rn_http_create(const char *host, const char *token, struct rn_http **ret_http,
                              struct rn_error *err) RN_MUST_CHECK;
// A second connection to the same daemon with the same token: a request may be made on it while
// one runs on the first, also from that one's `receive`.
enum rn_status rn_http_create_twin(const struct rn_http *http, struct rn_http **ret_http,
                                   struct rn_error *err) RN_MUST_CHECK;
void rn_http_destroy(struct rn_http **http);
// The daemon's URL without a slash at its end. Lives as long as `http`.
const char *rn_http_host(const struct rn_http *http);

// Lives for the call. Only method and path must be given.
struct rn_http_request {
    const char *method;        // "GET", "POST", "PATCH", "DELETE"
    const char *path;          // from the host's root on, escaped, with its query
    const char *content_type;  // of the body
    const char *accept;        // "Accept"; NULL: anything
    const char *last_event_id; // "Last-Event-ID"
    const char *upload_offset; // "Upload-Offset"
    const void *body;          // body_size bytes; or, for a streamed body, NULL and `read`
    size_t body_size;          // bytes, also of a streamed body
    // Fills up to `capacity` bytes and returns how many; SIZE_MAX aborts the request.
    size_t (*read)(void *context, char *buffer, size_t capacity);
    // Takes a part of a 2xx answer's body instead of the reply; false ends the request in RN_OK.
    bool (*receive)(void *context, const char *bytes, size_t size);
    void *context; // of read and receive
    int idle_s;    // fail when no byte comes for so many seconds; 0: wait for ever
    // A file descriptor that ends the request in RN_ERROR_CANCELLED once it is readable; 0: none.
    int interrupt_fd;
};

// Owner: the caller; rn_http_reply_finish. Zeroed by rn_http_perform before it is filled.
struct rn_http_reply {
    int status; // HTTP's
    char content_type[96];
    char location[160];
    char server_timing[160];
    char step[24];  // X-Ripnerf-Step
    char at[24];    // X-Ripnerf-At, of what was looked back at
    char scale[48]; // X-Ripnerf-Scale, of a heat map
    struct {        // of a budget, X-Ripnerf-*; "" without one
        char asked_ms[24], spent_ms[24], setting[96], curve[16], expected_psnr[24],
            expected_spread[24], late[8];
    } budget;
    int retry_after_s;
    struct rn_buf body; // NUL-terminated; empty when `receive` took it
};

// RN_OK once an answer of any HTTP status has arrived whole. RN_ERROR_UNAVAILABLE when the daemon
// cannot be reached or hangs up, RN_ERROR_CANCELLED by the interrupt or an aborting `read`,
// RN_ERROR_LIMIT for an answer larger than RN_HTTP_MAX_BODY. The reply is valid after any status.
enum rn_status rn_http_perform(struct rn_http *http, const struct rn_http_request *request,
                               struct rn_http_reply *ret_reply, struct rn_error *err) RN_MUST_CHECK;
void rn_http_reply_finish(struct rn_http_reply *reply);

// Appends `text` percent-escaped, as one component of a path or query.
void rn_http_escape(struct rn_buf *buf, const char *text);

#endif

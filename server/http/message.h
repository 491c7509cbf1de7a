// Requests and replies as the rest of the daemon sees them; nothing here names an HTTP library.
//
// A handler runs on the one HTTP thread and must not block. It reads the request, fills the reply
// and returns; or it parks the request (rn_request_park) and another thread answers it later.
#ifndef RN_SERVER_HTTP_MESSAGE_H
#define RN_SERVER_HTTP_MESSAGE_H

#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

#include "common/base/status.h"
#include "proto/problem.h"

enum rn_method { RN_METHOD_GET = 1, RN_METHOD_POST = 2, RN_METHOD_DELETE = 4, RN_METHOD_PATCH = 8 };

#define RN_MAX_PARAMS 3
#define RN_REPLY_MAX_HEADERS 16

struct rn_request; // one exchange; valid during the handler's call only
struct rn_parked;  // a request that waits for its reply; see rn_request_park
struct rn_ring;    // a bounded list of events; see ring.h

// Who asks. A plain value; that of someone on this machine where no token is needed, and of the
// daemon's own token, has an empty id.
struct rn_caller {
    char id[RN_ID_MAX], name[RN_NAME_MAX]; // of the token
    enum rn_scope scope;
    char scene[RN_ID_MAX], job[RN_ID_MAX]; // a link's: all that it may see
    int64_t max_jobs, max_bytes;           // quotas; 0: none
    int64_t created_ms, expires_ms;
};

// A body that is produced piece by piece on the HTTP thread (files of any size, archives).
struct rn_stream {
    // Returns bytes written (> 0), 0 at the end, -1 on an error (the connection is cut).
    ssize_t (*read)(void *context, uint8_t *bytes, size_t capacity);
    void (*close)(void *context); // called exactly once
    void *context;
    uint64_t size; // 0: not known beforehand
};

enum rn_body {
    RN_BODY_NONE,
    RN_BODY_BYTES,
    RN_BODY_CONSTANT,
    RN_BODY_FILE,
    RN_BODY_STREAM,
    RN_BODY_EVENTS
};

// Thread-safety: one thread at a time. Owner: whoever filled it, until it is handed over.
struct rn_reply {
    int status;               // 0: not filled yet
    const char *content_type; // static text; NULL: none
    struct {
        const char *name; // static text
        char value[256];
    } headers[RN_REPLY_MAX_HEADERS];
    int header_count;
    enum rn_body body;
    uint8_t *bytes;          // RN_BODY_BYTES: owned, malloc; RN_BODY_CONSTANT: outlives all
    size_t size;             // of bytes or the file
    int fd;                  // RN_BODY_FILE: owned
    struct rn_stream stream; // RN_BODY_STREAM: owned
    struct rn_ring *ring;    // RN_BODY_EVENTS: one reference, owned
    uint64_t after_id;       // RN_BODY_EVENTS: replay what is newer
    // Told when the last byte was handed to the socket (rn_clock_ns), on a thread of the library's;
    // NULL: nobody is. An answer that was cut off is not told.
    void (*on_sent)(void *context, int64_t number, int64_t sent_ns);
    void *sent_context;
    int64_t sent_number;
};

// ---- reading a request ------------------------------------------------------------------------

const struct rn_caller *rn_request_caller(const struct rn_request *request);
unsigned rn_request_flags(const struct rn_request *request); // of its route, RN_ROUTE_*
// The trace in which it is answered (common/base/trace.h): what it causes is a part of it.
const char *rn_request_traceparent(const struct rn_request *request);
// When it arrived: its header was there (rn_clock_ns).
int64_t rn_request_begin_ns(const struct rn_request *request);
// The text matched by the i-th {…} of the route's pattern. Never NULL.
const char *rn_request_param(const struct rn_request *request, int i);
// A query parameter or a header, decoded; NULL when absent.
const char *rn_request_query(const struct rn_request *request, const char *name);
const char *rn_request_header(const struct rn_request *request, const char *name);
// Whether the body is of this media type; parameters do not count.
bool rn_request_has_type(const struct rn_request *request, const char *type);
// RN_ERROR_INVALID with the parameter's name when the query holds one that is not in the
// NULL-terminated list, or one of them twice.
enum rn_status rn_request_check_query(const struct rn_request *request, const char *const *known,
                                      struct rn_error *err) RN_MUST_CHECK;
// The whole body (NUL-terminated); empty when it was spooled.
const uint8_t *rn_request_body(const struct rn_request *request, size_t *ret_size);
// Headers alone are here (a route's `begin`): send the body to a new file in `folder` instead of
// memory, at most max_bytes of it.
enum rn_status rn_request_spool(struct rn_request *request, const char *folder, uint64_t max_bytes,
                                struct rn_error *err) RN_MUST_CHECK;
// The same into a file that is there, from byte `offset` on; it is never removed with the request.
enum rn_status rn_request_append(struct rn_request *request, const char *path, uint64_t offset,
                                 uint64_t max_bytes, struct rn_error *err) RN_MUST_CHECK;
// The spooled file's path, NULL when there is none. The file is removed with the request unless
// it is taken.
const char *rn_request_spooled(const struct rn_request *request, uint64_t *ret_size);
void rn_request_take_spooled(struct rn_request *request);

// ---- parking ----------------------------------------------------------------------------------

// Leaves the request open after the handler has returned. `on_gone` is called (on another thread,
// no lock held) when the client has left or the deadline has passed (it was then told 503): the
// reply is not wanted any more. The handle stays valid until rn_parked_answer, which must be
// called exactly once in every case. RN_ERROR_LIMIT when too many wait already.
enum rn_status rn_request_park(struct rn_request *request, int64_t timeout_ms,
                               void (*on_gone)(void *context, struct rn_parked *parked),
                               void *context, struct rn_parked **ret_parked,
                               struct rn_error *err) RN_MUST_CHECK;
// Hands over the reply (zeroed on return) and the handle. Any thread. The reply may be NULL when
// nobody waits for it (after on_gone).
void rn_parked_answer(struct rn_parked *parked, struct rn_reply *reply);

// ---- filling a reply --------------------------------------------------------------------------

void rn_reply_header(struct rn_reply *reply, const char *name, const char *fmt, ...)
    RN_PRINTF(3, 4);
// Takes the bytes.
void rn_reply_bytes(struct rn_reply *reply, int status, const char *content_type, uint8_t *bytes,
                    size_t size);
// Copies the text.
void rn_reply_text(struct rn_reply *reply, int status, const char *content_type, const char *text);
void rn_reply_empty(struct rn_reply *reply, int status);
// A problem that says that memory is short, without taking any.
void rn_reply_no_memory(struct rn_reply *reply);
// A regular file; on failure the reply is a problem.
void rn_reply_file(struct rn_reply *reply, const char *content_type, const char *path);
// Takes the stream.
void rn_reply_stream(struct rn_reply *reply, const char *content_type, struct rn_stream stream);
// Takes a reference to the ring.
void rn_reply_events(struct rn_reply *reply, struct rn_ring *ring, uint64_t after_id);
// application/problem+json made from an error; the status code follows from err->status.
void rn_reply_error(struct rn_reply *reply, const struct rn_error *err);
// The same with an explicit type (proto/problems.md).
void rn_reply_problem(struct rn_reply *reply, enum rn_problem_type type, const char *fmt, ...)
    RN_PRINTF(3, 4);
// A body that could not be decoded: 400 when it is no JSON, else 422 with each field's error.
void rn_reply_invalid(struct rn_reply *reply, const struct rn_field_errors *errors,
                      const struct rn_error *err);
// Frees what the reply owns and zeroes it.
void rn_reply_finish(struct rn_reply *reply);

#endif

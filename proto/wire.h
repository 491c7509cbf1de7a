// The framed protocol between daemon and runner, over one stream socket.
//
// A frame: 16 bytes of header, four little-endian 32-bit words (magic, type, JSON size, blob size),
// then the JSON text, then the blob. wire_messages.h says what each type carries.
#ifndef RN_PROTO_WIRE_H
#define RN_PROTO_WIRE_H

#include <stddef.h>
#include <stdint.h>

#include "common/base/buf.h"
#include "common/base/status.h"

#define RN_WIRE_MAGIC 0x31574e52u // "RNW1"
#define RN_WIRE_HEADER 16
#define RN_WIRE_MAX_JSON (16u << 20)
#define RN_WIRE_MAX_BLOB (512u << 20)

// One message as it came. Owner: the reader's caller; rn_wire_message_finish.
struct rn_wire_message {
    int type;   // enum rn_wire_type
    char *json; // NUL-terminated
    size_t json_size;
    uint8_t *blob; // NULL when there is none
    size_t blob_size;
};
void rn_wire_message_finish(struct rn_wire_message *message);

// Puts frames together from whatever pieces arrive. Thread-safety: owned by one thread.
struct rn_wire_reader {
    int fd; // not owned
    uint8_t header[RN_WIRE_HEADER];
    size_t have; // bytes of the frame read so far
    struct rn_wire_message message;
};
void rn_wire_reader_init(struct rn_wire_reader *reader, int fd);
void rn_wire_reader_finish(struct rn_wire_reader *reader);
// Reads without blocking. *ret_ready says whether *ret_message holds a whole message (now the
// caller's); false: poll for POLLIN and call again. RN_ERROR_UNAVAILABLE: the peer has closed;
// RN_ERROR_CORRUPT: not this protocol, or a size over the limits; RN_ERROR_IO, RN_ERROR_NO_MEMORY.
// After an error the connection is of no more use.
enum rn_status rn_wire_read(struct rn_wire_reader *reader, bool *ret_ready,
                            struct rn_wire_message *ret_message,
                            struct rn_error *err) RN_MUST_CHECK;

// Frames waiting to be sent. Thread-safety: owned by one thread.
struct rn_wire_writer {
    int fd; // not owned
    struct rn_buf pending;
    size_t sent; // of pending
};
// max_bytes bounds what may wait; 0 = one largest frame.
void rn_wire_writer_init(struct rn_wire_writer *writer, int fd, size_t max_bytes);
void rn_wire_writer_finish(struct rn_wire_writer *writer);
// Appends a frame. RN_ERROR_LIMIT when too much waits already, RN_ERROR_NO_MEMORY.
enum rn_status rn_wire_queue(struct rn_wire_writer *writer, int type, const char *json,
                             size_t json_size, const void *blob, size_t blob_size,
                             struct rn_error *err) RN_MUST_CHECK;
// Sends what the socket takes without blocking. *ret_empty: nothing waits any more; false: poll
// for POLLOUT and call again. RN_ERROR_UNAVAILABLE, RN_ERROR_IO.
enum rn_status rn_wire_flush(struct rn_wire_writer *writer, bool *ret_empty,
                             struct rn_error *err) RN_MUST_CHECK;
// Waits until all is sent (the runner's way of writing). As rn_wire_flush.
enum rn_status rn_wire_drain(struct rn_wire_writer *writer, struct rn_error *err) RN_MUST_CHECK;

#endif

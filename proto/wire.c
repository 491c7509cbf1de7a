#include "proto/wire.h"

#include <errno.h>
#include <poll.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>

// ---- header --------------------------------------------------------------------------------

static uint32_t get_word(const uint8_t *bytes) {
    return (uint32_t)bytes[0] | (uint32_t)bytes[1] << 8 | (uint32_t)bytes[2] << 16 |
           (uint32_t)bytes[3] << 24;
}

static void put_word(uint8_t *bytes, uint32_t word) {
    for (int i = 0; i < 4; i++)
        bytes[i] = (uint8_t)(word >> (8 * i));
}

void rn_wire_message_finish(struct rn_wire_message *message) {
    free(message->json);
    free(message->blob);
    *message = (struct rn_wire_message){0};
}

// ---- reading -------------------------------------------------------------------------------

void rn_wire_reader_init(struct rn_wire_reader *reader, int fd) {
    *reader = (struct rn_wire_reader){.fd = fd};
}

void rn_wire_reader_finish(struct rn_wire_reader *reader) {
    rn_wire_message_finish(&reader->message);
    reader->have = 0;
}

// Takes the header apart, checks it and allocates what it announces.
static enum rn_status begin_message(struct rn_wire_reader *reader, struct rn_error *err) {
    uint32_t magic = get_word(reader->header), type = get_word(reader->header + 4);
    size_t json_size = get_word(reader->header + 8), blob_size = get_word(reader->header + 12);
    if (magic != RN_WIRE_MAGIC || type > 255)
        return rn_error_set(err, RN_ERROR_CORRUPT, "wire", "not a frame of this protocol");
    if (json_size > RN_WIRE_MAX_JSON || blob_size > RN_WIRE_MAX_BLOB)
        return rn_error_set(err, RN_ERROR_CORRUPT, "wire",
                            "a frame of %zu + %zu bytes; at most %u + %u are allowed", json_size,
                            blob_size, RN_WIRE_MAX_JSON, RN_WIRE_MAX_BLOB);
    struct rn_wire_message *message = &reader->message;
    *message =
        (struct rn_wire_message){.type = (int)type, .json_size = json_size, .blob_size = blob_size};
    message->json = malloc(json_size + 1);
    message->blob = blob_size ? malloc(blob_size) : NULL;
    if (!message->json || (blob_size && !message->blob)) {
        rn_wire_message_finish(message);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "wire", "no memory for a frame of %zu bytes",
                            json_size + blob_size);
    }
    message->json[json_size] = '\0';
    return RN_OK;
}

// Where the next bytes go, and how many are wanted there.
static uint8_t *next_piece(struct rn_wire_reader *reader, size_t *ret_wanted) {
    struct rn_wire_message *message = &reader->message;
    size_t have = reader->have;
    if (have < RN_WIRE_HEADER) {
        *ret_wanted = RN_WIRE_HEADER - have;
        return reader->header + have;
    }
    have -= RN_WIRE_HEADER;
    if (have < message->json_size) {
        *ret_wanted = message->json_size - have;
        return (uint8_t *)message->json + have;
    }
    have -= message->json_size;
    *ret_wanted = message->blob_size - have;
    return message->blob + have;
}

static bool is_complete(const struct rn_wire_reader *reader) {
    return reader->have >= RN_WIRE_HEADER &&
           reader->have == RN_WIRE_HEADER + reader->message.json_size + reader->message.blob_size;
}

enum rn_status rn_wire_read(struct rn_wire_reader *reader, bool *ret_ready,
                            struct rn_wire_message *ret_message, struct rn_error *err) {
    for (;;) {
        size_t wanted;
        uint8_t *piece = next_piece(reader, &wanted);
        ssize_t got = recv(reader->fd, piece, wanted, MSG_DONTWAIT);
        if (got < 0 && errno == EINTR) continue;
        if (got < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) {
            *ret_ready = false;
            return RN_OK;
        }
        if (got == 0 || (got < 0 && errno == ECONNRESET))
            return rn_error_set(err, RN_ERROR_UNAVAILABLE, "wire", "the other end has closed");
        if (got < 0) return rn_error_from_errno(err, errno, "wire", "read");
        bool in_header = reader->have < RN_WIRE_HEADER;
        reader->have += (size_t)got;
        if (in_header && reader->have == RN_WIRE_HEADER) {
            enum rn_status status = begin_message(reader, err);
            if (status) return status;
        }
        if (!is_complete(reader)) continue;
        *ret_message = reader->message;
        *ret_ready = true;
        reader->message = (struct rn_wire_message){0};
        reader->have = 0;
        return RN_OK;
    }
}

// ---- writing -------------------------------------------------------------------------------

void rn_wire_writer_init(struct rn_wire_writer *writer, int fd, size_t max_bytes) {
    *writer = (struct rn_wire_writer){.fd = fd};
    if (!max_bytes) max_bytes = (size_t)RN_WIRE_HEADER + RN_WIRE_MAX_JSON + RN_WIRE_MAX_BLOB;
    rn_buf_init(&writer->pending, max_bytes);
}

void rn_wire_writer_finish(struct rn_wire_writer *writer) {
    rn_buf_finish(&writer->pending);
    writer->sent = 0;
}

enum rn_status rn_wire_queue(struct rn_wire_writer *writer, int type, const char *json,
                             size_t json_size, const void *blob, size_t blob_size,
                             struct rn_error *err) {
    size_t total = RN_WIRE_HEADER + json_size + blob_size;
    if (json_size > RN_WIRE_MAX_JSON || blob_size > RN_WIRE_MAX_BLOB ||
        total > writer->pending.max - writer->pending.size)
        return rn_error_set(err, RN_ERROR_LIMIT, "wire",
                            "no room for a frame of %zu bytes behind %zu waiting ones", total,
                            writer->pending.size);
    uint8_t header[RN_WIRE_HEADER];
    put_word(header, RN_WIRE_MAGIC);
    put_word(header + 4, (uint32_t)type);
    put_word(header + 8, (uint32_t)json_size);
    put_word(header + 12, (uint32_t)blob_size);
    size_t before = writer->pending.size;
    rn_buf_append(&writer->pending, header, sizeof header);
    rn_buf_append(&writer->pending, json, json_size);
    if (blob_size) rn_buf_append(&writer->pending, blob, blob_size);
    if (!writer->pending.failed) return RN_OK;
    writer->pending.size = before; // no half frame is ever sent
    writer->pending.failed = false;
    return rn_error_set(err, RN_ERROR_NO_MEMORY, "wire", "no memory for a frame of %zu bytes",
                        total);
}

enum rn_status rn_wire_flush(struct rn_wire_writer *writer, bool *ret_empty, struct rn_error *err) {
    struct rn_buf *pending = &writer->pending;
    while (writer->sent < pending->size) {
        ssize_t put = send(writer->fd, pending->data + writer->sent, pending->size - writer->sent,
                           MSG_DONTWAIT | MSG_NOSIGNAL);
        if (put < 0 && errno == EINTR) continue;
        if (put < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) {
            *ret_empty = false;
            return RN_OK;
        }
        if (put < 0 && (errno == EPIPE || errno == ECONNRESET))
            return rn_error_set(err, RN_ERROR_UNAVAILABLE, "wire", "the other end has closed");
        if (put < 0) return rn_error_from_errno(err, errno, "wire", "write");
        writer->sent += (size_t)put;
    }
    rn_wire_writer_finish(writer);
    *ret_empty = true;
    return RN_OK;
}

enum rn_status rn_wire_drain(struct rn_wire_writer *writer, struct rn_error *err) {
    for (;;) {
        bool empty;
        enum rn_status status = rn_wire_flush(writer, &empty, err);
        if (status || empty) return status;
        struct pollfd wait = {.fd = writer->fd, .events = POLLOUT};
        if (poll(&wait, 1, -1) < 0 && errno != EINTR)
            return rn_error_from_errno(err, errno, "wire", "wait");
    }
}

// From a reply to what the library sends, event streams included.
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "server/http/exchange.h"

#define BLOCK_BYTES (64u << 10)
#define SMALL_ANSWER (16u << 10) // not counted

static ssize_t read_stream(void *context, uint64_t position, char *bytes, size_t capacity) {
    struct rn_stream *stream = context;
    ssize_t size = stream->read(stream->context, (uint8_t *)bytes, capacity);
    if (size < 0) return MHD_CONTENT_READER_END_WITH_ERROR;
    return size == 0 ? MHD_CONTENT_READER_END_OF_STREAM : size;
}

static void close_stream(void *context) {
    struct rn_stream *stream = context;
    stream->close(stream->context);
    free(stream);
}

static void wake_reader(void *context) {
    struct rn_request *request = context;
    pthread_mutex_lock(&request->http->lock);
    rn_exchange_wake(request);
    pthread_mutex_unlock(&request->http->lock);
}

static ssize_t send_text(struct rn_event_stream *events, char *bytes, size_t capacity) {
    size_t size = events->size - events->sent;
    if (size > capacity) size = capacity;
    memcpy(bytes, events->text + events->sent, size);
    events->sent += size;
    if (events->sent == events->size) {
        free(events->text);
        events->text = NULL;
    }
    return (ssize_t)size;
}

// Nothing to send: a heartbeat when one is due, the end when the stream is over, else sleep. An
// event that came in between has woken nobody, so the ring is looked at once more.
static ssize_t idle(struct rn_request *request, char *bytes, size_t capacity) {
    static const char beat[] = ": beat\n\n";
    struct rn_http *http = request->http;
    ssize_t result = 0;
    pthread_mutex_lock(&http->lock);
    if (request->gone || http->stopping) {
        result = MHD_CONTENT_READER_END_OF_STREAM;
    } else if (request->events.beat && capacity >= sizeof beat - 1) {
        request->events.beat = false;
        memcpy(bytes, beat, sizeof beat - 1);
        result = sizeof beat - 1;
    } else {
        rn_exchange_suspend(request);
    }
    pthread_mutex_unlock(&http->lock);
    if (result == 0 && rn_ring_pending(&request->events.reader)) wake_reader(request);
    return result;
}

static ssize_t read_events(void *context, uint64_t position, char *bytes, size_t capacity) {
    struct rn_request *request = context;
    struct rn_event_stream *events = &request->events;
    const struct rn_http_options *options = &request->http->options;
    if (events->text != NULL) return send_text(events, bytes, capacity);
    if (options->stays != NULL && !options->stays(options->context, &request->caller))
        return MHD_CONTENT_READER_END_OF_STREAM;
    events->sent = 0;
    switch (rn_ring_read(&events->reader, &events->text, &events->size)) {
    case RN_RING_EVENT:
        return send_text(events, bytes, capacity);
    case RN_RING_EMPTY:
        return idle(request, bytes, capacity);
    case RN_RING_ENDED:
        return MHD_CONTENT_READER_END_OF_STREAM;
    case RN_RING_NO_MEMORY:
        break;
    }
    return MHD_CONTENT_READER_END_WITH_ERROR;
}

static void close_events(void *context) {
    struct rn_request *request = context;
    struct rn_http *http = request->http;
    struct rn_ring *ring = request->events.reader.ring;
    rn_ring_detach(&request->events.reader);
    rn_ring_unref(&ring);
    pthread_mutex_lock(&http->lock);
    request->events.attached = false;
    http->stats.streams--;
    pthread_mutex_unlock(&http->lock);
    rn_exchange_unref(request);
}

static struct MHD_Response *open_events(struct rn_request *request, struct rn_reply *reply) {
    struct rn_http *http = request->http;
    struct MHD_Response *response = MHD_create_response_from_callback(
        MHD_SIZE_UNKNOWN, BLOCK_BYTES, read_events, request, close_events);
    if (response == NULL) return NULL;
    pthread_mutex_lock(&http->lock);
    request->references++;
    request->events.attached = true;
    request->events.beat = true; // so that the client sees the stream open at once
    request->events.next_beat_ns = rn_clock_ns() + RN_BEAT_NS;
    http->stats.streams++;
    pthread_mutex_unlock(&http->lock);
    request->events.reader.wake = wake_reader;
    request->events.reader.context = request;
    rn_ring_attach(reply->ring, &request->events.reader, reply->after_id);
    reply->ring = NULL;
    return response;
}

static struct MHD_Response *open_stream(struct rn_reply *reply) {
    struct rn_stream *stream = malloc(sizeof *stream);
    if (stream == NULL) return NULL;
    *stream = reply->stream;
    struct MHD_Response *response =
        MHD_create_response_from_callback(stream->size > 0 ? stream->size : MHD_SIZE_UNKNOWN,
                                          BLOCK_BYTES, read_stream, stream, close_stream);
    if (response == NULL) {
        free(stream);
        return NULL;
    }
    reply->stream = (struct rn_stream){0};
    return response;
}

static struct MHD_Response *open_response(struct rn_request *request, struct rn_reply *reply) {
    struct MHD_Response *response = NULL;
    switch (reply->body) {
    case RN_BODY_NONE:
        return MHD_create_response_from_buffer(0, NULL, MHD_RESPMEM_PERSISTENT);
    case RN_BODY_BYTES:
        response =
            MHD_create_response_from_buffer(reply->size, reply->bytes, MHD_RESPMEM_MUST_FREE);
        if (response != NULL) reply->bytes = NULL;
        return response;
    case RN_BODY_CONSTANT:
        return MHD_create_response_from_buffer(reply->size, reply->bytes, MHD_RESPMEM_PERSISTENT);
    case RN_BODY_FILE:
        response = MHD_create_response_from_fd64(reply->size, reply->fd);
        if (response != NULL) reply->fd = -1;
        return response;
    case RN_BODY_STREAM:
        return open_stream(reply);
    case RN_BODY_EVENTS:
        return open_events(request, reply);
    }
    return NULL;
}

static bool add_headers(struct MHD_Response *response, const struct rn_reply *reply) {
    bool ok = true, cache = false;
    for (int i = 0; i < reply->header_count; i++) {
        const char *name = reply->headers[i].name;
        ok &= MHD_add_response_header(response, name, reply->headers[i].value) == MHD_YES;
        cache |= strcmp(name, "Cache-Control") == 0;
    }
    if (reply->content_type != NULL)
        ok &= MHD_add_response_header(response, "Content-Type", reply->content_type) == MHD_YES;
    if (!cache) ok &= MHD_add_response_header(response, "Cache-Control", "no-store") == MHD_YES;
    ok &= MHD_add_response_header(response, "X-Content-Type-Options", "nosniff") == MHD_YES;
    return ok;
}

// Counts an answer that lies in memory until it is sent; one that is too much becomes a 503.
static void keep_to_budget(struct rn_request *request, struct rn_reply *reply) {
    struct rn_http *http = request->http;
    if (reply->body != RN_BODY_BYTES || reply->size <= SMALL_ANSWER) return;
    pthread_mutex_lock(&http->lock);
    bool fits = http->answer_bytes + reply->size <= http->options.max_answer_bytes;
    if (fits) {
        http->answer_bytes += reply->size;
        request->answer_bytes += reply->size;
    } else {
        http->stats.refused++;
    }
    pthread_mutex_unlock(&http->lock);
    if (fits) return;
    rn_reply_finish(reply);
    rn_reply_problem(reply, RN_PROBLEM_BUSY,
                     "answers of %llu bytes wait for slow readers, the limit; try again later",
                     (unsigned long long)http->options.max_answer_bytes);
}

// HEAD: what has no length beforehand is not begun.
static void drop_stream(struct rn_reply *reply) {
    const char *type = reply->content_type;
    int status = reply->status;
    rn_reply_finish(reply);
    rn_reply_empty(reply, status);
    reply->content_type = type;
}

enum MHD_Result rn_respond(struct rn_request *request, struct rn_reply *reply) {
    struct rn_http *http = request->http;
    if (request->is_head && (reply->body == RN_BODY_STREAM || reply->body == RN_BODY_EVENTS))
        drop_stream(reply);
    keep_to_budget(request, reply);
    unsigned status = (unsigned)reply->status;
    struct MHD_Response *response = open_response(request, reply);
    enum MHD_Result result = MHD_NO;
    request->status = status;
    request->on_sent = reply->on_sent;
    request->sent_context = reply->sent_context;
    request->sent_number = reply->sent_number;
    if (response != NULL && add_headers(response, reply) &&
        MHD_add_response_header(response, "X-Request-Id", request->trace) == MHD_YES)
        result = MHD_queue_response(request->connection, status, response);
    if (response != NULL) MHD_destroy_response(response);
    rn_reply_finish(reply);
    pthread_mutex_lock(&http->lock);
    if (status < 600) http->stats.by_status[status]++;
    pthread_mutex_unlock(&http->lock);
    return result;
}

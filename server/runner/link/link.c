#include "server/runner/link/link.h"

#include <errno.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/log.h"
#include "common/base/utf8.h"

void rn_link_init(struct rn_link *link, int fd) {
    *link = (struct rn_link){.said_ns = rn_clock_ns()};
    rn_wire_reader_init(&link->reader, fd);
    rn_wire_writer_init(&link->writer, fd, 0);
}

void rn_link_finish(struct rn_link *link) {
    struct rn_letter letter;
    rn_log_set_trace(NULL);
    while (rn_link_take(link, &letter))
        rn_wire_message_finish(&letter.message);
    rn_wire_reader_finish(&link->reader);
    rn_wire_writer_finish(&link->writer);
}

static void close_link(struct rn_link *link, const struct rn_error *err) {
    if (!link->closed && err->status != RN_ERROR_UNAVAILABLE)
        rn_log(RN_LOG_ERROR, "the link to the daemon is lost: %s", err->text);
    link->closed = true;
}

static void keep_trace(struct rn_link *link, struct rn_wire_message *message) {
    struct rn_wire_trace *trace = &link->traces[link->trace_count % RN_LINK_TRACES];
    if (rn_wire_take(message, trace, NULL) == RN_OK) link->trace_count++;
    rn_wire_message_finish(message);
}

const char *rn_link_log_of(struct rn_link *link, const char *job) {
    const char *found = NULL;
    for (size_t i = 0; *job && i < RN_LINK_TRACES; i++)
        if (strcmp(link->traces[i].job, job) == 0) found = link->traces[i].traceparent;
    return rn_log_set_trace(found);
}

// Moves one message to the inbox; false when there is no whole one.
static bool receive(struct rn_link *link) {
    struct rn_wire_message message;
    struct rn_error err = {0};
    bool ready = false;
    enum rn_status status = rn_wire_read(&link->reader, &ready, &message, &err);
    if (status) close_link(link, &err);
    if (status || !ready) return false;
    if (message.type == RN_WIRE_TRACE) {
        keep_trace(link, &message);
        return true;
    }
    struct rn_letter *letter = malloc(sizeof *letter);
    if (!letter) {
        rn_wire_message_finish(&message);
        rn_error_set(&err, RN_ERROR_NO_MEMORY, "wire", "out of memory");
        close_link(link, &err);
        return false;
    }
    *letter = (struct rn_letter){.message = message, .arrived_ns = rn_clock_ns()};
    *(link->last ? &link->last->next : &link->first) = letter;
    link->last = letter;
    link->count++;
    return true;
}

static void say_alive(struct rn_link *link) {
    struct rn_wire_empty empty = {""};
    if (rn_clock_ns() - link->said_ns > RN_WIRE_ALIVE_S * 1000000000ll)
        rn_link_post(link, RN_WIRE_ALIVE, &empty, NULL, 0);
}

void rn_link_pump(struct rn_link *link, int timeout_ms) {
    say_alive(link);
    if (timeout_ms != 0 && !link->first && !link->closed) {
        struct pollfd wait = {.fd = link->reader.fd, .events = POLLIN};
        if (poll(&wait, 1, timeout_ms) < 0 && errno != EINTR) {
            struct rn_error err;
            rn_error_from_errno(&err, errno, "wire", "wait");
            close_link(link, &err);
        }
    }
    while (!link->closed && link->count < RN_LINK_MAX_LETTERS && receive(link))
        ;
}

// Takes out the letter that follows `before` (NULL: the first).
static struct rn_letter *unlink_after(struct rn_link *link, struct rn_letter *before) {
    struct rn_letter **slot = before ? &before->next : &link->first, *letter = *slot;
    *slot = letter->next;
    if (link->last == letter) link->last = before;
    link->count--;
    return letter;
}

// Hands the letter after `before` to its taker.
static bool take_after(struct rn_link *link, struct rn_letter *before,
                       struct rn_letter *ret_letter) {
    struct rn_letter *letter = unlink_after(link, before);
    *ret_letter = *letter;
    ret_letter->next = NULL;
    free(letter);
    return true;
}

bool rn_link_take(struct rn_link *link, struct rn_letter *ret_letter) {
    return link->first && take_after(link, NULL, ret_letter);
}

bool rn_link_take_type(struct rn_link *link, enum rn_wire_type type, struct rn_letter *ret_letter) {
    struct rn_letter *before = NULL, *at = link->first;
    while (at && at->message.type != (int)type) {
        before = at;
        at = at->next;
    }
    return at && take_after(link, before, ret_letter);
}

static bool is_cancel_of(const struct rn_wire_message *message, const char *job, int64_t request) {
    struct rn_wire_cancel cancel;
    if (message->type != RN_WIRE_CANCEL || rn_wire_take(message, &cancel, NULL)) return false;
    return (*job && strcmp(cancel.job, job) == 0) ||
           (request != RN_ABSENT && cancel.request == request);
}

// Whether a cancel for this job ("" for none) or request (RN_ABSENT for none) waits in the inbox;
// it is taken out.
static bool take_cancel(struct rn_link *link, const char *job, int64_t request) {
    struct rn_letter *before = NULL;
    for (struct rn_letter *at = link->first; at; before = at, at = at->next) {
        if (!is_cancel_of(&at->message, job, request)) continue;
        at = unlink_after(link, before);
        rn_wire_message_finish(&at->message);
        free(at);
        return true;
    }
    return false;
}

bool rn_link_has_news(void *context) {
    struct rn_link *link = context;
    struct pollfd look = {.fd = link->reader.fd, .events = POLLIN};
    return link->closed || link->first || poll(&look, 1, 0) > 0;
}

bool rn_link_must_stop(const struct rn_link *link) {
    for (const struct rn_letter *at = link->first; at; at = at->next)
        if (at->message.type == RN_WIRE_SHUTDOWN) return true;
    return link->closed;
}

void rn_link_post(struct rn_link *link, enum rn_wire_type type, const void *message,
                  const void *blob, size_t blob_size) {
    struct rn_error err = {0};
    if (link->closed) return;
    enum rn_status status = rn_wire_post(&link->writer, type, message, blob, blob_size, &err);
    if (!status) status = rn_wire_drain(&link->writer, &err);
    if (status) close_link(link, &err);
    link->said_ns = rn_clock_ns();
}

void rn_link_post_last(struct rn_link *link, enum rn_wire_type type, const void *message) {
    struct rn_error err = {0};
    bool empty;
    if (!link->closed)
        rn_link_post(link, type, message, NULL, 0);
    else if (rn_wire_post(&link->writer, type, message, NULL, 0, &err) ||
             rn_wire_flush(&link->writer, &empty, &err))
        rn_log(RN_LOG_INFO, "the daemon is not told: %s", err.text);
}

// A device that is lost stays lost in this process. The daemon takes its end for a crash: jobs go
// on from their last checkpoint in a new one.
static _Noreturn void leave(const struct rn_error *err) {
    rn_log(RN_LOG_ERROR, "the device is lost: %s: %s", err->where, err->text);
    _exit(1);
}

void rn_link_done(struct rn_link *link, const char *job, char *result) {
    struct rn_wire_done done = {.result = result};
    snprintf(done.job, sizeof done.job, "%s", job);
    rn_log(RN_LOG_INFO, "job %s: done", job);
    rn_link_post(link, RN_WIRE_DONE, &done, NULL, 0);
}

void rn_link_fail(struct rn_link *link, const char *job, int64_t request,
                  const struct rn_error *err) {
    struct rn_wire_failed failed = {.request = request};
    if (err->status == RN_ERROR_UNAVAILABLE) leave(err);
    snprintf(failed.job, sizeof failed.job, "%s", job);
    snprintf(failed.status, sizeof failed.status, "%s", rn_status_name(err->status));
    snprintf(failed.where, sizeof failed.where, "%s", err->where);
    snprintf(failed.text, sizeof failed.text, "%s", err->text);
    // They may quote a stranger's bytes, or be cut in a character; a message is UTF-8 or is not
    // sent.
    rn_utf8_clean(failed.where);
    rn_utf8_clean(failed.text);
    if (*job) rn_log(RN_LOG_INFO, "job %s: %s: %s: %s", job, failed.status, err->where, err->text);
    rn_link_post(link, RN_WIRE_FAILED, &failed, NULL, 0);
}

bool rn_watch_keep_going(void *context) {
    struct rn_watch *watch = context;
    rn_link_pump(watch->link, 0);
    if (take_cancel(watch->link, watch->job, watch->request)) watch->cancelled = true;
    return !watch->cancelled && !rn_link_must_stop(watch->link);
}

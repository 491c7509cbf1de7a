#include "client/commands/upload.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "client/api.h"
#include "client/interrupt.h"
#include "client/progress.h"
#include "common/base/clock.h"
#include "proto/job.h"

#define PART_BYTES (64ull << 20) // what a proxy may hold back until it has it all
#define IDLE_S 60                // without a byte: the connection counts as lost
#define LAST_IDLE_S 10 // the same of its end, for which somebody waits who has interrupted it
#define FIRST_WAIT_MS 250
#define MOST_WAIT_MS 8000
#define PATIENCE_NS (120 * 1000000000ll)

struct upload {
    struct rn_client *client;
    struct rn_tar *tar;
    struct rn_upload_record record;
    uint64_t part_end;
    struct rn_progress progress;
    int64_t alive_ns; // when something arrived last
    int wait_ms;
};

// Whether to try again, after a pause that grows: the daemon does not answer, or has no room now.
static bool is_worth_waiting(struct upload *upload, const struct rn_api_reply *reply) {
    bool busy = reply->http.status == 503 || reply->http.status == 429;
    int asked_ms = 1000 * reply->http.retry_after_s;
    if (reply->code != RN_EXIT_UNREACHABLE && !busy) return false;
    if (rn_clock_ns() - upload->alive_ns > PATIENCE_NS) return false;
    int wait_ms = busy && asked_ms > upload->wait_ms ? asked_ms : upload->wait_ms;
    rn_progress_note(&upload->progress, "%s; trying again in %.1f s",
                     busy ? "the daemon is busy" : "the connection is lost", wait_ms * 1e-3);
    if (rn_interrupt_sleep(wait_ms)) return false;
    upload->wait_ms = 2 * upload->wait_ms < MOST_WAIT_MS ? 2 * upload->wait_ms : MOST_WAIT_MS;
    return true;
}

static void arrived(struct upload *upload) {
    upload->alive_ns = rn_clock_ns();
    upload->wait_ms = FIRST_WAIT_MS;
}

static enum rn_exit complain(const struct rn_api_reply *reply) {
    if (!rn_interrupt_seen()) return rn_api_complain(reply);
    return rn_client_error(RN_EXIT_CANCELLED, "the upload", "was interrupted");
}

// One exchange with a JSON body, again and again while the daemon does not answer.
static enum rn_exit ask(struct upload *upload, const char *method, const char *path,
                        const char *body, struct rn_api_reply *ret_reply) {
    for (;;) {
        rn_api_send(upload->client, method, path, body, ret_reply);
        if (ret_reply->code == RN_EXIT_OK || !is_worth_waiting(upload, ret_reply)) break;
        rn_api_reply_finish(ret_reply);
    }
    if (ret_reply->code == RN_EXIT_OK) arrived(upload);
    return ret_reply->code == RN_EXIT_OK ? RN_EXIT_OK : complain(ret_reply);
}

static enum rn_exit begin(struct upload *upload, const char *name) {
    struct rn_upload_request wanted = {.size_bytes = (int64_t)rn_tar_size(upload->tar)};
    struct rn_api_reply reply;
    snprintf(wanted.name, sizeof wanted.name, "%s", name);
    char *body = rn_api_encode(&rn_upload_request_table, &wanted);
    if (!body) return RN_EXIT_FAILED;
    enum rn_exit code = ask(upload, "POST", "/v1/uploads", body, &reply);
    free(body);
    if (code == RN_EXIT_OK) code = rn_api_decode(&reply, &rn_upload_table, &upload->record);
    rn_api_reply_finish(&reply);
    return code;
}

// How much is there: after a lost connection.
static enum rn_exit look(struct upload *upload) {
    struct rn_api_reply reply;
    char *path = rn_api_path("uploads", upload->record.id, "");
    if (!path) return RN_EXIT_FAILED;
    enum rn_exit code = ask(upload, "GET", path, NULL, &reply);
    free(path);
    if (code == RN_EXIT_OK) code = rn_api_decode(&reply, &rn_upload_table, &upload->record);
    rn_api_reply_finish(&reply);
    return code;
}

static size_t send_tar(void *context, char *buffer, size_t capacity) {
    struct upload *upload = context;
    char sent[24], size[24];
    uint64_t left = upload->part_end - rn_tar_sent(upload->tar);
    size_t got = rn_tar_read(upload->tar, buffer, left < capacity ? (size_t)left : capacity);
    rn_format_bytes((double)rn_tar_sent(upload->tar), sent, sizeof sent);
    rn_format_bytes((double)rn_tar_size(upload->tar), size, sizeof size);
    rn_progress_update(&upload->progress,
                       (double)rn_tar_sent(upload->tar) / (double)rn_tar_size(upload->tar),
                       "sending %s of %s", sent, size);
    return got;
}

// The next part. *ret_lost: its connection was, and how much of it arrived is to be asked.
static enum rn_exit send_part(struct upload *upload, bool *ret_lost) {
    struct rn_api_reply reply;
    char offset[24];
    uint64_t from = (uint64_t)upload->record.offset, size = rn_tar_size(upload->tar);
    upload->part_end = size - from > PART_BYTES ? from + PART_BYTES : size;
    snprintf(offset, sizeof offset, "%lld", (long long)upload->record.offset);
    if (!rn_tar_seek(upload->tar, from)) return rn_client_fail(rn_tar_error(upload->tar));
    char *path = rn_api_path("uploads", upload->record.id, "");
    struct rn_http_request request = {.method = "PATCH",
                                      .path = path ? path : "/",
                                      .content_type = "application/offset+octet-stream",
                                      .upload_offset = offset,
                                      .read = send_tar,
                                      .body_size = (size_t)(upload->part_end - from),
                                      .context = upload,
                                      .idle_s = IDLE_S};
    rn_api_exchange(upload->client, &request, &reply);
    free(path);
    enum rn_exit code = reply.code;
    *ret_lost = false;
    if (rn_tar_error(upload->tar)->status != RN_OK) {
        code = rn_client_fail(rn_tar_error(upload->tar));
    } else if (code == RN_EXIT_OK) {
        upload->record.offset = (int64_t)upload->part_end;
        arrived(upload);
    } else if (reply.http.status == 409 || is_worth_waiting(upload, &reply)) {
        *ret_lost = true;
        code = RN_EXIT_OK;
    } else {
        code = complain(&reply);
    }
    rn_api_reply_finish(&reply);
    return code;
}

static enum rn_exit send_all(struct upload *upload) {
    enum rn_exit code = RN_EXIT_OK;
    while (code == RN_EXIT_OK && upload->record.offset < upload->record.size_bytes) {
        bool lost = false;
        int64_t before = upload->record.offset;
        code = send_part(upload, &lost);
        if (code == RN_EXIT_OK && lost) code = look(upload);
        if (upload->record.offset > before) arrived(upload);
    }
    return code;
}

static enum rn_exit import_it(struct upload *upload, const char *name,
                              const struct rn_ingest_options *options, char ret_job[RN_ID_MAX]) {
    struct rn_dataset_request wanted;
    struct rn_api_reply reply;
    struct rn_job job;
    rn_message_init(&rn_dataset_request_table, &wanted);
    snprintf(wanted.name, sizeof wanted.name, "%s", name);
    snprintf(wanted.upload, sizeof wanted.upload, "%s", upload->record.id);
    wanted.options = *options;
    char *body = rn_api_encode(&rn_dataset_request_table, &wanted);
    if (!body) return RN_EXIT_FAILED;
    enum rn_exit code = ask(upload, "POST", "/v1/datasets", body, &reply);
    free(body);
    if (code == RN_EXIT_OK) code = rn_api_decode(&reply, &rn_job_table, &job);
    rn_api_reply_finish(&reply);
    if (code != RN_EXIT_OK) return code;
    memcpy(ret_job, job.id, RN_ID_MAX);
    rn_message_finish(&rn_job_table, &job);
    return RN_EXIT_OK;
}

// What arrived of an upload that ended early is deleted: a later call begins anew. Also after an
// interrupt, which ends all other requests.
static void give_up(struct upload *upload) {
    struct rn_http_reply reply = {0};
    struct rn_error err = {0};
    char *path = rn_api_path("uploads", upload->record.id, "");
    struct rn_http_request request = {.method = "DELETE", .path = path, .idle_s = LAST_IDLE_S};
    if (!path) return;
    enum rn_status status = rn_http_perform(upload->client->http, &request, &reply, &err);
    if (status == RN_OK && reply.status == 404)
        rn_client_note(
            "ripnerf: the daemon has what was sent no longer, or imports it: ripnerf jobs");
    else if (status != RN_OK || reply.status / 100 != 2)
        rn_client_note("ripnerf: what was sent stays in the daemon for a day (%s)",
                       upload->record.id);
    rn_http_reply_finish(&reply);
    free(path);
}

enum rn_exit rn_upload(struct rn_client *client, struct rn_tar *tar, const char *name,
                       const struct rn_ingest_options *options, char ret_job[RN_ID_MAX]) {
    struct upload upload = {.client = client, .tar = tar};
    struct rn_error err = {0};
    if (rn_interrupt_catch(&err) != RN_OK) return rn_client_fail(&err);
    arrived(&upload);
    rn_progress_init(&upload.progress, !client->json);
    enum rn_exit code = begin(&upload, name);
    if (code == RN_EXIT_OK) code = send_all(&upload);
    rn_progress_finish(&upload.progress);
    if (code == RN_EXIT_OK) code = import_it(&upload, name, options, ret_job);
    if (code != RN_EXIT_OK && *upload.record.id) give_up(&upload);
    return code;
}

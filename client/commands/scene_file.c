#include "client/commands/scene_file.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "client/commands/export_job.h"
#include "client/follow.h"
#include "common/base/file.h"
#include "common/base/seal.h"
#include "proto/scene.h"

#define SUFFIX ".ripscene"
#define BEGINS "{\"__metadata__\":{\"format\":\"ripnerf\"" // behind eight bytes

static bool begins_like_one(const char *path, uint64_t *ret_bytes) {
    uint8_t head[8 + sizeof BEGINS - 1];
    size_t size = 0;
    *ret_bytes = 0;
    return rn_file_read_head(path, head, sizeof head, &size, ret_bytes, NULL) == RN_OK &&
           size == sizeof head && memcmp(head + 8, BEGINS, sizeof BEGINS - 1) == 0;
}

bool rn_is_scene_file(const char *path) {
    uint64_t bytes;
    size_t length = strlen(path), tail = strlen(SUFFIX);
    return (length > tail && strcmp(path + length - tail, SUFFIX) == 0) ||
           begins_like_one(path, &bytes);
}

enum rn_exit rn_check_scene_file(const char *path, uint64_t *ret_bytes) {
    struct rn_error err = {0};
    uint64_t bytes;
    uint8_t first;
    size_t size;
    char digest[65];
    enum rn_status status = rn_file_read_head(path, &first, 1, &size, &bytes, &err);
    if (status == RN_OK && bytes == 0)
        status = rn_error_set(&err, RN_ERROR_INVALID, path, "is empty; export the scene again");
    if (status == RN_OK && !begins_like_one(path, &bytes))
        status = rn_error_set(&err, RN_ERROR_INVALID, path,
                              "is no scene that ripnerf export --as scene wrote, or is damaged");
    if (status == RN_OK) status = rn_seal_check(path, digest, &err);
    if (status != RN_OK) return rn_client_fail(&err);
    *ret_bytes = bytes;
    return RN_EXIT_OK;
}

struct sending {
    FILE *file;
    uint64_t sent, bytes;
    struct rn_progress progress;
};

static size_t send_part(void *context, char *buffer, size_t capacity) {
    struct sending *sending = context;
    char sent[24], bytes[24];
    size_t got = fread(buffer, 1, capacity, sending->file);
    if (got == 0 && sending->sent < sending->bytes) return SIZE_MAX; // it has shrunk
    sending->sent += got;
    rn_format_bytes((double)sending->sent, sent, sizeof sent);
    rn_format_bytes((double)sending->bytes, bytes, sizeof bytes);
    rn_progress_update(&sending->progress, (double)sending->sent / (double)sending->bytes,
                       "sending %s of %s", sent, bytes);
    return got;
}

static char *query_of(const char *name, const char *dataset) {
    struct rn_buf query;
    rn_buf_init(&query, 4096);
    rn_buf_printf(&query, "/v1/scenes?name=");
    rn_http_escape(&query, name);
    if (dataset) {
        rn_buf_printf(&query, "&dataset=");
        rn_http_escape(&query, dataset);
    }
    char *text = query.failed ? NULL : strdup((char *)query.data);
    rn_buf_finish(&query);
    return text;
}

static enum rn_exit send_file(struct rn_client *client, const char *path, struct sending *sending,
                              char ret_job[RN_ID_MAX]) {
    struct rn_http_request request = {.method = "POST",
                                      .path = path,
                                      .content_type = "application/octet-stream",
                                      .read = send_part,
                                      .body_size = (size_t)sending->bytes,
                                      .context = sending,
                                      .idle_s = 300};
    struct rn_api_reply reply;
    struct rn_job job;
    rn_progress_init(&sending->progress, !client->json);
    rn_api_exchange(client, &request, &reply);
    rn_progress_finish(&sending->progress);
    enum rn_exit code = reply.code == RN_EXIT_OK ? rn_api_decode(&reply, &rn_job_table, &job)
                                                 : rn_api_complain(&reply);
    rn_api_reply_finish(&reply);
    if (code != RN_EXIT_OK) return code;
    memcpy(ret_job, job.id, RN_ID_MAX);
    rn_message_finish(&rn_job_table, &job);
    return RN_EXIT_OK;
}

static enum rn_exit print_made(struct rn_client *client, const char *id) {
    enum rn_kind kind;
    struct rn_api_reply reply;
    struct rn_scene scene;
    char planes[64];
    enum rn_exit code = rn_api_find(client, RN_KIND_SCENE, id, &kind, &reply);
    if (code != RN_EXIT_OK) return code;
    if (client->json) {
        puts((char *)reply.http.body.data);
    } else if ((code = rn_api_decode(&reply, &rn_scene_table, &scene)) == RN_EXIT_OK) {
        const struct rn_viewing_record *viewing = &scene.description.viewing;
        rn_format_planes(viewing->bits, planes, sizeof planes);
        printf("scene %s (%s): for viewing, %s, %.3f dB less than the scene it is of; it is not "
               "trained further\n",
               scene.name, scene.id, planes, viewing->loss);
        rn_message_finish(&rn_scene_table, &scene);
    }
    rn_api_reply_finish(&reply);
    return code;
}

enum rn_exit rn_import_scene(struct rn_client *client, const char *path, const char *name,
                             const char *dataset) {
    struct sending sending = {.file = NULL};
    char job[RN_ID_MAX];
    enum rn_exit code = rn_client_check_source(path);
    if (code == RN_EXIT_OK) code = rn_check_scene_file(path, &sending.bytes);
    if (code != RN_EXIT_OK) return code;
    char *query = query_of(name, dataset);
    sending.file = fopen(path, "rb");
    if (!query)
        code = rn_client_usage("--name", "is too long, or --dataset");
    else if (!sending.file)
        code = rn_client_usage(path, "cannot be read");
    if (code == RN_EXIT_OK) code = send_file(client, query, &sending, job);
    if (sending.file) fclose(sending.file);
    free(query);
    if (code != RN_EXIT_OK) return code;
    struct rn_follow follow = {.client = client, .quiet = client->json};
    code = rn_follow_job(&follow, job);
    if (code == RN_EXIT_OK) code = print_made(client, follow.job.scene);
    rn_follow_finish(&follow);
    return code;
}

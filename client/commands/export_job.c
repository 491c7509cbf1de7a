#include "client/commands/export_job.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "client/commands/submit.h"
#include "client/follow.h"

void rn_format_planes(int64_t bits, char *ret_text, size_t capacity) {
    if (bits == 32)
        snprintf(ret_text, capacity, "planes as trained");
    else
        snprintf(ret_text, capacity, "planes in %lld bits a value%s", (long long)bits,
                 bits == 16 ? "" : " by blocks");
}

struct export_request {
    int type;
    char *scene;
    struct rn_export_options options;
};
static const struct rn_field_spec export_request_fields[] = {
    RN_F_NAME(struct export_request, type, RN_REQUIRED, rn_job_type_names),
    RN_F_STRING(struct export_request, scene, RN_REQUIRED, 4096),
    RN_F_OBJECT(struct export_request, options, 0, &rn_export_options_table)};
static const struct rn_table export_request_table =
    RN_TABLE(struct export_request, "export request", export_request_fields);

// What is printed in the end.
struct export_summary {
    char *file;
    int64_t vertices, triangles, bytes, bits, views;
    double psnr, trained, loss;
    int split;
};
static const struct rn_field_spec export_summary_fields[] = {
    RN_F_STRING(struct export_summary, file, RN_REQUIRED, 4096),
    RN_F_INT(struct export_summary, vertices, 0, 0, INT64_MAX),
    RN_F_INT(struct export_summary, triangles, 0, 0, INT64_MAX),
    RN_F_INT(struct export_summary, bytes, RN_REQUIRED, 0, INT64_MAX),
    RN_F_INT(struct export_summary, bits, 0, 0, INT64_MAX),
    RN_F_INT(struct export_summary, views, 0, 0, INT64_MAX),
    RN_F_NUMBER(struct export_summary, psnr, 0, -INFINITY, INFINITY),
    RN_F_NUMBER(struct export_summary, trained, 0, -INFINITY, INFINITY),
    RN_F_NUMBER(struct export_summary, loss, 0, -INFINITY, INFINITY),
    RN_F_NAME(struct export_summary, split, 0, rn_split_names)};
static const struct rn_table export_summary_table =
    RN_TABLE(struct export_summary, "export summary", export_summary_fields);

static void print_made(const struct rn_export_result *made, const char *file) {
    char bytes[24], planes[64];
    rn_format_bytes((double)made->bytes, bytes, sizeof bytes);
    if (made->bits == RN_ABSENT) {
        printf("%s: %lld vertices, %lld triangles, %s\n", file, (long long)made->vertices,
               (long long)made->triangles, bytes);
        return;
    }
    rn_format_planes(made->bits, planes, sizeof planes);
    printf("%s: %s, %s: %.2f dB, %.3f dB less than the scene (%lld %s view%s)\n", file, bytes,
           planes, made->psnr, made->loss, (long long)made->views, rn_split_names[made->split],
           made->views == 1 ? "" : "s");
}

static enum rn_exit tell(const struct rn_client *client, const struct rn_job *job,
                         const char *file) {
    struct rn_export_result made;
    struct rn_error err = {0};
    const char *text = job->result ? job->result : "";
    if (rn_decode(&rn_export_result_table, text, strlen(text), &made, NULL, &err) != RN_OK)
        return rn_client_fail(&err);
    struct export_summary summary = {(char *)file, made.vertices, made.triangles, made.bytes,
                                     made.bits,    made.views,    made.psnr,      made.trained,
                                     made.loss,    made.split};
    char *json = client->json ? rn_api_encode(&export_summary_table, &summary) : NULL;
    if (json)
        puts(json);
    else
        print_made(&made, file);
    free(json);
    return RN_EXIT_OK;
}

static enum rn_exit follow_and_save(struct rn_client *client, const char *job, const char *file) {
    const char *quote = rn_quote_of(file);
    char path[RN_ID_MAX + 32], tail[512];
    snprintf(tail, sizeof tail, "-o %s%s%s", quote, file, quote);
    struct rn_follow follow = {
        .client = client, .quiet = client->json, .back = "export", .tail = tail};
    enum rn_exit code = rn_follow_job(&follow, job);
    snprintf(path, sizeof path, "/v1/jobs/%s/export", job);
    if (code == RN_EXIT_OK) code = rn_api_save(client, path, file);
    if (code == RN_EXIT_OK) code = tell(client, &follow.job, file);
    rn_follow_finish(&follow);
    return code;
}

enum rn_exit rn_export_by_job(struct rn_client *client, const char *scene,
                              const struct rn_export_options *options, const char *file) {
    struct export_request request = {
        .type = RN_JOB_EXPORT, .scene = (char *)scene, .options = *options}; // only read
    char job[RN_ID_MAX], *answer = NULL, *body = rn_api_encode(&export_request_table, &request);
    enum rn_exit code = body ? rn_submit(client, body, job, &answer) : RN_EXIT_FAILED;
    free(body);
    free(answer);
    return code == RN_EXIT_OK ? follow_and_save(client, job, file) : code;
}

// What the job writes, by its options; NULL: it is no export.
static const char *ending_of(const struct rn_job *job) {
    struct rn_export_options options;
    const char *text = job->options ? job->options : "";
    if (job->type != RN_JOB_EXPORT ||
        rn_decode(&rn_export_options_table, text, strlen(text), &options, NULL, NULL) != RN_OK)
        return NULL;
    return options.as == RN_EXPORT_SCENE     ? ".ripscene"
           : options.format == RN_EXPORT_OBJ ? ".obj"
                                             : ".ply";
}

enum rn_exit rn_export_of_job(struct rn_client *client, const char *id, const char *file) {
    struct rn_job job;
    enum rn_exit code = rn_api_get(client, "jobs", id, "", &rn_job_table, &job);
    if (code != RN_EXIT_OK) return code;
    const char *ending = ending_of(&job), *dot = strrchr(file, '.');
    if (!ending)
        code = rn_client_usage(id, "is a job of type %s, which exports nothing",
                               rn_job_type_names[job.type]);
    else if (!dot || strcmp(dot, ending) != 0)
        code = rn_client_usage(file, "is no file of what job %s writes; use %s", id, ending);
    rn_message_finish(&rn_job_table, &job);
    return code == RN_EXIT_OK ? follow_and_save(client, id, file) : code;
}

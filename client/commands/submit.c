#include "client/commands/submit.h"

#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/checks.h"
#include "proto/dataset.h"

bool rn_take_text(const char *option, const char *text, const char *(*check)(const char *),
                  char *ret_field, size_t capacity) {
    if (!text) return true;
    const char *wrong = strlen(text) >= capacity ? "is too long" : check ? check(text) : NULL;
    if (!wrong)
        snprintf(ret_field, capacity, "%s", text);
    else
        rn_client_usage(option, "%s; it is '%s'", wrong, text);
    return !wrong;
}

// What a source is called: the last part of its path, without a film's or a scene file's ending;
// "NAME" where that cannot be a name.
static void name_of(const char *source, char ret_name[RN_NAME_MAX]) {
    char path[PATH_MAX];
    if (!realpath(source, path)) snprintf(path, sizeof path, "%s", source);
    for (size_t end = strlen(path); end > 1 && path[end - 1] == '/';)
        path[--end] = '\0';
    const char *slash = strrchr(path, '/'), *last = slash ? slash + 1 : path;
    const char *dot = strrchr(last, '.');
    size_t size = dot && dot > last ? (size_t)(dot - last) : strlen(last);
    if (size >= RN_NAME_MAX) size = 0;
    snprintf(ret_name, RN_NAME_MAX, "%.*s", (int)size, last);
    if (rn_check_name(ret_name)) snprintf(ret_name, RN_NAME_MAX, "NAME");
}

const char *rn_quote_of(const char *word) {
    static const char plain[] =
        "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789/._-+:,@%";
    return word[strspn(word, plain)] ? "'" : "";
}

enum rn_exit rn_name_missing(const char *verb, const char *source) {
    const char *quote = rn_quote_of(source);
    char name[RN_NAME_MAX];
    name_of(source, name);
    return rn_client_usage(verb, "needs a name: ripnerf %s %s%s%s --name %s", verb, quote, source,
                           quote, name);
}

bool rn_crop_option(const char *text, double ret_crop[6]) {
    struct rn_box box;
    if (!text) return true;
    if (!rn_ingest_crop(text, &box)) {
        rn_client_usage("--crop", "needs a low and a high corner: X0,Y0,Z0,X1,Y1,Z1");
        return false;
    }
    memcpy(ret_crop, box.low, sizeof box.low);
    memcpy(ret_crop + 3, box.high, sizeof box.high);
    return true;
}

enum rn_exit rn_check_budget(const union rn_setting_value settings[RN_RENDER_SETTINGS]) {
    const char *setting = NULL, *budget = NULL;
    for (size_t i = 0; i < RN_RENDER_SETTINGS; i++) {
        const struct rn_setting *row = &rn_render_settings.rows[i];
        if (rn_setting_is_absent(row, &settings[i])) continue;
        if (i >= RN_RENDER_BUDGET && budget)
            return rn_client_usage("", "--%s and --%s exclude each other", budget, row->flag);
        *(i < RN_RENDER_BUDGET ? &setting : &budget) = row->flag;
    }
    if (!setting || !budget) return RN_EXIT_OK;
    return rn_client_usage("", "--%s and --%s exclude each other: it chooses such settings", budget,
                           setting);
}

// POSTs to a path that answers with a job.
static enum rn_exit post_for_job(struct rn_client *client, const char *path, const char *body,
                                 char ret_job[RN_ID_MAX], char **ret_json) {
    struct rn_api_reply reply;
    struct rn_job job;
    rn_api_send(client, "POST", path, body, &reply);
    enum rn_exit code = reply.code == RN_EXIT_OK ? rn_api_decode(&reply, &rn_job_table, &job)
                                                 : rn_api_complain(&reply);
    if (code == RN_EXIT_OK) {
        memcpy(ret_job, job.id, sizeof job.id);
        rn_message_finish(&rn_job_table, &job);
        *ret_json = (char *)rn_buf_take(&reply.http.body, &(size_t){0});
    }
    rn_api_reply_finish(&reply);
    return code;
}

enum rn_exit rn_submit(struct rn_client *client, const char *body, char ret_job[RN_ID_MAX],
                       char **ret_json) {
    return post_for_job(client, "/v1/jobs", body, ret_job, ret_json);
}

enum rn_exit rn_take_up(struct rn_client *client, char job[RN_ID_MAX]) {
    struct rn_job record;
    char *answer = NULL;
    enum rn_exit code = rn_api_get(client, "jobs", job, "", &rn_job_table, &record);
    if (code != RN_EXIT_OK) return code;
    bool unfinished = record.state == RN_JOB_FAILED || record.state == RN_JOB_CANCELLED;
    rn_message_finish(&rn_job_table, &record);
    if (!unfinished) return RN_EXIT_OK;
    char *path = rn_api_path("jobs", job, "/resume");
    code = path ? post_for_job(client, path, NULL, job, &answer) : RN_EXIT_FAILED;
    free(path);
    free(answer);
    return code;
}

enum rn_exit rn_submit_and_follow(struct rn_client *client, char *body,
                                  struct rn_follow *ret_follow) {
    char job[RN_ID_MAX], *answer = NULL;
    *ret_follow = (struct rn_follow){.client = client, .quiet = client->json};
    if (!body) return RN_EXIT_FAILED;
    enum rn_exit code = rn_submit(client, body, job, &answer);
    free(body);
    free(answer);
    return code == RN_EXIT_OK ? rn_follow_job(ret_follow, job) : code;
}

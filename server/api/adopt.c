// POST /v1/backup: a backup that was made here or elsewhere joins what is stored, while the daemon
// goes on. A thread of its own unpacks it beside the data and looks at all of its digests first.
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/base/file.h"
#include "common/base/log.h"
#include "common/base/tar.h"
#include "proto/adopted.h"
#include "server/api/app.h"

#define TAR_TYPE "application/x-tar"
#define PATIENCE_MS 3600000 // of the client

struct rn_adoption {
    pthread_t thread;
    bool started;        // the thread is to be joined
    atomic_bool working; // and has not ended
    atomic_bool stopping;
    struct rn_store *store;
    struct rn_control *control;
    struct rn_parked *parked;
    char *archive, *folder; // where it was spooled, and is unpacked
};

static bool keep_going(void *context) {
    const struct rn_adoption *adoption = context;
    return !adoption->stopping;
}

static enum rn_status take_in(struct rn_adoption *adoption, char **ret_json, struct rn_error *err) {
    struct rn_tar_contents contents;
    struct rn_adopted adopted;
    enum rn_status status = rn_mkdir(adoption->folder, 0700, err);
    if (status == RN_OK)
        status = rn_tar_unpack(adoption->archive, adoption->folder, keep_going, adoption, &contents,
                               err);
    if (status == RN_OK)
        status =
            rn_store_adopt(adoption->store, adoption->folder, keep_going, adoption, &adopted, err);
    if (status == RN_OK) status = rn_control_adopt(adoption->control, err);
    if (status != RN_OK) return status;
    const struct rn_adopted_record record = {adopted.datasets, adopted.scenes, adopted.camera_paths,
                                             adopted.jobs};
    rn_log(RN_LOG_INFO, "a backup was taken in: %lld scenes, %lld datasets, %lld jobs",
           (long long)adopted.scenes, (long long)adopted.datasets, (long long)adopted.jobs);
    return rn_encode(&rn_adopted_table, &record, ret_json, NULL, err);
}

static void clean_up(struct rn_adoption *adoption) {
    struct rn_error err = {0};
    (void)unlink(adoption->archive);
    if (rn_remove_tree(adoption->folder, &err) != RN_OK)
        rn_log(RN_LOG_WARN, "%s: %s", adoption->folder, err.text);
    free(adoption->archive);
    free(adoption->folder);
    adoption->archive = adoption->folder = NULL;
}

// What is wrong with the archive, its sender can mend.
static void tell(struct rn_error *err, struct rn_reply *reply) {
    rn_log(RN_LOG_WARN, "a backup was not taken in: %s: %s", err->where, err->text);
    if (err->status == RN_ERROR_CANCELLED) err->status = RN_ERROR_UNAVAILABLE;
    if (err->status == RN_ERROR_CORRUPT) {
        err->status = RN_ERROR_INVALID;
        snprintf(err->where, sizeof err->where, "body");
    }
    rn_reply_error(reply, err);
}

static void *adopt(void *context) {
    struct rn_adoption *adoption = context;
    struct rn_reply reply = {0};
    struct rn_error err = {0};
    char *json = NULL;
    if (take_in(adoption, &json, &err) == RN_OK)
        rn_api_json(&reply, 200, json);
    else
        tell(&err, &reply);
    clean_up(adoption);
    adoption->working = false; // before its sender may come with another one
    rn_parked_answer(adoption->parked, &reply);
    return NULL;
}

static void on_gone(void *context, struct rn_parked *parked) {}

void rn_begin_adoption(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_error err = {0};
    if (!rn_request_has_type(request, TAR_TYPE))
        rn_reply_problem(reply, RN_PROBLEM_MEDIA_TYPE,
                         "send the backup as Content-Type: " TAR_TYPE);
    else
        (void)rn_api_failed(rn_api_spool(context, request, &err), &err, reply);
}

static enum rn_status begin(struct rn_app *app, struct rn_request *request, const char *spooled,
                            struct rn_error *err) {
    struct rn_adoption *adoption = app->adoption;
    if (adoption == NULL) adoption = app->adoption = calloc(1, sizeof *adoption);
    if (adoption == NULL)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "no memory for a backup");
    if (adoption->working)
        return rn_error_set(err, RN_ERROR_BUSY, "", "a backup is being taken in already");
    if (adoption->started) pthread_join(adoption->thread, NULL);
    adoption->started = false;
    adoption->store = app->store;
    adoption->control = app->control;
    adoption->archive = strdup(spooled);
    if (asprintf(&adoption->folder, "%s.d", spooled) < 0) adoption->folder = NULL;
    enum rn_status status =
        adoption->archive == NULL || adoption->folder == NULL
            ? rn_error_set(err, RN_ERROR_NO_MEMORY, "", "no memory for a backup")
            : rn_request_park(request, PATIENCE_MS, on_gone, NULL, &adoption->parked, err);
    if (status != RN_OK) {
        free(adoption->archive);
        free(adoption->folder);
        return status;
    }
    rn_request_take_spooled(request);
    adoption->working = true;
    adoption->started = pthread_create(&adoption->thread, NULL, adopt, adoption) == 0;
    if (!adoption->started) {
        struct rn_reply reply = {0};
        clean_up(adoption);
        adoption->working = false;
        rn_reply_problem(&reply, RN_PROBLEM_INTERNAL, "a thread cannot be started");
        rn_parked_answer(adoption->parked, &reply);
    }
    return RN_OK;
}

void rn_adopt_backup(void *context, struct rn_request *request, struct rn_reply *reply) {
    static const char *const known[] = {NULL};
    struct rn_error err = {0};
    uint64_t size;
    const char *spooled = rn_request_spooled(request, &size);
    enum rn_status status = rn_request_check_query(request, known, &err);
    if (status == RN_OK && (spooled == NULL || size == 0))
        status = rn_error_set(&err, RN_ERROR_INVALID, "body",
                              "holds no backup: send what ripnerf backup wrote, as " TAR_TYPE);
    if (status == RN_OK) status = begin(context, request, spooled, &err);
    (void)rn_api_failed(status, &err, reply);
}

void rn_adoption_stop(struct rn_app *app) {
    if (app->adoption == NULL) return;
    app->adoption->stopping = true;
    if (app->adoption->started) pthread_join(app->adoption->thread, NULL);
    free(app->adoption);
    app->adoption = NULL;
}

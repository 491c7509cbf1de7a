// GET /v1/backup: all that is stored, or one scene with all that belongs to it, as of one moment,
// as a tar that ripnerf restore unpacks.
#include <dirent.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>

#include "common/base/file.h"
#include "common/base/log.h"
#include "common/base/tar.h"
#include "server/api/app.h"

#define PREPARE_MS 600000 // what may pass until the first byte

struct rn_backup {
    pthread_t thread;
    bool started; // the thread is to be joined
    atomic_bool preparing;
    atomic_bool working; // preparing or sending
    struct rn_store *store;
    struct rn_parked *parked;
    char *folder;          // of the snapshot
    char scene[RN_ID_MAX]; // of which it is; "": of all
    struct rn_tar *tar;
};

static void finish(struct rn_backup *backup) {
    struct rn_error err = {0};
    rn_tar_destroy(&backup->tar);
    if (backup->folder != NULL && rn_remove_tree(backup->folder, &err) != RN_OK)
        rn_log(RN_LOG_WARN, "%s: %s", backup->folder, err.text);
    free(backup->folder);
    backup->folder = NULL;
    backup->working = false;
}

static void *clean_up(void *context) {
    finish(context);
    return NULL;
}

// Many files take a while to remove: not on the thread that serves others. When nobody wanted the
// answer any more, it is the preparing thread that ends it.
static void end_stream(void *context) {
    struct rn_backup *backup = context;
    if (pthread_equal(pthread_self(), backup->thread)) {
        finish(backup);
        return;
    }
    pthread_join(backup->thread, NULL);
    backup->started = pthread_create(&backup->thread, NULL, clean_up, backup) == 0;
    if (!backup->started) finish(backup);
}

static ssize_t read_stream(void *context, uint8_t *bytes, size_t capacity) {
    struct rn_backup *backup = context;
    size_t size = rn_tar_read(backup->tar, (char *)bytes, capacity);
    if (size != SIZE_MAX) return (ssize_t)size;
    rn_log(RN_LOG_ERROR, "backup: %s: %s", rn_tar_error(backup->tar)->where,
           rn_tar_error(backup->tar)->text);
    return -1;
}

// All files below the folder, in the order of their names.
static enum rn_status add_files(struct rn_tar *tar, const char *root, const char *relative,
                                struct rn_error *err) {
    char path[4300], name[512];
    struct dirent **entries = NULL;
    struct stat about;
    snprintf(path, sizeof path, "%s/%s", root, relative);
    int count = scandir(path, &entries, NULL, alphasort);
    enum rn_status status =
        count < 0 ? rn_error_set(err, RN_ERROR_IO, path, "cannot be listed") : RN_OK;
    for (int i = 0; i < count; i++) {
        const char *entry = entries[i]->d_name;
        int size = snprintf(name, sizeof name, "%s%s%s", relative, *relative ? "/" : "", entry);
        if (status == RN_OK && entry[0] != '.' && size < (int)sizeof name) {
            snprintf(path, sizeof path, "%s/%s", root, name);
            if (stat(path, &about) == 0 && S_ISDIR(about.st_mode))
                status = add_files(tar, root, name, err);
            else
                status = rn_tar_add(tar, name, err);
        }
        free(entries[i]);
    }
    free(entries);
    return status;
}

static void *prepare(void *context) {
    struct rn_backup *backup = context;
    struct rn_reply reply = {0};
    struct rn_error err = {0};
    enum rn_status status = rn_store_snapshot(
        backup->store, backup->scene[0] != '\0' ? backup->scene : NULL, backup->folder, &err);
    if (status == RN_OK) status = rn_tar_create(backup->folder, &backup->tar, &err);
    if (status == RN_OK) status = add_files(backup->tar, backup->folder, "", &err);
    if (status == RN_OK) {
        rn_reply_stream(&reply, "application/x-tar",
                        (struct rn_stream){.read = read_stream,
                                           .close = end_stream,
                                           .context = backup,
                                           .size = rn_tar_size(backup->tar)});
        rn_reply_header(&reply, "Content-Disposition", "attachment; filename=\"ripnerf.tar\"");
    } else {
        rn_log(RN_LOG_ERROR, "backup: %s: %s", err.where, err.text);
        finish(backup);
        rn_reply_error(&reply, &err);
    }
    rn_parked_answer(backup->parked, &reply); // nobody may want it any more: the stream is closed
    backup->preparing = false;
    return NULL;
}

static void on_gone(void *context, struct rn_parked *parked) {}

static enum rn_status find_scene(struct rn_app *app, const struct rn_request *request,
                                 char ret_scene[RN_ID_MAX], struct rn_error *err) {
    static const char *const known[] = {"scene", NULL};
    struct rn_scene_row row;
    ret_scene[0] = '\0';
    enum rn_status status = rn_request_check_query(request, known, err);
    const char *reference = rn_request_query(request, "scene");
    if (status != RN_OK || reference == NULL) return status;
    status = rn_store_resolve(app->store, &rn_scenes, RN_ID_SCENE, reference, &row, err);
    if (status != RN_OK) return status;
    memcpy(ret_scene, row.id, RN_ID_MAX);
    rn_row_finish(&rn_scenes, &row);
    return RN_OK;
}

static enum rn_status begin(struct rn_app *app, struct rn_request *request, struct rn_error *err) {
    struct rn_backup *backup = app->backup;
    char id[RN_ID_MAX], scene[RN_ID_MAX];
    enum rn_status status = find_scene(app, request, scene, err);
    if (status != RN_OK) return status;
    if (backup == NULL) backup = app->backup = calloc(1, sizeof *backup);
    if (backup == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "no memory for a backup");
    if (backup->working)
        return rn_error_set(err, RN_ERROR_BUSY, "", "a backup is being made already");
    if (backup->started) pthread_join(backup->thread, NULL);
    backup->started = false;
    backup->store = app->store;
    memcpy(backup->scene, scene, RN_ID_MAX);
    status = rn_store_new_id("upload-", id, err);
    if (status == RN_OK) backup->folder = rn_store_path(app->store, "spool/%s", id);
    if (status == RN_OK && backup->folder == NULL)
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, "", "no memory for a backup");
    if (status == RN_OK)
        status = rn_request_park(request, PREPARE_MS, on_gone, NULL, &backup->parked, err);
    if (status != RN_OK) return status;
    backup->working = backup->preparing = true;
    if (pthread_create(&backup->thread, NULL, prepare, backup) == 0) {
        backup->started = true;
    } else {
        struct rn_reply reply = {0};
        backup->preparing = false;
        finish(backup);
        rn_reply_problem(&reply, RN_PROBLEM_INTERNAL, "a thread cannot be started");
        rn_parked_answer(backup->parked, &reply);
    }
    return RN_OK;
}

void rn_get_backup(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_error err = {0};
    (void)rn_api_failed(begin(context, request, &err), &err, reply);
}

void rn_backup_settle(struct rn_app *app) {
    while (app->backup != NULL && app->backup->preparing)
        nanosleep(&(struct timespec){.tv_nsec = 10000000}, NULL);
}

void rn_backup_stop(struct rn_app *app) {
    if (app->backup == NULL) return;
    if (app->backup->started) pthread_join(app->backup->thread, NULL);
    free(app->backup);
    app->backup = NULL;
}

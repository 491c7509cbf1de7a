// Cameras and photographs of a dataset, and the model that its poses were found in.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/base/buf.h"
#include "common/base/manifest.h"
#include "proto/camera.h"
#include "proto/job.h"
#include "proto/scene.h"
#include "server/api/app.h"

// The dataset of that name or id, kept for the next request. NULL: replied with an error.
static const struct rn_dataset *open_named(struct rn_app *app, const char *name,
                                           struct rn_reply *reply) {
    struct rn_error err = {0};
    struct rn_dataset_row row;
    enum rn_status status =
        rn_store_resolve(app->store, &rn_datasets, RN_ID_DATASET, name, &row, &err);
    if (rn_api_failed(status, &err, reply)) return NULL;
    if (app->dataset == NULL || strcmp(app->dataset_id, row.id) != 0) {
        char *folder = rn_store_path(app->store, "datasets/%s", row.id);
        rn_dataset_destroy(&app->dataset);
        snprintf(app->dataset_id, sizeof app->dataset_id, "%s", row.id);
        status = folder == NULL ? rn_error_set(&err, RN_ERROR_NO_MEMORY, "", "no memory")
                                : rn_dataset_read_whole(folder, &app->dataset, &err);
        free(folder);
    }
    rn_row_finish(&rn_datasets, &row);
    return rn_api_failed(status, &err, reply) ? NULL : app->dataset;
}

// The one that the path names.
static const struct rn_dataset *open_dataset(struct rn_app *app, struct rn_request *request,
                                             struct rn_reply *reply) {
    return open_named(app, rn_request_param(request, 0), reply);
}

static enum rn_status encode_frame(const struct rn_frame *frame, char **ret_json,
                                   struct rn_error *err) {
    struct rn_dataset_camera item = {.split = (int)frame->split,
                                     .index = frame->index,
                                     .scale = frame->scale,
                                     .camera = frame->camera};
    snprintf(item.name, sizeof item.name, "%s", frame->name);
    return rn_encode(&rn_dataset_camera_table, &item, ret_json, NULL, err);
}

static enum rn_status encode_frames(const struct rn_dataset *dataset, int split,
                                    struct rn_buf *json, struct rn_error *err) {
    bool first = true;
    rn_buf_printf(json, "{\"items\":[");
    for (size_t i = 0; i < dataset->frame_count; i++) {
        char *item = NULL;
        if (split >= 0 && (int)dataset->frames[i].split != split) continue;
        enum rn_status status = encode_frame(&dataset->frames[i], &item, err);
        if (status != RN_OK) return status;
        rn_buf_printf(json, "%s", first ? "" : ",");
        rn_buf_append(json, item, strlen(item));
        free(item);
        first = false;
    }
    rn_buf_printf(json, "]}");
    return rn_buf_status(json, "the list of cameras", err);
}

static enum rn_status parse_split(const char *text, int *ret_split, struct rn_error *err) {
    int split = text != NULL ? rn_name_index(rn_split_names, text) : -1;
    if (text != NULL && split < 0)
        return rn_error_set(err, RN_ERROR_INVALID, "split", "must be train, val or test");
    *ret_split = split;
    return RN_OK;
}

void rn_list_cameras(void *context, struct rn_request *request, struct rn_reply *reply) {
    static const char *const known[] = {"split", NULL};
    struct rn_error err = {0};
    struct rn_buf json;
    int split = -1;
    size_t size;
    enum rn_status status = rn_request_check_query(request, known, &err);
    if (status == RN_OK) status = parse_split(rn_request_query(request, "split"), &split, &err);
    if (rn_api_failed(status, &err, reply)) return;
    const struct rn_dataset *dataset = open_dataset(context, request, reply);
    if (dataset == NULL) return;
    rn_buf_init(&json, 256u << 20);
    status = encode_frames(dataset, split, &json, &err);
    if (!rn_api_failed(status, &err, reply)) {
        uint8_t *bytes = rn_buf_take(&json, &size);
        rn_reply_bytes(reply, 200, "application/json", bytes, size);
    }
    rn_buf_finish(&json);
}

static void reply_start(const struct rn_scene_start *start, struct rn_reply *reply) {
    struct rn_error err = {0};
    char *json = NULL;
    enum rn_status status = rn_encode(&rn_scene_start_table, start, &json, NULL, &err);
    if (!rn_api_failed(status, &err, reply)) rn_api_json(reply, 200, json);
}

static void start_of_dataset(const struct rn_dataset *dataset, struct rn_reply *reply) {
    const double *up = dataset->lie.up;
    const struct rn_frame *first = rn_dataset_start(dataset);
    if (first != NULL)
        reply_start(&(struct rn_scene_start){first->camera, {up[0], up[1], up[2]}}, reply);
    else
        rn_reply_problem(reply, RN_PROBLEM_NOT_FOUND, "the scene's dataset has no view");
}

// As the file for viewing tells that the scene came as.
static void start_of_file(const struct rn_scene_row *row, struct rn_reply *reply) {
    struct rn_error err = {0};
    struct rn_scene_description description;
    const struct rn_scene_start *start = &description.viewing.start;
    enum rn_status status = RN_OK;
    rn_message_init(&rn_scene_description_table, &description);
    if (row->record != NULL)
        status = rn_decode(&rn_scene_description_table, row->record, strlen(row->record),
                           &description, NULL, &err);
    if (rn_api_failed(status, &err, reply)) return;
    if (start->camera.width > 0)
        reply_start(start, reply);
    else
        rn_reply_problem(reply, RN_PROBLEM_NOT_FOUND,
                         "the scene '%s' has no photographs here, and its file, of an older build, "
                         "tells no camera; export it again",
                         row->name);
    rn_message_finish(&rn_scene_description_table, &description);
}

void rn_get_start(void *context, struct rn_request *request, struct rn_reply *reply) {
    static const char *const known[] = {NULL};
    struct rn_app *app = context;
    struct rn_error err = {0};
    struct rn_scene_row row;
    enum rn_status status = rn_request_check_query(request, known, &err);
    if (status == RN_OK)
        status = rn_store_resolve(app->store, &rn_scenes, RN_ID_SCENE, rn_request_param(request, 0),
                                  &row, &err);
    if (rn_api_failed(status, &err, reply)) return;
    const struct rn_dataset *dataset = NULL;
    if (*row.dataset)
        dataset = open_named(app, row.dataset, reply);
    else
        start_of_file(&row, reply);
    rn_row_finish(&rn_scenes, &row);
    if (dataset != NULL) start_of_dataset(dataset, reply);
}

// At most so many points: evenly of all there are.
#define MOST_POINTS 20000

void rn_list_points(void *context, struct rn_request *request, struct rn_reply *reply) {
    static const char *const known[] = {NULL};
    struct rn_error err = {0};
    struct rn_buf json;
    size_t size;
    if (rn_api_failed(rn_request_check_query(request, known, &err), &err, reply)) return;
    const struct rn_dataset *dataset = open_dataset(context, request, reply);
    if (dataset == NULL) return;
    const struct rn_points *points = &dataset->points;
    size_t shown = points->count < MOST_POINTS ? points->count : MOST_POINTS;
    rn_buf_init(&json, 4u << 20);
    rn_buf_printf(&json, "{\"count\":%zu,\"items\":[", points->count);
    for (size_t i = 0; i < shown; i++) {
        const struct rn_point *point = &points->items[i * points->count / shown];
        const double *at = point->position;
        rn_buf_printf(&json, "%s[%.9g,%.9g,%.9g,%d,%d,%d]", i ? "," : "", at[0], at[1], at[2],
                      point->colour[0], point->colour[1], point->colour[2]);
    }
    rn_buf_printf(&json, "]}");
    if (!rn_api_failed(rn_buf_status(&json, "the list of points", &err), &err, reply)) {
        uint8_t *bytes = rn_buf_take(&json, &size);
        rn_reply_bytes(reply, 200, "application/json", bytes, size);
    }
    rn_buf_finish(&json);
}

// Whether the photograph is as it was imported; datasets of before there were lists have to do.
static bool is_sound(const struct rn_app *app, const struct rn_frame *frame,
                     struct rn_reply *reply) {
    struct rn_error err = {0};
    enum rn_status status = RN_ERROR_NOT_FOUND;
    char *folder = rn_store_path(app->store, "datasets/%s", app->dataset_id);
    size_t size = folder != NULL ? strlen(folder) : 0;
    if (size > 0 && strncmp(frame->path, folder, size) == 0 && frame->path[size] == '/')
        status = rn_manifest_check_file(folder, frame->path + size + 1, &err);
    free(folder);
    return status == RN_ERROR_NOT_FOUND || !rn_api_failed(status, &err, reply);
}

void rn_get_image(void *context, struct rn_request *request, struct rn_reply *reply) {
    static const char *const known[] = {"scale", NULL};
    struct rn_error err = {0};
    int split = -1;
    int64_t index, scale = 0;
    const char *scale_text = rn_request_query(request, "scale");
    enum rn_status status = rn_request_check_query(request, known, &err);
    if (status == RN_OK) status = parse_split(rn_request_param(request, 1), &split, &err);
    if (status == RN_OK)
        status = rn_api_number(rn_request_param(request, 2), 0, 1000000, "index", &index, &err);
    if (status == RN_OK && scale_text != NULL)
        status = rn_api_number(scale_text, 0, 15, "scale", &scale, &err);
    if (rn_api_failed(status, &err, reply)) return;
    const struct rn_dataset *dataset = open_dataset(context, request, reply);
    if (dataset == NULL) return;
    const struct rn_frame *frame =
        rn_dataset_frame(dataset, (enum rn_split)split, (int)index, (int)scale);
    if (frame == NULL) {
        rn_reply_problem(reply, RN_PROBLEM_NOT_FOUND, "there is no view %s:%lld at scale %lld",
                         rn_split_names[split], (long long)index, (long long)scale);
        return;
    }
    if (!is_sound(context, frame, reply)) return;
    const char *ending = strrchr(frame->path, '.');
    bool kept = ending && strcmp(ending, ".jpg") == 0; // as it was sent; the others are made here
    rn_reply_file(reply, kept ? "image/jpeg" : "image/png", frame->path);
    rn_reply_header(reply, "Cache-Control", "private, max-age=3600");
}

// The COLMAP model that the import found poses in; the runner keeps it as this file.
#define MODEL "colmap.tar"

void rn_get_model(void *context, struct rn_request *request, struct rn_reply *reply) {
    static const char *const known[] = {NULL};
    struct rn_app *app = context;
    struct rn_error err = {0};
    struct rn_dataset_row row;
    enum rn_status status = rn_request_check_query(request, known, &err);
    if (status == RN_OK)
        status = rn_store_resolve(app->store, &rn_datasets, RN_ID_DATASET,
                                  rn_request_param(request, 0), &row, &err);
    if (rn_api_failed(status, &err, reply)) return;
    char *path = rn_store_path(app->store, "datasets/%s/" MODEL, row.id);
    if (path != NULL && access(path, F_OK) == 0) {
        rn_reply_file(reply, "application/x-tar", path);
        rn_reply_header(reply, "Cache-Control", "private, max-age=3600");
        rn_reply_header(reply, "Content-Disposition", "attachment; filename=\"%s-colmap.tar\"",
                        row.name);
    } else {
        rn_reply_problem(reply, RN_PROBLEM_NOT_FOUND,
                         "the dataset '%s' has no model: its poses came with it", row.name);
    }
    rn_row_finish(&rn_datasets, &row);
    free(path);
}

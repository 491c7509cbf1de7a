#include <errno.h>
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/file.h"
#include "common/base/manifest.h"
#include "common/path/path.h"
#include "server/runner/budget.h"
#include "server/runner/film.h"

#define FRAME_PNG_LEVEL 6
#define VIDEO_QUALITY 75 // where none is asked for

// A camera path: unit i is frame first + i, a PNG in the job's folder.
struct path_work {
    struct rn_work work;
    struct rn_wire_path request; // its texts are owned
    size_t first;
    double depth_scale; // one for all frames
};

static struct rn_camera frame_camera(const struct path_work *path, size_t unit) {
    const struct rn_path_options *options = &path->request.options;
    struct rn_camera camera = rn_path_camera(path->request.camera_path.path, path->first + unit);
    if (options->width == RN_ABSENT) return camera;
    return rn_camera_reframed(&camera, (int)options->width, (int)options->height);
}

static enum rn_status prepare(struct rn_work *work, struct rn_field *field, struct rn_error *err) {
    struct path_work *path = (struct path_work *)work;
    const struct rn_path_options *options = &path->request.options;
    struct rn_field_info info;
    enum rn_status status = rn_mkdirs(path->request.folder, 0777, err);
    if (status) return status;
    struct rn_path *keys = path->request.camera_path.path;
    keys->fps = rn_number_or(options->fps, keys->fps);
    size_t count = rn_path_frame_count(keys);
    path->first = (size_t)rn_int_or(options->first, 0);
    size_t last = (size_t)rn_int_or(options->last, (int64_t)count - 1);
    if (path->first >= count || last >= count || last < path->first)
        return rn_error_set(err, RN_ERROR_INVALID, "#/options/last",
                            "frames %zu to %zu are asked for; the path has frames 0 to %zu",
                            path->first, last, count - 1);
    work->total = last - path->first + 1;
    rn_field_describe(field, &info);
    for (size_t i = 0; i < work->total; i++) {
        struct rn_camera camera = frame_camera(path, i);
        path->depth_scale = fmax(path->depth_scale, rn_depth_scale(&camera, &info.bounds));
    }
    struct rn_camera first = frame_camera(path, 0);
    return rn_budget_settle(work, field, (double)first.width * first.height,
                            path->request.options.settings, &rn_path_options_table,
                            &path->request.options, err);
}

static enum rn_status frame_file(const struct path_work *path, size_t unit, char ret_file[PATH_MAX],
                                 struct rn_error *err) {
    const char *folder = path->request.folder;
    if (snprintf(ret_file, PATH_MAX, "%s/%05zu.png", folder, path->first + unit) >= PATH_MAX)
        return rn_error_set(err, RN_ERROR_LIMIT, folder, "the path is too long");
    return RN_OK;
}

// Frames of an earlier attempt are kept when they show the same step; a hidden file tells.
static enum rn_status begin(struct rn_work *work, struct rn_error *err) {
    struct path_work *path = (struct path_work *)work;
    char file[PATH_MAX], step[32];
    uint8_t *before = NULL;
    size_t size = 0;
    if (snprintf(file, sizeof file, "%s/.step", path->request.folder) >= (int)sizeof file)
        return rn_error_set(err, RN_ERROR_LIMIT, path->request.folder, "the path is too long");
    int length = snprintf(step, sizeof step, "%lld\n", (long long)work->step);
    bool same = rn_file_read(file, sizeof step, &before, &size, NULL) == RN_OK &&
                strcmp((const char *)before, step) == 0;
    free(before);
    if (same) return RN_OK;
    char frame[PATH_MAX];
    for (size_t i = 0; i < work->total; i++) {
        enum rn_status status = frame_file(path, i, frame, err);
        if (status) return status;
        if (unlink(frame) < 0 && errno != ENOENT)
            return rn_error_from_errno(err, errno, frame, "remove the frame");
    }
    return rn_file_write_atomic(file, step, (size_t)length, err);
}

static enum rn_status render_frame(struct path_work *path, struct rn_field *field,
                                   const struct rn_field_info *info, const char *file,
                                   struct rn_error *err) {
    static const unsigned outputs[] = {[RN_OUTPUT_KIND_RGB] = RN_OUTPUT_RGB,
                                       [RN_OUTPUT_KIND_DEPTH] = RN_OUTPUT_DEPTH,
                                       [RN_OUTPUT_KIND_ALPHA] = RN_OUTPUT_ALPHA};
    const struct rn_path_options *wanted = &path->request.options;
    enum rn_output_kind output =
        (enum rn_output_kind)rn_name_or(wanted->output, RN_OUTPUT_KIND_RGB);
    struct rn_render_options options = {.camera = frame_camera(path, path->work.done),
                                        .outputs = outputs[output]};
    struct rn_render_result result = {0};
    uint8_t *bytes = NULL;
    size_t size;
    rn_settings_put(&rn_render_settings, wanted->settings, &options.settings);
    memcpy(options.background, info->config.background, sizeof options.background);
    enum rn_status status = rn_render(path->work.host->engine, field, &options, rn_work_keep_going,
                                      &path->work, &result, err);
    if (status) return status;
    rn_work_rendered(&path->work, result.stats.render_ms, result.stats.nonfinite_rays);
    status = rn_picture_encode(&result, output, RN_FORMAT_PNG, 0, FRAME_PNG_LEVEL,
                               path->depth_scale, &bytes, &size, err);
    if (!status) status = rn_file_write_atomic(file, bytes, size, err);
    free(bytes);
    rn_render_result_finish(&result);
    return status;
}

static enum rn_status unit(struct rn_work *work, struct rn_field *field,
                           const struct rn_field_info *info, struct rn_error *err) {
    struct path_work *path = (struct path_work *)work;
    char file[PATH_MAX];
    struct stat about;
    enum rn_status status = frame_file(path, work->done, file, err);
    if (status) return status;
    if (stat(file, &about) == 0) return RN_OK; // a frame of an earlier attempt; it is whole
    status = render_frame(path, field, info, file, err);
    if (status) return status;
    struct rn_wire_frame frame = {.index = (int64_t)(path->first + work->done)};
    strcpy(frame.job, work->job);
    rn_link_post(&work->host->link, RN_WIRE_FRAME, &frame, NULL, 0);
    return RN_OK;
}

// The film that was asked for, out of all frames; its size in bytes.
static enum rn_status make_film(struct path_work *path, struct rn_path_result *record,
                                struct rn_error *err) {
    const struct rn_path_options *options = &path->request.options;
    struct rn_film_order order = {.folder = path->request.folder,
                                  .first = path->first,
                                  .count = path->work.total,
                                  .codec = options->film,
                                  .fps = path->request.camera_path.path->fps,
                                  .quality = (int)rn_int_or(options->video_quality, VIDEO_QUALITY),
                                  .keep_going = rn_work_keep_going,
                                  .context = &path->work};
    char file[PATH_MAX];
    struct stat about;
    enum rn_status status = rn_film_make(&order, err);
    if (status) return status;
    snprintf(record->film, sizeof record->film, "%s", rn_film_name(options->film));
    snprintf(file, sizeof file, "%s/%s", order.folder, record->film);
    if (stat(file, &about) < 0) return rn_error_from_errno(err, errno, file, "find the film");
    record->film_bytes = about.st_size;
    return RN_OK;
}

static enum rn_status result(struct rn_work *work, struct rn_field *field, char **ret_json,
                             struct rn_error *err) {
    struct path_work *path = (struct path_work *)work;
    struct rn_camera camera = frame_camera(path, 0);
    struct rn_path_result record = {.frames = (int64_t)work->total,
                                    .width = camera.width,
                                    .height = camera.height,
                                    .step = work->step,
                                    .film_bytes = RN_ABSENT,
                                    .render_ms_median =
                                        rn_work_median(work->render_ms, work->rendered)};
    (void)field;
    enum rn_status status = RN_OK;
    if (path->request.options.film >= 0) status = make_film(path, &record, err);
    if (!status) status = rn_manifest_write(path->request.folder, err);
    if (status) return status;
    return rn_encode(&rn_path_result_table, &record, ret_json, NULL, err);
}

static void release(struct rn_work *work) {
    rn_message_finish(rn_wire_table(RN_WIRE_PATH), &((struct path_work *)work)->request);
}

static const struct rn_work_kind kind = {.size = sizeof(struct path_work),
                                         .prepare = prepare,
                                         .begin = begin,
                                         .unit = unit,
                                         .result = result,
                                         .release = release};

void rn_work_add_path(struct rn_host *host, struct rn_wire_path *request) {
    struct path_work *path = (struct path_work *)rn_work_append(host, &kind, request->job);
    if (!path) return;
    path->request = *request;
    rn_message_init(rn_wire_table(RN_WIRE_PATH), request);
}

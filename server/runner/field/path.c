#include <errno.h>
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/file.h"
#include "common/base/log.h"
#include "common/base/manifest.h"
#include "common/math/numbers.h"
#include "common/path/path.h"
#include "server/runner/field/ahead.h"
#include "server/runner/field/behind.h"
#include "server/runner/field/budget.h"
#include "server/runner/field/film.h"
#include "server/runner/field/parts.h"

#define FRAME_PNG_LEVEL 6
#define INSTANTS 64      // at which a shutter looks
#define VIDEO_QUALITY 75 // where none is asked for

// A camera path: unit i is frame first + i, a file in the job's folder.
struct path_work {
    struct rn_work work;
    struct rn_wire_path request; // its texts are owned
    struct rn_parts parts;       // its frames
    double depth_scale;          // one for all frames
    struct rn_optics optics;     // in place of what the keys say
    struct rn_optics together;   // of all frames: what was on in any
    struct rn_ahead ahead;
    struct rn_behind behind;
};

// A frame that is rendered, on its way to its file.
struct path_frame {
    struct rn_piece piece;
    struct path_work *path;
    struct rn_render_result result;
    struct rn_picture_file how;
    int64_t index;
    char file[PATH_MAX];
};

// At frame first + `unit`, or in between.
static struct rn_camera frame_camera(const struct path_work *path, double unit) {
    const struct rn_path_options *options = &path->request.options;
    struct rn_camera camera =
        rn_path_camera(path->request.camera_path.path, (double)path->parts.first + unit);
    if (options->width == RN_ABSENT) return camera;
    return rn_camera_reframed(&camera, (int)options->width, (int)options->height);
}

static struct rn_optics frame_optics(const struct path_work *path, size_t unit) {
    struct rn_optics optics =
        rn_path_optics(path->request.camera_path.path, (double)(path->parts.first + unit));
    return rn_optics_over(&optics, &path->optics);
}

// The effects of a frame, and where the camera stands while its shutter is open: around the frame's
// time.
static void frame_shot(const struct path_work *path, size_t unit,
                       struct rn_camera instants[INSTANTS], struct rn_shot *ret_shot) {
    struct rn_shot shot = {.optics = frame_optics(path, unit)};
    for (int i = 0; i < INSTANTS && shot.optics.shutter > 0; i++)
        instants[i] =
            frame_camera(path, (double)unit + shot.optics.shutter * ((i + 0.5) / INSTANTS - 0.5));
    if (shot.optics.shutter > 0) {
        shot.instants = instants;
        shot.instant_count = INSTANTS;
    }
    *ret_shot = shot;
}

static enum rn_output_kind frame_output(const struct path_work *path) {
    return (enum rn_output_kind)rn_name_or(path->request.options.output, RN_OUTPUT_KIND_RGB);
}

static enum rn_picture_format frame_format(const struct path_work *path) {
    return (enum rn_picture_format)rn_name_or(path->request.options.format, RN_FORMAT_PNG);
}

// A runner that helps makes some frames and leaves all else to the one that has the job.
static bool is_part(const struct path_work *path) {
    return path->request.begin != RN_ABSENT;
}

// What the options of a frame borrow.
struct frame_stand {
    struct rn_camera instants[INSTANTS];
    struct rn_box box;
};

static void frame_options(const struct path_work *path, size_t unit, const float background[3],
                          struct frame_stand *stand, struct rn_render_options *ret_options) {
    const struct rn_path_options *wanted = &path->request.options;
    *ret_options = (struct rn_render_options){.camera = frame_camera(path, (double)unit)};
    rn_picture_crop(wanted->crop, &stand->box, ret_options);
    rn_settings_put(&rn_render_settings, wanted->settings, &ret_options->settings);
    memcpy(ret_options->background, background, sizeof ret_options->background);
    frame_shot(path, unit, stand->instants, &ret_options->shot);
    rn_picture_choose(frame_output(path), frame_format(path), ret_options);
}

// The frames that a budget is for: those that are seen from many places, where there are any.
struct frames_of_budget {
    const struct path_work *path;
    bool spread;
    struct frame_stand stand;
    float background[3];
};

static void describe_frame(void *context, size_t i, struct rn_render_options *ret_options) {
    struct frames_of_budget *frames = context;
    struct rn_optics optics;
    size_t unit = 0;
    for (;; unit++) {
        optics = frame_optics(frames->path, unit);
        if ((!frames->spread || rn_optics_spreads(&optics)) && i-- == 0) break;
    }
    frame_options(frames->path, unit, frames->background, &frames->stand, ret_options);
}

static enum rn_status settle_budget(struct path_work *path, struct rn_field *field,
                                    const struct rn_field_info *info, struct rn_error *err) {
    struct frames_of_budget frames = {.path = path};
    struct rn_budget_pictures pictures = {path->work.total, describe_frame, &frames};
    size_t spread = 0;
    for (size_t i = 0; i < path->work.total; i++) {
        struct rn_optics optics = frame_optics(path, i);
        spread += rn_optics_spreads(&optics);
    }
    frames.spread = spread > 0;
    if (spread > 0) pictures.count = spread;
    memcpy(frames.background, info->config.background, sizeof frames.background);
    return rn_budget_settle(&path->work, field, &pictures, path->request.options.settings,
                            &rn_path_options_table, &path->request.options, err);
}

static enum rn_status prepare(struct rn_work *work, struct rn_field *field, struct rn_error *err) {
    struct path_work *path = (struct path_work *)work;
    const struct rn_path_options *options = &path->request.options;
    struct rn_field_info info;
    enum rn_status status =
        rn_mkdirs_in(work->host->place.scene_folder, path->request.folder, 0777, err);
    if (!status && options->film >= 0) status = rn_film_check(err); // before any frame is rendered
    if (!status && frame_format(path) == RN_FORMAT_EXR) status = rn_exr_check(err);
    if (!status) status = rn_optics_of_request(&options->optics, &path->optics, err);
    if (status) return status;
    struct rn_path *keys = path->request.camera_path.path;
    keys->fps = rn_number_or(options->fps, keys->fps);
    size_t count = rn_path_frame_count(keys);
    size_t first = (size_t)rn_int_or(options->first, 0);
    size_t last = (size_t)rn_int_or(options->last, (int64_t)count - 1);
    if (first >= count || last >= count || last < first)
        return rn_error_set(err, RN_ERROR_INVALID, "#/options/last",
                            "frames %zu to %zu are asked for; the path has frames 0 to %zu", first,
                            last, count - 1);
    path->parts = (struct rn_parts){.folder = path->request.folder,
                                    .ending = rn_picture_format_extensions[frame_format(path)],
                                    .first = first,
                                    .begin = RN_ABSENT};
    work->total = last - first + 1;
    rn_field_describe(field, &info);
    for (size_t i = 0; i < work->total; i++) {
        struct rn_camera camera = frame_camera(path, (double)i);
        path->depth_scale = fmax(path->depth_scale, rn_depth_scale(&camera, &info.bounds));
    }
    if (is_part(path)) {
        status = rn_parts_take(&path->parts, path->request.begin, path->request.end, work->total,
                               &work->total, err);
        if (status) return status;
    }
    return settle_budget(path, field, &info, err);
}

static enum rn_status begin(struct rn_work *work, struct rn_error *err) {
    struct path_work *path = (struct path_work *)work;
    rn_ahead_drop(&path->ahead);
    rn_behind_drop(&path->behind);
    return rn_parts_begin(&path->parts, work->step, work->total, err);
}

// A frame to come, which is rendered unless it is there already.
struct frames_to_come {
    const struct path_work *path;
    const struct rn_field_info *info;
    struct frame_stand stand;
};
static bool describe_next(void *context, size_t unit, struct rn_render_options *ret_options) {
    struct frames_to_come *frames = context;
    if (rn_parts_has(&frames->path->parts, unit)) return false;
    frame_options(frames->path, unit, frames->info->config.background, &frames->stand, ret_options);
    return true;
}

static enum rn_status render_frame(struct path_frame *frame, struct rn_field *field,
                                   const struct rn_field_info *info, struct rn_error *err) {
    struct path_work *path = frame->path;
    const struct rn_path_options *wanted = &path->request.options;
    struct rn_render_options options;
    struct frame_stand stand;
    struct frames_to_come others = {.path = path, .info = info};
    frame->how = (struct rn_picture_file){.output = frame_output(path),
                                          .format = frame_format(path),
                                          .jpeg_quality =
                                              (int)rn_int_or(wanted->jpeg_quality, RN_JPEG_QUALITY),
                                          .png_level = FRAME_PNG_LEVEL,
                                          .depth_scale = path->depth_scale};
    frame_options(path, path->work.done, info->config.background, &stand, &options);
    path->together = rn_optics_over(&path->together, &options.shot.optics);
    enum rn_status status = rn_ahead_render(&path->ahead, &path->work, field, &options,
                                            describe_next, &others, &frame->result, err);
    if (status) return status;
    rn_work_rendered(&path->work, frame->result.stats.render_ms,
                     frame->result.stats.nonfinite_rays);
    return RN_OK;
}

static enum rn_status write_frame(struct rn_piece *piece, struct rn_error *err) {
    struct path_frame *frame = (struct path_frame *)piece;
    uint8_t *bytes = NULL;
    size_t size;
    double high; // of a map: told of single pictures only
    enum rn_status status =
        rn_picture_encode(&frame->result, &frame->how, &bytes, &size, &high, err);
    if (!status) status = rn_parts_write(&frame->path->parts, frame->file, bytes, size, err);
    free(bytes);
    return status;
}

static enum rn_status tell_frame(struct rn_piece *piece, struct rn_error *err) {
    const struct path_frame *frame = (const struct path_frame *)piece;
    const struct rn_work *work = &frame->path->work;
    struct rn_wire_frame message = {.index = frame->index};
    strcpy(message.job, work->job);
    rn_link_post(&work->host->link, RN_WIRE_FRAME, &message, NULL, 0);
    (void)err;
    return RN_OK;
}

static void release_frame(struct rn_piece *piece) {
    rn_render_result_finish(&((struct path_frame *)piece)->result);
    free(piece);
}

static enum rn_status make_frame(struct path_work *path, struct rn_field *field,
                                 const struct rn_field_info *info, const char *file,
                                 struct rn_error *err) {
    struct path_frame *frame = calloc(1, sizeof *frame);
    if (!frame) return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "out of memory");
    frame->piece =
        (struct rn_piece){.run = write_frame, .settle = tell_frame, .release = release_frame};
    frame->path = path;
    frame->index = (int64_t)(path->parts.first + path->work.done);
    snprintf(frame->file, sizeof frame->file, "%s", file);
    enum rn_status status = render_frame(frame, field, info, err);
    if (status) {
        release_frame(&frame->piece);
        return status;
    }
    struct rn_camera camera = frame_camera(path, 0);
    struct rn_device_info about;
    rn_engine_describe(path->work.host->engine, &about);
    size_t most =
        rn_behind_most(frame->result.stats.on_device, about.threads, camera.width, camera.height);
    if (most > 0 && path->work.done == 0)
        rn_log(RN_LOG_INFO, "frames are encoded while the next ones are rendered");
    return rn_behind_add(&path->behind, &frame->piece, most, err);
}

static enum rn_status unit(struct rn_work *work, struct rn_field *field,
                           const struct rn_field_info *info, struct rn_error *err) {
    struct path_work *path = (struct path_work *)work;
    char file[PATH_MAX];
    struct stat about;
    enum rn_status status = rn_parts_file(&path->parts, work->done, file, err);
    if (status) return status;
    if (stat(file, &about) == 0) return RN_OK; // a frame of an earlier attempt; it is whole
    return make_frame(path, field, info, file, err);
}

// The film that was asked for, out of all frames; its size in bytes.
static enum rn_status make_film(struct path_work *path, struct rn_path_result *record,
                                struct rn_error *err) {
    const struct rn_path_options *options = &path->request.options;
    struct rn_film_order order = {.folder = path->request.folder,
                                  .first = path->parts.first,
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
                                        rn_numbers_median(work->render_ms, work->rendered)};
    struct rn_budget_told told;
    enum rn_status status = rn_behind_settle(&path->behind, 0, err);
    if (status) return status;
    rn_optics_names(&path->together, record.effects, sizeof record.effects);
    rn_budget_tell(work->host, field, path->request.options.settings, &told);
    memcpy(record.setting, told.setting, sizeof record.setting);
    record.expected_psnr = told.expected_psnr;
    record.expected_spread = told.expected_spread;
    if (!is_part(path) && path->request.options.film >= 0) status = make_film(path, &record, err);
    if (!status && !is_part(path)) status = rn_manifest_write(path->request.folder, err);
    if (status) return status;
    return rn_encode(&rn_path_result_table, &record, ret_json, NULL, err);
}

static void release(struct rn_work *work) {
    struct path_work *path = (struct path_work *)work;
    rn_ahead_drop(&path->ahead);
    rn_behind_drop(&path->behind);
    rn_message_finish(rn_wire_table(RN_WIRE_PATH), &path->request);
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

#include <errno.h>
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/log.h"
#include "common/path/path.h"
#include "server/runner/host.h"

#define PROGRESS_INTERVAL_S 0.5
#define FRAME_PNG_LEVEL 6
#define MAX_SCALES 16

// A path or evaluation job. It is prepared when its turn comes and then done unit by unit.
struct rn_work {
    char job[RN_ID_MAX];
    bool prepared;
    size_t done, total; // units
    double *render_ms;  // of the units that were rendered
    size_t rendered;    // how many
    uint64_t nonfinite; // rays of them that were replaced
    double began_s, reported_s;
    int64_t step; // the training step that all units show
    struct rn_host *host;
    struct rn_watch watch;
    struct rn_work *next;

    // a path job: unit i is frame first + i
    struct rn_wire_path *path; // NULL for an evaluation; owned
    struct rn_path *keys;
    size_t first;
    double depth_scale; // one for all frames

    // an evaluation: unit i is frames[i]
    struct rn_wire_eval eval;
    const struct rn_frame **frames;
    struct rn_view_result *scores;
};

static double now_s(void) {
    return (double)rn_clock_ns() * 1e-9;
}

// ---- the list ------------------------------------------------------------------------------

static void destroy(struct rn_work *work) {
    if (work->path) rn_message_finish(rn_wire_table(RN_WIRE_PATH), work->path);
    free(work->path);
    if (work->keys) rn_path_destroy(&work->keys);
    free(work->frames);
    free(work->scores);
    free(work->render_ms);
    free(work);
}

static struct rn_work *append(struct rn_host *host, const char *job) {
    struct rn_work *work = calloc(1, sizeof *work), **slot = &host->works;
    if (!work) {
        struct rn_error err;
        rn_error_set(&err, RN_ERROR_NO_MEMORY, "", "out of memory");
        rn_link_fail(&host->link, job, RN_ABSENT, &err);
        return NULL;
    }
    memcpy(work->job, job, sizeof work->job);
    work->step = RN_ABSENT;
    work->host = host;
    work->watch = (struct rn_watch){.link = &host->link, .job = work->job, .request = RN_ABSENT};
    while (*slot)
        slot = &(*slot)->next;
    *slot = work;
    return work;
}

static void drop_first(struct rn_host *host) {
    struct rn_work *work = host->works;
    host->works = work->next;
    destroy(work);
}

void rn_work_drop_all(struct rn_host *host) {
    while (host->works)
        drop_first(host);
}

static void fail_first(struct rn_host *host, const struct rn_error *err) {
    rn_link_fail(&host->link, host->works->job, RN_ABSENT, err);
    drop_first(host);
}

static void fail_cancelled(struct rn_host *host, const char *job) {
    struct rn_error err;
    rn_error_set(&err, RN_ERROR_CANCELLED, "", "cancelled; what was finished is kept");
    rn_link_fail(&host->link, job, RN_ABSENT, &err);
}

bool rn_work_cancel(struct rn_host *host, const char *job) {
    struct rn_work **slot = &host->works;
    while (*slot && strcmp((*slot)->job, job) != 0)
        slot = &(*slot)->next;
    struct rn_work *work = *slot;
    if (!work) return false;
    fail_cancelled(host, job);
    *slot = work->next;
    destroy(work);
    return true;
}

// The first job's reply and its end. `status` and `err` are of the encoding of `result`.
static void finish_first(struct rn_host *host, enum rn_status status, char *result,
                         const struct rn_error *err) {
    if (status) {
        fail_first(host, err);
        return;
    }
    struct rn_wire_done done = {.result = result};
    memcpy(done.job, host->works->job, sizeof done.job);
    rn_link_post(&host->link, RN_WIRE_DONE, &done, NULL, 0);
    free(result);
    drop_first(host);
}

static void post_progress(struct rn_host *host, struct rn_work *work) {
    double now = now_s();
    struct rn_work_progress record = {.done = (int64_t)work->done,
                                      .total = (int64_t)work->total,
                                      .nonfinite = {.rays = (int64_t)work->nonfinite},
                                      .fraction = (double)work->done / (double)work->total,
                                      .eta_seconds = NAN};
    if (work->rendered)
        record.eta_seconds =
            (now - work->began_s) * (double)(work->total - work->done) / (double)work->rendered;
    struct rn_wire_progress message = {.progress = NULL};
    memcpy(message.job, work->job, sizeof message.job);
    if (rn_encode(&rn_work_progress_table, &record, &message.progress, NULL, NULL)) return;
    rn_link_post(&host->link, RN_WIRE_PROGRESS, &message, NULL, 0);
    free(message.progress);
    work->reported_s = now;
}

static int compare_doubles(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

// NAN for none. Sorts the values.
static double median(double *values, size_t count) {
    if (!count) return NAN;
    qsort(values, count, sizeof *values, compare_doubles);
    return 0.5 * (values[(count - 1) / 2] + values[count / 2]);
}

// What a unit's rendering polls: interactive renders do not wait for it.
static bool keep_going(void *context) {
    struct rn_work *work = context;
    if (!rn_watch_keep_going(&work->watch)) return false;
    rn_host_serve_render(work->host);
    return true;
}

// ---- camera paths --------------------------------------------------------------------------

void rn_work_add_path(struct rn_host *host, const struct rn_wire_path *path) {
    struct rn_work *work = append(host, path->job);
    if (!work) return;
    work->path = malloc(sizeof *work->path);
    char *json = strdup(path->camera_path), *folder = strdup(path->folder);
    if (work->path && json && folder) {
        *work->path = *path;
        work->path->camera_path = json;
        work->path->folder = folder;
        return;
    }
    free(json);
    free(folder);
    free(work->path);
    work->path = NULL;
    struct rn_error err;
    rn_error_set(&err, RN_ERROR_NO_MEMORY, "", "out of memory");
    rn_link_fail(&host->link, path->job, RN_ABSENT, &err);
    struct rn_work **slot = &host->works;
    while (*slot != work)
        slot = &(*slot)->next;
    *slot = NULL; // it is the last one
    destroy(work);
}

static enum rn_status parse_path(const char *json, struct rn_path **ret_path,
                                 struct rn_error *err) {
    size_t size = strlen(json) + sizeof "{\"path\":}";
    char *document = malloc(size);
    if (!document) return rn_error_set(err, RN_ERROR_NO_MEMORY, "#/path", "out of memory");
    int length = snprintf(document, size, "{\"path\":%s}", json);
    enum rn_status status = rn_path_parse(document, (size_t)length, "", ret_path, err);
    free(document);
    return status;
}

static struct rn_camera frame_camera(const struct rn_work *work, size_t unit) {
    const struct rn_path_options *options = &work->path->options;
    struct rn_camera camera = rn_path_camera(work->keys, work->first + unit);
    if (options->width == RN_ABSENT) return camera;
    return rn_camera_reframed(&camera, (int)options->width, (int)options->height);
}

static enum rn_status prepare_path(struct rn_host *host, struct rn_work *work,
                                   struct rn_error *err) {
    const struct rn_path_options *options = &work->path->options;
    struct rn_field *field;
    struct rn_field_info info;
    enum rn_status status = rn_host_field(host, &field, err);
    if (!status) status = parse_path(work->path->camera_path, &work->keys, err);
    if (!status) status = rn_mkdirs(work->path->folder, 0777, err);
    if (status) return status;
    size_t count = rn_path_frame_count(work->keys);
    work->first = (size_t)rn_int_or(options->first, 0);
    size_t last = (size_t)rn_int_or(options->last, (int64_t)count - 1);
    if (work->first >= count || last >= count || last < work->first)
        return rn_error_set(err, RN_ERROR_INVALID, "#/options/last",
                            "frames %zu to %zu are asked for; the path has frames 0 to %zu",
                            work->first, last, count - 1);
    work->total = last - work->first + 1;
    rn_field_describe(field, &info);
    for (size_t i = 0; i < work->total; i++) {
        struct rn_camera camera = frame_camera(work, i);
        work->depth_scale = fmax(work->depth_scale, rn_depth_scale(&camera, &info.bounds));
    }
    return RN_OK;
}

static enum rn_status frame_path(const struct rn_work *work, size_t unit, char ret_path[PATH_MAX],
                                 struct rn_error *err) {
    const char *folder = work->path->folder;
    if (snprintf(ret_path, PATH_MAX, "%s/%05zu.png", folder, work->first + unit) >= PATH_MAX)
        return rn_error_set(err, RN_ERROR_LIMIT, folder, "the path is too long");
    return RN_OK;
}

// Frames of an earlier attempt are kept when they show the same step; a hidden file tells.
static enum rn_status claim_frames(const struct rn_work *work, struct rn_error *err) {
    char path[PATH_MAX], step[32];
    uint8_t *before = NULL;
    size_t size = 0;
    if (snprintf(path, sizeof path, "%s/.step", work->path->folder) >= (int)sizeof path)
        return rn_error_set(err, RN_ERROR_LIMIT, work->path->folder, "the path is too long");
    int length = snprintf(step, sizeof step, "%lld\n", (long long)work->step);
    bool same = rn_file_read(path, sizeof step, &before, &size, NULL) == RN_OK &&
                strcmp((const char *)before, step) == 0;
    free(before);
    if (same) return RN_OK;
    char frame[PATH_MAX];
    for (size_t i = 0; i < work->total; i++) {
        enum rn_status status = frame_path(work, i, frame, err);
        if (status) return status;
        if (unlink(frame) < 0 && errno != ENOENT)
            return rn_error_from_errno(err, errno, frame, "remove the frame");
    }
    return rn_file_write_atomic(path, step, (size_t)length, err);
}

static enum rn_status render_frame(struct rn_host *host, struct rn_work *work,
                                   struct rn_field *field, const struct rn_field_info *info,
                                   const char *path, struct rn_error *err) {
    static const unsigned outputs[] = {[RN_OUTPUT_KIND_RGB] = RN_OUTPUT_RGB,
                                       [RN_OUTPUT_KIND_DEPTH] = RN_OUTPUT_DEPTH,
                                       [RN_OUTPUT_KIND_ALPHA] = RN_OUTPUT_ALPHA};
    enum rn_output_kind output =
        (enum rn_output_kind)rn_name_or(work->path->options.output, RN_OUTPUT_KIND_RGB);
    struct rn_render_options options = {.camera = frame_camera(work, work->done),
                                        .outputs = outputs[output]};
    struct rn_render_result result = {0};
    uint8_t *bytes = NULL;
    size_t size;
    rn_settings_put(&rn_render_settings, work->path->options.settings, &options.settings);
    memcpy(options.background, info->config.background, sizeof options.background);
    enum rn_status status =
        rn_render(host->engine, field, &options, keep_going, work, &result, err);
    if (status) return status;
    work->render_ms[work->rendered++] = result.stats.render_ms;
    work->nonfinite += result.stats.nonfinite_rays;
    status = rn_picture_encode(&result, output, RN_FORMAT_PNG, 0, FRAME_PNG_LEVEL,
                               work->depth_scale, &bytes, &size, err);
    if (!status) status = rn_file_write_atomic(path, bytes, size, err);
    free(bytes);
    rn_render_result_finish(&result);
    return status;
}

static enum rn_status path_unit(struct rn_host *host, struct rn_work *work, struct rn_field *field,
                                const struct rn_field_info *info, struct rn_error *err) {
    char path[PATH_MAX];
    struct stat about;
    enum rn_status status = frame_path(work, work->done, path, err);
    if (status) return status;
    if (stat(path, &about) == 0) return RN_OK; // a frame of an earlier attempt; it is whole
    status = render_frame(host, work, field, info, path, err);
    if (status) return status;
    struct rn_wire_frame frame = {.index = (int64_t)(work->first + work->done)};
    memcpy(frame.job, work->job, sizeof frame.job);
    rn_link_post(&host->link, RN_WIRE_FRAME, &frame, NULL, 0);
    return RN_OK;
}

static void finish_path(struct rn_host *host, struct rn_work *work) {
    struct rn_camera camera = frame_camera(work, 0);
    struct rn_path_result result = {.frames = (int64_t)work->total,
                                    .width = camera.width,
                                    .height = camera.height,
                                    .step = work->step,
                                    .render_ms_median = median(work->render_ms, work->rendered)};
    struct rn_error err = {0};
    char *json = NULL;
    enum rn_status status = rn_encode(&rn_path_result_table, &result, &json, NULL, &err);
    finish_first(host, status, json, &err);
}

// ---- evaluations ---------------------------------------------------------------------------

void rn_work_add_eval(struct rn_host *host, const struct rn_wire_eval *eval) {
    struct rn_work *work = append(host, eval->job);
    if (work) work->eval = *eval;
}

// The frames of `wanted` (0 = all) evenly spaced views of the split, at one scale or all.
static enum rn_status choose_frames(const struct rn_dataset *dataset, struct rn_work *work,
                                    struct rn_error *err) {
    const struct rn_eval_options *options = &work->eval.options;
    enum rn_split split = (enum rn_split)rn_name_or(options->split, RN_SPLIT_TEST);
    size_t views = (size_t)dataset->view_count[split];
    size_t wanted = (size_t)rn_int_or(options->views, 0);
    if (!wanted || wanted > views) wanted = views;
    work->frames = calloc(dataset->frame_count + 1, sizeof(struct rn_frame *));
    if (!work->frames) return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "out of memory");
    size_t view = 0, chosen = 0; // frames are ordered by split, index, scale
    int last_index = -1;
    bool take = false;
    for (size_t i = 0; i < dataset->frame_count; i++) {
        const struct rn_frame *frame = &dataset->frames[i];
        if (frame->split != split) continue;
        if (frame->index != last_index) {
            take = chosen < wanted && view == chosen * views / wanted;
            chosen += take;
            view++;
            last_index = frame->index;
        }
        if (take && (options->scale == RN_ABSENT || options->scale == frame->scale))
            work->frames[work->total++] = frame;
    }
    if (work->total) return RN_OK;
    return rn_error_set(err, RN_ERROR_INVALID, views ? "#/options/scale" : "#/options/split",
                        "the dataset has no such views: its %s split has %zu, at %d scales",
                        rn_split_name(split), views, dataset->scale_count);
}

static enum rn_status prepare_eval(struct rn_host *host, struct rn_work *work,
                                   struct rn_error *err) {
    struct rn_field *field;
    enum rn_status status = rn_host_field(host, &field, err);
    if (!status) status = rn_host_need_sound_dataset(host, err);
    if (!status) status = choose_frames(host->dataset, work, err);
    if (status) return status;
    work->scores = calloc(work->total, sizeof *work->scores);
    return work->scores ? RN_OK : rn_error_set(err, RN_ERROR_NO_MEMORY, "", "out of memory");
}

static enum rn_status eval_unit(struct rn_host *host, struct rn_work *work, struct rn_field *field,
                                const struct rn_field_info *info, struct rn_error *err) {
    const struct rn_frame *frame = work->frames[work->done];
    struct rn_render_options options = {.outputs = RN_OUTPUT_RGB};
    struct rn_view_score score;
    rn_settings_put(&rn_render_settings, work->eval.options.settings, &options.settings);
    memcpy(options.background, info->config.background, sizeof options.background);
    enum rn_status status =
        rn_evaluate_view(host->engine, field, frame, &options, keep_going, work, &score, err);
    if (status) return status;
    struct rn_view_result *result = &work->scores[work->done];
    *result = (struct rn_view_result){.index = frame->index,
                                      .scale = frame->scale,
                                      .psnr = score.psnr,
                                      .ssim = score.ssim,
                                      .render_ms = score.render_ms};
    snprintf(result->name, sizeof result->name, "%s", frame->name);
    work->render_ms[work->rendered++] = score.render_ms;
    work->nonfinite += score.nonfinite_rays;
    return RN_OK;
}

// Mean psnr and ssim and median time of each scale; returns the number of scales. `times`: scratch.
static size_t score_scales(const struct rn_work *work, double *times,
                           struct rn_scale_score *scales) {
    size_t count = 0;
    for (int64_t scale = 0; scale < MAX_SCALES; scale++) {
        double psnr = 0, ssim = 0;
        size_t views = 0;
        for (size_t i = 0; i < work->total; i++) {
            if (work->scores[i].scale != scale) continue;
            psnr += work->scores[i].psnr;
            ssim += work->scores[i].ssim;
            times[views++] = work->scores[i].render_ms;
        }
        if (!views) continue;
        scales[count++] = (struct rn_scale_score){.scale = scale,
                                                  .psnr = psnr / (double)views,
                                                  .ssim = ssim / (double)views,
                                                  .render_ms = median(times, views)};
    }
    return count;
}

// Standard deviation over views of a view's mean over its scales. The scores of a view follow
// each other; `ssim` chooses the figure.
static double spread(const struct rn_work *work, bool ssim, int64_t *ret_views) {
    double sum = 0, squares = 0;
    size_t views = 0, i = 0;
    double *means = malloc(work->total * sizeof *means);
    if (!means) return NAN;
    while (i < work->total) {
        int64_t index = work->scores[i].index;
        double total = 0;
        size_t begin = i;
        for (; i < work->total && work->scores[i].index == index; i++)
            total += ssim ? work->scores[i].ssim : work->scores[i].psnr;
        means[views] = total / (double)(i - begin);
        sum += means[views++];
    }
    for (size_t v = 0; v < views; v++)
        squares += (means[v] - sum / (double)views) * (means[v] - sum / (double)views);
    free(means);
    *ret_views = (int64_t)views;
    return sqrt(squares / (double)views);
}

static void fill_protocol(struct rn_host *host, const struct rn_work *work,
                          const struct rn_field_info *info, struct rn_protocol *protocol) {
    struct rn_device_info device;
    rn_engine_describe(host->engine, &device);
    *protocol =
        (struct rn_protocol){.split = rn_name_or(work->eval.options.split, RN_SPLIT_TEST),
                             .downscale = host->dataset->premultiplied_scales ? 0 : 1,
                             .rounding = "none: the fp32 picture against the 8-bit photograph",
                             .seed = (int64_t)info->config.seed,
                             .train_split = info->config.train_val,
                             .step = info->steps,
                             .version = RIPNERF_VERSION,
                             .threads = device.threads};
    for (int i = 0; i < 3; i++)
        protocol->background[i] = (double)info->config.background[i];
    snprintf(protocol->device, sizeof protocol->device, "%s", device.device);
    snprintf(protocol->kernels, sizeof protocol->kernels, "%s", device.kernels);
}

static void finish_eval(struct rn_host *host, struct rn_work *work) {
    struct rn_scale_score scales[MAX_SCALES];
    struct rn_eval_result result = {.scales = scales,
                                    .per_view = work->scores,
                                    .view_count = work->total,
                                    .render_ms_median = median(work->render_ms, work->rendered)};
    result.scale_count = score_scales(work, work->render_ms, scales);
    for (size_t i = 0; i < result.scale_count; i++) {
        result.psnr += scales[i].psnr / (double)result.scale_count;
        result.ssim += scales[i].ssim / (double)result.scale_count;
    }
    result.psnr_spread = spread(work, false, &result.views);
    result.ssim_spread = spread(work, true, &result.views);
    struct rn_error err = {0};
    struct rn_field *field;
    struct rn_field_info info;
    char *json = NULL;
    enum rn_status status = rn_host_field(host, &field, &err);
    if (!status) {
        rn_field_describe(field, &info);
        fill_protocol(host, work, &info, &result.protocol);
        status = rn_encode(&rn_eval_result_table, &result, &json, NULL, &err);
    }
    finish_first(host, status, json, &err);
}

// ---- units ---------------------------------------------------------------------------------

static enum rn_status prepare(struct rn_host *host, struct rn_work *work, struct rn_error *err) {
    enum rn_status status =
        work->path ? prepare_path(host, work, err) : prepare_eval(host, work, err);
    if (status) return status;
    work->render_ms = calloc(work->total, sizeof *work->render_ms);
    if (!work->render_ms) return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "out of memory");
    work->prepared = true;
    work->began_s = now_s();
    post_progress(host, work);
    return RN_OK;
}

// The field as all units show it. A training that was cancelled meanwhile has left another step:
// then everything begins anew.
static enum rn_status take_field(struct rn_host *host, struct rn_work *work,
                                 struct rn_field **ret_field, struct rn_field_info *ret_info,
                                 struct rn_error *err) {
    enum rn_status status = rn_host_field(host, ret_field, err);
    if (status) return status;
    rn_field_describe(*ret_field, ret_info);
    if (ret_info->steps == work->step) return RN_OK;
    work->step = ret_info->steps;
    work->done = work->rendered = 0;
    return work->path ? claim_frames(work, err) : RN_OK;
}

static enum rn_status do_unit(struct rn_host *host, struct rn_work *work, struct rn_error *err) {
    struct rn_field *field;
    struct rn_field_info info;
    enum rn_status status = work->prepared ? RN_OK : prepare(host, work, err);
    if (!status) status = take_field(host, work, &field, &info, err);
    if (status) return status;
    return work->path ? path_unit(host, work, field, &info, err)
                      : eval_unit(host, work, field, &info, err);
}

void rn_work_unit(struct rn_host *host) {
    struct rn_work *work = host->works;
    struct rn_error err = {0};
    enum rn_status status = do_unit(host, work, &err);
    // Stopped because the runner must end: the daemon will start the job again.
    if (status == RN_ERROR_CANCELLED && rn_link_must_stop(&host->link)) return;
    if (status == RN_ERROR_CANCELLED) {
        fail_cancelled(host, work->job);
        drop_first(host);
        return;
    }
    if (status) {
        fail_first(host, &err);
        return;
    }
    work->done++;
    if (work->done == work->total || now_s() - work->reported_s >= PROGRESS_INTERVAL_S)
        post_progress(host, work);
    if (work->done < work->total) return;
    if (work->path)
        finish_path(host, work);
    else
        finish_eval(host, work);
}

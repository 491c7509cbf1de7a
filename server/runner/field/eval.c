#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/file.h"
#include "common/base/log.h"
#include "common/math/numbers.h"
#include "server/runner/field/ahead.h"
#include "server/runner/field/behind.h"
#include "server/runner/field/budget.h"
#include "server/runner/field/parts.h"
#include "server/runner/link/join.h"

#define MAX_SCALES 16
#define SCORE_BYTES 4096

// An evaluation: unit i is frames[i], rendered and compared with its photograph.
struct eval_work {
    struct rn_work work;
    struct rn_wire_eval request; // its texts are owned
    struct rn_parts parts;       // scores, where they are kept
    const struct rn_frame **frames;
    struct rn_view_result *scores;
    struct rn_ahead ahead;
    struct rn_behind behind;
};

// A view that is rendered, on its way to its score.
struct eval_view {
    struct rn_piece piece;
    struct eval_work *eval;
    size_t unit;
    struct rn_rendered_view rendered;
    struct rn_view_score score;
    double depth_error;
    char file[PATH_MAX]; // of the score; "": none is kept
};

// The frames of `wanted` (0 = all) evenly spaced views of the split, at one scale or all.
static enum rn_status choose_frames(const struct rn_dataset *dataset, struct eval_work *eval,
                                    struct rn_error *err) {
    const struct rn_eval_options *options = &eval->request.options;
    enum rn_split split = (enum rn_split)rn_name_or(options->split, RN_SPLIT_TEST);
    size_t views = (size_t)dataset->view_count[split];
    size_t wanted = (size_t)rn_int_or(options->views, 0);
    if (!wanted || wanted > views) wanted = views;
    eval->frames = calloc(dataset->frame_count + 1, sizeof(struct rn_frame *));
    if (!eval->frames) return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "out of memory");
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
            eval->frames[eval->work.total++] = frame;
    }
    if (eval->work.total) return RN_OK;
    if (!views)
        return rn_error_set(err, RN_ERROR_INVALID, "#/options/split",
                            "the dataset has no %s views; it has %d train, %d val and %d test: "
                            "ask for a split that it has, or import it with --split every:8",
                            rn_split_name(split), dataset->view_count[RN_SPLIT_TRAIN],
                            dataset->view_count[RN_SPLIT_VAL], dataset->view_count[RN_SPLIT_TEST]);
    return rn_error_set(err, RN_ERROR_INVALID, "#/options/scale",
                        "the dataset has no %s views of that scale; its scales are 0 to %d",
                        rn_split_name(split), dataset->scale_count - 1);
}

static enum rn_status prepare_parts(struct eval_work *eval, struct rn_error *err) {
    const struct rn_wire_eval *request = &eval->request;
    eval->parts =
        (struct rn_parts){.folder = request->folder, .ending = "json", .begin = RN_ABSENT};
    enum rn_status status =
        rn_mkdirs_in(eval->work.host->place.scene_folder, request->folder, 0777, err);
    if (!status && request->begin != RN_ABSENT)
        status = rn_parts_take(&eval->parts, request->begin, request->end, eval->work.total,
                               &eval->work.total, err);
    return status;
}

static void describe_view(void *context, size_t i, struct rn_render_options *ret_options) {
    const struct eval_work *eval = context;
    *ret_options = (struct rn_render_options){.camera = eval->frames[eval->parts.first + i]->camera,
                                              .outputs = RN_OUTPUT_RGB};
}

static enum rn_status prepare(struct rn_work *work, struct rn_field *field, struct rn_error *err) {
    struct eval_work *eval = (struct eval_work *)work;
    enum rn_status status = rn_host_need_sound_dataset(work->host, err);
    if (!status) status = choose_frames(work->host->dataset, eval, err);
    if (!status && eval->request.folder) status = prepare_parts(eval, err);
    if (status) return status;
    eval->scores = calloc(work->total, sizeof *eval->scores);
    if (!eval->scores) return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "out of memory");
    struct rn_budget_pictures views = {work->total, describe_view, eval};
    return rn_budget_settle(work, field, &views, eval->request.options.settings,
                            &rn_eval_options_table, &eval->request.options, err);
}

static enum rn_status begin(struct rn_work *work, struct rn_error *err) {
    struct eval_work *eval = (struct eval_work *)work;
    rn_ahead_drop(&eval->ahead);
    rn_behind_drop(&eval->behind);
    return eval->request.folder ? rn_parts_begin(&eval->parts, work->step, work->total, err)
                                : RN_OK;
}

// What views are compared by.
struct views_to_come {
    const struct eval_work *eval;
    const struct rn_field *field;
    struct rn_render_options options; // but for what is a view's own
};

// A view to come, which is rendered unless its score is there already.
static bool describe_next(void *context, size_t unit, struct rn_render_options *ret_options) {
    const struct views_to_come *views = context;
    const struct eval_work *eval = views->eval;
    if (eval->request.folder && rn_parts_has(&eval->parts, unit)) return false;
    *ret_options =
        rn_view_options(views->field, eval->frames[eval->parts.first + unit], &views->options);
    return true;
}

static enum rn_status render_view(struct eval_view *view, struct rn_field *field,
                                  const struct rn_field_info *info, struct rn_error *err) {
    struct eval_work *eval = view->eval;
    struct rn_work *work = &eval->work;
    const struct rn_frame *frame = eval->frames[eval->parts.first + view->unit];
    struct rn_render_options options = {.outputs = RN_OUTPUT_RGB, .lpips = work->host->lpips};
    rn_settings_put(&rn_render_settings, eval->request.options.settings, &options.settings);
    memcpy(options.background, info->config.background, sizeof options.background);
    options.fit = rn_effects_fit(info->effects);
    struct views_to_come others = {eval, field, options};
    view->rendered = (struct rn_rendered_view){.engine = work->host->engine,
                                               .field = field,
                                               .frame = frame,
                                               .options = rn_view_options(field, frame, &options),
                                               .keep_going = rn_work_keep_going,
                                               .context = work};
    enum rn_status status = rn_ahead_render(&eval->ahead, work, field, &view->rendered.options,
                                            describe_next, &others, &view->rendered.result, err);
    struct rn_depth_score depth = {.median = NAN};
    if (!status && frame->scale == 0)
        status = rn_evaluate_depth(work->host->engine, field, frame, &work->host->dataset->points,
                                   &options, rn_work_keep_going, work, &depth, err);
    view->depth_error = depth.median;
    return status;
}

static enum rn_status compare_view(struct rn_piece *piece, struct rn_error *err) {
    struct eval_view *view = (struct eval_view *)piece;
    return rn_view_compare(&view->rendered, &view->score, err);
}

// A score of an earlier attempt, or of a runner that helps; false: there is none.
static bool take_score(struct eval_work *eval, const char *path, struct rn_view_result *ret_view) {
    uint8_t *bytes;
    size_t size;
    if (rn_file_read(path, SCORE_BYTES, &bytes, &size, NULL)) return false;
    bool taken =
        rn_decode(&rn_view_result_table, (const char *)bytes, size, ret_view, NULL, NULL) == RN_OK;
    free(bytes);
    if (taken) rn_work_rendered(&eval->work, ret_view->render_ms, 0);
    return taken;
}

static enum rn_status keep_score(struct eval_view *view, struct rn_error *err) {
    struct eval_work *eval = view->eval;
    struct rn_wire_frame frame = {.index = (int64_t)(eval->parts.first + view->unit)};
    char *json;
    size_t size;
    enum rn_status status =
        rn_encode(&rn_view_result_table, &eval->scores[view->unit], &json, &size, err);
    if (status) return status;
    status = rn_parts_write(&eval->parts, view->file, json, size, err);
    free(json);
    strcpy(frame.job, eval->work.job);
    if (!status) rn_link_post(&eval->work.host->link, RN_WIRE_FRAME, &frame, NULL, 0);
    return status;
}

static enum rn_status note_score(struct rn_piece *piece, struct rn_error *err) {
    struct eval_view *view = (struct eval_view *)piece;
    struct eval_work *eval = view->eval;
    const struct rn_frame *frame = eval->frames[eval->parts.first + view->unit];
    const struct rn_view_score *score = &view->score;
    struct rn_view_result *result = &eval->scores[view->unit];
    *result = (struct rn_view_result){.index = frame->index,
                                      .scale = frame->scale,
                                      .psnr = score->psnr,
                                      .ssim = score->ssim,
                                      .psnr_fitted = score->psnr_fitted,
                                      .lpips = score->lpips,
                                      .depth_error = view->depth_error,
                                      .render_ms = score->render_ms};
    snprintf(result->name, sizeof result->name, "%s", frame->name);
    rn_work_rendered(&eval->work, score->render_ms, score->nonfinite_rays);
    return *view->file ? keep_score(view, err) : RN_OK;
}

static void release_view(struct rn_piece *piece) {
    rn_render_result_finish(&((struct eval_view *)piece)->rendered.result);
    free(piece);
}

static enum rn_status score_view(struct eval_work *eval, const char *file, struct rn_field *field,
                                 const struct rn_field_info *info, struct rn_error *err) {
    struct eval_view *view = calloc(1, sizeof *view);
    if (!view) return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "out of memory");
    view->piece =
        (struct rn_piece){.run = compare_view, .settle = note_score, .release = release_view};
    view->eval = eval;
    view->unit = eval->work.done;
    snprintf(view->file, sizeof view->file, "%s", file);
    enum rn_status status = render_view(view, field, info, err);
    if (status) {
        release_view(&view->piece);
        return status;
    }
    const struct rn_rendered_view *rendered = &view->rendered;
    struct rn_device_info about;
    rn_engine_describe(eval->work.host->engine, &about);
    size_t most = rn_behind_most(rendered->result.stats.on_device, about.threads,
                                 rendered->options.camera.width, rendered->options.camera.height);
    if (!rn_view_is_apart(rendered)) most = 0;
    if (most > 0 && eval->work.done == 0)
        rn_log(RN_LOG_INFO, "views are compared while the next ones are rendered");
    return rn_behind_add(&eval->behind, &view->piece, most, err);
}

static enum rn_status unit(struct rn_work *work, struct rn_field *field,
                           const struct rn_field_info *info, struct rn_error *err) {
    struct eval_work *eval = (struct eval_work *)work;
    char path[PATH_MAX] = "";
    enum rn_status status = RN_OK;
    if (eval->request.folder) status = rn_parts_file(&eval->parts, work->done, path, err);
    if (status || (*path && take_score(eval, path, &eval->scores[work->done]))) return status;
    return score_view(eval, path, field, info, err);
}

// Mean psnr and ssim and median time of each scale; returns the number of scales. `times`: scratch.
static size_t score_scales(const struct eval_work *eval, double *times,
                           struct rn_scale_score *scales) {
    size_t count = 0;
    for (int64_t scale = 0; scale < MAX_SCALES; scale++) {
        double psnr = 0, ssim = 0;
        size_t views = 0;
        for (size_t i = 0; i < eval->work.total; i++) {
            if (eval->scores[i].scale != scale) continue;
            psnr += eval->scores[i].psnr;
            ssim += eval->scores[i].ssim;
            times[views++] = eval->scores[i].render_ms;
        }
        if (!views) continue;
        scales[count++] = (struct rn_scale_score){.scale = scale,
                                                  .psnr = psnr / (double)views,
                                                  .ssim = ssim / (double)views,
                                                  .render_ms = rn_numbers_median(times, views)};
    }
    return count;
}

// Mean over the views that are large enough.
static double mean_lpips(const struct eval_work *eval) {
    double sum = 0;
    size_t count = 0;
    for (size_t i = 0; i < eval->work.total; i++) {
        if (isnan(eval->scores[i].lpips)) continue;
        sum += eval->scores[i].lpips;
        count++;
    }
    return count ? sum / (double)count : NAN;
}

// Median over the views whose photographs see points. `errors`: scratch.
static double middle_depth_error(const struct eval_work *eval, double *errors) {
    size_t count = 0;
    for (size_t i = 0; i < eval->work.total; i++)
        if (isfinite(eval->scores[i].depth_error)) errors[count++] = eval->scores[i].depth_error;
    return count ? rn_numbers_median(errors, count) : NAN;
}

// Standard deviation over views of a view's mean over its scales. The scores of a view follow
// each other; `ssim` chooses the figure.
static double spread(const struct eval_work *eval, bool ssim, int64_t *ret_views) {
    double sum = 0, squares = 0;
    size_t views = 0, i = 0;
    double *means = malloc(eval->work.total * sizeof *means);
    if (!means) return NAN;
    while (i < eval->work.total) {
        int64_t index = eval->scores[i].index;
        double total = 0;
        size_t begin = i;
        for (; i < eval->work.total && eval->scores[i].index == index; i++)
            total += ssim ? eval->scores[i].ssim : eval->scores[i].psnr;
        means[views] = total / (double)(i - begin);
        sum += means[views++];
    }
    for (size_t v = 0; v < views; v++)
        squares += (means[v] - sum / (double)views) * (means[v] - sum / (double)views);
    free(means);
    *ret_views = (int64_t)views;
    return sqrt(squares / (double)views);
}

static void fill_protocol(const struct eval_work *eval, const struct rn_field_info *info,
                          struct rn_protocol *protocol) {
    const struct rn_host *host = eval->work.host;
    struct rn_device_info device;
    rn_engine_describe(host->engine, &device);
    *protocol =
        (struct rn_protocol){.split = rn_name_or(eval->request.options.split, RN_SPLIT_TEST),
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
    rn_machine_text(device.name, protocol->machine, sizeof protocol->machine);
}

static enum rn_status result(struct rn_work *work, struct rn_field *field, char **ret_json,
                             struct rn_error *err) {
    struct eval_work *eval = (struct eval_work *)work;
    enum rn_status status = rn_behind_settle(&eval->behind, 0, err);
    if (status) return status;
    struct rn_scale_score scales[MAX_SCALES];
    struct rn_eval_result record = {.scales = scales,
                                    .per_view = eval->scores,
                                    .view_count = work->total,
                                    .render_ms_median =
                                        rn_numbers_median(work->render_ms, work->rendered)};
    record.scale_count = score_scales(eval, work->render_ms, scales);
    for (size_t i = 0; i < record.scale_count; i++) {
        record.psnr += scales[i].psnr / (double)record.scale_count;
        record.ssim += scales[i].ssim / (double)record.scale_count;
    }
    for (size_t i = 0; i < work->total; i++)
        record.psnr_fitted += eval->scores[i].psnr_fitted / (double)work->total;
    record.lpips = mean_lpips(eval);
    record.depth_error = middle_depth_error(eval, work->render_ms);
    record.psnr_spread = spread(eval, false, &record.views);
    record.ssim_spread = spread(eval, true, &record.views);
    struct rn_budget_told told;
    rn_budget_tell(eval->work.host, field, eval->request.options.settings, &told);
    memcpy(record.setting, told.setting, sizeof record.setting);
    struct rn_field_info info;
    rn_field_describe(field, &info);
    fill_protocol(eval, &info, &record.protocol);
    return rn_encode(&rn_eval_result_table, &record, ret_json, NULL, err);
}

static void release(struct rn_work *work) {
    struct eval_work *eval = (struct eval_work *)work;
    rn_ahead_drop(&eval->ahead);
    rn_behind_drop(&eval->behind);
    free(eval->frames);
    free(eval->scores);
    rn_message_finish(rn_wire_table(RN_WIRE_EVAL), &eval->request);
}

static const struct rn_work_kind kind = {.size = sizeof(struct eval_work),
                                         .prepare = prepare,
                                         .begin = begin,
                                         .unit = unit,
                                         .result = result,
                                         .release = release};

void rn_work_add_eval(struct rn_host *host, struct rn_wire_eval *request) {
    struct eval_work *eval = (struct eval_work *)rn_work_append(host, &kind, request->job);
    if (!eval) return;
    eval->request = *request;
    eval->work.at = request->options.at;
    rn_message_init(rn_wire_table(RN_WIRE_EVAL), request);
}

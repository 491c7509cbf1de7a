// The scene's curve, measured: many ways to render on one held-out view, then the best of them on
// several, in turns, so that a machine that slows down slows all alike.
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/log.h"
#include "common/image/metrics.h"
#include "proto/folder.h"
#include "server/runner/field/budget.h"
#include "server/runner/field/turned.h"
#include "server/runner/field/work.h"
#include "server/runner/link/join.h"

#define VIEWS 16 // so many tell what ways are worth; their times are one sample each
#define MOST_VIEWS 64
#define WAYS RN_CURVE_TRIALS // to render, tried on the first view
#define FINALISTS 40         // of these, measured on all views
#define MOST_ROUNDS 3        // times, where views are few
#define MOST_PIXELS 1e6 // of its pictures; larger views are rendered smaller, without photographs
#define SAVE_EVERY_S 1.0

// One way to render, and what is known of it.
struct way {
    struct rn_curve_setting setting;
    double first_ms, first_worth; // on the first view
    uint32_t times;
    float ms[MOST_VIEWS];
    double psnr, psnr_squares, ssim, psnr_full, rays, samples; // sums over views
    double interpolation, roughness;
    uint32_t same; // views equal to the full picture
};

// What a killed runner leaves for the next one: plain data.
struct state {
    char digest[65], version[32], kernels[32], machine[64];
    int32_t method, threads, views, done;
    int32_t ways, finalists, finalist[FINALISTS];
    double seconds;
    struct way way[WAYS]; // [0]: the full picture
    struct rn_curve_view around[RN_CURVE_VIEWS];
    int32_t around_count;
};

struct curve_work {
    struct rn_work work;
    struct rn_curve_options options;
    struct state *state;
    struct rn_camera cameras[MOST_VIEWS]; // that ways are measured on,
    int views;
    const struct rn_frame *frames[MOST_VIEWS];     // these views' photographs, where there are any,
    const struct rn_frame *around[RN_CURVE_VIEWS]; // and whose full pictures are
    int around_count;
    bool photographs;
    int shown; // the view that `full` and `truth` are of, -1: none
    struct rn_picture full, truth;
    double saved_s;
};

// ---- the ways -------------------------------------------------------------------------------

static void set(struct rn_curve_setting *setting, const char *name, double number) {
    *rn_settings_value(&rn_render_settings, setting->values, name) =
        rn_setting_of_number(rn_settings_find(&rn_render_settings, name), number);
}

static struct rn_curve_setting nothing_set(void) {
    struct rn_curve_setting setting;
    for (size_t i = 0; i < RN_RENDER_SETTINGS; i++)
        setting.values[i] = rn_setting_absent(&rn_render_settings.rows[i]);
    return setting;
}

// 0 of a number: as the scene calls for.
static void add_way(struct state *state, int subsample, int supersample, double step, double stop,
                    double tolerance) {
    if (state->ways == WAYS) return;
    struct rn_curve_setting *setting = &state->way[state->ways++].setting;
    *setting = nothing_set();
    if (subsample > 1) set(setting, "subsample", subsample);
    if (supersample > 0) set(setting, "supersample", supersample);
    if (step > 0) set(setting, "step", fmin(step, 1));
    if (stop > 0) set(setting, "stop", stop);
    if (tolerance > 0) set(setting, "tolerance", tolerance);
}

static void list_ways(struct state *state, double trained_step, int cones) {
    static const double tolerances[] = {0, 0.01, 0.02, 0.03, 0.045, 0.07, 0.1, 0.15, 0.2, 0.3, 0.5};
    static const int subsamples[] = {2, 3, 4, 6, 8, 12, 16};
    const double steps[] = {0, 1.5 * trained_step, 2.2 * trained_step};
    add_way(state, 1, 0, 0, 0, 0);
    for (size_t s = 0; s < 3; s++)
        for (size_t t = 0; t < sizeof tolerances / sizeof *tolerances; t++)
            for (int ends = s + t == 0; ends < 2; ends++)
                add_way(state, 1, 0, steps[s], ends ? 0.1 : 0, tolerances[t]);
    for (size_t n = 0; n < sizeof subsamples / sizeof *subsamples; n++)
        for (size_t s = 0; s < 3; s += 2)
            for (size_t t = 0; t < sizeof tolerances / sizeof *tolerances; t += 3)
                add_way(state, subsamples[n], 0, steps[s], 0.1, tolerances[t]);
    for (int n = 1; n < cones; n *= 2)
        for (size_t t = 0; t < sizeof tolerances / sizeof *tolerances; t += 2)
            add_way(state, 1, n, 0, 0.1, tolerances[t]);
}

static void choose_finalists(struct state *state) {
    struct rn_curve_trial trials[WAYS];
    size_t chosen[FINALISTS];
    for (int i = 0; i < state->ways; i++)
        trials[i] = (struct rn_curve_trial){state->way[i].first_ms, state->way[i].first_worth};
    state->finalists = (int32_t)rn_curve_finalists(trials, (size_t)state->ways, FINALISTS, chosen);
    for (int i = 0; i < state->finalists; i++)
        state->finalist[i] = (int32_t)chosen[i];
}

// ---- views ----------------------------------------------------------------------------------

static struct rn_camera view_camera(const struct curve_work *curve, int view) {
    struct rn_camera camera = curve->cameras[view];
    double pixels = (double)camera.width * camera.height;
    if (pixels <= MOST_PIXELS) return camera;
    double scale = sqrt(MOST_PIXELS / pixels);
    return rn_camera_resized(&camera, (int)(camera.width * scale), (int)(camera.height * scale));
}

static enum rn_status read_truth(struct curve_work *curve, const struct rn_field_info *info,
                                 struct rn_error *err) {
    struct rn_image photograph;
    enum rn_status status = rn_image_read(curve->frames[curve->shown]->path,
                                          &rn_image_default_limits, &photograph, err);
    if (status) return status;
    status = rn_image_composite(&photograph, info->config.background, &curve->truth, err);
    rn_image_finish(&photograph);
    return status;
}

static enum rn_status render(struct curve_work *curve, struct rn_field *field,
                             const struct rn_field_info *info,
                             const struct rn_curve_setting *setting,
                             struct rn_render_result *ret_result, struct rn_error *err) {
    struct rn_render_options options = {.camera = view_camera(curve, curve->shown),
                                        .outputs = RN_OUTPUT_RGB};
    rn_settings_put(&rn_render_settings, setting->values, &options.settings);
    memcpy(options.background, info->config.background, sizeof options.background);
    enum rn_status status = rn_work_render(&curve->work, field, &options, ret_result, err);
    if (status) return status;
    size_t n = (size_t)ret_result->rgb.width * (size_t)ret_result->rgb.height * 3;
    for (size_t i = 0; i < n; i++)
        ret_result->rgb.values[i] = fminf(fmaxf(ret_result->rgb.values[i], 0), 1);
    return RN_OK;
}

// The full picture and the photograph of a view.
static enum rn_status show_view(struct curve_work *curve, struct rn_field *field,
                                const struct rn_field_info *info, int view, struct rn_error *err) {
    if (curve->shown == view) return RN_OK;
    rn_picture_finish(&curve->full);
    rn_picture_finish(&curve->truth);
    curve->shown = view;
    struct rn_render_result result;
    struct rn_curve_setting setting = nothing_set();
    enum rn_status status = curve->photographs ? read_truth(curve, info, err) : RN_OK;
    if (!status) status = render(curve, field, info, &setting, &result, err);
    if (status) {
        curve->shown = -1;
        return status;
    }
    curve->full = result.rgb;
    return RN_OK;
}

// ---- units ----------------------------------------------------------------------------------

static enum rn_status compare(const struct curve_work *curve, const struct rn_picture *picture,
                              double *ret_psnr, double *ret_full) {
    enum rn_status status = rn_psnr(picture, &curve->full, ret_full);
    *ret_psnr = *ret_full;
    if (!status && curve->photographs) status = rn_psnr(picture, &curve->truth, ret_psnr);
    return status;
}

static enum rn_status note_quality(struct curve_work *curve, struct way *way,
                                   const struct rn_render_result *result) {
    double psnr, psnr_full, ssim = 0;
    enum rn_status status = compare(curve, &result->rgb, &psnr, &psnr_full);
    if (!status)
        status = rn_ssim(&result->rgb, curve->photographs ? &curve->truth : &curve->full, &ssim);
    if (status) return status;
    way->same += isinf(psnr_full);
    if (isinf(psnr_full)) psnr_full = 0;
    if (isinf(psnr)) psnr = 0;
    way->psnr += psnr;
    way->psnr_squares += psnr * psnr;
    way->psnr_full += psnr_full;
    way->ssim += ssim;
    way->rays += (double)result->stats.rays;
    way->samples += (double)result->stats.samples;
    way->interpolation += result->stats.interpolation;
    way->roughness += result->stats.roughness;
    return RN_OK;
}

// So that there are as many times as with VIEWS views.
static int rounds_of(const struct curve_work *curve) {
    int rounds = (VIEWS + curve->views - 1) / curve->views;
    return rounds < MOST_ROUNDS ? rounds : MOST_ROUNDS;
}

// Unit i < WAYS: way i on the first view. Then a view after the other, in rounds over the
// finalists.
static enum rn_status measure(struct curve_work *curve, struct rn_field *field,
                              const struct rn_field_info *info, struct rn_error *err) {
    struct state *state = curve->state;
    int unit = (int)curve->work.done, rest = unit - WAYS;
    bool first = rest < 0;
    int rounds = rounds_of(curve);
    int round = first ? 0 : rest / FINALISTS % rounds, place = rest % FINALISTS;
    if (rest == 0) choose_finalists(state);
    if (first ? unit >= state->ways : place >= state->finalists) return RN_OK;
    struct way *way = &state->way[first ? unit : state->finalist[place]];
    struct rn_render_result result;
    enum rn_status status =
        show_view(curve, field, info, first ? 0 : rest / (FINALISTS * rounds), err);
    if (!status) status = render(curve, field, info, &way->setting, &result, err);
    if (status) return status;
    rn_work_rendered(&curve->work, result.stats.render_ms, result.stats.nonfinite_rays);
    if (first) {
        double psnr_full;
        way->first_ms = result.stats.render_ms;
        status = compare(curve, &result.rgb, &way->first_worth, &psnr_full);
    } else {
        way->ms[way->times++] = (float)result.stats.render_ms;
        if (round == 0) status = note_quality(curve, way, &result);
    }
    rn_render_result_finish(&result);
    return status ? rn_error_set(err, status, "curve", "the pictures cannot be compared") : RN_OK;
}

// ---- what a killed runner leaves ------------------------------------------------------------

static enum rn_status state_path(const struct curve_work *curve, char ret_path[PATH_MAX],
                                 struct rn_error *err) {
    const char *folder = curve->work.host->place.scene_folder;
    if (snprintf(ret_path, PATH_MAX, "%s/curve.part", folder) >= PATH_MAX)
        return rn_error_set(err, RN_ERROR_LIMIT, folder, "the path is too long");
    return RN_OK;
}

static void save_state(struct curve_work *curve) {
    char path[PATH_MAX];
    struct rn_error err = {0};
    double now_s = (double)rn_clock_ns() * 1e-9;
    if (now_s - curve->saved_s < SAVE_EVERY_S || state_path(curve, path, &err)) return;
    curve->state->seconds += curve->saved_s > 0 ? now_s - curve->saved_s : 0;
    curve->saved_s = now_s;
    curve->state->done = (int32_t)curve->work.done + 1;
    if (rn_file_write_atomic(path, curve->state, sizeof *curve->state, &err))
        rn_log(RN_LOG_WARN, "what was measured is not kept: %s: %s", err.where, err.text);
}

static bool is_of_the_same(const struct state *before, const struct state *now) {
    return *now->digest && strcmp(before->digest, now->digest) == 0 &&
           strcmp(before->version, now->version) == 0 && before->method == now->method &&
           before->threads == now->threads && before->views == now->views &&
           before->ways == now->ways && before->done > 0;
}

// Goes on where a runner was killed, if it was measuring the same, on the same machine and with the
// same kernels: times of two are no curve.
static void take_state(struct curve_work *curve) {
    char path[PATH_MAX];
    uint8_t *bytes = NULL;
    size_t size = 0;
    if (state_path(curve, path, NULL)) return;
    bool found = rn_file_read(path, sizeof *curve->state, &bytes, &size, NULL) == RN_OK &&
                 size == sizeof *curve->state;
    const struct state *before = (void *)bytes;
    if (found && is_of_the_same(before, curve->state)) {
        bool alike = strcmp(before->machine, curve->state->machine) == 0 &&
                     strcmp(before->kernels, curve->state->kernels) == 0;
        rn_log(RN_LOG_INFO,
               "the curve was measured on %s, kernels %s, up to part %d: on %s, %s, it %s",
               before->machine, before->kernels, (int)before->done, curve->state->machine,
               curve->state->kernels, alike ? "goes on from there" : "begins anew");
        if (alike) {
            memcpy(curve->state, bytes, size);
            curve->work.done = (size_t)curve->state->done;
        }
    }
    free(bytes);
}

// ---- the kind of work -----------------------------------------------------------------------

// Of both splits that were not trained on: each may see the scene from other places.
static void choose_around(struct curve_work *curve, const struct rn_dataset *dataset,
                          const struct rn_field *field) {
    struct rn_field_info info;
    rn_field_describe(field, &info);
    int most = RN_CURVE_VIEWS / 2,
        count = rn_work_choose_views(dataset, RN_SPLIT_TEST, most, curve->around);
    if (!info.config.train_val)
        count += rn_work_choose_views(dataset, RN_SPLIT_VAL, most, curve->around + count);
    curve->around_count = count;
}

// The views of the dataset that were not trained on, else those that were, else its own.
static enum rn_status choose_views(struct curve_work *curve, const struct rn_field *field,
                                   struct rn_error *err) {
    int wanted = (int)rn_int_or(curve->options.views, VIEWS);
    struct rn_host *host = curve->work.host;
    if (!*host->place.dataset_folder) { // the scene came as a file
        struct rn_field_info info;
        rn_field_describe(field, &info);
        curve->views = wanted;
        rn_turned_cameras(&info, wanted, curve->cameras);
        return RN_OK;
    }
    enum rn_status status = rn_host_need_sound_dataset(host, err);
    if (status) return status;
    curve->views = rn_work_choose_views(host->dataset, RN_SPLIT_TEST, wanted, curve->frames);
    curve->photographs = curve->views > 0;
    if (!curve->photographs)
        curve->views = rn_work_choose_views(host->dataset, RN_SPLIT_TRAIN, wanted, curve->frames);
    for (int i = 0; i < curve->views; i++)
        curve->cameras[i] = curve->frames[i]->camera;
    return RN_OK;
}

static enum rn_status prepare(struct rn_work *work, struct rn_field *field, struct rn_error *err) {
    struct curve_work *curve = (struct curve_work *)work;
    enum rn_status status = choose_views(curve, field, err);
    if (status) return status;
    if (curve->views == 0)
        return rn_error_set(err, RN_ERROR_INVALID, "#/scene", "its dataset has no views");
    const struct rn_camera camera = view_camera(curve, 0), taken = curve->cameras[0];
    curve->photographs &= camera.width == taken.width && camera.height == taken.height;
    if (curve->photographs) choose_around(curve, work->host->dataset, field);
    work->total =
        WAYS + (size_t)(curve->views * FINALISTS * rounds_of(curve)) + (size_t)curve->around_count;
    curve->state = calloc(1, sizeof *curve->state);
    return curve->state ? RN_OK : rn_error_set(err, RN_ERROR_NO_MEMORY, "", "out of memory");
}

static enum rn_status begin(struct rn_work *work, struct rn_error *err) {
    struct curve_work *curve = (struct curve_work *)work;
    struct state *state = curve->state;
    struct rn_host *host = work->host;
    struct rn_device_info device;
    struct rn_field *field;
    struct rn_field_info info;
    enum rn_status status = rn_host_field(host, &field, err);
    if (status) return status;
    rn_field_describe(field, &info);
    rn_engine_describe(host->engine, &device);
    struct rn_camera camera = view_camera(curve, 0);
    *state =
        (struct state){.method = RN_CURVE_METHOD, .threads = device.threads, .views = curve->views};
    rn_machine_name(state->machine);
    snprintf(state->version, sizeof state->version, "%s", RIPNERF_VERSION);
    snprintf(state->kernels, sizeof state->kernels, "%s", device.kernels);
    if (!host->training) snprintf(state->digest, sizeof state->digest, "%s", host->digest);
    list_ways(state, info.config.step, rn_render_cones(field, &camera));
    curve->shown = -1;
    take_state(curve);
    return RN_OK;
}

// The last units: one more view's full picture, beside its photograph.
static enum rn_status look_around(struct curve_work *curve, struct rn_field *field,
                                  const struct rn_field_info *info, size_t view,
                                  struct rn_error *err) {
    struct rn_view_score score;
    enum rn_status status =
        rn_work_score(&curve->work, field, info, curve->around[view], &score, err);
    if (status || !isfinite(score.psnr)) return status;
    struct rn_curve_view *seen = &curve->state->around[curve->state->around_count++];
    seen->psnr = score.psnr;
    for (int i = 0; i < 3; i++)
        seen->position[i] = curve->around[view]->camera.world_from_camera[i][3];
    return RN_OK;
}

static enum rn_status unit(struct rn_work *work, struct rn_field *field,
                           const struct rn_field_info *info, struct rn_error *err) {
    struct curve_work *curve = (struct curve_work *)work;
    size_t ways = work->total - (size_t)curve->around_count;
    enum rn_status status = work->done < ways
                                ? measure(curve, field, info, err)
                                : look_around(curve, field, info, work->done - ways, err);
    if (!status) save_state(curve);
    return status;
}

static int ascending(const void *a, const void *b) {
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

static struct rn_curve_point point_of(const struct curve_work *curve, struct way *way) {
    double views = curve->views, psnr = way->psnr / views;
    double spread = sqrt(fmax(way->psnr_squares / views - psnr * psnr, 0));
    qsort(way->ms, way->times, sizeof *way->ms, ascending);
    uint32_t different = (uint32_t)curve->views - way->same;
    return (struct rn_curve_point){.setting = way->setting,
                                   .ms_median = (double)way->ms[way->times / 2],
                                   .ms_p95 = (double)way->ms[(way->times * 95 + 99) / 100 - 1],
                                   .psnr = curve->photographs ? psnr : NAN,
                                   .ssim = way->ssim / views,
                                   .psnr_full = different ? way->psnr_full / different : NAN,
                                   .psnr_spread = spread,
                                   .rays = way->rays / views,
                                   .samples = way->samples / views,
                                   .interpolation = way->interpolation / views,
                                   .roughness = way->roughness / views};
}

static void describe(struct curve_work *curve, struct rn_curve_record *record) {
    struct rn_camera camera = view_camera(curve, 0);
    rn_curve_place(curve->work.host, record);
    record->step = curve->work.step;
    record->width = camera.width;
    record->height = camera.height;
    record->views = curve->views;
    record->photographs = curve->photographs;
    record->seconds = curve->state->seconds;
    snprintf(record->digest, sizeof record->digest, "%s", curve->state->digest);
    rn_time_text(rn_clock_wall_ms(), record->measured_at);
}

static enum rn_status write_curve(struct curve_work *curve, const char *json,
                                  struct rn_error *err) {
    char path[PATH_MAX];
    struct rn_host *host = curve->work.host;
    enum rn_status status = rn_folder_write(host->place.scene_folder, "curve.json", json, err);
    if (status) return status;
    rn_message_finish(&rn_curve_record_table, &host->pace.record);
    host->pace.looked = false;
    if (state_path(curve, path, NULL) == RN_OK) unlink(path);
    return RN_OK;
}

static enum rn_status result(struct rn_work *work, struct rn_field *field, char **ret_json,
                             struct rn_error *err) {
    struct curve_work *curve = (struct curve_work *)work;
    struct state *state = curve->state;
    struct rn_curve_point points[FINALISTS];
    struct rn_curve_record record;
    (void)field;
    describe(curve, &record);
    for (int i = 0; i < state->finalists; i++)
        points[record.count++] = point_of(curve, &state->way[state->finalist[i]]);
    rn_curve_reduce(points, &record.count);
    record.points = points;
    record.around = state->around;
    record.around_count = (size_t)state->around_count;
    char *json = NULL;
    enum rn_status status = rn_encode(&rn_curve_record_table, &record, &json, NULL, err);
    if (!status) status = write_curve(curve, json, err);
    if (status)
        free(json);
    else
        *ret_json = json;
    return status;
}

static void release(struct rn_work *work) {
    struct curve_work *curve = (struct curve_work *)work;
    rn_picture_finish(&curve->full);
    rn_picture_finish(&curve->truth);
    free(curve->state);
}

static const struct rn_work_kind kind = {.size = sizeof(struct curve_work),
                                         .prepare = prepare,
                                         .begin = begin,
                                         .unit = unit,
                                         .result = result,
                                         .release = release};

void rn_work_add_curve(struct rn_host *host, const struct rn_wire_curve *request) {
    struct rn_work *work = rn_work_append(host, &kind, request->job);
    if (work) ((struct curve_work *)work)->options = request->options;
}

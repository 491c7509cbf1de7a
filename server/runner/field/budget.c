#include "server/runner/field/budget.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "common/base/log.h"
#include "common/image/image.h"

#define JPEG_GROWTH 1.5  // power of a file's size that its error goes by, about
#define JPEG_COUNTS 0.85 // of a JPEG's error; the rest is of detail that was wrong
#define MOST_LOOKS 4     // at how long pictures take, before a job gets the quickest ones
#define MOST_TRIES 3     // at a picture of a PSNR
#define TOLD_DB 0.005    // less than asked for is not told of
#define MOST_PLACES 5    // of a job's pictures, that the dearest is looked for among
#define SHARPER_DB 1.0   // more than when it was measured what a JPEG takes

// Of a pixel, before one was encoded.
static const double encode_ns[] = {
    [RN_FORMAT_PNG] = 60, [RN_FORMAT_JPEG] = 20, [RN_FORMAT_PNG16] = 200, [RN_FORMAT_EXR] = 300};

void rn_pace_finish(struct rn_pace *pace) {
    rn_message_finish(&rn_curve_record_table, &pace->record);
    *pace = (struct rn_pace){0};
}

static void look_for_curve(struct rn_host *host) {
    struct rn_error err = {0};
    if (host->pace.looked) return;
    host->pace.looked = true;
    enum rn_status status = rn_curve_read(host->place.scene_folder, &host->pace.record, &err);
    if (status == RN_OK || status == RN_ERROR_NOT_FOUND) return;
    host->pace.record = (struct rn_curve_record){0};
    rn_log(RN_LOG_WARN, "the curve is not used: %s: %s", err.where, err.text);
}

void rn_curve_place(const struct rn_host *host, struct rn_curve_record *ret_record) {
    struct rn_device_info device;
    rn_engine_describe(host->engine, &device);
    *ret_record = (struct rn_curve_record){.threads = device.threads, .method = RN_CURVE_METHOD};
    snprintf(ret_record->machine, sizeof ret_record->machine, "%s", device.name);
    snprintf(ret_record->device, sizeof ret_record->device, "%s", device.device);
    snprintf(ret_record->kernels, sizeof ret_record->kernels, "%s", device.kernels);
    snprintf(ret_record->version, sizeof ret_record->version, "%s", RIPNERF_VERSION);
}

static bool is_of_now(const struct rn_host *host, const struct rn_curve_record *record) {
    struct rn_curve_record now;
    rn_curve_place(host, &now);
    snprintf(now.digest, sizeof now.digest, "%s", host->digest);
    return !host->training && !rn_curve_changed(record, &now);
}

// The curve to go by, and which one that is: "measured", or "stale" where the parameters or the
// machine have changed since, or "preset". Valid until the scene's curve changes.
struct chosen_curve {
    struct rn_curve curve;
    struct rn_curve_point points[RN_CURVE_POINTS]; // the preset's
    const char *source;
};

static void find_curve(struct rn_host *host, struct chosen_curve *ret_found) {
    look_for_curve(host);
    const struct rn_curve_record *record = &host->pace.record;
    if (record->count == 0) {
        rn_curve_of_presets(ret_found->points, &ret_found->curve);
        ret_found->source = "preset";
        return;
    }
    ret_found->curve = rn_curve_in(record);
    ret_found->source = is_of_now(host, record) ? "measured" : "stale";
}

static void put_settings(const struct rn_curve_point *point,
                         union rn_setting_value settings[RN_RENDER_SETTINGS]) {
    memcpy(settings, point->setting.values, RN_RENDER_BUDGET * sizeof *settings);
}

static bool has_settings(const union rn_setting_value settings[RN_RENDER_SETTINGS]) {
    for (size_t i = 0; i < RN_RENDER_BUDGET; i++)
        if (!rn_setting_is_absent(&rn_render_settings.rows[i], &settings[i])) return true;
    return false;
}

// The ways to render a picture, from the quickest on, and what each is expected to take here.
static size_t plain_choices(const struct chosen_curve *found, double scale,
                            struct rn_render_choice choices[RN_CURVE_POINTS]) {
    const struct rn_curve *curve = &found->curve;
    for (size_t i = 0; i < curve->count; i++) {
        choices[i] = (struct rn_render_choice){.ms = curve->points[i].ms_median * scale,
                                               .samples = curve->points[i].samples * scale};
        rn_settings_put(&rn_render_settings, curve->points[i].setting.values, &choices[i].settings);
    }
    return curve->count;
}

// Of one whose pixels are seen from many places (a lens, a shutter): ever more cones a pixel. They
// cost what the full picture's do.
static size_t spread_choices(const struct rn_field *field, const struct chosen_curve *found,
                             double scale, const struct rn_camera *camera,
                             struct rn_render_choice choices[RN_CURVE_POINTS]) {
    const struct rn_curve_point *full = &found->curve.points[found->curve.count - 1];
    double cones = pow(rn_render_cones(field, camera), 2);
    size_t count = 0;
    for (int side = 1; side <= 16; side *= 2, count++) {
        double share = scale * side * side / cones;
        choices[count] = (struct rn_render_choice){.settings = {.supersample = side},
                                                   .ms = full->ms_median * share,
                                                   .samples = full->samples * share};
    }
    return count;
}

// ---- all pictures of a job --------------------------------------------------------------------

// The picture whose rays take the most samples, of some that are made in the quickest way: the
// others are thought to take no longer. What takes none is the first.
static enum rn_status find_dearest(struct rn_work *work, struct rn_field *field,
                                   const struct rn_budget_pictures *pictures,
                                   const struct rn_render_settings *quickest,
                                   struct rn_render_options *ret_options, struct rn_error *err) {
    size_t looks = pictures->count < MOST_PLACES ? pictures->count : MOST_PLACES, dearest = 0;
    uint64_t most = 0;
    for (size_t k = 0; k < looks && looks > 1; k++) {
        struct rn_render_result result;
        size_t i = k * (pictures->count - 1) / (looks - 1);
        pictures->describe(pictures->context, i, ret_options);
        ret_options->settings = *quickest;
        enum rn_status status = rn_work_render(work, field, ret_options, &result, err);
        if (status) return status;
        if (result.stats.samples > most) most = result.stats.samples, dearest = i;
        rn_render_result_finish(&result);
    }
    pictures->describe(pictures->context, dearest, ret_options);
    return RN_OK;
}

// How long a picture takes here and now, beside what else the cores do: the quicker of two, as the
// first may have memory to fetch.
static enum rn_status time_picture(struct rn_work *work, struct rn_field *field,
                                   const struct rn_render_options *options, double *ret_ms,
                                   struct rn_error *err) {
    *ret_ms = INFINITY;
    for (int i = 0; i < 2; i++) {
        struct rn_render_result result;
        enum rn_status status = rn_work_render(work, field, options, &result, err);
        if (status) return status;
        *ret_ms = fmin(*ret_ms, result.stats.render_ms);
        rn_render_result_finish(&result);
    }
    return RN_OK;
}

// The last of the choices that is expected to take no longer.
static size_t last_within(const struct rn_render_choice *choices, size_t count, double ms) {
    size_t last = 0;
    for (size_t i = 0; i < count; i++)
        if (choices[i].ms <= ms) last = i;
    return last;
}

// The best of the choices within a time for all pictures of a job, the quickest where none is.
// Where the dearest is slower now than expected, for what trains beside it, say, less fits.
static enum rn_status choose_within(struct rn_work *work, struct rn_field *field,
                                    const struct rn_budget_pictures *pictures,
                                    const struct rn_render_choice *choices, size_t count, double ms,
                                    size_t *ret_choice, struct rn_error *err) {
    struct rn_render_options options;
    double slowness = 1, took_ms;
    *ret_choice = last_within(choices, count, ms);
    if (*ret_choice == 0) return RN_OK;
    enum rn_status status =
        find_dearest(work, field, pictures, &choices[0].settings, &options, err);
    for (int look = 0; look < MOST_LOOKS && !status && *ret_choice > 0; look++) {
        const struct rn_render_choice *choice = &choices[*ret_choice];
        options.settings = choice->settings;
        status = time_picture(work, field, &options, &took_ms, err);
        if (status || took_ms <= ms) return status;
        slowness = fmax(slowness, took_ms / choice->ms);
        *ret_choice = last_within(choices, count, ms / slowness);
        if (look == MOST_LOOKS - 1) *ret_choice = 0;
    }
    return status;
}

// What 95 of 100 pictures of the curve keep is what a choice is expected to take.
static enum rn_status settle_within(struct rn_work *work, struct rn_field *field,
                                    const struct rn_budget_pictures *pictures,
                                    const struct chosen_curve *found, double ms,
                                    union rn_setting_value settings[RN_RENDER_SETTINGS],
                                    struct rn_error *err) {
    struct rn_render_choice choices[RN_CURVE_POINTS];
    struct rn_render_options first;
    size_t choice;
    pictures->describe(pictures->context, 0, &first);
    const struct rn_curve_point *points = found->curve.points;
    size_t full = found->curve.count - 1;
    double pixels = (double)first.camera.width * first.camera.height;
    double scale = pixels / rn_curve_pixels(&found->curve);
    bool spread = rn_optics_spreads(&first.shot.optics);
    size_t count = spread ? spread_choices(field, found, scale, &first.camera, choices)
                          : plain_choices(found, scale, choices);
    for (size_t i = 0; i < count; i++) {
        const struct rn_curve_point *of = &points[spread ? full : i];
        choices[i].ms *= of->ms_p95 / of->ms_median;
    }
    enum rn_status status = choose_within(work, field, pictures, choices, count, ms, &choice, err);
    if (status) return status;
    if (spread)
        rn_settings_value(&rn_render_settings, settings, "supersample")->whole =
            choices[choice].settings.supersample;
    else
        put_settings(&points[choice], settings);
    return RN_OK;
}

// *ret_changed: the settings are others.
static enum rn_status resolve(struct rn_work *work, struct rn_field *field,
                              const struct rn_budget_pictures *pictures,
                              union rn_setting_value settings[RN_RENDER_SETTINGS],
                              bool *ret_changed, struct rn_error *err) {
    struct chosen_curve found;
    struct rn_field_info info;
    double number;
    bool missed;
    enum rn_budget_kind kind = rn_budget_of(settings, &number);
    *ret_changed = kind != RN_BUDGET_NONE && !has_settings(settings);
    if (!*ret_changed) return RN_OK;
    find_curve(work->host, &found);
    rn_field_describe(field, &info);
    if (kind == RN_BUDGET_TIME) {
        enum rn_status status = settle_within(work, field, pictures, &found, number, settings, err);
        if (status) return status;
    } else {
        size_t point = rn_curve_choose(&found.curve, kind, number, NAN, info.psnr, &missed);
        put_settings(&found.curve.points[point], settings);
    }
    // The full picture's settings are none: what says so, so that the budget is resolved once.
    if (!has_settings(settings))
        *rn_settings_value(&rn_render_settings, settings, "tolerance") =
            (union rn_setting_value){.number = 0};
    return RN_OK;
}

enum rn_status rn_budget_settle(struct rn_work *work, struct rn_field *field,
                                const struct rn_budget_pictures *pictures,
                                union rn_setting_value settings[RN_RENDER_SETTINGS],
                                const struct rn_table *table, const void *options,
                                struct rn_error *err) {
    struct rn_wire_resolved resolved = {.options = NULL};
    bool changed;
    enum rn_status status = resolve(work, field, pictures, settings, &changed, err);
    if (status || !changed) return status;
    status = rn_encode(table, options, &resolved.options, NULL, err);
    if (status) return status;
    snprintf(resolved.job, sizeof resolved.job, "%s", work->job);
    rn_link_post(&work->host->link, RN_WIRE_RESOLVED, &resolved, NULL, 0);
    free(resolved.options);
    return RN_OK;
}

void rn_budget_tell(struct rn_host *host, const struct rn_field *field,
                    const union rn_setting_value settings[RN_RENDER_SETTINGS],
                    struct rn_budget_told *ret_told) {
    struct chosen_curve found;
    struct rn_curve_setting setting;
    struct rn_field_info info;
    char text[sizeof ret_told->setting];
    double number;
    *ret_told = (struct rn_budget_told){.expected_psnr = NAN, .expected_spread = NAN};
    if (rn_budget_of(settings, &number) == RN_BUDGET_NONE) return;
    memcpy(setting.values, settings, sizeof setting.values);
    rn_curve_setting_text(&setting, ret_told->setting, sizeof ret_told->setting);
    rn_field_describe(field, &info);
    find_curve(host, &found);
    for (size_t i = 0; i < found.curve.count; i++) {
        const struct rn_curve_point *point = &found.curve.points[i];
        rn_curve_setting_text(&point->setting, text, sizeof text);
        if (strcmp(text, ret_told->setting) != 0) continue;
        ret_told->expected_psnr = rn_curve_expected(&found.curve, i, info.psnr);
        if (!isnan(point->psnr)) ret_told->expected_spread = point->psnr_spread;
    }
}

// ---- one picture ----------------------------------------------------------------------------

static struct rn_curve_here look_here(const struct chosen_curve *found,
                                      const struct rn_camera *camera) {
    const double place[3] = {camera->world_from_camera[0][3], camera->world_from_camera[1][3],
                             camera->world_from_camera[2][3]};
    return rn_curve_here(&found->curve, place);
}

static void tell(const struct chosen_curve *found, size_t point,
                 const struct rn_render_stats *stats, const struct rn_camera *camera, double psnr,
                 struct rn_wire_rendered *rendered) {
    const struct rn_curve_point *p = &found->curve.points[point];
    struct rn_curve_setting setting = p->setting;
    const struct rn_curve_made made = {stats->interpolation, stats->roughness};
    const struct rn_curve_here here = look_here(found, camera);
    *rn_settings_value(&rn_render_settings, setting.values, "tolerance") =
        (union rn_setting_value){.number = stats->tolerance < 1e-6 ? 0 : stats->tolerance};
    rn_curve_setting_text(&setting, rendered->setting, sizeof rendered->setting);
    rendered->expected_psnr =
        rn_curve_expected_here(&found->curve, point, &made, psnr, here.better);
    if (!isnan(p->psnr))
        rendered->expected_spread =
            rn_curve_spread_here(&found->curve, rendered->expected_psnr, psnr, &here);
    snprintf(rendered->curve, sizeof rendered->curve, "%s", found->source);
}

static enum rn_status render_by_deadline(struct rn_host *host, const struct rn_wire_render *render,
                                         const struct rn_field_info *info, struct rn_field *field,
                                         const struct rn_render_options *options,
                                         struct rn_watch *watch, struct rn_wire_rendered *rendered,
                                         struct rn_render_result *ret_result,
                                         struct rn_error *err) {
    struct chosen_curve found;
    struct rn_render_choice choices[RN_CURVE_POINTS];
    struct rn_render_spent spent;
    find_curve(host, &found);
    double pixels = (double)options->camera.width * (double)options->camera.height;
    double scale = pixels / rn_curve_pixels(&found.curve);
    bool spread = rn_optics_spreads(&options->shot.optics);
    size_t count = spread ? spread_choices(field, &found, scale, &options->camera, choices)
                          : plain_choices(&found, scale, choices);
    int format = rn_name_or(render->render.format, RN_FORMAT_PNG);
    double pixel_ns =
        host->pace.encode_ns[format] > 0 ? host->pace.encode_ns[format] : encode_ns[format];
    double asked_ms;
    rn_budget_of(render->render.settings, &asked_ms);
    if (!isnan(render->needed_ms)) rn_pace_note(&host->pace.end, render->needed_ms);
    double kept_ms = rn_pace_keep_ms(&host->pace.end, asked_ms);
    double reserve_ns = pixel_ns * pixels + kept_ms * 1e6;
    struct rn_render_budget budget = {.choices = choices,
                                      .count = count,
                                      .deadline_ns = render->deadline_ns - (int64_t)reserve_ns,
                                      .slowness = host->pace.slowness > 0 ? host->pace.slowness : 1,
                                      .ray_ms = host->pace.ray_ms};
    enum rn_status status = rn_render_within(host->engine, field, options, &budget,
                                             rn_watch_keep_going, watch, ret_result, &spent, err);
    if (status) return status;
    host->pace.slowness = budget.slowness;
    host->pace.ray_ms = budget.ray_ms;
    rendered->kept_ms =
        kept_ms + fmax((double)(budget.deadline_ns - rn_clock_ns()) * 1e-6, 0); // what is left
    rendered->render_ms = spent.ms;
    if (spread) {
        snprintf(rendered->setting, sizeof rendered->setting, "supersample=%d",
                 spent.settings.supersample);
        snprintf(rendered->curve, sizeof rendered->curve, "%s", found.source);
        return RN_OK;
    }
    tell(&found, spent.choice, &ret_result->stats, &options->camera, info->psnr, rendered);
    return RN_OK;
}

// What the picture is to be worth for its file to be worth so much, by what the last JPEG lost; no
// picture is where the file alone loses more.
static double psnr_of_picture(const struct rn_pace *pace, const struct rn_render_request *request,
                              double psnr) {
    bool known = request->format == RN_FORMAT_JPEG &&
                 pace->jpeg_quality == (int)rn_int_or(request->jpeg_quality, RN_JPEG_QUALITY);
    double error = pow(10, -psnr / 10) - (known ? JPEG_COUNTS * pace->jpeg_error : 0);
    return known ? error > 0 ? -10 * log10(error) : INFINITY : psnr;
}

// By the quickest point that is expected to reach it here. What a picture was interpolated from
// tells when it was made: where it is expected to be worth less, a better one takes its place.
static enum rn_status render_of_psnr(struct rn_host *host, const struct rn_wire_render *render,
                                     const struct rn_field_info *info, struct rn_field *field,
                                     const struct rn_render_options *options, double asked,
                                     struct rn_watch *watch, struct rn_wire_rendered *rendered,
                                     struct rn_render_result *ret_result, struct rn_error *err) {
    struct chosen_curve found;
    struct rn_render_options chosen = *options;
    find_curve(host, &found);
    double better = look_here(&found, &options->camera).better;
    double worth = psnr_of_picture(&host->pace, &render->render, asked), aim = worth;
    size_t point = 0;
    for (int tries = 1;; tries++) {
        bool missed;
        size_t next = rn_curve_choose(&found.curve, RN_BUDGET_PSNR,
                                      rn_curve_from_here(&found.curve, aim, better), NAN,
                                      info->psnr, &missed);
        point = tries > 1 && next <= point ? point + 1 : next;
        chosen.settings = options->settings;
        rn_settings_put(&rn_render_settings, found.curve.points[point].setting.values,
                        &chosen.settings);
        enum rn_status status =
            rn_render(host->engine, field, &chosen, rn_watch_keep_going, watch, ret_result, err);
        if (status) return status;
        rendered->render_ms += ret_result->stats.render_ms;
        tell(&found, point, &ret_result->stats, &options->camera, info->psnr, rendered);
        double less = worth - rendered->expected_psnr;
        if (!(less > TOLD_DB) || missed || tries == MOST_TRIES || point + 1 == found.curve.count)
            return RN_OK;
        aim += less;
        rn_render_result_finish(ret_result);
    }
}

enum rn_status rn_budget_render(struct rn_host *host, const struct rn_wire_render *render,
                                const struct rn_field_info *info, struct rn_field *field,
                                struct rn_render_options *options, struct rn_watch *watch,
                                struct rn_wire_rendered *rendered,
                                struct rn_render_result *ret_result, struct rn_error *err) {
    struct chosen_curve found;
    double number;
    size_t point = 0;
    bool missed;
    enum rn_budget_kind kind = rn_budget_of(render->render.settings, &number);
    if (kind == RN_BUDGET_TIME && render->deadline_ns != RN_ABSENT)
        return render_by_deadline(host, render, info, field, options, watch, rendered, ret_result,
                                  err);
    if (kind == RN_BUDGET_PSNR)
        return render_of_psnr(host, render, info, field, options, number, watch, rendered,
                              ret_result, err);
    if (kind != RN_BUDGET_NONE) {
        find_curve(host, &found);
        point = rn_curve_choose(&found.curve, kind, number,
                                (double)options->camera.width * (double)options->camera.height,
                                info->psnr, &missed);
        rn_settings_put(&rn_render_settings, found.curve.points[point].setting.values,
                        &options->settings);
    }
    enum rn_status status =
        rn_render(host->engine, field, options, rn_watch_keep_going, watch, ret_result, err);
    if (status) return status;
    rendered->render_ms = ret_result->stats.render_ms;
    if (kind != RN_BUDGET_NONE)
        tell(&found, point, &ret_result->stats, &options->camera, info->psnr, rendered);
    return RN_OK;
}

// Mean square over the colour channels, in [0, 1].
static double image_error(const struct rn_image *a, const struct rn_image *b) {
    size_t count = (size_t)a->width * (size_t)a->height;
    uint64_t sum = 0;
    for (size_t i = 0; i < 4 * count; i++) {
        int apart = i % 4 == 3 ? 0 : a->pixels[i] - b->pixels[i];
        sum += (uint64_t)(apart * apart);
    }
    return (double)sum / (3 * 255.0 * 255.0 * (double)count);
}

// What a JPEG differs from its picture by; 0 where there is no memory to know.
static double jpeg_error(const struct rn_picture *rgb, const uint8_t *bytes, size_t size) {
    struct rn_image whole, decoded;
    if (rn_picture_to_image(rgb, &whole, NULL)) return 0;
    bool known = !rn_image_decode(bytes, size, "", &rn_image_default_limits, &decoded, NULL);
    double error = known ? image_error(&whole, &decoded) : 0;
    if (known) rn_image_finish(&decoded);
    rn_image_finish(&whole);
    return error;
}

// Measured with the first picture of a quality, and again with one that has much more to lose.
void rn_budget_look(struct rn_host *host, const struct rn_wire_render *render,
                    const struct rn_picture *rgb, const uint8_t *bytes, size_t size,
                    double picture_psnr) {
    struct rn_pace *pace = &host->pace;
    int quality = (int)rn_int_or(render->render.jpeg_quality, RN_JPEG_QUALITY);
    bool known = pace->jpeg_quality == quality && picture_psnr <= pace->jpeg_psnr + SHARPER_DB;
    if (known || render->render.format != RN_FORMAT_JPEG || !rgb->values || isnan(picture_psnr))
        return;
    pace->jpeg_error = jpeg_error(rgb, bytes, size);
    pace->jpeg_quality = quality;
    pace->jpeg_psnr = picture_psnr;
    pace->jpeg_density = (double)size / ((double)rgb->width * rgb->height);
}

// By its size: what takes more bytes has more to lose.
static void expect_jpeg(const struct rn_pace *pace, const struct rn_render_request *request,
                        double pixels, size_t size, struct rn_wire_rendered *rendered) {
    if (pace->jpeg_quality != (int)rn_int_or(request->jpeg_quality, RN_JPEG_QUALITY)) return;
    double growth = pow((double)size / pixels / pace->jpeg_density, JPEG_GROWTH);
    double error = JPEG_COUNTS * pace->jpeg_error * growth;
    rendered->expected_psnr = -10 * log10(pow(10, -rendered->expected_psnr / 10) + error);
}

void rn_budget_encoded(struct rn_host *host, const struct rn_wire_render *render,
                       const struct rn_picture *rgb, const uint8_t *bytes, size_t size,
                       struct rn_wire_rendered *rendered) {
    double pixels = (double)rendered->width * (double)rendered->height;
    double *kept = &host->pace.encode_ns[rendered->format];
    double now = rendered->encode_ms * 1e6 / pixels;
    if (pixels >= 1e4) *kept = *kept > 0 ? 0.8 * *kept + 0.2 * now : now;
    if (rendered->format == RN_FORMAT_JPEG && rgb->values) {
        if (render->deadline_ns == RN_ABSENT)
            rn_budget_look(host, render, rgb, bytes, size, rendered->expected_psnr);
        expect_jpeg(&host->pace, &render->render, pixels, size, rendered);
    }
    double asked;
    if (rn_budget_of(render->render.settings, &asked) == RN_BUDGET_PSNR)
        rendered->missed = !(rendered->expected_psnr >= asked - TOLD_DB);
}

// A rendered view against its photograph.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/image/lpips.h"
#include "common/image/metrics.h"
#include "server/engine/effects/effects.h"
#include "server/engine/render/cones.h"
#include "server/engine/render/render.h"
#include "server/engine/scene/appearance.h"
#include "server/engine/scene/device.h"
#include "server/engine/scene/pixels.h"
#include "server/engine/scene/pose.h"

#define SOUGHT (RN_FIT_POSE | RN_FIT_APPEARANCE) // what a picture is rendered anew with

static bool is_folded(const struct rn_camera *c, int x, int y) {
    return !(rn_camera_ray(c, x + 0.5, y + 0.5).radius > 0);
}

// What a lens sees is one piece around its axis: it folds within the picture where it does at the
// edge.
static bool folds(const struct rn_camera *c) {
    bool any = false;
    if (c->lens == RN_LENS_PINHOLE) return false;
    for (int x = 0; x < c->width && !any; x++)
        any = is_folded(c, x, 0) || is_folded(c, x, c->height - 1);
    for (int y = 0; y < c->height && !any; y++)
        any = is_folded(c, 0, y) || is_folded(c, c->width - 1, y);
    return any;
}

// A byte a pixel, 0 for those that a mask or the lens's fold leaves out; NULL where all count.
static enum rn_status find_used(const struct rn_frame *frame, uint8_t **ret_used,
                                struct rn_error *err) {
    const struct rn_camera *camera = &frame->camera;
    size_t width = (size_t)camera->width, count = width * (size_t)camera->height;
    bool folded = folds(camera);
    *ret_used = NULL;
    if (!frame->mask_path && !folded) return RN_OK;
    uint8_t *used = malloc(count);
    if (!used) return rn_error_set(err, RN_ERROR_NO_MEMORY, frame->path, "out of memory");
    memset(used, 1, count);
    enum rn_status status = frame->mask_path ? rn_mask_read(frame, used, err) : RN_OK;
    for (size_t i = 0; status == RN_OK && folded && i < count; i++)
        if (used[i]) used[i] = !is_folded(camera, (int)(i % width), (int)(i / width));
    if (status == RN_OK)
        *ret_used = used;
    else
        free(used);
    return status;
}

// Clamps to [0, 1]; what is left out becomes the photograph's. Returns how many pixels count.
static size_t prepare(struct rn_picture *rendered, const struct rn_picture *truth,
                      const uint8_t *used) {
    size_t count = 0, n = (size_t)rendered->width * (size_t)rendered->height;
    for (size_t i = 0; i < n; i++) {
        bool counts = !used || used[i];
        count += counts;
        for (size_t c = 3 * i; c < 3 * i + 3; c++)
            rendered->values[c] =
                counts ? fminf(fmaxf(rendered->values[c], 0), 1) : truth->values[c];
    }
    return count;
}

// Sums for the line that takes rendered values to the photograph's, of one channel.
struct line {
    double n, x, y, xx, xy;
};

static void add_to_line(struct line *l, double x, double y) {
    l->n++, l->x += x, l->y += y, l->xx += x * x, l->xy += x * y;
}

// The line's value at x, 0 .. 1.
static double value_on(const struct line *l, double x) {
    double spread = l->n * l->xx - l->x * l->x;
    double gain = spread > 1e-9 * l->n * l->n ? (l->n * l->xy - l->x * l->y) / spread : 1;
    double offset = l->n > 0 ? (l->y - gain * l->x) / l->n : 0;
    return fmin(fmax(gain * x + offset, 0), 1);
}

// Squared errors of the right (half 1) or left half after a fit on the other; *count: its values.
static double fitted_half(const struct rn_picture *rendered, const struct rn_picture *truth,
                          const uint8_t *used, int half, size_t *count) {
    struct line lines[3] = {{0}};
    int width = rendered->width, middle = width / 2;
    double sum = 0;
    for (int pass = 0; pass < 2; pass++) {
        int side = pass ? half : 1 - half, begin = side ? middle : 0, end = side ? width : middle;
        for (size_t i = 0; i < (size_t)rendered->height * (size_t)width; i++) {
            int x = (int)(i % (size_t)width);
            if (x < begin || x >= end || (used && !used[i])) continue;
            for (size_t c = 0; c < 3; c++) {
                double shown = (double)rendered->values[3 * i + c];
                double is = (double)truth->values[3 * i + c];
                if (pass) {
                    double off = value_on(&lines[c], shown) - is;
                    sum += off * off;
                    ++*count;
                } else {
                    add_to_line(&lines[c], shown, is);
                }
            }
        }
    }
    return sum;
}

// A view that is compared: its photograph as it is in the file and over the background, and a byte
// a pixel for those that count (NULL: all).
struct view {
    struct rn_rendered_view *rendered;
    struct rn_image photograph;
    struct rn_picture truth;
    uint8_t *used;
};

// The picture from where the camera is found to be, and in the light that there is found to be, by
// the photograph's other half.
static enum rn_status render_sought(const struct view *view, int half,
                                    struct rn_render_result *ret_result, struct rn_error *err) {
    const struct rn_rendered_view *r = view->rendered;
    struct rn_render_options options = r->options;
    struct rn_pose_looker looker = {r->engine, r->field, 0, rn_effects_march_trained(r->field)};
    float *background = looker.march.colour.background;
    struct rn_pose_photo photo = {view->photograph.pixels, view->used, options.camera};
    int levels = rn_levels_for_camera(r->field, &photo.camera, r->field->config.step);
    enum rn_status status = rn_field_fetch(r->field, NULL, err);
    if (status == RN_OK) status = rn_field_make_ready(r->field, r->engine, levels, err);
    if (status != RN_OK) return status;
    memcpy(background, options.background, sizeof options.background);
    enum rn_pose_part part = half ? RN_POSE_LEFT : RN_POSE_RIGHT;
    uint64_t seed = r->field->config.seed;
    if (options.fit & RN_FIT_POSE)
        options.camera = rn_pose_seek(&looker, &photo, part, RN_POSE_UNKNOWNS, seed);
    photo.camera = options.camera;
    if (options.fit & RN_FIT_APPEARANCE && rn_field_appearances(r->field)) {
        options.appearance.own = true;
        rn_appearance_seek(&looker, &photo, part, seed, options.appearance.code);
    }
    return rn_render(r->engine, r->field, &options, r->keep_going, r->context, ret_result, err);
}

static enum rn_status fitted_psnr(const struct view *view, double *ret_psnr, struct rn_error *err) {
    struct rn_picture *rendered = &view->rendered->result.rgb;
    size_t count = 0;
    double sum = 0;
    enum rn_status status = RN_OK;
    bool seeks = view->rendered->options.fit & SOUGHT;
    for (int half = 0; half < 2 && status == RN_OK; half++) {
        struct rn_render_result sought = {0};
        if (seeks) status = render_sought(view, half, &sought, err);
        if (status == RN_OK && seeks) (void)prepare(&sought.rgb, &view->truth, view->used);
        if (status == RN_OK)
            sum +=
                fitted_half(seeks ? &sought.rgb : rendered, &view->truth, view->used, half, &count);
        rn_render_result_finish(&sought);
    }
    if (status == RN_OK) *ret_psnr = count && sum > 0 ? -10 * log10(sum / (double)count) : NAN;
    return status;
}

static enum rn_status compare(struct view *view, struct rn_view_score *score,
                              struct rn_error *err) {
    struct rn_picture *rendered = &view->rendered->result.rgb;
    const struct rn_frame *frame = view->rendered->frame;
    const struct rn_picture *truth = &view->truth;
    enum rn_status status = find_used(frame, &view->used, err);
    if (status != RN_OK) return status;
    size_t n = (size_t)rendered->width * (size_t)rendered->height;
    size_t count = prepare(rendered, truth, view->used);
    score->psnr_fitted = NAN;
    if (view->rendered->options.fit) status = fitted_psnr(view, &score->psnr_fitted, err);
    if (status != RN_OK) return status;
    if (count == 0)
        return rn_error_set(err, RN_ERROR_INVALID, frame->path,
                            "cannot be compared: its mask leaves no pixel");
    status = rn_psnr(rendered, truth, &score->psnr);
    if (status == RN_OK) status = rn_ssim(rendered, truth, &score->ssim);
    if (status != RN_OK)
        return rn_error_set(err, status, frame->path, "cannot be compared with its rendering");
    if (count < n) score->psnr += 10 * log10((double)count / (double)n);
    return RN_OK;
}

// The photograph is there.
static enum rn_status score_view(struct view *view, struct rn_view_score *score,
                                 struct rn_error *err) {
    const struct rn_rendered_view *r = view->rendered;
    const struct rn_render_options *options = &r->options;
    enum rn_status status =
        rn_image_composite(&view->photograph, options->background, &view->truth, err);
    if (status == RN_OK) status = compare(view, score, err);
    score->lpips = NAN;
    if (status == RN_OK && options->lpips)
        status =
            rn_lpips_compare(options->lpips, &r->result.rgb, &view->truth, r->engine->info.threads,
                             r->keep_going, r->context, &score->lpips, err);
    rn_picture_finish(&view->truth);
    free(view->used);
    return status;
}

struct rn_render_options rn_view_options(const struct rn_field *field, const struct rn_frame *frame,
                                         const struct rn_render_options *given) {
    struct rn_render_options options = *given;
    options.camera = rn_field_camera(field, frame);
    options.outputs = RN_OUTPUT_RGB;
    options.straight = rn_field_averages_straight(field, frame);
    return options;
}

enum rn_status rn_view_render(struct rn_engine *engine, struct rn_field *field,
                              const struct rn_frame *frame, const struct rn_render_options *given,
                              bool (*keep_going)(void *context), void *context,
                              struct rn_rendered_view *ret_view, struct rn_error *err) {
    struct rn_rendered_view view = {.engine = engine,
                                    .field = field,
                                    .frame = frame,
                                    .options = rn_view_options(field, frame, given),
                                    .keep_going = keep_going,
                                    .context = context};
    enum rn_status status =
        rn_render(engine, field, &view.options, keep_going, context, &view.result, err);
    if (status == RN_OK) *ret_view = view;
    return status;
}

bool rn_view_is_apart(const struct rn_rendered_view *view) {
    return !view->options.lpips && !(view->options.fit & SOUGHT);
}

enum rn_status rn_view_compare(struct rn_rendered_view *rendered, struct rn_view_score *ret_score,
                               struct rn_error *err) {
    struct view view = {.rendered = rendered};
    const struct rn_render_stats *stats = &rendered->result.stats;
    struct rn_view_score score = {.render_ms = stats->render_ms,
                                  .nonfinite_rays = stats->nonfinite_rays,
                                  .on_device = stats->on_device};
    enum rn_status status =
        rn_image_read(rendered->frame->path, &rn_image_default_limits, &view.photograph, err);
    if (status == RN_OK) status = score_view(&view, &score, err);
    rn_image_finish(&view.photograph);
    rn_render_result_finish(&rendered->result);
    if (status == RN_OK) *ret_score = score;
    return status;
}

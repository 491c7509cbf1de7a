// A rendered depth against the sparse points that the view's photograph sees.
#include <math.h>
#include <stdlib.h>

#include "common/math/numbers.h"
#include "server/engine/render/render.h"

enum rn_status rn_depth_compare(const struct rn_picture *depth, const struct rn_frame *frame,
                                const struct rn_points *points, struct rn_depth_score *ret,
                                struct rn_error *err) {
    double *errors = malloc((points->sighting_count + 1) * sizeof *errors);
    if (!errors) return rn_error_set(err, RN_ERROR_NO_MEMORY, frame->path, "out of memory");
    size_t count = 0;
    for (size_t i = 0; i < points->sighting_count; i++) {
        const struct rn_sighting *s = &points->sightings[i];
        if (s->photo != (uint32_t)frame->photo || s->point >= points->count) continue;
        double x = floor((double)s->x * depth->width), y = floor((double)s->y * depth->height);
        double truth = rn_camera_distance(&frame->camera, points->items[s->point].position);
        if (!(x >= 0 && y >= 0 && x < depth->width && y < depth->height && truth > 0)) continue;
        float shown = depth->values[(size_t)y * (size_t)depth->width + (size_t)x];
        errors[count++] = fabs((double)shown - truth) / truth;
    }
    *ret = (struct rn_depth_score){.points = count, .median = rn_numbers_median(errors, count)};
    free(errors);
    return RN_OK;
}

static bool is_seen(const struct rn_frame *frame, const struct rn_points *points) {
    for (size_t i = 0; i < points->sighting_count; i++)
        if (points->sightings[i].photo == (uint32_t)frame->photo) return true;
    return false;
}

enum rn_status rn_evaluate_depth(struct rn_engine *engine, struct rn_field *field,
                                 const struct rn_frame *frame, const struct rn_points *points,
                                 const struct rn_render_options *given,
                                 bool (*keep_going)(void *context), void *context,
                                 struct rn_depth_score *ret_score, struct rn_error *err) {
    struct rn_render_options options = *given;
    struct rn_render_result result = {0};
    *ret_score = (struct rn_depth_score){.median = NAN};
    if (!is_seen(frame, points)) return RN_OK;
    options.camera = frame->camera;
    options.outputs = RN_OUTPUT_DEPTH;
    enum rn_status status = rn_render(engine, field, &options, keep_going, context, &result, err);
    if (status == RN_OK) status = rn_depth_compare(&result.depth, frame, points, ret_score, err);
    rn_render_result_finish(&result);
    return status;
}

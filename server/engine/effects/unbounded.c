// Unbounded space: for photographs of something with its surroundings to infinity, without an alpha
// channel that cuts it out. The space that is sampled is then all of it (field/space.h), steps are
// long, and what a ray sees is drawn together (the distortion loss), as nothing else keeps fog from
// the many steps between a camera and what it looks at.
#include <math.h>
#include <stdio.h>

#include "server/engine/effects/effects.h"

#define GRID 16       // pixels looked through, a side of a photograph
#define THRESHOLD 0.1 // of them look past the ball
#define NARROW 0.25   // of the cameras' mean distance: what they surely all look at
#define INNER 0.5     // likewise: the inner ball
// fox at 270x480, 600 steps of 32,768 samples, held-out views: 0.01 radii 22.4 dB and 610 rays a
// step, 0.02 23.6 and 1,310, with distortion 24.1 (0.05), 23.6 (0.2).
#define STEP 0.01
#define OCCUPANCY 0.03
#define STOP 0.02
#define DISTORTION 0.02

// Whether the ray through a pixel passes the ball.
static bool passes(const struct rn_camera *camera, const struct rn_bounds *ball, double x,
                   double y) {
    struct rn_ray ray = rn_camera_ray(camera, x, y);
    double along = 0, squares = 0;
    for (int i = 0; i < 3; i++) {
        double offset = ball->centre[i] - ray.origin[i];
        along += offset * ray.direction[i];
        squares += offset * offset;
    }
    double inside = ball->radius * ball->radius - squares;
    return inside < 0 && (along < 0 || along * along + inside < 0);
}

// Share of the training photographs' pixels that look past the ball; those of photographs with an
// alpha channel do not, as that cuts out what lies in it.
static double share_past(const struct rn_dataset *d, const struct rn_bounds *ball) {
    size_t past = 0, all = 0;
    for (size_t f = 0; f < d->frame_count; f++) {
        const struct rn_frame *frame = &d->frames[f];
        if (frame->split != RN_SPLIT_TRAIN) continue;
        all += GRID * GRID;
        for (int i = 0; i < GRID * GRID && !frame->has_alpha; i++)
            past += passes(&frame->camera, ball, (i % GRID + 0.5) / GRID * frame->camera.width,
                           (i / GRID + 0.5) / GRID * frame->camera.height);
    }
    return all ? (double)past / (double)all : 0;
}

// Whether the training cameras all look one way between depths that are given: such a place is
// held by the planes of a forward-facing space (effects/forward_facing.c).
static bool faces_one_way(const struct rn_dataset *d) {
    double mean[3] = {0}, size = 0, least = 1;
    for (size_t f = 0; f < d->frame_count; f++)
        for (int i = 0; i < 3; i++)
            if (d->frames[f].split == RN_SPLIT_TRAIN)
                mean[i] += d->frames[f].camera.world_from_camera[i][2];
    for (int i = 0; i < 3; i++)
        size += mean[i] * mean[i];
    for (size_t f = 0; f < d->frame_count; f++) {
        const struct rn_frame *frame = &d->frames[f];
        double cosine = 0;
        if (frame->split != RN_SPLIT_TRAIN) continue;
        if (!(frame->near > 0 && frame->far > 0)) return false;
        for (int i = 0; i < 3; i++)
            cosine += frame->camera.world_from_camera[i][2] * mean[i] / sqrt(size);
        least = fmin(least, cosine);
    }
    return size > 0 && acos(least) * 57.29577951308232 <= RN_FORWARD_WIDEST;
}

static void take_up(struct rn_train_config *c) {
    c->field.space = RN_SPACE_UNBOUNDED;
    c->step = fmax(c->step, STEP);
    c->stop = fmax(c->stop, STOP);
    c->occupancy_limit = OCCUPANCY;
    c->distortion_loss = DISTORTION;
    c->cone_step = false;
    // Cameras' distances from the centre say little of footprints that are contracted: levels took
    // fox (300 steps) 20.1 s of one thread to 20.1 dB, points 9.0 s to 19.8.
    if (!c->footprint_given) c->field.footprint = RN_FOOTPRINT_POINT;
}

static void prepare(const struct rn_dataset *dataset, struct rn_train_config *config,
                    struct rn_bounds *bounds, struct rn_effect_record *r) {
    bool known = bounds->source != RN_BOUNDS_CAMERAS;
    struct rn_bounds ball = known ? *bounds : rn_bounds_from_cameras(dataset, NARROW);
    r->number = share_past(dataset, &ball);
    r->threshold = THRESHOLD;
    bool forward = faces_one_way(dataset);
    r->on = config->auto_effects ? r->number > r->threshold && !forward
                                 : config->field.space == RN_SPACE_UNBOUNDED;
    snprintf(r->reason, sizeof r->reason, "%.0f %% of the pixels, alpha left out, look past %s%s",
             100 * r->number,
             known ? "the dataset's ball" : "a ball of a quarter of the cameras' distance",
             forward ? "; cameras that face one way have a space of their own" : "");
    if (!r->on) return;
    if (config->auto_effects) take_up(config);
    if (bounds->source != RN_BOUNDS_GIVEN) *bounds = rn_bounds_from_cameras(dataset, INNER);
}

static void march(const struct rn_train_config *config, double done, struct rn_march_options *m) {
    if (config->field.space != RN_SPACE_UNBOUNDED) return;
    double grown = isnan(done) ? 1 : fmin(fmax((done - 0.2) / 0.3, 0), 1);
    m->distortion_loss = (float)(config->distortion_loss * grown);
}

const struct rn_effect_row rn_effect_unbounded = {.prepare = prepare, .march = march};

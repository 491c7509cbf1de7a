// Unbounded space: for photographs of something with its surroundings to infinity, without an alpha
// channel that cuts it out. The space that is sampled is then all of it (field/space.h), steps are
// long, and what a ray sees is drawn together (the distortion loss), as nothing else keeps fog from
// the many steps between a camera and what it looks at.
#include <math.h>
#include <stdio.h>

#include "common/dataset/calls.h"
#include "server/engine/effects/effects.h"

// Of the cameras' mean distance from where their axes pass nearest: the inner ball. Where cameras
// look around from within, it holds them: a ray that passes far from the centre comes far across it
// in a step, and what is far away, drawn into few texels, is a smear.
#define INNER 0.5
#define INNER_WITHIN 1.5
// fox at 270x480, 600 steps of 32,768 samples, held-out views: 0.01 radii 22.4 dB and 610 rays a
// step, 0.02 23.6 and 1,310, with distortion 24.1 (0.05), 23.6 (0.2).
#define STEP 0.01
#define OCCUPANCY 0.03
#define STOP 0.02
#define DISTORTION 0.02

static void take_up(struct rn_train_config *c) {
    c->field.space = RN_SPACE_UNBOUNDED;
    rn_train_config_suit_data(c, "step", fmax(c->step, STEP));
    rn_train_config_suit_data(c, "stop", fmax(c->stop, STOP));
    rn_train_config_suit_data(c, "occupancy_limit", OCCUPANCY);
    rn_train_config_suit_data(c, "distortion_loss", DISTORTION);
    // Twice as many steps of half as many samples, where there is time for few
    // (tests/bench/captures.md).
    if (c->max_seconds > 0 && c->max_seconds < RN_TRAIN_LONG_RUN)
        rn_train_config_suit_data(c, "target_samples", c->target_samples / 2);
    c->cone_step = false;
    // Cameras' distances from the centre say little of footprints that are contracted: levels took
    // fox (300 steps) 20.1 s of one thread to 20.1 dB, points 9.0 s to 19.8.
    if (!c->footprint_given) c->field.footprint = RN_FOOTPRINT_POINT;
}

static void prepare(const struct rn_dataset *dataset, struct rn_train_config *config,
                    struct rn_bounds *bounds, struct rn_effect_record *r) {
    bool known = bounds->source <= RN_BOUNDS_LAYOUT;
    r->number = rn_share_past(dataset, bounds, config->cut_out);
    r->threshold = RN_SHARE_PAST;
    enum rn_effect_choice choice = config->effect[RN_EFFECT_UNBOUNDED];
    bool forward =
        config->effect[RN_EFFECT_FORWARD_FACING] != RN_EFFECT_UNWANTED && rn_faces_one_way(dataset);
    r->on = rn_effect_choose(config, RN_EFFECT_UNBOUNDED, true,
                             config->auto_effects ? r->number > r->threshold && !forward
                                                  : config->field.space == RN_SPACE_UNBOUNDED);
    snprintf(r->reason, sizeof r->reason, "%.0f %% of the pixels, alpha left out, look past %s%s",
             100 * r->number,
             known ? "the dataset's ball" : "a ball of a quarter of the cameras' distance",
             forward ? "; cameras that face one way have a space of their own" : "");
    if (choice == RN_EFFECT_UNWANTED) config->field.space = RN_SPACE_BALL;
    if (!r->on) return;
    if (config->auto_effects || choice == RN_EFFECT_WANTED) take_up(config);
    double inner = dataset->lie.kind == RN_CAPTURE_ROOM ? INNER_WITHIN : INNER;
    if (bounds->source != RN_BOUNDS_GIVEN) *bounds = rn_bounds_from_cameras(dataset, inner);
}

static void march(const struct rn_train_config *config, double done, struct rn_march_options *m) {
    if (config->field.space != RN_SPACE_UNBOUNDED) return;
    double grown = isnan(done) ? 1 : fmin(fmax((done - 0.2) / 0.3, 0), 1);
    m->distortion_loss = (float)(config->distortion_loss * grown);
}

const struct rn_effect_row rn_effect_unbounded = {
    .unit = {" %", 100},
    .optional = true,
    .prepare = prepare,
    .march = march,
};

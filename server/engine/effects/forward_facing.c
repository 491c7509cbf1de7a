// Forward-facing captures: cameras that all look the same way see a place between two depths, and
// the planes cover its disparity box (field/disparity.h) in place of a ball. No alpha says there
// what is empty, so a ray's weights are drawn together (cpu/crisp.h), its end is opaque, and cells
// are kept by what they showed (train/seen.c).
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "common/dataset/calls.h"
#include "common/math/vector.h"
#include "server/engine/effects/effects.h"

#define SIDEWAYS 0.3         // least part of a ray along the reference camera's axis
#define BEFORE 0.85          // the box begins at this share of the nearest depth given, and
#define BEHIND 4.0           // ends at this many times the farthest: what is given are percentiles
#define STEP (2.0 / 96)      // of the cube: 96 samples from end to end
#define DISTORTION 0.005     // weight of the distortion loss,
#define DISTORTION_GROWS 0.1 // which grows over this share of the schedule

struct extent {
    double nearest, farthest; // depths of the reference camera
    double low[2], high[2];   // of x / z and y / z that the cameras see there
    double least;             // part of a ray along the reference's axis
    double foremost;          // depth of a camera
};

static void normalise(double a[3]) {
    double size = sqrt(rn_dot(a, a));
    for (int i = 0; i < 3; i++)
        a[i] /= size;
}

// The mean of the cameras: position, axis, and as far as that allows the direction down.
static void reference_camera(const struct rn_pixels *p, struct rn_disparity *space) {
    double down[3] = {0}, ahead[3] = {0}, right[3];
    for (int f = 0; f < p->frame_count; f++)
        for (int i = 0; i < 3; i++) {
            const double *row = p->frames[f].camera.world_from_camera[i];
            space->origin[i] += row[3] / p->frame_count;
            down[i] += row[1];
            ahead[i] += row[2];
        }
    normalise(ahead);
    double along = rn_dot(down, ahead);
    for (int i = 0; i < 3; i++)
        down[i] -= along * ahead[i];
    normalise(down);
    for (int i = 0; i < 3; i++)
        right[i] = down[(i + 1) % 3] * ahead[(i + 2) % 3] - down[(i + 2) % 3] * ahead[(i + 1) % 3];
    for (int i = 0; i < 3; i++) {
        space->axes[i][0] = right[i];
        space->axes[i][1] = down[i];
        space->axes[i][2] = ahead[i];
    }
}

// The largest angle between a camera's axis and the reference's, degrees; NAN without a mean.
static double widest_angle(const struct rn_pixels *p, const struct rn_disparity *space) {
    double widest = 0;
    for (int f = 0; f < p->frame_count; f++) {
        double cosine = 0;
        for (int i = 0; i < 3; i++)
            cosine += p->frames[f].camera.world_from_camera[i][2] * space->axes[i][2];
        if (isnan(cosine)) return NAN;
        widest = fmax(widest, acos(fmin(fmax(cosine, -1), 1)) * 57.29577951308232);
    }
    return widest;
}

// Adds what a camera sees through one corner of its picture: at its own near and far depth, or in
// the second pass where its ray meets the box's ends.
static void add_corner(const struct rn_pixel_frame *f, int corner, const struct rn_disparity *space,
                       bool ends, struct extent *x) {
    const struct rn_camera *c = &f->camera;
    struct rn_ray ray = rn_camera_ray(c, corner & 1 ? c->width : 0, corner & 2 ? c->height : 0);
    double eye[3], d[3], along = 0;
    rn_disparity_seen(space, ray.origin, eye);
    rn_disparity_turn(space, ray.direction, d);
    for (int i = 0; i < 3; i++)
        along += c->world_from_camera[i][2] * ray.direction[i];
    x->least = fmin(x->least, d[2]);
    x->foremost = fmax(x->foremost, eye[2]);
    x->nearest = fmin(x->nearest, eye[2] + d[2] * f->frame->near / (along * space->unit));
    x->farthest = fmax(x->farthest, eye[2] + d[2] * f->frame->far / (along * space->unit));
    for (int end = 0; end < 2 && ends; end++)
        for (int i = 0; i < 2; i++) {
            double z = end ? space->far : space->near;
            double at = (eye[i] + (z - eye[2]) * d[i] / d[2]) / z;
            x->low[i] = fmin(x->low[i], at);
            x->high[i] = fmax(x->high[i], at);
        }
}

static struct extent see(const struct rn_pixels *p, const struct rn_disparity *space, bool ends) {
    struct extent x = {INFINITY, 0, {INFINITY, INFINITY}, {-INFINITY, -INFINITY}, 1, -INFINITY};
    for (int f = 0; f < p->frame_count; f++)
        for (int corner = 0; corner < 4; corner++)
            add_corner(&p->frames[f], corner, space, ends, &x);
    return x;
}

static bool depths_given(const struct rn_pixels *p) {
    for (int f = 0; f < p->frame_count; f++)
        if (!(p->frames[f].frame->near > 0 && p->frames[f].frame->far > 0)) return false;
    return p->frame_count > 0;
}

// The cube around what is seen: square pixels, disparity from end to end.
static void fit(const struct extent *x, struct rn_disparity *space) {
    double width = x->high[0] - x->low[0], height = x->high[1] - x->low[1];
    double size = fmax(width, height), disparity = 1 / space->near - 1 / space->far;
    for (int i = 0; i < 2; i++) {
        space->scale[i] = 2 / size;
        space->shift[i] = -space->scale[i] * (x->low[i] + x->high[i]) / 2;
        space->half[i] = (x->high[i] - x->low[i]) / size;
    }
    space->scale[2] = -2 / disparity;
    space->shift[2] = 1 - space->scale[2] / space->far;
    space->half[2] = 1;
}

// The space that a capture's cameras call for; why there is none, or NULL.
static const char *find_space(const struct rn_evidence *e, struct rn_disparity *ret,
                              double *ret_angle) {
    const struct rn_pixels *p = e->photographs;
    struct rn_disparity space = {.on = true, .unit = e->field->bounds.radius};
    reference_camera(p, &space);
    *ret_angle = widest_angle(p, &space);
    if (!(*ret_angle <= RN_FORWARD_WIDEST)) return "; these look around";
    if (e->field->effects[RN_EFFECT_BACKGROUND].on) return "; alpha cuts the scene out";
    if (e->field->config.field.space != RN_SPACE_BALL) return "; its space is unbounded";
    if (!depths_given(p)) return "; neither the dataset nor points in it say near and far";
    struct extent x = see(p, &space, false);
    space.near = BEFORE * x.nearest;
    space.far = BEHIND * x.farthest;
    if (!(x.least >= SIDEWAYS) || !(space.near > x.foremost) || !(space.far > space.near))
        return "; a camera stands within the depths given, or sees sideways";
    x = see(p, &space, true);
    fit(&x, &space);
    *ret = space;
    return NULL;
}

static void detect(const struct rn_evidence *e, struct rn_effect_record *r) {
    struct rn_disparity space;
    const char *why_not = find_space(e, &space, &r->number);
    bool asked = e->field->config.auto_effects;
    r->threshold = RN_FORWARD_WIDEST;
    r->on = rn_effect_choose(&e->field->config, RN_EFFECT_FORWARD_FACING, !why_not, asked);
    snprintf(r->reason, sizeof r->reason,
             "the cameras' axes are within %.1f degrees of their mean%s", r->number,
             !asked && !r->on ? "; the configuration asks for the scene's ball"
             : why_not        ? why_not
                              : ": planes cover the disparity that they see");
}

static void settle(const struct rn_evidence *e) {
    struct rn_field *field = e->field;
    struct rn_train_config *config = &field->config;
    double angle;
    if (!field->effects[RN_EFFECT_FORWARD_FACING].on) return;
    if (find_space(e, &field->cpu.disparity, &angle)) return;
    rn_train_config_suit_data(config, "step", STEP);
    rn_train_config_suit_data(config, "distortion_loss", DISTORTION);
    config->cone_step = false;
}

static void march(const struct rn_train_config *config, double done, struct rn_march_options *m) {
    if (config->field.space != RN_SPACE_BALL) return;
    m->distortion_loss = (float)(config->distortion_loss * fmin(done / DISTORTION_GROWS, 1));
}

const struct rn_effect_row rn_effect_forward_facing = {
    .unit = {" degrees", 1},
    .side = RN_EFFECT_AT_MOST,
    .optional = true,
    .detect = detect,
    .settle = settle,
    .march = march,
};

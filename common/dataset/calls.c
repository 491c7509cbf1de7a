#include "common/dataset/calls.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/dataset/reader.h"

#define SHIFT_GRID 32 // points a side of a photograph at which its lens is measured
#define LOOK_GRID 16  // pixels looked through, a side of a photograph
#define SAMPLED 16    // masks looked at, before any photograph is decoded
#define NARROW 0.25   // of the cameras' mean distance: what they surely all look at

// ---- lenses ----

// How far a pixel lies from where a pinhole of the same focal length would have it; the picture's
// diagonal at most, and where a pinhole would not have it at all.
static double shift_at(const struct rn_camera *c, double px, double py) {
    double x = (px - c->cx) / c->fx, y = (py - c->cy) / c->fy, look[3];
    double diagonal = hypot(c->width, c->height);
    if (!(rn_camera_look(c, x, y, look) > 0) || !(look[2] > 0)) return diagonal;
    return fmin(hypot((look[0] / look[2] - x) * c->fx, (look[1] / look[2] - y) * c->fy), diagonal);
}

static bool is_folded(const struct rn_camera *c, int x, int y) {
    return !(rn_camera_ray(c, x + 0.5, y + 0.5).radius > 0);
}

// What a lens sees is one piece around its axis: where no pixel of the edge is beyond the fold,
// none is.
static size_t count_folded(const struct rn_camera *c) {
    bool any = false;
    for (int x = 0; x < c->width && !any; x++)
        any = is_folded(c, x, 0) || is_folded(c, x, c->height - 1);
    for (int y = 0; y < c->height && !any; y++)
        any = is_folded(c, 0, y) || is_folded(c, c->width - 1, y);
    size_t count = 0;
    for (int y = 0; y < c->height && any; y++)
        for (int x = 0; x < c->width; x++)
            count += is_folded(c, x, y);
    return count;
}

static bool same_lens(const struct rn_camera *a, const struct rn_camera *b) {
    return a->lens == b->lens && a->width == b->width && a->height == b->height && a->fx == b->fx &&
           a->fy == b->fy && a->cx == b->cx && a->cy == b->cy &&
           memcmp(a->lens_k, b->lens_k, sizeof a->lens_k) == 0;
}

void rn_lens_shift_add(struct rn_lens_shift *shift, const struct rn_camera *c) {
    if (c->lens == RN_LENS_PINHOLE) return;
    bool again = shift->before && same_lens(shift->before, c);
    if (!again) shift->before_folded = count_folded(c);
    shift->folded += shift->before_folded;
    for (int i = 0; i < (SHIFT_GRID + 1) * (SHIFT_GRID + 1) && !again; i++)
        shift->most =
            fmax(shift->most, shift_at(c, i % (SHIFT_GRID + 1) * (c->width / (double)SHIFT_GRID),
                                       i / (SHIFT_GRID + 1) * (c->height / (double)SHIFT_GRID)));
    shift->before = c;
}

// ---- masks ----

double rn_share_left_out(const struct rn_dataset *dataset) {
    size_t left_out = 0, all = 0, stride = 1 + dataset->frame_count / SAMPLED;
    for (size_t f = 0; f < dataset->frame_count; f += stride) {
        const struct rn_frame *frame = &dataset->frames[f];
        size_t count = (size_t)frame->camera.width * (size_t)frame->camera.height;
        uint8_t *used = frame->mask_path ? malloc(count) : NULL;
        bool known = used && rn_mask_read(frame, used, NULL) == RN_OK;
        for (size_t i = 0; i < count && known; i++)
            left_out += !used[i];
        all += count;
        free(used);
    }
    return all ? (double)left_out / (double)all : 0;
}

// ---- what cameras look at ----

// Whether the ray through a pixel passes the ball.
static bool passes(const struct rn_camera *camera, const struct rn_bounds *ball, double x,
                   double y) {
    struct rn_ray ray = rn_camera_ray(camera, x, y);
    return !rn_bounds_met(ball, ray.origin, ray.direction);
}

double rn_share_past(const struct rn_dataset *d, const struct rn_bounds *bounds, bool cut_out) {
    bool known = bounds->source <= RN_BOUNDS_LAYOUT;
    struct rn_bounds ball = known ? *bounds : rn_bounds_from_cameras(d, NARROW);
    size_t past = 0, all = 0;
    for (size_t f = 0; f < d->frame_count; f++) {
        const struct rn_frame *frame = &d->frames[f];
        const struct rn_camera *camera = &frame->camera;
        if (frame->split != RN_SPLIT_TRAIN) continue;
        bool within = frame->has_alpha || (cut_out && frame->mask_path);
        all += LOOK_GRID * LOOK_GRID;
        for (int i = 0; i < LOOK_GRID * LOOK_GRID && !within; i++)
            past += passes(camera, &ball, (i % LOOK_GRID + 0.5) / LOOK_GRID * camera->width,
                           (i / LOOK_GRID + 0.5) / LOOK_GRID * camera->height);
    }
    return all ? (double)past / (double)all : 0;
}

bool rn_looks_one_way(const struct rn_dataset *d) {
    double mean[3] = {0}, size = 0, least = 1;
    for (size_t f = 0; f < d->frame_count; f++)
        for (int i = 0; i < 3; i++)
            if (d->frames[f].split == RN_SPLIT_TRAIN)
                mean[i] += d->frames[f].camera.world_from_camera[i][2];
    for (int i = 0; i < 3; i++)
        size += mean[i] * mean[i];
    for (size_t f = 0; f < d->frame_count; f++) {
        double cosine = 0;
        if (d->frames[f].split != RN_SPLIT_TRAIN) continue;
        for (int i = 0; i < 3; i++)
            cosine += d->frames[f].camera.world_from_camera[i][2] * mean[i] / sqrt(size);
        least = fmin(least, cosine);
    }
    return size > 0 && acos(least) * 57.29577951308232 <= RN_FORWARD_WIDEST;
}

bool rn_faces_one_way(const struct rn_dataset *d) {
    for (size_t f = 0; f < d->frame_count; f++)
        if (d->frames[f].split == RN_SPLIT_TRAIN &&
            !(d->frames[f].near > 0 && d->frames[f].far > 0))
            return false;
    return rn_looks_one_way(d);
}

// Distortion: the lenses of the photographs. Where they move no pixel by as much as would show,
// they are taken for pinholes.
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "server/engine/effects/effects.h"

#define SHIFT 0.05 // pixels: what the best calibrations leave is more
#define GRID 32    // points a side of a photograph at which it is measured

struct shifts {
    double most;   // pixels
    size_t folded; // pixels beyond a lens's fold, all photographs together
};

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

static struct shifts measure(const struct rn_pixels *photographs) {
    struct shifts all = {0, 0};
    const struct rn_camera *before = NULL;
    size_t folded = 0;
    for (int f = 0; f < photographs->frame_count; f++) {
        const struct rn_camera *c = &photographs->frames[f].frame->camera;
        if (c->lens == RN_LENS_PINHOLE) continue;
        bool again = before && same_lens(before, c);
        if (!again) folded = count_folded(c);
        all.folded += folded;
        for (int i = 0; i < (GRID + 1) * (GRID + 1) && !again; i++)
            all.most = fmax(all.most, shift_at(c, i % (GRID + 1) * (c->width / (double)GRID),
                                               i / (GRID + 1) * (c->height / (double)GRID)));
        before = c;
    }
    return all;
}

static void detect(const struct rn_evidence *e, struct rn_effect_record *r) {
    struct shifts shifts = measure(e->photographs);
    char folded[64] = "";
    r->number = shifts.most;
    r->threshold = SHIFT;
    r->on = r->number > r->threshold;
    if (shifts.folded > 0)
        snprintf(folded, sizeof folded, "; %zu pixels beyond its fold are left out", shifts.folded);
    snprintf(r->reason, sizeof r->reason, "the lens moves pixels by up to %.3g pixels%s",
             shifts.most, folded);
}

const struct rn_effect_row rn_effect_distortion = {.detect = detect};

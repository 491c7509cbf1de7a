// Rays of pixels, RN_VD at a time: rn_camera_ray and rn_ray_cut in vectors of float64, because a
// camera may be far away and the ball is cut where rounding the distance would be seen.
#ifndef RN_ENGINE_CPU_RAYS_H
#define RN_ENGINE_CPU_RAYS_H

#include <stddef.h>

#include "common/math/camera.h"
#include "server/engine/cpu/forward.h"
#include "server/engine/cpu/simd.h"
#include "server/engine/kernels/kernels.h"

// rn_view's numbers, one view a lane.
struct view_lanes {
    vd origin[3], axes[3][3], cx, cy, inverse_fx, inverse_fy, radius;
};
#define RN_VIEW_NUMBERS (offsetof(struct rn_view, lens) / sizeof(double))
_Static_assert(sizeof(struct view_lanes) == RN_VIEW_NUMBERS * sizeof(vd), "the same numbers");

// The views of RN_VD places; `*loaded` is the view that all lanes hold already, if any.
RN_INLINE void view_load(const struct rn_view *const view[RN_VD], const struct rn_view **loaded,
                         struct view_lanes *ret) {
    double numbers[RN_VIEW_NUMBERS][RN_VD];
    vd *to = (vd *)ret;
    bool same = true;
    for (int j = 1; j < RN_VD; j++)
        same &= view[j] == view[0];
    if (same && *loaded == view[0]) return;
    *loaded = same ? view[0] : NULL;
    for (int j = 0; j < RN_VD; j++) {
        double own[RN_VIEW_NUMBERS];
        memcpy(own, view[j], sizeof own);
        for (size_t i = 0; i < RN_VIEW_NUMBERS; i++)
            numbers[i][j] = own[i];
    }
    for (size_t i = 0; i < RN_VIEW_NUMBERS; i++)
        memcpy(&to[i], numbers[i], sizeof to[i]);
}

// Where rays enter the cube and leave it: rn_enter_cube.
RN_INLINE void enter_cube(const vd o[3], const vd d[3], vd *ret_enter, vd *ret_leave) {
    vd enter = vd_set(0), leave = vd_set(1e300);
    for (int i = 0; i < 3; i++) {
        vl sign = (vl)d[i] & (vl)vd_set(-0.0), tiny = ((vd)((vl)d[i] ^ sign)) < 1e-300;
        vd inverse = 1.0 / vd_select(tiny, (vd)((vl)vd_set(1e-300) | sign), d[i]);
        vd a = (-1.0 - o[i]) * inverse, b = (1.0 - o[i]) * inverse;
        vd first = vd_select(a < b, a, b), last = vd_select(a < b, b, a);
        enter = vd_select(first > enter, first, enter);
        leave = vd_select(last < leave, last, leave);
    }
    *ret_enter = enter;
    *ret_leave = leave;
}

// What rn_ray_cut finds.
RN_INLINE void cut_rays(const vd o[3], const vd d[3], vd radius, double step, bool cone_step,
                        vd jitter, struct cut_lanes *ret) {
    vd along = o[0] * d[0] + o[1] * d[1] + o[2] * d[2], across = vd_set(0), enter, leave;
    for (int i = 0; i < 3; i++) {
        vd foot = o[i] - along * d[i]; // the point nearest the centre
        across += foot * foot;
    }
    enter_cube(o, d, &enter, &leave);
    vl hit = (across <= 1.0) & (leave > enter);
    vd stride = vd_set(1);
    if (cone_step) {
        vd ratio = radius * -along * (0.5 / (step / 3.46410161513775458705)); // sqrt 12
        stride = vd_select(ratio < 1.41421356, stride,
                           vd_select(ratio < 2.82842712, vd_set(2),
                                     vd_select(ratio < 5.65685425, vd_set(4), vd_set(8))));
        stride = vd_select(hit, stride, vd_set(1));
    }
    vd near = enter + jitter * step * stride, length = vd_sqrt(1.0 - across) - along - near;
    for (int i = 0; i < 3; i++)
        ret->origin[i] = (vd)((vl)(o[i] + d[i] * near) & hit);
    ret->near = (vd)((vl)near & hit);
    ret->length = (vd)((vl)length & hit);
    ret->stride = stride;
}

// What rn_ray_cut_unbounded finds.
RN_INLINE void cut_unbounded(const vd o[3], const vd d[3], double step, vd jitter,
                             struct cut_lanes *ret) {
    vd along = o[0] * d[0] + o[1] * d[1] + o[2] * d[2], from = along + RN_SPACE_NEAR;
    vd size = vd_select(from < 0.0, -from, from), far = 2.0 - 1.0 / size;
    vd place = vd_select(size <= 1.0, from, vd_select(from < 0.0, -far, far));
    for (int i = 0; i < 3; i++)
        ret->origin[i] = o[i] - along * d[i];
    ret->near = -along;
    ret->length = 2.0 - place - 2 * step * jitter;
    ret->stride = vd_set(1);
}

typedef int32_t vd_ints __attribute__((vector_size(4 * RN_VD)));

RN_INLINE vd load_ints(const int32_t from[RN_VD]) {
    vd_ints whole;
    memcpy(&whole, from, sizeof whole);
    return __builtin_convertvector(whole, vd);
}

RN_CAMERA_TURN_FUNCTION(turn, vd, 3, vd_sqrt)

// The cones through the pixels' centres. Lenses lane by lane: 4 to 6 steps of Newton's method,
// which is little beside the march.
RN_INLINE void pixel_cones(const struct view_lanes *view, const struct rn_view *const of[RN_VD],
                           vd px, vd py, vd d[3], vd *ret_radius) {
    vd x = (px + 0.5 - view->cx) * view->inverse_fx, y = (py + 0.5 - view->cy) * view->inverse_fy;
    vd z = vd_set(1), radius = view->radius;
    bool lenses = false;
    for (int j = 0; j < RN_VD; j++)
        lenses |= of[j]->lens != NULL;
    if (!lenses) turn(view->axes, x, y, vd_set(1), d);
    for (int j = 0; j < RN_VD && lenses; j++) {
        if (!of[j]->lens) continue;
        double look[3] = {0, 0, 1}, area = rn_camera_look(of[j]->lens, x[j], y[j], look);
        x[j] = look[0], y[j] = look[1], z[j] = look[2];
        radius[j] *= sqrt(area);
    }
    if (lenses) turn(view->axes, x, y, z, d);
    *ret_radius = radius;
}

// The view whose space all views of some places share: the first that there is.
RN_INLINE const struct rn_view *shared_view(const struct rn_ray_place *places, int n) {
    for (int j = 0; j < n; j++)
        if (places[j].view) return places[j].view;
    return NULL;
}

static void rays(const struct rn_ray_place *places, int count, double step, bool cone_step,
                 struct rn_march_ray *ret_rays) {
    static const struct rn_view nowhere;
    const struct rn_view *view[RN_VD], *loaded = NULL;
    struct view_lanes lanes = {0};
    for (int begin = 0; begin < count; begin += RN_VD) {
        int n = count - begin < RN_VD ? count - begin : RN_VD;
        int32_t px[RN_VD], py[RN_VD];
        vd d[3], radius;
        float jitters[RN_VD], out[10][RN_VD];
        for (int j = 0; j < RN_VD; j++) {
            const struct rn_ray_place *place = &places[begin + (j < n ? j : n - 1)];
            view[j] = place->view ? place->view : &nowhere;
            px[j] = place->x;
            py[j] = place->y;
            jitters[j] = place->jitter;
        }
        view_load(view, &loaded, &lanes);
        pixel_cones(&lanes, view, load_ints(px), load_ints(py), d, &radius);
        struct cut_lanes cut;
        const struct rn_view *shared = shared_view(places + begin, n);
        if (shared && shared->disparity.on)
            cut_forward(&shared->disparity, lanes.origin, d, step, vd_load(jitters), &cut);
        else if (shared && shared->space == RN_SPACE_UNBOUNDED)
            cut_unbounded(lanes.origin, d, step, vd_load(jitters), &cut);
        else
            cut_rays(lanes.origin, d, radius, step, cone_step, vd_load(jitters), &cut);
        for (int i = 0; i < 3; i++) {
            vd_store(out[i], cut.origin[i]);
            vd_store(out[3 + i], d[i]);
        }
        vd_store(out[6], cut.near);
        vd_store(out[7], cut.length);
        vd_store(out[8], radius);
        vd_store(out[9], cut.stride);
        for (int j = 0; j < n; j++)
            ret_rays[begin + j] = (struct rn_march_ray){
                .origin = {out[0][j], out[1][j], out[2][j]},
                .direction = {out[3][j], out[4][j], out[5][j]},
                .near = out[6][j],
                .length = view[j] == &nowhere || !(out[8][j] > 0) ? 0 : out[7][j],
                .radius = out[8][j],
                .stride = (int)out[9][j],
                .weight = out[8][j] > 0};
    }
}

#endif

#include "server/engine/scene/pose.h"

#include <math.h>
#include <string.h>

#include "common/math/rng.h"
#include "common/math/rotation.h"
#include "server/engine/scene/pixels.h"

#define HUBER 0.1   // difference of colours beyond which it counts linearly
#define NEAREST 0.1 // of the bounds' radius: a camera that is nearer to their centre counts as this
#define COARSEST 8  // pixels: a square's side, where a search begins
#define STEPS 4     // of a search, for each size of squares
#define BLOCK 256   // rays rendered together

struct rn_camera rn_pose_move(const struct rn_camera *from, const double by[RN_POSE_UNKNOWNS],
                              double unit) {
    struct rn_camera camera = *from;
    double turn[3][4];
    rn_rotation_from_vector(by + RN_POSE_TURN, turn);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            camera.world_from_camera[i][j] = 0;
            for (int k = 0; k < 3; k++)
                camera.world_from_camera[i][j] += from->world_from_camera[i][k] * turn[k][j];
            camera.world_from_camera[i][3] +=
                from->world_from_camera[i][j] * by[RN_POSE_SHIFT + j] * unit;
        }
    camera.fx *= exp(by[RN_POSE_FOCAL]);
    camera.fy *= exp(by[RN_POSE_FOCAL]);
    return camera;
}

// ---- sights ----

// The mean of a square of pixels; false where one of them is left out.
static bool mean_of(const struct rn_pose_photo *photo, int side, const float background[3],
                    struct rn_pose_sight *sight) {
    memset(sight->target, 0, sizeof sight->target);
    for (int j = 0; j < side * side; j++) {
        size_t at = (size_t)(sight->y + j / side) * (size_t)photo->camera.width +
                    (size_t)(sight->x + j % side);
        float colour[3];
        if (photo->used && !photo->used[at]) return false;
        (void)rn_pixel_over(photo->rgba + 4 * at, background, colour);
        for (int c = 0; c < 3; c++)
            sight->target[c] += colour[c] / (float)(side * side);
    }
    return true;
}

void rn_pose_draw(const struct rn_pose_photo *photo, const struct rn_pose_draw *draw,
                  struct rn_pose_sights *ret) {
    int middle = photo->camera.width / 2, side = draw->side;
    int begin = draw->part == RN_POSE_RIGHT ? middle : 0;
    int columns = (draw->part == RN_POSE_LEFT ? middle : photo->camera.width) - begin - side + 1;
    int rows = photo->camera.height - side + 1;
    ret->side = side;
    ret->count = 0;
    for (int i = 0; i < draw->wanted && columns > 0 && rows > 0; i++) {
        struct rn_rng4 at =
            rn_rng_draw(draw->seed, draw->stream, draw->counter * RN_POSE_SIGHTS + (uint64_t)i);
        struct rn_pose_sight *sight = &ret->at[ret->count];
        sight->x = begin + (int)rn_rng_below(at.v[0], (uint32_t)columns);
        sight->y = (int)rn_rng_below(at.v[1], (uint32_t)rows);
        ret->count += mean_of(photo, side, draw->background, sight);
    }
}

// ---- looking ----

void rn_pose_look(const struct rn_pose_looker *l, const struct rn_camera *camera,
                  const struct rn_pose_sights *sights, rn_pose_colours ret) {
    struct rn_view view = rn_field_view(l->field, camera);
    int side = sights->side, each = side * side, total = sights->count * each;
    struct rn_ray_place places[BLOCK];
    struct rn_march_ray rays[BLOCK];
    struct rn_pixel pixels[BLOCK];
    memset(ret, 0, sizeof(rn_pose_colours));
    for (int begin = 0; begin < total; begin += BLOCK) {
        int n = total - begin < BLOCK ? total - begin : BLOCK;
        for (int i = 0; i < n; i++) {
            const struct rn_pose_sight *sight = &sights->at[(begin + i) / each];
            int j = (begin + i) % each;
            places[i] = (struct rn_ray_place){&view, sight->x + j % side, sight->y + j / side, 0};
        }
        l->engine->kernels->rays(places, n, (double)l->march.step, l->field->config.cone_step,
                                 rays);
        l->engine->kernels->render(&l->field->cpu, &l->march, rays, n,
                                   rn_engine_workspace(l->engine, l->thread), pixels);
        for (int i = 0; i < n; i++)
            for (int c = 0; c < 3; c++)
                ret[(begin + i) / each][c] += pixels[i].rgb[c] / (float)each;
    }
}

// How far a move goes that shifts pixels by half a square's side.
static double step_of(const struct rn_pose_looker *l, const struct rn_camera *camera, int side,
                      int unknown) {
    const struct rn_bounds *bounds = &l->field->bounds;
    double half = 0.5 * side, away = 0;
    if (unknown == RN_POSE_FOCAL) return half / (0.5 * hypot(camera->width, camera->height));
    if (unknown < RN_POSE_SHIFT) return half / camera->fx;
    for (int i = 0; i < 3; i++)
        away += pow((camera->world_from_camera[i][3] - bounds->centre[i]) / bounds->radius, 2);
    return half / camera->fx * fmax(sqrt(away), NEAREST);
}

void rn_pose_slopes(const struct rn_pose_looker *l, const struct rn_camera *camera,
                    const struct rn_pose_sights *sights, rn_pose_colours *ret) {
    for (int k = 0; k < RN_POSE_UNKNOWNS; k++) {
        double step = step_of(l, camera, sights->side, k), by[RN_POSE_UNKNOWNS] = {0};
        rn_pose_colours back;
        by[k] = step;
        struct rn_camera there = rn_pose_move(camera, by, l->field->bounds.radius);
        rn_pose_look(l, &there, sights, ret[k]);
        by[k] = -step;
        there = rn_pose_move(camera, by, l->field->bounds.radius);
        rn_pose_look(l, &there, sights, back);
        for (int i = 0; i < sights->count; i++)
            for (int c = 0; c < 3; c++)
                ret[k][i][c] = (ret[k][i][c] - back[i][c]) / (float)(2 * step);
    }
}

// target = gain * colour + offset by least squares.
static void fit_exposure(const struct rn_pose_sights *sights, rn_pose_colours seen,
                         double *ret_gain, double *ret_offset) {
    double x = 0, y = 0, xx = 0, xy = 0, n = 3.0 * (sights->count ? sights->count : 1);
    for (int i = 0; i < 3 * sights->count; i++) {
        double a = (double)seen[i / 3][i % 3], b = (double)sights->at[i / 3].target[i % 3];
        x += a;
        y += b;
        xx += a * a;
        xy += a * b;
    }
    double spread = xx - x * x / n;
    *ret_gain = spread > 1e-9 ? (xy - x * y / n) / spread : 1;
    *ret_offset = (y - *ret_gain * x) / n;
}

static double difference(const struct rn_pose_sights *sights, rn_pose_colours seen, double gain,
                         double offset, int i) {
    return (double)sights->at[i / 3].target[i % 3] - gain * (double)seen[i / 3][i % 3] - offset;
}

static double cost_of(const struct rn_pose_sights *sights, rn_pose_colours seen) {
    double gain, offset, sum = 0;
    fit_exposure(sights, seen, &gain, &offset);
    for (int i = 0; i < 3 * sights->count; i++) {
        double r = fabs(difference(sights, seen, gain, offset, i));
        sum += r < HUBER ? r * r : HUBER * (2 * r - HUBER);
    }
    return sum;
}

void rn_pose_equations(const struct rn_pose_looker *l, const struct rn_camera *camera,
                       const struct rn_pose_sights *sights, struct rn_pose_equations *ret) {
    rn_pose_colours seen, slopes[RN_POSE_UNKNOWNS];
    memset(ret, 0, sizeof *ret);
    rn_pose_look(l, camera, sights, seen);
    rn_pose_slopes(l, camera, sights, slopes);
    fit_exposure(sights, seen, &ret->gain, &ret->offset);
    ret->cost = cost_of(sights, seen);
    for (int i = 0; i < 3 * sights->count; i++) {
        double r = difference(sights, seen, ret->gain, ret->offset, i);
        double weight = fabs(r) < HUBER ? 1 : HUBER / fabs(r), slope[RN_POSE_UNKNOWNS];
        for (int k = 0; k < RN_POSE_UNKNOWNS; k++)
            slope[k] = ret->gain * (double)slopes[k][i / 3][i % 3];
        for (int k = 0; k < RN_POSE_UNKNOWNS; k++) {
            for (int j = 0; j < RN_POSE_UNKNOWNS; j++)
                ret->a[k][j] += weight * slope[k] * slope[j];
            ret->b[k] += weight * slope[k] * r;
        }
    }
}

// Cholesky's decomposition of the damped equations; what has no solution moves nothing.
void rn_pose_solve(const struct rn_pose_equations *e, int n, double damping,
                   double ret_by[RN_POSE_UNKNOWNS]) {
    double l[RN_POSE_UNKNOWNS][RN_POSE_UNKNOWNS] = {{0}}, y[RN_POSE_UNKNOWNS];
    memset(ret_by, 0, RN_POSE_UNKNOWNS * sizeof *ret_by);
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            double sum = e->a[i][j] * (i == j ? 1 + damping : 1);
            for (int k = 0; k < j; k++)
                sum -= l[i][k] * l[j][k];
            if (i == j && !(sum > 1e-12 * e->a[i][i])) return;
            l[i][j] = i == j ? sqrt(sum) : sum / l[j][j];
        }
    for (int i = 0; i < n; i++) {
        y[i] = e->b[i];
        for (int k = 0; k < i; k++)
            y[i] -= l[i][k] * y[k];
        y[i] /= l[i][i];
    }
    for (int i = n - 1; i >= 0; i--) {
        ret_by[i] = y[i];
        for (int k = i + 1; k < n; k++)
            ret_by[i] -= l[k][i] * ret_by[k];
        ret_by[i] /= l[i][i];
    }
}

double rn_pose_error(const struct rn_pose_looker *looker, const struct rn_camera *camera,
                     const struct rn_pose_sights *fitted, const struct rn_pose_sights *scored) {
    rn_pose_colours seen;
    double gain, offset, sum = 0;
    rn_pose_look(looker, camera, fitted, seen);
    fit_exposure(fitted, seen, &gain, &offset);
    rn_pose_look(looker, camera, scored, seen);
    for (int i = 0; i < 3 * scored->count; i++)
        sum += pow(difference(scored, seen, gain, offset, i), 2);
    return scored->count ? sum / (3 * scored->count) : 1;
}

// ---- searching ----

struct rn_camera rn_pose_seek(const struct rn_pose_looker *l, const struct rn_pose_photo *photo,
                              enum rn_pose_part part, int unknowns, uint64_t seed) {
    struct rn_camera camera = photo->camera;
    struct rn_pose_equations equations;
    struct rn_pose_sights sights;
    double unit = l->field->bounds.radius, by[RN_POSE_UNKNOWNS];
    rn_pose_colours seen;
    for (int side = COARSEST; side >= 1; side /= 2) {
        double damping = 1e-3;
        struct rn_pose_draw draw = {.part = part,
                                    .side = side,
                                    .wanted = RN_POSE_SIGHTS / (side > 4 ? 4 : side),
                                    .background = l->march.colour.background,
                                    .seed = seed,
                                    .stream = (uint64_t)part,
                                    .counter = (uint64_t)side};
        rn_pose_draw(photo, &draw, &sights);
        rn_pose_equations(l, &camera, &sights, &equations);
        for (int step = 0; step < STEPS; step++) {
            rn_pose_solve(&equations, unknowns, damping, by);
            struct rn_camera next = rn_pose_move(&camera, by, unit);
            rn_pose_look(l, &next, &sights, seen);
            bool better = cost_of(&sights, seen) < equations.cost;
            damping *= better ? 0.3 : 10;
            if (!better) continue;
            camera = next;
            rn_pose_equations(l, &camera, &sights, &equations);
        }
    }
    return camera;
}

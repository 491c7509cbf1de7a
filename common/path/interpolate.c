// Between keys: centripetal Catmull-Rom for positions, squad for rotations; or straight lines, or
// arcs about the point that all look at, and slerp.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/rotation.h"
#include "common/path/motion.h"

struct quaternion {
    double w, x, y, z;
};

static struct quaternion quaternion_of(const struct rn_path_key *key) {
    double q[4];
    rn_rotation_to_quaternion(key->world_from_camera, q);
    return (struct quaternion){q[0], q[1], q[2], q[3]};
}

static double dot(struct quaternion a, struct quaternion b) {
    return a.w * b.w + a.x * b.x + a.y * b.y + a.z * b.z;
}

static struct quaternion combine(struct quaternion a, double s, struct quaternion b, double t) {
    return (struct quaternion){a.w * s + b.w * t, a.x * s + b.x * t, a.y * s + b.y * t,
                               a.z * s + b.z * t};
}

// q or -q, the same rotation, whichever is nearer to `to`.
static struct quaternion align(struct quaternion q, struct quaternion to) {
    return dot(q, to) < 0 ? combine(q, -1, q, 0) : q;
}

static struct quaternion multiply(struct quaternion a, struct quaternion b) {
    return (struct quaternion){a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
                               a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
                               a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
                               a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w};
}

// log(a^-1 b) of unit quaternions: a pure one.
static struct quaternion log_between(struct quaternion a, struct quaternion b) {
    struct quaternion inverse = {a.w, -a.x, -a.y, -a.z}, d = multiply(inverse, b);
    double sine = sqrt(d.x * d.x + d.y * d.y + d.z * d.z);
    double scale = sine > 1e-12 ? atan2(sine, d.w) / sine : 1;
    return (struct quaternion){0, d.x * scale, d.y * scale, d.z * scale};
}

static struct quaternion exp_pure(struct quaternion v) {
    double angle = sqrt(v.x * v.x + v.y * v.y + v.z * v.z);
    double scale = angle > 1e-12 ? sin(angle) / angle : 1;
    return (struct quaternion){cos(angle), v.x * scale, v.y * scale, v.z * scale};
}

// The great arc from a to b as the signs stand (no choice of the shorter one). Shoemake 1985.
static struct quaternion slerp(struct quaternion a, struct quaternion b, double u) {
    struct quaternion step = log_between(a, b);
    return multiply(a, exp_pure(combine(step, u, step, 0)));
}

// Inner control rotation at q between its neighbours. Shoemake 1987.
static struct quaternion control(struct quaternion before, struct quaternion q,
                                 struct quaternion after) {
    struct quaternion sum = combine(log_between(q, before), 1, log_between(q, after), 1);
    return multiply(q, exp_pure(combine(sum, -0.25, sum, 0)));
}

static struct quaternion squad(const struct quaternion q[4], double u, double tension) {
    struct quaternion a = control(q[0], q[1], q[2]), b = control(q[1], q[2], q[3]);
    return slerp(slerp(q[1], q[2], u), slerp(a, b, u), 2 * u * (1 - u) * (1 - tension));
}

// Where a frame's time falls: between keys 1 and 2 of four neighbours, at u in [0, 1].
struct segment {
    const struct rn_path_key *key[4]; // 0 and 3 repeat 1 and 2 at an open path's ends
    double u;
};

// From key i to the next; a loop's last one to the first.
static struct segment segment_after(const struct rn_path *path, size_t i, double u) {
    size_t count = path->key_count, after = (i + 1) % count;
    const struct rn_path_key *keys = path->keys;
    bool open_begin = !path->loop && i == 0, open_end = !path->loop && after + 1 == count;
    return (struct segment){{&keys[open_begin ? 0 : (i + count - 1) % count], &keys[i],
                             &keys[after], &keys[open_end ? after : (after + 1) % count]},
                            u};
}

// When the stretch that begins at key i ends: at the next key, a loop's last one after the mean
// spacing.
static double end_of_stretch(const struct rn_path *path, size_t i) {
    const struct rn_path_key *keys = path->keys;
    size_t last = path->key_count - 1;
    if (i < last) return keys[i + 1].time_s;
    return keys[last].time_s + (keys[last].time_s - keys[0].time_s) / (double)last;
}

static struct segment find_segment(const struct rn_path *path, double time_s) {
    size_t count = path->key_count, i = 0;
    const struct rn_path_key *keys = path->keys;
    while (i + 1 < count && keys[i + 1].time_s <= time_s)
        i++;
    if (count == 1 || (i + 1 == count && !path->loop))
        return (struct segment){{&keys[i], &keys[i], &keys[i], &keys[i]}, 0};
    double begin_s = keys[i].time_s, end_s = end_of_stretch(path, i);
    return segment_after(path, i, fmin((time_s - begin_s) / (end_s - begin_s), 1));
}

// Square root of the distance between two keys' positions.
static double knot_step(const struct rn_path_key *a, const struct rn_path_key *b) {
    double squared = 0;
    for (int i = 0; i < 3; i++)
        squared += pow(a->world_from_camera[i][3] - b->world_from_camera[i][3], 2);
    return pow(squared, 0.25);
}

// Non-uniform Catmull-Rom as a cubic Hermite curve: the tangent at an inner key is that of the
// parabola through three knots; at an end, or beside a repeated position, it is the chord's.
// Tension takes them to those of the straight line, 0 at the keys (Kochanek and Bartels 1984).
static double catmull_rom(const double p[4], const double step[3], double tension, double u) {
    double chord = p[2] - p[1], begin = chord, end = chord;
    if (step[0] > 0)
        begin = step[1] * ((p[1] - p[0]) / step[0] - (p[2] - p[0]) / (step[0] + step[1])) + chord;
    if (step[2] > 0)
        end = step[1] * ((p[3] - p[2]) / step[2] - (p[3] - p[1]) / (step[1] + step[2])) + chord;
    double u2 = u * u, u3 = u2 * u;
    return p[1] + (3 * u2 - 2 * u3) * chord +
           ((u3 - 2 * u2 + u) * begin + (u3 - u2) * end) * (1 - tension);
}

static double blend(const struct rn_path *path, const struct segment *at, const double p[4],
                    const double step[3]) {
    if (path->interpolation != RN_INTERPOLATE_SPLINE || !(step[1] > 0))
        return p[1] + (p[2] - p[1]) * at->u;
    return catmull_rom(p, step, path->tension, at->u);
}

static void blend_rotation(const struct rn_path *path, const struct segment *at,
                           double pose[3][4]) {
    struct quaternion q[4];
    for (int k = 0; k < 4; k++)
        q[k] = quaternion_of(at->key[k]);
    q[0] = align(q[0], q[1]);
    q[2] = align(q[2], q[1]);
    q[3] = align(q[3], q[2]);
    bool spline = path->interpolation == RN_INTERPOLATE_SPLINE;
    struct quaternion r = spline ? squad(q, at->u, path->tension) : slerp(q[1], q[2], at->u);
    rn_rotation_from_quaternion((double[]){r.w, r.x, r.y, r.z}, pose);
}

// Along the arc from key 1 to key 2 about the centre: the direction by slerp, the distance
// linearly. False where there is no such arc.
static bool blend_arc(const struct rn_path *path, const struct segment *at, double ret[3]) {
    double a[3], b[3], ra = 0, rb = 0, cosine = 0;
    for (int i = 0; i < 3; i++) {
        a[i] = at->key[1]->world_from_camera[i][3] - path->centre[i];
        b[i] = at->key[2]->world_from_camera[i][3] - path->centre[i];
        ra += a[i] * a[i];
        rb += b[i] * b[i];
        cosine += a[i] * b[i];
    }
    ra = sqrt(ra), rb = sqrt(rb);
    if (!(ra > 0 && rb > 0)) return false;
    double angle = acos(fmax(-1, fmin(1, cosine / (ra * rb)))), sine = sin(angle);
    if (angle > 3.1) return false; // opposite: any plane would do
    double wa = sine > 1e-9 ? sin((1 - at->u) * angle) / sine : 1 - at->u;
    double wb = sine > 1e-9 ? sin(at->u * angle) / sine : at->u, r = ra + (rb - ra) * at->u;
    for (int i = 0; i < 3; i++)
        ret[i] = path->centre[i] + r * (wa * a[i] / ra + wb * b[i] / rb);
    return true;
}

static void blend_position(const struct rn_path *path, const struct segment *at,
                           const double step[3], double ret[3]) {
    double p[4];
    if (path->interpolation == RN_INTERPOLATE_CIRCLE && path->has_centre &&
        blend_arc(path, at, ret))
        return;
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 4; k++)
            p[k] = at->key[k]->world_from_camera[i][3];
        ret[i] = blend(path, at, p, step);
    }
}

static void steps_of(const struct segment *at, double step[3]) {
    for (int k = 0; k < 3; k++)
        step[k] = knot_step(at->key[k], at->key[k + 1]);
}

// Duration of one round; a loop's includes the way back.
static double span_s(const struct rn_path *path) {
    double span = path->keys[path->key_count - 1].time_s - path->keys[0].time_s;
    return path->loop && path->key_count > 1 ? span + span / (double)(path->key_count - 1) : span;
}

// ---- the way ----------------------------------------------------------------------------------

enum { PARTS = 32 }; // of each stretch, for its length

// The point nearest to all lines of sight: sum (I - d d') (c - p) = 0. False when they are
// parallel.
static bool find_centre(const struct rn_path *path, double ret[3]) {
    double m[3][4] = {{0}};
    for (size_t k = 0; k < path->key_count; k++) {
        double(*pose)[4] = path->keys[k].world_from_camera;
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                double part = (i == j) - pose[i][2] * pose[j][2];
                m[i][j] += part;
                m[i][3] += part * pose[j][3];
            }
    }
    for (int i = 0; i < 3; i++) { // Gauss; the matrix is symmetric and positive
        if (!(m[i][i] > 1e-6 * (double)path->key_count)) return false;
        for (int r = i + 1; r < 3; r++) {
            double factor = m[r][i] / m[i][i];
            for (int c = i; c < 4; c++)
                m[r][c] -= factor * m[i][c];
        }
    }
    for (int i = 2; i >= 0; i--) {
        ret[i] = m[i][3];
        for (int c = i + 1; c < 3; c++)
            ret[i] -= m[i][c] * ret[c];
        ret[i] /= m[i][i];
    }
    return true;
}

// travelled[i]: the length of the way up to part i % PARTS of stretch i / PARTS.
static void measure_way(struct rn_path *path) {
    double before[3], now[3], step[3], length = 0;
    for (size_t i = 0; i <= path->travelled_count; i++) {
        size_t stretch =
            i < path->travelled_count ? i / PARTS : i / PARTS - 1; // the end is the last one's
        struct segment at = segment_after(path, stretch, (double)(i - stretch * PARTS) / PARTS);
        double squared = 0;
        steps_of(&at, step);
        blend_position(path, &at, step, now);
        for (int k = 0; i && k < 3; k++)
            squared += (now[k] - before[k]) * (now[k] - before[k]);
        memcpy(before, now, sizeof before);
        path->travelled[i] = length += sqrt(squared);
    }
}

enum rn_status rn_path_prepare(struct rn_path *path) {
    path->has_centre =
        path->interpolation == RN_INTERPOLATE_CIRCLE && find_centre(path, path->centre);
    if (!path->constant_speed || path->key_count < 2 || !(span_s(path) > 0)) return RN_OK;
    size_t count = PARTS * (path->key_count - !path->loop);
    if (!path->travelled) path->travelled = malloc((count + 1) * sizeof *path->travelled);
    if (!path->travelled) return RN_ERROR_NO_MEMORY;
    path->travelled_count = count;
    measure_way(path);
    return RN_OK;
}

// The time of the keys' clock at which the camera has travelled as far as it should have.
static double time_of_way(const struct rn_path *path, double time_s) {
    double begin_s = path->keys[0].time_s, span = span_s(path);
    size_t count = path->travelled_count, low = 0, high = count;
    if (!count || !(path->travelled[count] > 0)) return time_s;
    double wanted = fmin(1, (time_s - begin_s) / span) * path->travelled[count];
    while (high - low > 1) {
        size_t middle = (low + high) / 2;
        if (path->travelled[middle] <= wanted)
            low = middle;
        else
            high = middle;
    }
    double step = path->travelled[high] - path->travelled[low];
    double part = step > 0 ? (wanted - path->travelled[low]) / step : 0;
    size_t stretch = low / PARTS;
    double from_s = path->keys[stretch].time_s, u = ((double)(low % PARTS) + fmin(part, 1)) / PARTS;
    return from_s + (end_of_stretch(path, stretch) - from_s) * u;
}

// ---- cameras ----------------------------------------------------------------------------------

static struct rn_camera camera_of(const struct rn_path *path, double fov_y_rad) {
    struct rn_camera camera = {.lens = path->lens, .width = path->width, .height = path->height};
    camera.fx = camera.fy = rn_camera_focal_from_fov(fov_y_rad, path->height);
    if (path->lens == RN_LENS_EQUIRECTANGULAR) { // the picture is the whole sphere
        camera.fx = path->width / (2 * M_PI);
        camera.fy = path->height / M_PI;
        camera.lens_fold = rn_lens_fold(path->lens, camera.lens_k);
    }
    camera.cx = 0.5 * path->width;
    camera.cy = 0.5 * path->height;
    return camera;
}

struct rn_camera rn_path_key_camera(const struct rn_path *path, size_t key) {
    struct rn_camera camera = camera_of(path, path->keys[key].fov_y_rad);
    memcpy(camera.world_from_camera, path->keys[key].world_from_camera,
           sizeof camera.world_from_camera);
    return camera;
}

static struct segment segment_of(const struct rn_path *path, double frame) {
    double begin_s = path->keys[0].time_s, past_s = frame / path->fps, span = span_s(path);
    if (!path->loop || !(span > 0))
        past_s = fmax(0, past_s);
    else if (past_s < 0 || past_s > span)
        past_s -= span * floor(past_s / span);
    return find_segment(path, time_of_way(path, begin_s + past_s));
}

struct rn_camera rn_path_camera(const struct rn_path *path, double frame) {
    struct segment at = segment_of(path, frame);
    double step[3], p[4], position[3];
    steps_of(&at, step);
    for (int k = 0; k < 4; k++)
        p[k] = at.key[k]->fov_y_rad;
    double fov_y_rad = blend(path, &at, p, step);
    fov_y_rad = fmax(fmin(p[1], p[2]), fmin(fmax(p[1], p[2]), fov_y_rad)); // no overshoot
    struct rn_camera camera = camera_of(path, fov_y_rad);
    blend_rotation(path, &at, camera.world_from_camera);
    blend_position(path, &at, step, position);
    for (int i = 0; i < 3; i++)
        camera.world_from_camera[i][3] = position[i];
    return camera;
}

struct rn_optics rn_path_optics(const struct rn_path *path, double frame) {
    struct segment at = segment_of(path, frame);
    return rn_optics_between(&at.key[1]->optics, &at.key[2]->optics, at.u);
}

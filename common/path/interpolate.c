// Between keys: centripetal Catmull-Rom for positions, squad for rotations; or straight lines and
// slerp.
#include <math.h>
#include <string.h>

#include "common/path/path.h"

struct quaternion {
    double w, x, y, z;
};

static struct quaternion quaternion_from_matrix(const double m[3][4]) { // Shepperd 1978
    double trace = m[0][0] + m[1][1] + m[2][2], q[4];
    int i = m[1][1] > m[0][0] ? 1 : 0;
    if (m[2][2] > m[i][i]) i = 2;
    if (trace > m[i][i]) {
        q[0] = 1 + trace;
        q[1] = m[2][1] - m[1][2];
        q[2] = m[0][2] - m[2][0];
        q[3] = m[1][0] - m[0][1];
    } else {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        q[0] = m[k][j] - m[j][k];
        q[1 + i] = 1 + m[i][i] - m[j][j] - m[k][k];
        q[1 + j] = m[j][i] + m[i][j];
        q[1 + k] = m[k][i] + m[i][k];
    }
    double norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    return (struct quaternion){q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm};
}

static void matrix_from_quaternion(struct quaternion q, double m[3][4]) {
    double norm = sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
    double w = q.w / norm, x = q.x / norm, y = q.y / norm, z = q.z / norm;
    m[0][0] = 1 - 2 * (y * y + z * z);
    m[0][1] = 2 * (x * y - w * z);
    m[0][2] = 2 * (x * z + w * y);
    m[1][0] = 2 * (x * y + w * z);
    m[1][1] = 1 - 2 * (x * x + z * z);
    m[1][2] = 2 * (y * z - w * x);
    m[2][0] = 2 * (x * z - w * y);
    m[2][1] = 2 * (y * z + w * x);
    m[2][2] = 1 - 2 * (x * x + y * y);
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

static struct quaternion squad(const struct quaternion q[4], double u) {
    struct quaternion a = control(q[0], q[1], q[2]), b = control(q[1], q[2], q[3]);
    return slerp(slerp(q[1], q[2], u), slerp(a, b, u), 2 * u * (1 - u));
}

// Where a frame's time falls: between keys 1 and 2 of four neighbours, at u in [0, 1].
struct segment {
    const struct rn_path_key *key[4]; // 0 and 3 repeat 1 and 2 at an open path's ends
    double u;
};

static struct segment find_segment(const struct rn_path *path, double time_s) {
    size_t count = path->key_count, i = 0;
    const struct rn_path_key *keys = path->keys;
    while (i + 1 < count && keys[i + 1].time_s <= time_s)
        i++;
    bool last = i + 1 == count;
    if (count == 1 || (last && !path->loop))
        return (struct segment){{&keys[i], &keys[i], &keys[i], &keys[i]}, 0};
    double begin_s = keys[i].time_s,
           mean_s = (keys[count - 1].time_s - keys[0].time_s) / (double)(count - 1);
    double end_s = last ? begin_s + mean_s : keys[i + 1].time_s;
    size_t after = (i + 1) % count;
    bool open_begin = !path->loop && i == 0, open_end = !path->loop && after + 1 == count;
    return (struct segment){{&keys[open_begin ? 0 : (i + count - 1) % count], &keys[i],
                             &keys[after], &keys[open_end ? after : (after + 1) % count]},
                            fmin((time_s - begin_s) / (end_s - begin_s), 1)};
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
static double catmull_rom(const double p[4], const double step[3], double u) {
    double chord = p[2] - p[1], begin = chord, end = chord;
    if (step[0] > 0)
        begin = step[1] * ((p[1] - p[0]) / step[0] - (p[2] - p[0]) / (step[0] + step[1])) + chord;
    if (step[2] > 0)
        end = step[1] * ((p[3] - p[2]) / step[2] - (p[3] - p[1]) / (step[1] + step[2])) + chord;
    double u2 = u * u, u3 = u2 * u;
    return p[1] + (3 * u2 - 2 * u3) * chord + (u3 - 2 * u2 + u) * begin + (u3 - u2) * end;
}

static double blend(const struct segment *at, const double p[4], const double step[3],
                    enum rn_interpolation interpolation) {
    if (interpolation == RN_INTERPOLATE_LINEAR || !(step[1] > 0))
        return p[1] + (p[2] - p[1]) * at->u;
    return catmull_rom(p, step, at->u);
}

static void blend_rotation(const struct segment *at, enum rn_interpolation interpolation,
                           double pose[3][4]) {
    struct quaternion q[4];
    for (int k = 0; k < 4; k++)
        q[k] = quaternion_from_matrix(at->key[k]->world_from_camera);
    q[0] = align(q[0], q[1]);
    q[2] = align(q[2], q[1]);
    q[3] = align(q[3], q[2]);
    bool linear = interpolation == RN_INTERPOLATE_LINEAR;
    matrix_from_quaternion(linear ? slerp(q[1], q[2], at->u) : squad(q, at->u), pose);
}

struct rn_camera rn_path_camera(const struct rn_path *path, size_t frame) {
    struct segment at = find_segment(path, path->keys[0].time_s + (double)frame / path->fps);
    struct rn_camera camera = {.lens = RN_LENS_PINHOLE};
    double step[3], p[4];
    for (int k = 0; k < 3; k++)
        step[k] = knot_step(at.key[k], at.key[k + 1]);
    blend_rotation(&at, path->interpolation, camera.world_from_camera);
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 4; k++)
            p[k] = at.key[k]->world_from_camera[i][3];
        camera.world_from_camera[i][3] = blend(&at, p, step, path->interpolation);
    }
    for (int k = 0; k < 4; k++)
        p[k] = at.key[k]->fov_y_rad;
    double fov_y_rad = blend(&at, p, step, path->interpolation);
    fov_y_rad = fmax(fmin(p[1], p[2]), fmin(fmax(p[1], p[2]), fov_y_rad)); // no overshoot
    camera.width = path->width;
    camera.height = path->height;
    camera.fx = camera.fy = rn_camera_focal_from_fov(fov_y_rad, path->height);
    camera.cx = 0.5 * path->width;
    camera.cy = 0.5 * path->height;
    return camera;
}

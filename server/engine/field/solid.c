#include "server/engine/field/solid.h"

#include <math.h>
#include <stddef.h>

#include "common/math/rng.h"

#define PHI 1.61803398874989484820458683436563811772L

typedef long double vec3[3];

static const vec3 cube[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
static const vec3 octahedral[4] = {{1, 1, 1}, {1, 1, -1}, {1, -1, 1}, {1, -1, -1}};
static const vec3 icosahedral[6] = {{0, 1, PHI},  {0, -1, PHI}, {1, PHI, 0},
                                    {-1, PHI, 0}, {PHI, 0, 1},  {PHI, 0, -1}};
static const vec3 dodecahedral[10] = {{1, 1, 1},         {1, 1, -1},         {1, -1, 1},
                                      {1, -1, -1},       {0, PHI, 1 / PHI},  {0, PHI, -1 / PHI},
                                      {1 / PHI, 0, PHI}, {1 / PHI, 0, -PHI}, {PHI, 1 / PHI, 0},
                                      {PHI, -1 / PHI, 0}};

static void normalise(vec3 v) {
    long double norm = sqrtl(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    for (int i = 0; i < 3; i++)
        v[i] /= norm;
}

// p0 = Z x a, p1 = a x p0; for a along Z: p0 = (0, -a_z, a_y).
static void set_plane(struct rn_solid *solid, int k, const vec3 direction) {
    vec3 a = {direction[0], direction[1], direction[2]};
    normalise(a);
    vec3 u = {-a[1], a[0], 0};
    if (a[0] == 0 && a[1] == 0) {
        u[0] = 0;
        u[1] = -a[2];
        u[2] = a[1];
    }
    normalise(u);
    vec3 v = {a[1] * u[2] - a[2] * u[1], a[2] * u[0] - a[0] * u[2], a[0] * u[1] - a[1] * u[0]};
    normalise(v);
    for (int i = 0; i < 3; i++) {
        solid->normal[k][i] = (double)a[i];
        solid->axis_u[k][i] = (double)u[i];
        solid->axis_v[k][i] = (double)v[i];
    }
}

static const vec3 *platonic(int planes) {
    switch (planes) {
    case 3:
        return cube;
    case 4:
        return octahedral;
    case 6:
        return icosahedral;
    case 10:
        return dodecahedral;
    default:
        return NULL;
    }
}

// Point i of 2n on the upper half of a golden spiral.
static void golden_spiral(int i, int n, vec3 ret) {
    long double z = (2 * i + 1) / (2.0L * n), ring = sqrtl(1 - z * z);
    long double angle = 2 * 3.14159265358979323846264338327950288L * i / PHI;
    ret[0] = ring * cosl(angle);
    ret[1] = ring * sinl(angle);
    ret[2] = z;
}

// Uniform on the sphere from two words.
static void white_noise(uint64_t seed, int i, vec3 ret) {
    struct rn_rng4 draw = rn_rng_draw(seed, 0x736f6c6964u, (uint64_t)i);
    long double z = 2.0L * rn_rng_unit(draw.v[0]) - 1, ring = sqrtl(fmaxl(0, 1 - z * z));
    long double angle = 2 * 3.14159265358979323846264338327950288L * rn_rng_unit(draw.v[1]);
    ret[0] = ring * cosl(angle);
    ret[1] = ring * sinl(angle);
    ret[2] = z;
}

// Best-candidate blue noise over directions without sign (Mitchell 1991): of 64 white candidates
// the one farthest from all axes chosen so far.
static void blue_noise(uint64_t seed, int i, struct rn_solid *solid, vec3 ret) {
    long double best = -1;
    for (int c = 0; c < 64; c++) {
        vec3 candidate;
        white_noise(seed, 1000 * (i + 1) + c, candidate);
        long double nearest = 2;
        for (int j = 0; j < i; j++) {
            long double dot = 0;
            for (int k = 0; k < 3; k++)
                dot += candidate[k] * solid->normal[j][k];
            nearest = fminl(nearest, 1 - fabsl(dot));
        }
        if (nearest > best) {
            best = nearest;
            for (int k = 0; k < 3; k++)
                ret[k] = candidate[k];
        }
    }
}

enum rn_status rn_solid_init(int planes, enum rn_orientation orientation, uint64_t seed,
                             struct rn_solid *ret_solid, struct rn_error *err) {
    const vec3 *vertices = platonic(planes);
    enum rn_status status = rn_planes_check(planes, orientation, err);
    if (status != RN_OK) return status;
    ret_solid->planes = planes;
    for (int k = 0; k < planes; k++) {
        vec3 direction = {0, 0, 1};
        switch (orientation) {
        case RN_ORIENTATION_PLATONIC:
            for (int i = 0; i < 3; i++)
                direction[i] = vertices[k][i];
            break;
        case RN_ORIENTATION_GOLDEN:
            golden_spiral(k, planes, direction);
            break;
        case RN_ORIENTATION_BLUE:
            blue_noise(seed, k, ret_solid, direction);
            break;
        case RN_ORIENTATION_WHITE:
            white_noise(seed, k, direction);
            break;
        }
        set_plane(ret_solid, k, direction);
    }
    return RN_OK;
}

#include "common/math/lens.h"

#define MOST 1e6

const char *const rn_lens_names[RN_LENS_COUNT] = {
    "pinhole", "opencv", "polynomial", "fisheye", "fov", "thin-prism-fisheye", "equirectangular"};

const struct rn_lens_model rn_lens_models[RN_LENS_COUNT] = {
    [RN_LENS_PINHOLE] = {0, 0, {0}},
    [RN_LENS_OPENCV] = {8, MOST, {"k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"}},
    [RN_LENS_POLYNOMIAL] = {6, MOST, {"k1", "k2", "k3", "k4", "p1", "p2"}},
    [RN_LENS_FISHEYE] = {4, MOST, {"k1", "k2", "k3", "k4"}},
    [RN_LENS_FOV] = {1, 3.1, {"omega"}}, // radians
    [RN_LENS_THIN_PRISM_FISHEYE] = {8, MOST, {"k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1"}},
    [RN_LENS_EQUIRECTANGULAR] = {0, 0, {0}},
};

#define STEPS 4096

// What is left of the derivative in its weakest direction at a flat point's size; negative beyond
// the fold.
static double margin(const struct rn_lens_terms *t, double r) {
    struct rn_lens_terms radial = *t;
    radial.p1 = radial.p2 = radial.prism[0] = radial.prism[1] = 0;
    struct rn_bent at = rn_lens_bend(&radial, r, 0);
    double s = r * r, d = 1 + s * (t->below[0] + s * (t->below[1] + s * t->below[2]));
    double taken = 6 * hypot(t->p1, t->p2) + 2 * hypot(t->prism[0], t->prism[1]);
    return d > 0 ? fmin(at.xx, at.yy) - taken * r : -1;
}

double rn_lens_fold(enum rn_lens lens, const double *k) {
    const double pi = 3.14159265358979323846;
    struct rn_lens_terms t = rn_lens_terms(lens, k);
    if (lens == RN_LENS_EQUIRECTANGULAR) return 4; // more than (pi, pi / 2) is long
    double most = lens == RN_LENS_FOV && t.omega > 0 ? pi / 2 / t.omega : t.omega > 0 ? pi : 0;
    double inside = 0, outside = 0;
    for (int i = 1; i <= STEPS; i++) {
        outside = most > 0 ? most * i / STEPS : tan(i * (pi / 2 - 1e-4) / STEPS);
        if (!(margin(&t, outside) > 0)) break;
        inside = outside;
    }
    for (int i = 0; i < 60 && inside < outside; i++) {
        double middle = inside + (outside - inside) / 2;
        *(margin(&t, middle) > 0 ? &inside : &outside) = middle;
    }
    return inside;
}

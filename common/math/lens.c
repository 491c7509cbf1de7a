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

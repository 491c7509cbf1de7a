// How a synthetic photograph is taken: a camera, and what the truth has not. Internal to
// common/dataset.
#ifndef RN_COMMON_DATASET_SYNTH_SHOT_H
#define RN_COMMON_DATASET_SYNTH_SHOT_H

#include <stdint.h>

#include "common/dataset/synth_scenes.h"
#include "common/image/image.h"

// A plain value. All but the camera 0: the truth.
struct rn_synth_shot {
    struct rn_camera camera;
    double focus;          // from the camera to what is sharp, dataset units
    double aperture;       // the lens's radius, dataset units
    struct vec moved;      // how far the camera moves while it looks, dataset units
    double stops;          // of light more than the mean
    struct rn_crowd crowd; // who stands about
};

// The ray through a pixel's coordinates; false where the lens sees nothing.
bool rn_synth_ray(const struct rn_camera *camera, double px, double py, struct ray *ret);
// Fills straight-alpha rgba of the camera's size: the mean of `side` x `side` rays a pixel.
void rn_synth_shoot(const struct rn_synth_scene *scene, const struct rn_synth_shot *shot, int side,
                    struct rn_picture *picture);
// Where view `index` of a split stands, and how it is taken: the test split shows the truth, of
// which only the lens is the others'. RN_ERROR_INVALID for a camera that looks nowhere.
enum rn_status rn_synth_place_shot(const struct rn_synth_scene *scene,
                                   const struct rn_synth_options *options, enum rn_split split,
                                   int index, int count, struct rn_synth_shot *ret_shot);

#endif

// The three synthetic scenes: what a ray sees. Internal to common/dataset.
#ifndef RN_COMMON_DATASET_SYNTH_SCENES_H
#define RN_COMMON_DATASET_SYNTH_SCENES_H

#include "common/dataset/synth_shapes.h"

struct rn_synth_scene;

// NULL for an unknown name.
const struct rn_synth_scene *rn_synth_find(const char *name);
// Radius about the origin that holds the whole scene.
double rn_synth_radius(const struct rn_synth_scene *scene);
// Whether the ray meets the scene; then its colour there, 0..1, and the distance. Diffuse light
// with shadows, and on "sphere" alone a highlight that moves with the viewer.
bool rn_synth_trace(const struct rn_synth_scene *scene, const struct ray *ray, double rgb[3],
                    double *ret_distance);

#endif

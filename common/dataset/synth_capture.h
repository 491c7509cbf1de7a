// A synthetic capture as COLMAP would have found it, but right. Internal to common/dataset.
#ifndef RN_COMMON_DATASET_SYNTH_CAPTURE_H
#define RN_COMMON_DATASET_SYNTH_CAPTURE_H

#include "common/dataset/synth_shot.h"

// The name of photograph `index`, from 0, in images/.
#define RN_SYNTH_PHOTO "%05d.png"

// Writes target/sparse/0/{cameras,images,points3D}.txt: the photographs' cameras, and points on
// what is still, each seen by all photographs from which nothing that is still hides it.
// RN_ERROR_NO_MEMORY, or what writing a file ends with.
enum rn_status rn_synth_write_capture(const struct rn_synth_scene *scene,
                                      const struct rn_synth_shot *shots, int count,
                                      const char *target, struct rn_error *err) RN_MUST_CHECK;

#endif

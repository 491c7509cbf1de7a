// What a photograph's code would be (effect appearance), by a part of what it shows: scores of
// photographs that a scene was not trained on are taken so (Martin-Brualla et al. 2021, "NeRF in
// the Wild", section 5).
#ifndef RN_ENGINE_SCENE_APPEARANCE_H
#define RN_ENGINE_SCENE_APPEARANCE_H

#include "server/engine/scene/pose.h"

// The field's table of codes, [photograph of the dataset][RN_APPEARANCE]; NULL where it has none.
const float *rn_field_appearances(const struct rn_field *field);
// Takes their mean off all codes that are trained: pictures are rendered with the code 0.
void rn_field_centre_appearances(struct rn_field *field);

// The code with which the field's colours are nearest to the photograph's part, by Gauss-Newton
// from 0 on, with a prior as wide as the codes that were trained. What
// photographs that are not trained on gain by it: tests/ops/appearance_test.c.
void rn_appearance_seek(const struct rn_pose_looker *looker, const struct rn_pose_photo *photo,
                        enum rn_pose_part part, uint64_t seed, float ret_code[RN_APPEARANCE]);

#endif

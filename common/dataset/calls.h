// The numbers by which a capture calls for effects of a training, as far as its cameras and masks
// alone say them: what training decides by (server/engine/effects), and what a report tells before.
#ifndef RN_COMMON_DATASET_CALLS_H
#define RN_COMMON_DATASET_CALLS_H

#include "common/dataset/dataset.h"

#define RN_LENS_SHIFT 0.05     // pixels: what the best calibrations leave is more
#define RN_SHARE_PAST 0.1      // of the pixels, that look past the ball
#define RN_SHARE_LEFT_OUT 0.5  // of the pixels, from which on masks cut an object out
#define RN_FORWARD_WIDEST 30.0 // degrees: cameras whose axes are as near to their mean face one way

// How far lenses move pixels. Zero-initialised; cameras are added one by one, those of a lens in
// turn, and stay where they are.
struct rn_lens_shift {
    double most;   // pixels, from where a pinhole of the same focal length has them
    size_t folded; // pixels beyond a lens's fold, all photographs together
    const struct rn_camera *before;
    size_t before_folded;
};
void rn_lens_shift_add(struct rn_lens_shift *shift, const struct rn_camera *camera);

// The share of the pixels that the masks of some photographs leave out; unreadable ones, which are
// told of when photographs are loaded, leave out nothing.
double rn_share_left_out(const struct rn_dataset *dataset);

// Share of the training photographs' pixels that look past `bounds` where they are given or the
// layout's, else past a ball of a quarter of the cameras' distance, which they surely all look at.
// Those of photographs with an alpha channel do not, as that cuts out what lies in it, nor with
// `cut_out` those of photographs with masks.
double rn_share_past(const struct rn_dataset *dataset, const struct rn_bounds *bounds,
                     bool cut_out);

// Whether the axes of all training cameras lie within RN_FORWARD_WIDEST of their mean.
bool rn_looks_one_way(const struct rn_dataset *dataset);
// Whether they do, between depths that are known: such a place is held by planes over its
// disparity.
bool rn_faces_one_way(const struct rn_dataset *dataset);

#endif

// Surroundings of places in small grey pictures, and how alike they are. Internal to
// common/dataset.
#ifndef RN_COMMON_DATASET_PATCH_H
#define RN_COMMON_DATASET_PATCH_H

#include <stdbool.h>
#include <stdint.h>

#define RN_PATCH_HALF 3 // steps to each side of the place
#define RN_PATCH_WIDE (2 * RN_PATCH_HALF + 1)

struct rn_patch {
    float rows[RN_PATCH_WIDE][8]; // grey levels less 128; the last of each row is 0
};

struct rn_grey_picture {
    const uint8_t *levels; // rows top to bottom
    int width, height;
};

// About `at`, pixels from the top-left corner, a step to the right and one down being so many
// pixels; bilinear. False where it leaves the picture.
bool rn_patch_take(const struct rn_grey_picture *picture, const double at[2], const double right[2],
                   const double down[2], struct rn_patch *ret_patch);

// Makes the mean 0 and the sum of the squares 1. False where it is flat: its standard deviation is
// under 3 grey levels.
bool rn_patch_normalise(struct rn_patch *patch);

// Normalised correlation, -1 .. 1, of a patch that is normalised with one as it was taken; -1 where
// that is flat.
float rn_patch_correlate(const struct rn_patch *normalised, const struct rn_patch *other);

#endif

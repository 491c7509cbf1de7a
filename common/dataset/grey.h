// Small grey copies of photographs, by which they are compared. Internal to common/dataset.
#ifndef RN_COMMON_DATASET_GREY_H
#define RN_COMMON_DATASET_GREY_H

#include "common/image/image.h"

// Mean brightness 0 .. 255 of a picture's cells, whole ones alone, *ret_cell pixels a side so that
// the longest side is about `side`; malloc'd, *ret_width x *ret_height. NULL when memory is out.
float *rn_grey(const struct rn_image *image, int side, int *ret_cell, int *ret_width,
               int *ret_height);

#endif

#include "common/dataset/grey.h"

#include <stdlib.h>

float *rn_grey(const struct rn_image *image, int side, int *ret_cell, int *ret_width,
               int *ret_height) {
    int longest = image->width > image->height ? image->width : image->height;
    int shorter = image->width + image->height - longest;
    int cell = longest > side ? (longest + side / 2) / side : 1;
    if (cell > shorter) cell = shorter;
    int width = *ret_width = image->width / cell, height = *ret_height = image->height / cell;
    float *grey = calloc((size_t)width * (size_t)height, sizeof *grey);
    for (int y = 0; grey && y < height * cell; y++)
        for (int x = 0; x < width * cell; x++) {
            const uint8_t *p = image->pixels + 4 * ((size_t)y * (size_t)image->width + (size_t)x);
            grey[(size_t)(y / cell) * (size_t)width + (size_t)(x / cell)] +=
                (float)(p[0] + 2 * p[1] + p[2]) * (float)p[3] / (1020.0f * (float)(cell * cell));
        }
    *ret_cell = cell;
    return grey;
}

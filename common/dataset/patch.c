#include "common/dataset/patch.h"

#include <math.h>

#define COUNT (RN_PATCH_WIDE * RN_PATCH_WIDE)
#define FLAT 3.0f // grey levels: the least standard deviation of what is compared
#define EDGE 0.01 // pixels that rounding may take

bool rn_patch_take(const struct rn_grey_picture *picture, const double at[2], const double right[2],
                   const double down[2], struct rn_patch *ret_patch) {
    double reach_x = RN_PATCH_HALF * (fabs(right[0]) + fabs(down[0]));
    double reach_y = RN_PATCH_HALF * (fabs(right[1]) + fabs(down[1]));
    if (!(at[0] - reach_x >= 0.5 + EDGE && at[0] + reach_x <= picture->width - 0.5 - EDGE &&
          at[1] - reach_y >= 0.5 + EDGE && at[1] + reach_y <= picture->height - 0.5 - EDGE))
        return false;
    const float across[2] = {(float)right[0], (float)right[1]};
    for (int v = 0; v < RN_PATCH_WIDE; v++) {
        int below = v - RN_PATCH_HALF;
        float x = (float)(at[0] - 0.5 + below * down[0] - RN_PATCH_HALF * right[0]);
        float y = (float)(at[1] - 0.5 + below * down[1] - RN_PATCH_HALF * right[1]);
        float *row = ret_patch->rows[v];
        for (int u = 0; u < RN_PATCH_WIDE; u++) {
            float px = x + (float)u * across[0], py = y + (float)u * across[1];
            int left = (int)px, top = (int)py;
            const uint8_t *p = picture->levels + top * picture->width + left;
            const uint8_t *q = p + picture->width;
            float to_right = px - (float)left, to_below = py - (float)top;
            float upper = (float)p[0] + to_right * (float)(p[1] - p[0]);
            float lower = (float)q[0] + to_right * (float)(q[1] - q[0]);
            row[u] = upper + to_below * (lower - upper) - 128;
        }
        row[RN_PATCH_WIDE] = 0;
    }
    return true;
}

bool rn_patch_normalise(struct rn_patch *patch) {
    float mean = 0, squares = 0;
    for (int i = 0; i < COUNT; i++)
        mean += patch->rows[i / RN_PATCH_WIDE][i % RN_PATCH_WIDE] / COUNT;
    for (int i = 0; i < COUNT; i++) {
        float *value = &patch->rows[i / RN_PATCH_WIDE][i % RN_PATCH_WIDE];
        *value -= mean;
        squares += *value * *value;
    }
    if (!(squares > FLAT * FLAT * COUNT)) return false;
    for (int i = 0; i < COUNT; i++)
        patch->rows[i / RN_PATCH_WIDE][i % RN_PATCH_WIDE] /= sqrtf(squares);
    return true;
}

float rn_patch_correlate(const struct rn_patch *normalised, const struct rn_patch *other) {
    float sums[8] = {0}, squares[8] = {0}, products[8] = {0}; // by column
    for (int v = 0; v < RN_PATCH_WIDE; v++)
        for (int u = 0; u < 8; u++) {
            float value = other->rows[v][u];
            sums[u] += value;
            squares[u] += value * value;
            products[u] += value * normalised->rows[v][u]; // whose mean is 0
        }
    float sum = 0, square = 0, product = 0;
    for (int u = 0; u < RN_PATCH_WIDE; u++) {
        sum += sums[u];
        square += squares[u];
        product += products[u];
    }
    float about_mean = square - sum * sum / COUNT;
    return about_mean > FLAT * FLAT * COUNT ? product / sqrtf(about_mean) : -1;
}

// sRGB's transfer function, IEC 61966-2-1, and back; below 0 as 0, above 1 it goes on.
#ifndef RN_COMMON_MATH_SRGB_H
#define RN_COMMON_MATH_SRGB_H

#include <math.h>

static inline float rn_srgb_to_linear(float value) {
    if (!(value > 0)) return 0;
    return value <= 0.04045f ? value / 12.92f : powf((value + 0.055f) / 1.055f, 2.4f);
}

static inline float rn_srgb_from_linear(float value) {
    if (!(value > 0)) return 0;
    return value <= 0.0031308f ? value * 12.92f : 1.055f * powf(value, 1 / 2.4f) - 0.055f;
}

#endif

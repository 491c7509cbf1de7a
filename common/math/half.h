// IEEE 754 binary16 as uint16_t: 11 significant bits, 2^-24 to 65504.
#ifndef RN_COMMON_MATH_HALF_H
#define RN_COMMON_MATH_HALF_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#define RN_HALF_MAX 65504.0f

static inline bool rn_half_is_finite(uint16_t half) {
    return (half & 0x7c00) != 0x7c00;
}

// Exact.
static inline float rn_half_to_float(uint16_t half) {
    uint32_t fraction = half & 1023, exponent = half >> 10 & 31;
    uint32_t bits =
        exponent == 31 ? 0x7f800000 | fraction << 13 : (exponent + 112) << 23 | fraction << 13;
    float value;
    memcpy(&value, &bits, sizeof value);
    if (exponent == 0) value = (float)fraction * 0x1p-24f;
    return half & 0x8000 ? -value : value;
}

// The nearest one, of two the even one; infinity from 65520 on.
static inline uint16_t rn_half_nearest(float value) {
    uint32_t bits, sign, size;
    memcpy(&bits, &value, sizeof bits);
    sign = bits >> 16 & 0x8000;
    size = bits & 0x7fffffff;
    if (size > 0x7f800000) return (uint16_t)(sign | 0x7e00);
    if (size >= 0x477ff000) return (uint16_t)(sign | 0x7c00);
    if (size < 0x38800000) // below 2^-14: multiples of 2^-24
        return (uint16_t)(sign | (uint32_t)lrintf(fabsf(value) * 0x1p24f));
    uint32_t half = (size - 0x38000000) >> 13, rest = size & 0x1fff;
    return (uint16_t)(sign | (half + (rest > 0x1000 || (rest == 0x1000 && (half & 1)))));
}

// The greatest one that is not above `value`, the least one that is not below it. Of finite values
// up to RN_HALF_MAX.
static inline uint16_t rn_half_below(float value) {
    uint16_t half = rn_half_nearest(value);
    if (rn_half_to_float(half) <= value) return half;
    if (half == 0) return 0x8001;
    return (uint16_t)(half & 0x8000 ? half + 1 : half - 1);
}
static inline uint16_t rn_half_above(float value) {
    return rn_half_below(-value) ^ 0x8000;
}

#endif

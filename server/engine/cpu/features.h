// Rows of features, as the products of the kernel set being compiled take them: fp32 numbers, a
// multiple of 16 a row, or bf16 numbers (to nearest, ties to even), a multiple of 32. Numbers
// behind the features are zero. With RN_FP32_FEATURES every set has fp32 numbers and rounds them
// later, so that tests see what is fetched.
#ifndef RN_ENGINE_CPU_FEATURES_H
#define RN_ENGINE_CPU_FEATURES_H

#include <stdbool.h>

#include "server/engine/cpu/simd.h"
#include "server/engine/kernels/kernels.h"

typedef float v4 __attribute__((vector_size(16), aligned(4), may_alias));
typedef float v8 __attribute__((vector_size(32), aligned(4), may_alias));
typedef float v16 __attribute__((vector_size(64), aligned(4), may_alias));

#if defined(__AVX512BF16__) && !defined(RN_FP32_FEATURES)

typedef uint16_t feature;
enum { FEATURES_READY = true }; // for the products, without another rounding

RN_INLINE size_t features_a_row(const struct rn_cpu_field *field) {
    return (size_t)(field->features + 31) / 32 * 32;
}
RN_INLINE void store_features_4(feature *to, v4 x) {
    _mm_storel_epi64((__m128i *)to, (__m128i)_mm_cvtneps_pbh((__m128)x));
}
RN_INLINE void store_features_8(feature *to, v8 x) {
    _mm_storeu_si128((__m128i *)to, (__m128i)_mm256_cvtneps_pbh((__m256)x));
}
RN_INLINE void store_features_16(feature *to, v16 x) {
    _mm256_storeu_si256((__m256i *)to, (__m256i)_mm512_cvtneps_pbh((__m512)x));
}
RN_INLINE float number_of(feature x) {
    uint32_t bits = (uint32_t)x << 16;
    float number;
    memcpy(&number, &bits, sizeof number);
    return number;
}

#else

typedef float feature;
enum { FEATURES_READY = false };

RN_INLINE size_t features_a_row(const struct rn_cpu_field *field) {
    return (size_t)field->feature_stride;
}
RN_INLINE void store_features_4(feature *to, v4 x) {
    *(v4 *)to = x;
}
RN_INLINE void store_features_8(feature *to, v8 x) {
    *(v8 *)to = x;
}
RN_INLINE void store_features_16(feature *to, v16 x) {
    *(v16 *)to = x;
}
RN_INLINE float number_of(feature x) {
    return x;
}

#endif

RN_INLINE void store_features(feature *to, vf x) {
#if RN_VL == 16
    store_features_16(to, (v16)x);
#elif RN_VL == 8
    store_features_8(to, (v8)x);
#else
    store_features_4(to, (v4)x);
#endif
}

// The features of sample i of the workspace.
RN_INLINE feature *feature_row(const struct rn_cpu_field *field, const struct rn_workspace *w,
                               int i) {
    return (feature *)w->features + (size_t)i * features_a_row(field);
}

// Zeros behind the features of the first `rows` samples: once, as nothing else is written there but
// by a set whose rows are others.
RN_INLINE void clear_padding(const struct rn_cpu_field *field, int rows, struct rn_workspace *w) {
    int features = field->features, stride = (int)features_a_row(field);
    int rest = features + (stride - features) % 16;
    int bytes = (int)sizeof(feature);
    if (w->padded.features != features || w->padded.bytes != bytes)
        w->padded = (struct rn_padding){.features = features, .bytes = bytes};
    for (int i = w->padded.rows; i < rows && features < stride; i++) {
        feature *row = feature_row(field, w, i);
        for (int k = features; k < rest; k += 4)
            store_features_4(row + k, (v4){0});
        for (int k = rest; k < stride; k += 16)
            store_features_16(row + k, (v16){0});
    }
    if (rows > w->padded.rows) w->padded.rows = rows;
}

static void put_features(const struct rn_cpu_field *field, int i, const float *from,
                         struct rn_workspace *w) {
    feature *row = feature_row(field, w, i);
    for (int k = 0; k < field->features; k += 4)
        store_features_4(row + k, *(const v4 *)(from + k));
    clear_padding(field, i + 1, w);
}

static void get_features(const struct rn_cpu_field *field, int i, const struct rn_workspace *w,
                         float *ret) {
    const feature *row = feature_row(field, w, i);
    for (int k = 0; k < field->features; k++)
        ret[k] = number_of(row[k]);
}

#endif

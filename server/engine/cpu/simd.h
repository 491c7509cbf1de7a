// Vectors of fp32 in the width of the kernel set being compiled.
//
// Written with the compiler's vector extensions; intrinsics only where those say nothing (gather,
// masks, minimum). The same source serves every kernel set: RN_VL lanes of 16 (AVX-512), 8 (AVX2)
// or 4 (SSE2, NEON). Kernel sets are compiled with -ffp-contract=fast: a * b + c is one FMA where
// the set has it.
#ifndef RN_ENGINE_CPU_SIMD_H
#define RN_ENGINE_CPU_SIMD_H

#include <stdint.h>
#include <string.h>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

#if defined(__AVX512F__) && defined(__AVX512DQ__)
#define RN_VL 16
#elif defined(__AVX2__)
#define RN_VL 8
#else
#define RN_VL 4
#endif

typedef float vf __attribute__((vector_size(4 * RN_VL)));
typedef int32_t vi __attribute__((vector_size(4 * RN_VL)));
typedef float vf_u __attribute__((vector_size(4 * RN_VL), aligned(4), may_alias));
typedef int32_t vi_u __attribute__((vector_size(4 * RN_VL), aligned(4), may_alias));

#define RN_INLINE static inline __attribute__((always_inline))

// Float64, half as many lanes.
#define RN_VD (RN_VL / 2)
typedef double vd __attribute__((vector_size(8 * RN_VD)));
typedef int64_t vl __attribute__((vector_size(8 * RN_VD)));

RN_INLINE vd vd_set(double x) {
    return x - (vd){0};
}
RN_INLINE vd vd_select(vl mask, vd yes, vd no) {
    return (vd)((mask & (vl)yes) | (~mask & (vl)no));
}
RN_INLINE vd vd_sqrt(vd x) {
#if RN_VL == 16
    return (vd)_mm512_sqrt_pd((__m512d)x);
#elif RN_VL == 8
    return (vd)_mm256_sqrt_pd((__m256d)x);
#else
    for (int i = 0; i < RN_VD; i++)
        x[i] = __builtin_sqrt(x[i]);
    return x;
#endif
}

// fp32 numbers, widened and rounded.
typedef float vd_floats __attribute__((vector_size(4 * RN_VD)));
RN_INLINE vd vd_load(const float *p) {
    vd_floats x;
    memcpy(&x, p, sizeof x);
    return __builtin_convertvector(x, vd);
}
RN_INLINE void vd_store(float *p, vd x) {
    vd_floats rounded = __builtin_convertvector(x, vd_floats);
    memcpy(p, &rounded, sizeof rounded);
}

// The mask of the first `count` lanes.
RN_INLINE vl vd_first_lanes(int64_t count) {
    vl lane;
    for (int i = 0; i < RN_VD; i++)
        lane[i] = i;
    return lane < count;
}

// Lanes moved BY places down (lane i is lane i + BY) or up, with zeros behind them.
#if RN_VD == 8
#define VD_LANES_FROM(A, B, I)                                                                     \
    __builtin_shufflevector(A, B, I, I + 1, I + 2, I + 3, I + 4, I + 5, I + 6, I + 7)
#elif RN_VD == 4
#define VD_LANES_FROM(A, B, I) __builtin_shufflevector(A, B, I, I + 1, I + 2, I + 3)
#else
#define VD_LANES_FROM(A, B, I) __builtin_shufflevector(A, B, I, I + 1)
#endif
#define VD_DOWN(X, BY) VD_LANES_FROM(X, (vd){0}, BY)
#define VD_UP(X, BY) VD_LANES_FROM((vd){0}, X, RN_VD - BY)

// Lane i is the sum of the lanes up to i, or of those from i on.
#define VD_SUMS(NAME, MOVE)                                                                        \
    RN_INLINE vd NAME(vd x) {                                                                      \
        x += MOVE(x, 1);                                                                           \
        if (RN_VD > 2) x += MOVE(x, 2);                                                            \
        if (RN_VD > 4) x += MOVE(x, RN_VD / 2);                                                    \
        return x;                                                                                  \
    }
VD_SUMS(vd_prefix_sums, VD_UP)
VD_SUMS(vd_suffix_sums, VD_DOWN)
RN_INLINE double vd_sum(vd x) {
    return vd_suffix_sums(x)[0];
}

RN_INLINE vf vf_load(const float *p) {
    return *(const vf_u *)p;
}
RN_INLINE void vf_store(float *p, vf x) {
    *(vf_u *)p = x;
}
RN_INLINE vi vi_load(const int32_t *p) {
    return *(const vi_u *)p;
}
RN_INLINE void vi_store(int32_t *p, vi x) {
    *(vi_u *)p = x;
}
RN_INLINE vf vf_set(float x) {
    return x - (vf){0};
}
RN_INLINE vi vi_set(int32_t x) {
    return x - (vi){0};
}
RN_INLINE vf vf_from_int(vi x) {
    return __builtin_convertvector(x, vf);
}
RN_INLINE vi vi_from_float(vf x) {
    return __builtin_convertvector(x, vi);
} // truncates
RN_INLINE vi vi_bits(vf x) {
    return (vi)x;
}
RN_INLINE vf vf_bits(vi x) {
    return (vf)x;
}
RN_INLINE vf vf_select(vi mask, vf yes, vf no) {
    return (vf)((mask & (vi)yes) | (~mask & (vi)no));
}

// The second operand where the first is NaN, as the hardware does.
RN_INLINE vf vf_min(vf a, vf b) {
#if RN_VL == 16
    return (vf)_mm512_min_ps((__m512)a, (__m512)b);
#elif RN_VL == 8
    return (vf)_mm256_min_ps((__m256)a, (__m256)b);
#else
    return vf_select(a < b, a, b);
#endif
}
RN_INLINE vf vf_max(vf a, vf b) {
#if RN_VL == 16
    return (vf)_mm512_max_ps((__m512)a, (__m512)b);
#elif RN_VL == 8
    return (vf)_mm256_max_ps((__m256)a, (__m256)b);
#else
    return vf_select(a > b, a, b);
#endif
}
RN_INLINE vf vf_clamp(vf x, float low, float high) {
    return vf_min(vf_max(x, vf_set(low)), vf_set(high)); // NaN gives low
}
RN_INLINE vf vf_abs(vf x) {
    return vf_bits(vi_bits(x) & 0x7fffffff);
}
RN_INLINE vf vf_sqrt(vf x) {
#if RN_VL == 16
    return (vf)_mm512_sqrt_ps((__m512)x);
#elif RN_VL == 8
    return (vf)_mm256_sqrt_ps((__m256)x);
#else
    for (int i = 0; i < RN_VL; i++)
        x[i] = __builtin_sqrtf(x[i]);
    return x;
#endif
}

RN_INLINE vi vi_select(vi mask, vi yes, vi no) {
    return (mask & yes) | (~mask & no);
}

// One bit a lane where the mask (0 or -1) is set.
RN_INLINE unsigned vi_mask_bits(vi mask) {
#if RN_VL == 16
    return _mm512_movepi32_mask((__m512i)mask);
#elif RN_VL == 8
    return (unsigned)_mm256_movemask_ps((__m256)mask);
#else
    unsigned bits = 0;
    for (int i = 0; i < RN_VL; i++)
        bits |= (unsigned)(mask[i] & 1) << i;
    return bits;
#endif
}

// The mask of the lanes whose bit is set.
RN_INLINE vi vi_mask_of(unsigned bits) {
    vi out;
    for (int i = 0; i < RN_VL; i++)
        out[i] = 1 << i;
    return ((int32_t)bits & out) != 0;
}

RN_INLINE vi vi_gather(const int32_t *base, vi index) {
#if RN_VL == 16
    return (vi)_mm512_i32gather_epi32((__m512i)index, base, 4);
#elif RN_VL == 8
    return (vi)_mm256_i32gather_epi32(base, (__m256i)index, 4);
#else
    vi out;
    for (int i = 0; i < RN_VL; i++)
        out[i] = base[index[i]];
    return out;
#endif
}

// Bytes; reads up to 3 behind each.
RN_INLINE vi vi_gather_bytes(const uint8_t *base, vi index) {
#if RN_VL == 16
    return (vi)_mm512_i32gather_epi32((__m512i)index, base, 1) & 255;
#elif RN_VL == 8
    return (vi)_mm256_i32gather_epi32((const int *)base, (__m256i)index, 1) & 255;
#else
    vi out;
    for (int i = 0; i < RN_VL; i++)
        out[i] = base[index[i]];
    return out;
#endif
}

RN_INLINE vf vf_iota(void) {
    vf out;
    for (int i = 0; i < RN_VL; i++)
        out[i] = (float)i;
    return out;
}

RN_INLINE float vf_sum(vf x) {
    float sum = 0;
    for (int i = 0; i < RN_VL; i++)
        sum += x[i];
    return sum;
}

// Nearest integer, ties to even, for |x| < 2^22.
RN_INLINE vf vf_round(vf x) {
    vf magic = vf_set(12582912.0f); // 1.5 * 2^23
    vf shifted = x + magic;
#if defined(__x86_64__)
    __asm__("" : "+x"(shifted)); // keep the compiler from undoing the addition
#else
    __asm__("" : "+w"(shifted));
#endif
    return shifted - magic;
}

// exp(x), x clamped to [-87.3, 88.7]. Within 2 ULP (Taylor polynomial of degree 7 on
// [-ln 2 / 2, ln 2 / 2], two-part reduction; tests/numerics/proofs/exp.gappa). NaN gives
// exp(-87.3).
RN_INLINE vf vf_exp(vf x) {
    x = vf_clamp(x, -87.3f, 88.7f);
    vf n = vf_round(x * 1.44269504088896341f);
    vf r = x - n * 0.693145751953125f; // ln 2, high part: 16 bits, n * it is exact
    r = r - n * 1.42860677e-6f;
    vf p = vf_set(1.98412698e-4f) * r + 1.38888889e-3f;
    p = p * r + 8.33333333e-3f;
    p = p * r + 4.16666667e-2f;
    p = p * r + 1.66666667e-1f;
    p = p * r + 0.5f;
    p = p * r * r + r + 1.0f;
    vi k = vi_from_float(n);
    vi half = k >> 1; // in two factors, so that n = 128 does not overflow
    vf scale = vf_bits((half + 127) << 23), rest = vf_bits((k - half + 127) << 23);
    return p * scale * rest;
}

// 1 - exp(-x) for x >= 0, to 4 ULP also for tiny x.
RN_INLINE vf vf_one_minus_exp(vf x) {
    // Below 1/2: x - x^2/2 + x^3/6 - ..., to x^9.
    vf p = vf_set(2.75573192e-6f) * x - 2.48015873e-5f;
    p = p * x + 1.98412698e-4f;
    p = p * x - 1.38888889e-3f;
    p = p * x + 8.33333333e-3f;
    p = p * x - 4.16666667e-2f;
    p = p * x + 1.66666667e-1f;
    p = p * x - 0.5f;
    vf small = p * x * x + x;
    return vf_select(x < 0.5f, small, 1.0f - vf_exp(-x));
}

// log2(x) for normal x > 0: error at most 1e-7 plus half a unit in the last place of the result
// (tests/numerics/proofs/log2.gappa).
RN_INLINE vf vf_log2(vf x) {
    vi bits = vi_bits(x);
    vi e = ((bits - 0x3f3504f3) >> 23); // mantissa in [sqrt(1/2), sqrt(2))
    vf m = vf_bits(bits - (e << 23));
    vf t = (m - 1.0f) / (m + 1.0f), t2 = t * t; // atanh series: 2 (t + t^3/3 + ...)
    vf p = vf_set(0.2623082f) * t2 + 0.3205989f;
    p = p * t2 + 0.4121986f;
    p = p * t2 + 0.5770780f;
    p = p * t2 + 0.9617967f;
    vf tail = p * t2 * t + t * 0.8853900817779268f;
    return vf_from_int(e) + (t * 2.0f + tail);
}

#endif

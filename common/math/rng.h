// Counter-based random numbers: a value depends only on (seed, stream, counter), never on the
// order of calls, so any thread may draw any number. Philox4x32-10 (Salmon et al., SC 2011).
#ifndef RN_COMMON_MATH_RNG_H
#define RN_COMMON_MATH_RNG_H

#include <stdint.h>

#include "common/math/hd.h"

struct rn_rng4 {
    uint32_t v[4];
};

// Four independent 32-bit words for one (seed, stream, counter).
RN_HD struct rn_rng4 rn_rng_draw(uint64_t seed, uint64_t stream, uint64_t counter) {
    uint32_t k0 = (uint32_t)seed, k1 = (uint32_t)(seed >> 32);
    uint32_t c0 = (uint32_t)counter, c1 = (uint32_t)(counter >> 32);
    uint32_t c2 = (uint32_t)stream, c3 = (uint32_t)(stream >> 32);
    for (int round = 0; round < 10; round++) {
        uint64_t p0 = (uint64_t)0xD2511F53u * c0, p1 = (uint64_t)0xCD9E8D57u * c2;
        uint32_t n0 = (uint32_t)(p1 >> 32) ^ c1 ^ k0, n2 = (uint32_t)(p0 >> 32) ^ c3 ^ k1;
        c1 = (uint32_t)p1;
        c3 = (uint32_t)p0;
        c0 = n0;
        c2 = n2;
        k0 += 0x9E3779B9u;
        k1 += 0xBB67AE85u;
    }
    struct rn_rng4 out = {{c0, c1, c2, c3}};
    return out;
}

// Uniform in [0, 1), 24 bits: exact in fp32.
RN_HD float rn_rng_unit(uint32_t word) {
    return (float)(word >> 8) * 0x1p-24f;
}

// Uniform integer in [0, n), n >= 1 (multiply-shift; bias below n / 2^32).
RN_HD uint32_t rn_rng_below(uint32_t word, uint32_t n) {
    return (uint32_t)(((uint64_t)word * n) >> 32);
}

#endif

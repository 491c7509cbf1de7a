// fp32 multiply-adds in the vectors of one kernel set; compiled once for each.
#include "server/engine/bench/peak.h"

#include "server/engine/cpu/simd.h"

#define CHAINS 12 // independent sums: more than latency times units

#define RN_PASTE2(a, b) a##b
#define RN_PASTE(a, b) RN_PASTE2(a, b)

double RN_PASTE(rn_peak_, RN_KERNEL_SET)(size_t rounds, float *sink) {
    vf sum[CHAINS], factor = vf_set(1 - *sink), term = vf_set(*sink);
#pragma GCC unroll 12
    for (int i = 0; i < CHAINS; i++)
        sum[i] = vf_set((float)i);
    for (size_t k = 0; k < rounds; k++) {
#pragma GCC unroll 12
        for (int i = 0; i < CHAINS; i++)
            sum[i] = sum[i] * factor + term;
    }
    float total = 0;
    for (int i = 0; i < CHAINS; i++)
        total += vf_sum(sum[i]);
    *sink = total * 1e-30f;
    return (double)rounds * CHAINS * RN_VL;
}

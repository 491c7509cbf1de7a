// Loops of nothing but multiply-adds, in units of their own: each is compiled for one instruction
// set and runs only where the machine has it.
#ifndef RN_ENGINE_BENCH_PEAK_H
#define RN_ENGINE_BENCH_PEAK_H

#include <stddef.h>

// Does `rounds` rounds and returns the multiply-adds done; *sink keeps the work from vanishing.
typedef double rn_peak_function(size_t rounds, float *sink);

rn_peak_function rn_peak_generic;
#if defined(__x86_64__)
rn_peak_function rn_peak_avx2, rn_peak_avx512;
rn_peak_function rn_peak_bf16;   // AVX-512 BF16
rn_peak_function rn_peak_amx;    // AMX bf16, operands in tiles
rn_peak_function rn_peak_amx_l1; // AMX bf16, every operand loaded from L1
#endif

#endif

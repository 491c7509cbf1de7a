// What the CPU has and the system grants.
#ifndef RN_ENGINE_CPU_DISPATCH_H
#define RN_ENGINE_CPU_DISPATCH_H

#include <stdbool.h>

bool rn_cpu_has_avx512(void); // F, DQ, BW and VL
bool rn_cpu_has_bf16(void);   // AVX512-BF16 and the above
// AMX with bf16 tiles, granted to this process by the kernel, which is asked.
bool rn_cpu_has_amx(void);

#endif

// Which kernel sets this machine can run.
#include <stddef.h>
#include <string.h>

#include "server/engine/cpu/kernels.h"

extern const struct rn_kernels rn_kernels_generic;
#if defined(__x86_64__)
extern const struct rn_kernels rn_kernels_avx2, rn_kernels_avx512;
#endif

const struct rn_kernels *rn_kernels_available(int i) {
    const struct rn_kernels *found[4];
    int n = 0;
    found[n++] = &rn_kernels_generic;
#if defined(__x86_64__)
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"))
        found[n++] = &rn_kernels_avx2;
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl"))
        found[n++] = &rn_kernels_avx512;
#endif
    return i < n ? found[i] : NULL;
}

const struct rn_kernels *rn_kernels_find(const char *name) {
    const struct rn_kernels *k;
    for (int i = 0; (k = rn_kernels_available(i)); i++)
        if (strcmp(k->name, name) == 0) return k;
    return NULL;
}

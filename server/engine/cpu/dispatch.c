// Which kernel sets this machine can run.
#include <stdbool.h>
#include <stddef.h>
#include <string.h>

#include "server/engine/cpu/dispatch.h"
#include "server/engine/kernels/kernels.h"

#if defined(__x86_64__)
#include <cpuid.h>
#include <sys/syscall.h>
#include <unistd.h>
#endif

extern const struct rn_kernels rn_kernels_generic;
#if defined(__x86_64__)
extern const struct rn_kernels rn_kernels_avx2, rn_kernels_avx512, rn_kernels_avx512bf16,
    rn_kernels_amx;
#endif

#if defined(__x86_64__)
#define ARCH_REQ_XCOMP_PERM 0x1023
#define XFEATURE_XTILEDATA 18

bool rn_cpu_has_avx512(void) {
    __builtin_cpu_init();
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
           __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl");
}

bool rn_cpu_has_bf16(void) {
    unsigned a, b, c, d;
    const unsigned bf16 = 1u << 5;
    return rn_cpu_has_avx512() && __get_cpuid_count(7, 1, &a, &b, &c, &d) && (a & bf16);
}

bool rn_cpu_has_amx(void) {
    unsigned a, b, c, d;
    const unsigned bf16 = 1u << 22, tiles = 1u << 24;
    if (!__get_cpuid_count(7, 0, &a, &b, &c, &d) || !(d & bf16) || !(d & tiles)) return false;
    return syscall(SYS_arch_prctl, ARCH_REQ_XCOMP_PERM, XFEATURE_XTILEDATA) == 0;
}
#else
bool rn_cpu_has_avx512(void) {
    return false;
}
bool rn_cpu_has_bf16(void) {
    return false;
}
bool rn_cpu_has_amx(void) {
    return false;
}
#endif

const struct rn_kernels *rn_kernels_available(int i) {
    const struct rn_kernels *found[6];
    int n = 0;
    found[n++] = &rn_kernels_generic;
#if defined(__x86_64__)
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"))
        found[n++] = &rn_kernels_avx2;
    if (rn_cpu_has_avx512()) found[n++] = &rn_kernels_avx512;
    if (rn_cpu_has_bf16()) {
        found[n++] = &rn_kernels_avx512bf16;
        if (rn_cpu_has_amx()) found[n++] = &rn_kernels_amx;
    }
#endif
    return i < n ? found[i] : NULL;
}

const struct rn_kernels *rn_kernels_find(const char *name) {
    const struct rn_kernels *k;
    for (int i = 0; (k = rn_kernels_available(i)); i++)
        if (strcmp(k->name, name) == 0) return k;
    return NULL;
}

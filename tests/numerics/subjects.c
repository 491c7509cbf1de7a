// Every subject that this machine can run.
#include <stddef.h>
#include <string.h>

#include "server/engine/kernels/kernels.h"
#include "tests/numerics/subject.h"

extern const struct subject subject_float64, subject_float32;
#define SET(name) extern const struct subject subject_##name;
SUBJECT_SETS
#undef SET
#ifdef SUBJECT_CUDA
extern const struct subject subject_cuda;
extern const struct rn_kernels subject_cuda_kernels;
#endif

const struct subject *subject_at(int i) {
#define SET(name) &subject_##name,
    static const struct subject *const sets[] = {SUBJECT_SETS};
#undef SET
    if (i < 2) return i == 0 ? &subject_float64 : &subject_float32;
    const struct rn_kernels *kernels = rn_kernels_available(i - 2);
    for (size_t k = 0; kernels && k < sizeof sets / sizeof *sets; k++)
        if (strcmp(sets[k]->name, kernels->name) == 0) return sets[k];
#ifdef SUBJECT_CUDA
    if (!kernels && (i == 2 || rn_kernels_available(i - 3))) return &subject_cuda;
#endif
    return NULL;
}

const struct rn_kernels *optimiser_at(int i) {
    const struct rn_kernels *kernels = rn_kernels_available(i);
#ifdef SUBJECT_CUDA
    if (!kernels && (i == 0 || rn_kernels_available(i - 1))) return &subject_cuda_kernels;
#endif
    return kernels;
}

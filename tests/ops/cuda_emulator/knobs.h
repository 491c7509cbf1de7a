// What tests in C ask of the emulator.
#ifndef RN_TESTS_EMULATOR_KNOBS_H
#define RN_TESTS_EMULATOR_KNOBS_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif
// In which order threads run to their next collective: 0 first to last, 1 last to first, 2 shuffled
// by `seed`, 3 the first warp after all others.
void rn_emulator_order(int order, uint64_t seed);
void rn_emulator_memory(size_t bytes);
// Bytes of shared memory that a block may have, of devices opened from now on: 227 KB at first, as
// on an H200; 163 KB as on an A100, 99 KB as on cards for desks.
void rn_emulator_shared(size_t bytes);
size_t rn_emulator_memory_used(void);
long rn_emulator_allocations(void);
// From now on every call fails with this error; 0 ends it.
void rn_emulator_fail(int error);
// Kernels in whose name this is do nothing from now on; NULL: there are none.
void rn_emulator_skip(const char *name);
#ifdef __cplusplus
}
#endif

#endif

// The emulator's state, and what tests in C set.
#include "emulator.hpp"

#include <unistd.h>

#include "knobs.h"

emu::machine emu::m;
// RIPNERF_EMULATOR_MEMORY: bytes of every process's device.
static size_t given_memory() {
    const char *bytes = getenv("RIPNERF_EMULATOR_MEMORY");
    return bytes ? strtoull(bytes, NULL, 10) : (size_t)2 << 30;
}
size_t emu::memory_total = given_memory(), emu::memory_used;
// RIPNERF_EMULATOR_SHARED: bytes of shared memory that a block of every process may have.
static size_t given_shared() {
    const char *bytes = getenv("RIPNERF_EMULATOR_SHARED");
    return bytes ? strtoull(bytes, NULL, 10) : (size_t)emu::SHARED;
}
size_t emu::shared_most = given_shared();
long emu::allocations;
uint64_t emu::launched;
cudaError_t emu::sticky;
const char *emu::skips;
enum { CHECKED = 7 + 3 + 3 }; // graphs that the check of a device by "auto" launches
void emu::maybe_lose() {
    static int launches;
    const char *file = getenv("RIPNERF_EMULATOR_LOSES");
    if (file && ++launches == CHECKED + 3 && unlink(file) == 0) sticky = cudaErrorIllegalAddress;
}

void rn_emulator_order(int order, uint64_t seed) {
    emu::m.policy = (rn_emu_order)order;
    emu::m.random = seed;
}
void rn_emulator_memory(size_t bytes) {
    emu::memory_total = bytes;
}
void rn_emulator_shared(size_t bytes) {
    emu::shared_most = bytes;
}
size_t rn_emulator_memory_used(void) {
    return emu::memory_used;
}
long rn_emulator_allocations(void) {
    return emu::allocations;
}
void rn_emulator_fail(int error) {
    emu::sticky = error;
}
void rn_emulator_skip(const char *name) {
    emu::skips = name;
}

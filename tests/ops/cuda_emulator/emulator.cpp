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
long emu::allocations;
cudaError_t emu::sticky;
void emu::maybe_lose() {
    static int launches;
    const char *file = getenv("RIPNERF_EMULATOR_LOSES");
    if (file && ++launches == 3 && unlink(file) == 0) sticky = cudaErrorIllegalAddress;
}

static const float *all_halves() {
    static float values[65536];
    for (uint32_t i = 0; i < 65536; i++) {
        uint16_t bits = (uint16_t)i;
        _Float16 h;
        memcpy(&h, &bits, sizeof h);
        values[i] = (float)h;
    }
    return values;
}
const float *const emu::half_values = all_halves();

void rn_emulator_order(int order, uint64_t seed) {
    emu::m.policy = (rn_emu_order)order;
    emu::m.random = seed;
}
void rn_emulator_memory(size_t bytes) {
    emu::memory_total = bytes;
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

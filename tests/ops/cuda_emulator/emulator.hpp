// CUDA on a CPU, for tests: the kernels' sources compiled by a C++ compiler, every thread of a
// block a fiber, one block after the other.
//
// What is checked: every warp collective is entered by all 32 lanes with the same operation and
// __syncthreads by the whole block (anything else ends the program); memory from the allocator, and
// shared memory at every block's beginning, hold NaN bytes until written; asynchronous copies run
// as late as they may, when their group is waited for, and must be waited for; a warp runs as far
// as it can before the next one begins, first to last or last to first, or all threads shuffled, so
// that a missing barrier shows. What is not: weak memory order between blocks, timing, registers.
#ifndef RN_TESTS_EMULATOR_H
#define RN_TESTS_EMULATOR_H

#include <math.h>
#include <setjmp.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <ucontext.h>
#include <unistd.h>

#include <algorithm>
#include <functional>
#include <map>
#include <tuple>
#include <vector>

#define __global__
#define __device__
#define __host__
#define __constant__
#define __restrict__
#define __grid_constant__
#define __launch_bounds__(...)
#define __forceinline__ inline
#define __align__(bytes) __attribute__((aligned(bytes)))
#define RN_DEVICE static inline
// Blocks run one after the other. Not within templates: there gcc forgets the section.
#define RN_SHARED static __attribute__((section("rn_shared")))
#define RN_UNROLL
#define RN_ROLLED
#define RN_UNROLL_8

struct alignas(8) uint2 {
    uint32_t x, y;
};
struct alignas(16) uint4 {
    uint32_t x, y, z, w;
};
struct alignas(16) float4 {
    float x, y, z, w;
};
struct longlong4_t {
    long long x, y, z, w;
};
struct dim3 {
    unsigned x, y, z;
    dim3(unsigned a = 1, unsigned b = 1, unsigned c = 1) : x(a), y(b), z(c) {}
};

enum rn_emu_order { RN_EMU_FORWARD, RN_EMU_BACKWARD, RN_EMU_RANDOM, RN_EMU_STARVE_FIRST };

// All RN_SHARED variables, from the linker.
extern "C" unsigned char __start_rn_shared[], __stop_rn_shared[];

namespace emu {

enum { LANES = 32, STACK = 64 << 10, SHARED = 227 << 10 };

struct copy {
    void *to;
    const void *from;
    int group;
};
struct fiber {
    ucontext_t context;
    jmp_buf jump;
    std::vector<char> stack;
    bool started = false, done;
    const uint64_t *waits_on; // runnable when *waits_on != waited
    uint64_t waited;
    std::vector<copy> copies;
    int group;
};
struct warp {
    const char *operation;
    int arrived;
    uint64_t generation;
    uint32_t in[LANES][12], out[LANES][4];
};
struct machine {
    std::vector<fiber> fibers;
    std::vector<warp> warps;
    std::vector<unsigned> order;
    const char *kernel = "", *barrier = "";
    std::function<void()> body;
    jmp_buf scheduler;
    unsigned first = 0, turn = 0; // places in `order`; like what follows, to outlive a longjmp
    bool progress = false, unit_progress = false;
    unsigned current = 0, threads = 0, finished = 0, arrived = 0;
    uint64_t generation = 0, random = 1;
    rn_emu_order policy = RN_EMU_FORWARD;
    dim3 block, grid, index;
    alignas(128) unsigned char shared[SHARED];
};
extern machine m;

[[noreturn]] inline void die(const char *what) {
    fprintf(stderr, "emulated kernel %s: block %u thread %u: %s\n", m.kernel, m.index.x, m.current,
            what);
    abort();
}

inline void yield() {
    if (_setjmp(m.fibers[m.current].jump) == 0) _longjmp(m.scheduler, 1);
}
inline void wait_for(const uint64_t *generation) {
    fiber &f = m.fibers[m.current];
    f.waits_on = generation;
    f.waited = *generation;
    yield();
}

template <typename F> inline warp &collective(const char *operation, F compute) {
    warp &w = m.warps[m.current / LANES];
    if (w.arrived == 0) w.operation = operation;
    if (w.operation != operation && strcmp(w.operation, operation) != 0)
        die("lanes of a warp meet in different operations");
    if (++w.arrived < LANES) {
        wait_for(&w.generation);
        return w;
    }
    compute(w);
    w.arrived = 0;
    w.generation++;
    return w;
}

inline void barrier(const char *name) {
    if (m.arrived == 0) m.barrier = name;
    if (m.barrier != name && strcmp(m.barrier, name) != 0)
        die("threads of a block meet in different barriers");
    if (++m.arrived < m.threads) {
        wait_for(&m.generation);
        return;
    }
    m.arrived = 0;
    m.generation++;
}

// A thread of one block after the other: making a fiber costs system calls.
inline void fiber_main() {
    for (;;) {
        m.body();
        fiber &f = m.fibers[m.current];
        if (!f.copies.empty()) die("ends before its asynchronous copies");
        f.done = true;
        m.finished++;
        yield();
    }
}

// Runs every runnable thread of a part of the order once.
inline void run_unit(unsigned unit) {
    m.unit_progress = false;
    for (m.turn = m.first; m.turn < m.first + unit; m.turn++) {
        m.current = m.order[m.turn];
        fiber &f = m.fibers[m.current];
        if (f.done || (f.waits_on && *f.waits_on == f.waited)) continue;
        m.progress = m.unit_progress = true;
        f.waits_on = NULL;
        if (_setjmp(m.scheduler) != 0) continue;
        if (f.started) _longjmp(f.jump, 1);
        f.started = true;
        setcontext(&f.context);
    }
}

// What lies behind the shared memory that the launch asked for is still as it was.
inline void check_beyond(size_t bytes) {
    const unsigned char *beyond = m.shared + bytes;
    if (bytes < SHARED && (*beyond != 0xff || memcmp(beyond, beyond + 1, SHARED - bytes - 1) != 0))
        die("wrote behind its shared memory");
}

inline void run_block() {
    memset(m.shared, 0xff, sizeof m.shared);
    memset(__start_rn_shared, 0xff, (size_t)(__stop_rn_shared - __start_rn_shared));
    m.finished = m.arrived = 0;
    for (warp &w : m.warps)
        w.arrived = 0;
    for (fiber &f : m.fibers) {
        f.done = false;
        f.waits_on = NULL;
        f.group = 0;
    }
    while (m.finished < m.threads) {
        m.progress = false;
        // A warp goes as far as it can before the next one begins, unless all are shuffled.
        unsigned unit = m.policy == RN_EMU_RANDOM ? m.threads : (unsigned)LANES;
        for (m.first = 0; m.first < m.threads; m.first += unit)
            do
                run_unit(unit);
            while (m.unit_progress);
        if (!m.progress) die("the block waits for ever");
    }
}

inline void set_order() {
    m.order.resize(m.threads);
    for (unsigned i = 0; i < m.threads; i++)
        m.order[i] = m.policy == RN_EMU_BACKWARD ? m.threads - 1 - i : i;
    if (m.policy == RN_EMU_STARVE_FIRST)
        for (unsigned i = 0; i < m.threads; i++)
            m.order[i] = (i + LANES) % m.threads;
    if (m.policy == RN_EMU_RANDOM)
        for (unsigned i = m.threads; i > 1; i--) {
            m.random = m.random * 6364136223846793005u + 1442695040888963407u;
            std::swap(m.order[i - 1], m.order[(m.random >> 33) % i]);
        }
}

inline void make_fiber(fiber &f) {
    if (f.started) return;
    f.stack.resize(STACK);
    getcontext(&f.context);
    f.context.uc_stack.ss_sp = f.stack.data();
    f.context.uc_stack.ss_size = STACK;
    f.context.uc_link = NULL;
    makecontext(&f.context, fiber_main, 0);
}

inline void launch(const char *name, dim3 grid, dim3 block, size_t shared,
                   const std::function<void()> &body) {
    m.kernel = name;
    m.body = body;
    m.grid = grid;
    m.block = block;
    m.threads = block.x;
    if (m.threads % LANES || m.threads > 1024 || shared > SHARED) die("launched out of limits");
    if (m.fibers.size() < m.threads) m.fibers.resize(m.threads);
    m.warps.resize(m.threads / LANES);
    set_order();
    for (unsigned i = 0; i < m.threads; i++)
        make_fiber(m.fibers[i]);
    for (m.index.x = 0; m.index.x < grid.x; m.index.x++) {
        run_block();
        check_beyond(shared);
    }
}

extern const float *const half_values; // of all 65536 fp16 numbers
inline float half_value(uint32_t bits) {
    return half_values[bits & 0xffff];
}
inline uint32_t half_bits(float x) {
    _Float16 h = (_Float16)x;
    uint16_t bits;
    memcpy(&bits, &h, sizeof bits);
    return bits;
}

} // namespace emu

struct rn_emu_index {
    unsigned x;
};
#define threadIdx (rn_emu_index{emu::m.current})
#define blockIdx (emu::m.index)
#define blockDim (emu::m.block)
#define gridDim (emu::m.grid)

// ---- what device.cuh offers ------------------------------------------------------------------

RN_DEVICE unsigned char *rn_shared_memory() {
    return emu::m.shared;
}
RN_DEVICE void __syncthreads() {
    emu::barrier("__syncthreads");
}
RN_DEVICE void __syncwarp() {
    emu::collective("__syncwarp", [](emu::warp &) {});
}
RN_DEVICE void __threadfence() {}

RN_DEVICE uint32_t rn_shuffle_bits(uint32_t value, int from) {
    int lane = (int)(emu::m.current % 32);
    emu::warp &w = emu::m.warps[emu::m.current / 32];
    w.in[lane][0] = value;
    w.in[lane][1] = (uint32_t)from & 31;
    emu::collective("shuffle", [](emu::warp &w) {
        for (int i = 0; i < 32; i++)
            w.out[i][0] = w.in[w.in[i][1]][0];
    });
    return w.out[lane][0];
}
RN_DEVICE float rn_shuffle(float value, int from) {
    uint32_t bits;
    memcpy(&bits, &value, 4);
    bits = rn_shuffle_bits(bits, from);
    memcpy(&value, &bits, 4);
    return value;
}
RN_DEVICE int rn_shuffle(int value, int from) {
    return (int)rn_shuffle_bits((uint32_t)value, from);
}
RN_DEVICE uint32_t rn_ballot(bool vote) {
    int lane = (int)(emu::m.current % 32);
    emu::warp &w = emu::m.warps[emu::m.current / 32];
    w.in[lane][0] = vote;
    emu::collective("ballot", [](emu::warp &w) {
        uint32_t bits = 0;
        for (int i = 0; i < 32; i++)
            bits |= (w.in[i][0] & 1) << i;
        for (int i = 0; i < 32; i++)
            w.out[i][0] = bits;
    });
    return w.out[lane][0];
}
RN_DEVICE int rn_popcount(uint32_t bits) {
    return __builtin_popcount(bits);
}
RN_DEVICE int rn_lowest(uint32_t bits) {
    return __builtin_ctz(bits);
}

// As far off as the machine's may be, to the side that leaves the maps.
RN_DEVICE float rn_log2(float x) {
    return log2f(x) * (1 + 0x1p-22f) + 0x1p-22f;
}
RN_DEVICE float rn_root(float x) {
    return sqrtf(x) * (1 + 0x1p-22f);
}
RN_DEVICE float rn_divide(float x, float y) {
    return x / y * (1 + 0x1p-22f);
}
RN_DEVICE uint32_t rn_pack(float low, float high) {
    return emu::half_bits(low) | emu::half_bits(high) << 16;
}
RN_DEVICE float rn_low(uint32_t pair) {
    return emu::half_value(pair);
}
RN_DEVICE float rn_high(uint32_t pair) {
    return emu::half_value(pair >> 16);
}

namespace emu {
// D = A B + C of m16n8k16, the operands as the 32 lanes hold them; products exact, sums in fp32.
inline void multiply(warp &w) {
    static float a[16][16], b[16][8], c[16][8];
    for (int lane = 0; lane < 32; lane++) {
        int g = lane / 4, t = lane % 4;
        const uint32_t *in = w.in[lane];
        for (int r = 0; r < 4; r++)
            for (int i = 0; i < 2; i++)
                a[g + 8 * (r & 1)][2 * t + 8 * (r >> 1) + i] = half_value(in[r] >> (16 * i));
        for (int r = 0; r < 2; r++)
            for (int i = 0; i < 2; i++)
                b[2 * t + 8 * r + i][g] = half_value(in[4 + r] >> (16 * i));
        for (int r = 0; r < 4; r++)
            memcpy(&c[g + 8 * (r >> 1)][2 * t + (r & 1)], &in[6 + r], 4);
    }
    for (int i = 0; i < 16; i++)
        for (int k = 0; k < 16; k++)
            for (int j = 0; j < 8; j++)
                c[i][j] += a[i][k] * b[k][j];
    for (int lane = 0; lane < 32; lane++)
        for (int r = 0; r < 4; r++)
            memcpy(&w.out[lane][r], &c[lane / 4 + 8 * (r >> 1)][2 * (lane % 4) + (r & 1)], 4);
}
inline void transpose(warp &w) {
    for (int lane = 0; lane < 32; lane++) {
        int g = lane / 4, t = lane % 4;
        uint32_t pair = 0;
        for (int i = 0; i < 2; i++) {
            int row = 2 * t + i; // of the source; its column is g
            uint32_t word = w.in[row * 4 + g / 2][0];
            pair |= (word >> (16 * (g & 1)) & 0xffff) << (16 * i);
        }
        w.out[lane][0] = pair;
    }
}
} // namespace emu

RN_DEVICE void rn_mma(float (&c)[4], const uint32_t (&a)[4], uint32_t b0, uint32_t b1) {
    int lane = (int)(emu::m.current % 32);
    emu::warp &w = emu::m.warps[emu::m.current / 32];
    memcpy(w.in[lane], a, 16);
    w.in[lane][4] = b0;
    w.in[lane][5] = b1;
    memcpy(&w.in[lane][6], c, 16);
    emu::collective("mma", emu::multiply);
    memcpy(c, w.out[lane], 16);
}
RN_DEVICE uint32_t rn_transpose(uint32_t pair) {
    int lane = (int)(emu::m.current % 32);
    emu::warp &w = emu::m.warps[emu::m.current / 32];
    w.in[lane][0] = pair;
    emu::collective("movmatrix", emu::transpose);
    return w.out[lane][0];
}

RN_DEVICE void rn_copy_async(void *to, const void *from) {
    if (((uintptr_t)to | (uintptr_t)from) % 16) emu::die("asynchronous copy of unaligned bytes");
    emu::fiber &f = emu::m.fibers[emu::m.current];
    f.copies.push_back(emu::copy{to, from, f.group});
}
RN_DEVICE void rn_copy_commit() {
    emu::m.fibers[emu::m.current].group++;
}
template <int N> RN_DEVICE void rn_copy_wait() {
    emu::fiber &f = emu::m.fibers[emu::m.current];
    std::vector<emu::copy> open;
    for (const emu::copy &c : f.copies)
        if (c.group < f.group - N)
            memcpy(c.to, c.from, 16);
        else
            open.push_back(c);
    f.copies.swap(open);
}

template <typename T> RN_DEVICE T atomicAdd(T *to, T value) {
    T old = *to;
    *to += value;
    return old;
}
RN_DEVICE int atomicMax(int *to, int value) {
    int old = *to;
    if (value > old) *to = value;
    return old;
}
RN_DEVICE int atomicMin(int *to, int value) {
    int old = *to;
    if (value < old) *to = value;
    return old;
}
RN_DEVICE uint32_t atomicOr(uint32_t *to, uint32_t value) {
    uint32_t old = *to;
    *to |= value;
    return old;
}
RN_DEVICE int atomicExch(int *to, int value) {
    int old = *to;
    *to = value;
    return old;
}
RN_DEVICE void rn_red_half4(uint2 *to, uint32_t a, uint32_t b) {
    if ((uintptr_t)to % 8) emu::die("vector red to unaligned bytes");
    to->x = rn_pack(rn_low(to->x) + rn_low(a), rn_high(to->x) + rn_high(a));
    to->y = rn_pack(rn_low(to->y) + rn_low(b), rn_high(to->y) + rn_high(b));
}

#include "runtime.hpp"

#endif

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

// Stacks of which not all begin at the same place of a cache.
enum { LANES = 32, STACK = (64 << 10) + 576, SHARED = 227 << 10 };

struct copy {
    void *to;
    const void *from;
    int group;
};
struct alignas(64) fiber {
    const uint64_t *waits_on; // runnable when *waits_on != waited
    uint64_t waited;
    void *jump[5]; // __builtin_setjmp's: the library's saves and hides more than a fiber has
    bool started = false, done;
    int group;
    std::vector<copy> copies;
    std::vector<char> stack;
    ucontext_t context;
};
struct warp {
    const char *operation;
    int arrived;
    uint64_t generation;
    uint32_t in[10][LANES], out[4][LANES];
};
struct machine {
    std::vector<fiber> fibers;
    std::vector<warp> warps;
    std::vector<unsigned> order;
    const char *kernel = "", *barrier = "";
    std::function<void()> body;
    void *scheduler[5];
    unsigned turn = 0, end = 0; // places in `order`: whose turn is next, and the part's end
    bool progress = false;      // of the part
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

[[noreturn, gnu::noinline]] inline void jump(void **to) {
    __builtin_longjmp(to, 1);
}
// To the next runnable thread of the part, or back to the scheduler.
[[noreturn]] inline void next() {
    while (m.turn < m.end) {
        m.current = m.order[m.turn++];
        fiber &f = m.fibers[m.current];
        if (f.done || (f.waits_on && *f.waits_on == f.waited)) continue;
        m.progress = true;
        f.waits_on = NULL;
        if (f.started) jump(f.jump);
        f.started = true;
        setcontext(&f.context);
    }
    jump(m.scheduler);
}
[[gnu::noinline]] inline void yield() {
    if (__builtin_setjmp(m.fibers[m.current].jump) == 0) next();
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
[[gnu::noinline]] inline void run_part(unsigned first, unsigned count) {
    m.progress = false;
    m.turn = first;
    m.end = first + count;
    if (__builtin_setjmp(m.scheduler) == 0) next();
}

// What lies behind the shared memory that the launch asked for is still as it was, after all blocks.
inline void check_beyond(size_t bytes) {
    const unsigned char *beyond = m.shared + bytes;
    if (bytes < SHARED && (*beyond != 0xff || memcmp(beyond, beyond + 1, SHARED - bytes - 1) != 0))
        die("wrote behind its shared memory");
}

inline void run_block(size_t shared) {
    memset(m.shared, 0xff, shared);
    memset(__start_rn_shared, 0xff, (size_t)(__stop_rn_shared - __start_rn_shared));
    m.finished = m.arrived = 0;
    for (warp &w : m.warps)
        w.arrived = 0;
    for (fiber &f : m.fibers) {
        f.done = false;
        f.waits_on = NULL;
        f.group = 0;
    }
    // A warp goes as far as it can before the next one begins, unless all are shuffled.
    unsigned part = m.policy == RN_EMU_RANDOM ? m.threads : (unsigned)LANES;
    for (bool progress = true; m.finished < m.threads;) {
        if (!progress) die("the block waits for ever");
        progress = false;
        for (unsigned first = 0; first < m.threads; first += part)
            for (run_part(first, part); m.progress; run_part(first, part))
                progress = true;
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
    memset(m.shared + shared, 0xff, SHARED - shared);
    for (m.index.x = 0; m.index.x < grid.x; m.index.x++)
        run_block(shared);
    check_beyond(shared);
}

inline float as_float(uint32_t bits) {
    float x;
    memcpy(&x, &bits, sizeof x);
    return x;
}
inline uint32_t as_bits(float x) {
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}
// fp16 and back, as the machine has them; _Float16 is a call where the compiler may not take F16C for granted.
inline float half_value(uint32_t bits) { // without branches, so that 32 are taken at once
    uint32_t magnitude = (bits & 0x7fff) << 13, exponent = magnitude & 0x7c00 << 13;
    uint32_t is_tiny = -(uint32_t)(exponent == 0), is_none = -(uint32_t)(exponent == 0x7c00 << 13);
    uint32_t normal = magnitude + ((127 - 15) << 23) + (is_none & (128 - 16) << 23);
    uint32_t tiny = as_bits(as_float(normal + (1 << 23)) - 0x1p-14f);
    return as_float((tiny & is_tiny) | (normal & ~is_tiny) | (bits & 0x8000) << 16);
}
// To the nearest, ties to even.
inline uint32_t half_bits(float x) {
    uint32_t magnitude = as_bits(x) & 0x7fffffff, sign = as_bits(x) >> 16 & 0x8000;
    if (magnitude > 0x7f800000) return sign | 0x7e00 | (magnitude >> 13 & 0x3ff);
    if (magnitude >= (127 + 16) << 23) return sign | 0x7c00;
    if (magnitude < (127 - 14) << 23) // the sum's last bits are what it is in units of 2^-24
        return sign | (as_bits(as_float(magnitude) + 0.5f) - as_bits(0.5f));
    return sign | (magnitude + ((uint32_t)(15 - 127) << 23) + 0xfff + (magnitude >> 13 & 1)) >> 13;
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
    w.in[0][lane] = value;
    w.in[1][lane] = (uint32_t)from & 31;
    emu::collective("shuffle", [](emu::warp &w) {
        for (int i = 0; i < 32; i++)
            w.out[0][i] = w.in[0][w.in[1][i]];
    });
    return w.out[0][lane];
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
    w.in[0][lane] = vote;
    emu::collective("ballot", [](emu::warp &w) {
        uint32_t bits = 0;
        for (int i = 0; i < 32; i++)
            bits |= (w.in[0][i] & 1) << i;
        for (int i = 0; i < 32; i++)
            w.out[0][i] = bits;
    });
    return w.out[0][lane];
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
    typedef float row __attribute__((vector_size(32)));
    static float pairs[6][2][LANES], a[16][16];
    static row b[16], c[16];
    for (int r = 0; r < 6; r++)
        for (int i = 0; i < 2; i++)
            for (int lane = 0; lane < LANES; lane++)
                pairs[r][i][lane] = half_value(w.in[r][lane] >> (16 * i));
    for (int lane = 0; lane < LANES; lane++) {
        int g = lane / 4, t = lane % 4;
        for (int i = 0; i < 2; i++) {
            for (int r = 0; r < 4; r++)
                a[g + 8 * (r & 1)][2 * t + 8 * (r >> 1) + i] = pairs[r][i][lane];
            for (int r = 0; r < 2; r++)
                b[2 * t + 8 * r + i][g] = pairs[4 + r][i][lane];
        }
        for (int r = 0; r < 4; r++)
            c[g + 8 * (r >> 1)][2 * t + (r & 1)] = as_float(w.in[6 + r][lane]);
    }
    for (int i = 0; i < 16; i++)
        for (int k = 0; k < 16; k++)
            c[i] += a[i][k] * b[k];
    for (int lane = 0; lane < LANES; lane++)
        for (int r = 0; r < 4; r++)
            w.out[r][lane] = as_bits(c[lane / 4 + 8 * (r >> 1)][2 * (lane % 4) + (r & 1)]);
}
inline void transpose(warp &w) {
    for (int lane = 0; lane < 32; lane++) {
        int g = lane / 4, t = lane % 4;
        uint32_t pair = 0;
        for (int i = 0; i < 2; i++) {
            int row = 2 * t + i; // of the source; its column is g
            uint32_t word = w.in[0][row * 4 + g / 2];
            pair |= (word >> (16 * (g & 1)) & 0xffff) << (16 * i);
        }
        w.out[0][lane] = pair;
    }
}
} // namespace emu

RN_DEVICE void rn_mma(float (&c)[4], const uint32_t (&a)[4], uint32_t b0, uint32_t b1) {
    int lane = (int)(emu::m.current % 32);
    emu::warp &w = emu::m.warps[emu::m.current / 32];
    for (int r = 0; r < 4; r++) {
        w.in[r][lane] = a[r];
        w.in[6 + r][lane] = emu::as_bits(c[r]);
    }
    w.in[4][lane] = b0;
    w.in[5][lane] = b1;
    emu::collective("mma", emu::multiply);
    for (int r = 0; r < 4; r++)
        c[r] = emu::as_float(w.out[r][lane]);
}
RN_DEVICE uint32_t rn_transpose(uint32_t pair) {
    int lane = (int)(emu::m.current % 32);
    emu::warp &w = emu::m.warps[emu::m.current / 32];
    w.in[0][lane] = pair;
    emu::collective("movmatrix", emu::transpose);
    return w.out[0][lane];
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

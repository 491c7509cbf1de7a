// What the kernels use of the machine, behind small functions: each is one or two instructions here
// and a fiber operation where the tests run the same source on a CPU (emulator.hpp).
//
// Fragments are those of mma.sync m16n8k16 (PTX ISA, "Matrix fragments for mma.m16n8k16"): lane
// 4 g + t holds of A rows g and g + 8, columns 2t, 2t + 1, 2t + 8, 2t + 9; of B rows 2t .. and
// column g; of C rows g and g + 8, columns 2t and 2t + 1.
#ifndef RN_ENGINE_CUDA_DEVICE_CUH
#define RN_ENGINE_CUDA_DEVICE_CUH

#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __CUDACC__
#include <cuda_runtime.h>

#define RN_DEVICE static __device__ __forceinline__
#define RN_SHARED __shared__
#define RN_UNROLL _Pragma("unroll")
#define RN_UNROLL_8 _Pragma("unroll 8")
#define RN_ROLLED _Pragma("unroll 1")
#define RN_LAUNCH(kernel, grid, block, shared, stream, ...)                                        \
    (kernel<<<grid, block, shared, stream>>>(__VA_ARGS__), cudaGetLastError())

// The block's dynamic shared memory, 128-byte aligned.
RN_DEVICE unsigned char *rn_shared_memory() {
    extern __shared__ __align__(128) unsigned char memory[];
    return memory;
}

// Warp operations: all 32 lanes take part.
RN_DEVICE float rn_shuffle(float value, int from) {
    return __shfl_sync(0xffffffffu, value, from);
}
RN_DEVICE int rn_shuffle(int value, int from) {
    return __shfl_sync(0xffffffffu, value, from);
}
RN_DEVICE uint32_t rn_ballot(bool vote) {
    return __ballot_sync(0xffffffffu, vote);
}
RN_DEVICE int rn_popcount(uint32_t bits) {
    return __popc(bits);
}
RN_DEVICE int rn_lowest(uint32_t bits) { // of bits that are not all zero
    return __ffs((int)bits) - 1;
}

// The machine's own functions, to about 2^-21, of few instructions. The logarithm is not exact at
// powers of two.
RN_DEVICE float rn_log2(float x) {
    return __log2f(x);
}
RN_DEVICE float rn_root(float x) {
    float root;
    asm("sqrt.approx.f32 %0, %1;" : "=f"(root) : "f"(x));
    return root;
}
RN_DEVICE float rn_divide(float x, float y) { // |y| below 2^126
    return __fdividef(x, y);
}

// Two fp16 numbers in a word, rounded to nearest; and back.
RN_DEVICE uint32_t rn_pack(float low, float high) {
    uint32_t pair;
    asm("cvt.rn.f16x2.f32 %0, %1, %2;" : "=r"(pair) : "f"(high), "f"(low));
    return pair;
}
RN_DEVICE float rn_low(uint32_t pair) {
    float x;
    asm("{ .reg .b16 l, h; mov.b32 {l, h}, %1; cvt.f32.f16 %0, l; }" : "=f"(x) : "r"(pair));
    return x;
}
RN_DEVICE float rn_high(uint32_t pair) {
    float x;
    asm("{ .reg .b16 l, h; mov.b32 {l, h}, %1; cvt.f32.f16 %0, h; }" : "=f"(x) : "r"(pair));
    return x;
}

// c += A B: fp16 operands, fp32 sums.
RN_DEVICE void rn_mma(float (&c)[4], const uint32_t (&a)[4], uint32_t b0, uint32_t b1) {
    asm volatile("mma.sync.aligned.m16n8k16.row.col.f32.f16.f16.f32 {%0, %1, %2, %3}, "
                 "{%4, %5, %6, %7}, {%8, %9}, {%0, %1, %2, %3};"
                 : "+f"(c[0]), "+f"(c[1]), "+f"(c[2]), "+f"(c[3])
                 : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "r"(b0), "r"(b1));
}
// The transpose of an 8x8 fp16 matrix, lane 4 g + t holding row g, columns 2t and 2t + 1.
RN_DEVICE uint32_t rn_transpose(uint32_t pair) {
    uint32_t out;
    asm volatile("movmatrix.sync.aligned.m8n8.trans.b16 %0, %1;" : "=r"(out) : "r"(pair));
    return out;
}

// Asynchronous copy of 16 aligned bytes from global to shared memory; the thread's copies so far
// become a group; waits for all groups of this thread but the newest N (others' need a barrier
// after it).
RN_DEVICE void rn_copy_async(void *to, const void *from) {
    uint32_t address = (uint32_t)__cvta_generic_to_shared(to);
    asm volatile("cp.async.cg.shared.global [%0], [%1], 16;" ::"r"(address), "l"(from) : "memory");
}
RN_DEVICE void rn_copy_commit() {
    asm volatile("cp.async.commit_group;" ::: "memory");
}
template <int N> RN_DEVICE void rn_copy_wait() {
    asm volatile("cp.async.wait_group %0;" ::"n"(N) : "memory");
}

// Adds four fp16 numbers to four in global memory, 8-byte aligned: one instruction from sm_90 on.
RN_DEVICE void rn_red_half4(uint2 *to, uint32_t a, uint32_t b) {
#if __CUDA_ARCH__ >= 900
    asm volatile("red.global.add.noftz.v2.f16x2 [%0], {%1, %2};" ::"l"(to), "r"(a), "r"(b)
                 : "memory");
#else
    asm volatile("red.global.add.noftz.f16x2 [%0], %1;" ::"l"(&to->x), "r"(a) : "memory");
    asm volatile("red.global.add.noftz.f16x2 [%0], %1;" ::"l"(&to->y), "r"(b) : "memory");
#endif
}
#else
#include <emulator.hpp>
#endif

#define RN_LANES 32
#define RN_LANE ((int)(threadIdx.x % RN_LANES))

RN_DEVICE float rn_shuffle_xor(float value, int mask) {
    return rn_shuffle(value, RN_LANE ^ mask);
}
RN_DEVICE float rn_warp_sum(float value) {
    for (int mask = 16; mask > 0; mask /= 2)
        value += rn_shuffle_xor(value, mask);
    return value;
}

// Sum of x over the lanes before this one, of each part of `lanes` lanes. The lane's own x is never
// in it: a large one would cost what lies before it its digits.
template <typename T> RN_DEVICE T rn_sum_before(T x, int lanes) {
    T before = rn_shuffle(x, RN_LANE - 1), sum = RN_LANE % lanes > 0 ? before : 0;
    for (int d = 1; d < lanes; d *= 2) {
        T other = rn_shuffle(sum, RN_LANE - d);
        if (RN_LANE % lanes >= d) sum += other;
    }
    return sum;
}

#endif

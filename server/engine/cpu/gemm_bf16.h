// Products of bf16 numbers with fp32 sums, 32 rows at a time: AMX tiles where the set has them,
// else VDPBF16PS. Denormal numbers count as zero in both.
//
// Three forms of a matrix, in bf16:
//   rows:    [row][k], rows of a multiple of 32 numbers: the left operand.
//   columns: the same of the transposed matrix, when the sum runs over its rows.
//   pairs:   tiles of 32 k x 16 columns, [k / 2][column][k % 2]: the right operand.
#ifndef RN_ENGINE_CPU_GEMM_BF16_H
#define RN_ENGINE_CPU_GEMM_BF16_H

#include <stdbool.h>

#include "server/engine/cpu/simd.h"

#define RN_TILE_K 32  // numbers of k in a tile
#define RN_TILE 512   // numbers of a tile of pairs
#define RN_TILES_M 32 // rows of a product, at most

RN_INLINE int round32(int n) {
    return (n + 31) & ~31;
}

// c[rows][16 or 32] (+)= a[rows][k] b[k][16 or 32]. What is beyond k up to whole tiles is zero, and
// c and a have 32 rows: AMX computes with both.
struct bf16_product {
    const uint16_t *a; // rows
    int a_stride;      // numbers
    const uint16_t *b; // pairs
    int b_k, b_n;      // numbers from a tile of b to the next along k, and along the columns
    int k;             // a multiple of 2
    int rows;          // a multiple of 8
    float *c;
    int c_stride;
    bool accumulate, wide; // wide: 32 columns
};

#ifdef __AMX_BF16__

struct tile_config {
    uint8_t palette, start_row, reserved[14];
    uint16_t row_bytes[16];
    uint8_t rows[16];
};

// Products begin and end here; between, the tiles are in use. A product's sums are stored when the
// next one needs their tiles, or by products_flush: a tile that is stored at once waits for its
// products' latency, and all behind it.
enum { PRODUCT_SUMS = 1 }; // places for sums that follow each other
struct products {
    float *c; // of the last product, NULL: stored
    size_t c_bytes;
    bool wide;
};

static void products_begin(struct products *s) {
    _Alignas(64) static const struct tile_config config = {
        .palette = 1,
        .row_bytes = {64, 64, 64, 64, 64, 64, 64, 64},
        .rows = {16, 16, 16, 16, 16, 16, 16, 16}};
    __asm__ volatile("" ::"m"(config) : "memory");
    _tile_loadconfig(&config);
    s->c = NULL;
}

static void products_flush(struct products *s) {
    if (!s->c) return;
    float *lower = s->c + s->c_bytes * 4; // 16 rows
    _tile_stored(0, s->c, s->c_bytes);
    _tile_stored(1, lower, s->c_bytes);
    if (s->wide) _tile_stored(2, s->c + 16, s->c_bytes);
    if (s->wide) _tile_stored(3, lower + 16, s->c_bytes);
    s->c = NULL;
}

static void products_end(struct products *s) {
    products_flush(s);
    _tile_release();
}

// The tiles' unit falls asleep 300 ns after its last product and then takes as long to wake
// (measured on a Sapphire Rapids): between products, long work with vectors calls this now and
// then. The product is of no use; tile 7 is loaded before it is read.
RN_INLINE void products_keep_awake(void) {
    _tile_dpbf16ps(7, 4, 6);
}

// Stores the last product's sum TILE, if it has that, and begins the next one's there.
#define TURN_TILE(TILE, USED, STORED, C, A, B)                                                     \
    if (last.c && (STORED)) _tile_stored(TILE, last.c + offset_##TILE, last.c_bytes);              \
    if (USED) {                                                                                    \
        if (p->accumulate)                                                                         \
            _tile_loadd(TILE, C, c_bytes);                                                         \
        else                                                                                       \
            _tile_zero(TILE);                                                                      \
        _tile_dpbf16ps(TILE, A, B);                                                                \
    }

// Tiles 0-3 are sums, 4 and 5 rows, 6 and 7 pairs.
RN_INLINE void product_tiles(struct products *s, const struct bf16_product *p, const bool WIDE) {
    const struct products last = *s;
    const size_t offset_0 = 0, offset_1 = last.c_bytes * 4, offset_2 = 16, offset_3 = offset_1 + 16;
    size_t a_bytes = (size_t)p->a_stride * 2, c_bytes = (size_t)p->c_stride * 4;
    const uint16_t *a = p->a, *b = p->b, *lower = p->a + (size_t)16 * p->a_stride;
    float *c = p->c, *c_lower = p->c + (size_t)16 * p->c_stride;
    __asm__ volatile("" ::: "memory"); // what the tiles read is stored before
    _tile_loadd(4, a, a_bytes);
    _tile_loadd(6, b, 64);
    _tile_loadd(5, lower, a_bytes);
    if (WIDE) _tile_loadd(7, b + p->b_n, 64);
    TURN_TILE(0, true, true, c, 4, 6)
    TURN_TILE(1, true, true, c_lower, 5, 6)
    TURN_TILE(2, WIDE, last.wide, c + 16, 4, 7)
    TURN_TILE(3, WIDE, last.wide, c_lower + 16, 5, 7)
    for (int k = RN_TILE_K; k < p->k; k += RN_TILE_K) {
        a += RN_TILE_K;
        lower += RN_TILE_K;
        b += p->b_k;
        _tile_loadd(4, a, a_bytes);
        _tile_loadd(6, b, 64);
        _tile_loadd(5, lower, a_bytes);
        if (WIDE) _tile_loadd(7, b + p->b_n, 64);
        _tile_dpbf16ps(0, 4, 6);
        _tile_dpbf16ps(1, 5, 6);
        if (WIDE) _tile_dpbf16ps(2, 4, 7);
        if (WIDE) _tile_dpbf16ps(3, 5, 7);
    }
    *s = (struct products){.c = c, .c_bytes = c_bytes, .wide = WIDE};
}

#else

enum { PRODUCT_SUMS = 2 };
struct products {
    bool unused;
};
static void products_begin(struct products *s) {}
static void products_flush(struct products *s) {}
RN_INLINE void products_keep_awake(void) {}
static void products_end(struct products *s) {}

enum { PRODUCT_ROWS = 8 }; // times 2 sums in registers

RN_INLINE void product_rows(const struct bf16_product *p, int row, const bool WIDE) {
    __m512 sum[PRODUCT_ROWS][2];
    const uint16_t *a = p->a + (size_t)row * p->a_stride;
    float *c = p->c + (size_t)row * p->c_stride;
#pragma GCC unroll 8
    for (int i = 0; i < PRODUCT_ROWS; i++)
#pragma GCC unroll 2
        for (int j = 0; j < 1 + WIDE; j++)
            sum[i][j] = p->accumulate ? _mm512_loadu_ps(c + (size_t)i * p->c_stride + 16 * j)
                                      : _mm512_setzero_ps();
    const uint16_t *tile = p->b;
    for (int k = 0; k < p->k; k += RN_TILE_K, a += RN_TILE_K, tile += p->b_k) {
        const int count = p->k - k < RN_TILE_K ? p->k - k : RN_TILE_K;
        for (int pair = 0; pair < count; pair += 2) {
            const uint16_t *b = tile + pair * 16;
            __m512i b0 = _mm512_loadu_si512(b);
            __m512i b1 = WIDE ? _mm512_loadu_si512(b + p->b_n) : b0;
#pragma GCC unroll 8
            for (int i = 0; i < PRODUCT_ROWS; i++) {
                int32_t both;
                memcpy(&both, a + (size_t)i * p->a_stride + pair, 4);
                __m512bh ai = (__m512bh)_mm512_set1_epi32(both);
                sum[i][0] = _mm512_dpbf16_ps(sum[i][0], ai, (__m512bh)b0);
                if (WIDE) sum[i][1] = _mm512_dpbf16_ps(sum[i][1], ai, (__m512bh)b1);
            }
        }
    }
#pragma GCC unroll 8
    for (int i = 0; i < PRODUCT_ROWS; i++)
#pragma GCC unroll 2
        for (int j = 0; j < 1 + WIDE; j++)
            _mm512_storeu_ps(c + (size_t)i * p->c_stride + 16 * j, sum[i][j]);
}

RN_INLINE void product_tiles(struct products *s, const struct bf16_product *p, const bool WIDE) {
    for (int row = 0; row < p->rows; row += PRODUCT_ROWS)
        product_rows(p, row, WIDE);
}

#endif

static void product(struct products *s, const struct bf16_product *p) {
    if (p->wide)
        product_tiles(s, p, true);
    else
        product_tiles(s, p, false);
}

// ---- conversions, to nearest, ties to even ------------------------------------------------------

RN_INLINE __m512i bf16_of(__m512 low, __m512 high) {
    return (__m512i)_mm512_cvtne2ps_pbh(high, low);
}

RN_INLINE __mmask16 first_lanes(int count) {
    return count >= 16 ? 0xffff : count > 0 ? (__mmask16)((1u << count) - 1) : 0;
}

// Between products_begin and products_end: rows of `count` numbers; columns from `count` to
// `to_stride` and rows up to a multiple of 32 are zero.
static void rows_from(const float *from, int from_stride, int rows, int count, uint16_t *to,
                      int to_stride) {
    for (int k = 0; k < to_stride; k += 32) {
        const __mmask16 low = first_lanes(count - k), high = first_lanes(count - k - 16);
        for (int i = 0; i < rows; i++) {
            const float *row = from + (size_t)i * from_stride + k;
            if (i % 32 == 31) products_keep_awake();
            _mm512_storeu_si512(
                to + (size_t)i * to_stride + k,
                bf16_of(_mm512_maskz_loadu_ps(low, row), _mm512_maskz_loadu_ps(high, row + 16)));
        }
    }
    if (rows % 32)
        memset(to + (size_t)rows * to_stride, 0,
               (size_t)(round32(rows) - rows) * (size_t)to_stride * sizeof *to);
}

// One line of a tile of pairs, from 16 columns of two rows of fp32 numbers.
RN_INLINE __m512i pair_of(__m512 even, __m512 odd) {
    const __m512i order =
        _mm512_set_epi16(31, 15, 30, 14, 29, 13, 28, 12, 27, 11, 26, 10, 25, 9, 24, 8, 23, 7, 22, 6,
                         21, 5, 20, 4, 19, 3, 18, 2, 17, 1, 16, 0);
    return _mm512_permutexvar_epi16(order, bf16_of(even, odd));
}

// Tiles [column / 16][k / 32] of pairs from fp32 rows of `columns` numbers; k rounded up with zero.
static void pairs_from(const float *from, int k_count, int columns, uint16_t *to) {
    const __m512 zero = _mm512_setzero_ps();
    for (int column = 0; column < columns; column += 16)
        for (int k = 0; k < round32(k_count); k += 2, to += 32) {
            const float *even = from + (size_t)k * columns + column;
            __m512 a = k < k_count ? _mm512_loadu_ps(even) : zero;
            __m512 b = k + 1 < k_count ? _mm512_loadu_ps(even + columns) : zero;
            _mm512_storeu_si512(to, pair_of(a, b));
        }
}

// Two lines of tiles of pairs, from 32 columns of two rows.
RN_INLINE void store_pairs(__m512i even, __m512i odd, bool wide, uint16_t *to) {
    const __m512i low = _mm512_set_epi16(47, 15, 46, 14, 45, 13, 44, 12, 43, 11, 42, 10, 41, 9, 40,
                                         8, 39, 7, 38, 6, 37, 5, 36, 4, 35, 3, 34, 2, 33, 1, 32, 0);
    const __m512i high = _mm512_add_epi16(low, _mm512_set1_epi16(16));
    _mm512_storeu_si512(to, _mm512_permutex2var_epi16(even, low, odd));
    if (wide) _mm512_storeu_si512(to + RN_TILE, _mm512_permutex2var_epi16(even, high, odd));
}

// 8 numbers of rows 0, 8, 16 and 24.
RN_INLINE __m512i four_rows(const uint16_t *from, size_t stride) {
    __m512i x = _mm512_castsi128_si512(_mm_loadu_si128((const __m128i *)from));
    x = _mm512_inserti32x4(x, _mm_loadu_si128((const __m128i *)(from + 8 * stride)), 1);
    x = _mm512_inserti32x4(x, _mm_loadu_si128((const __m128i *)(from + 16 * stride)), 2);
    return _mm512_inserti32x4(x, _mm_loadu_si128((const __m128i *)(from + 24 * stride)), 3);
}

// 32 rows of 8 numbers to 8 rows of 32: words, double words and quad words change places.
RN_INLINE void transpose_32x8(const uint16_t *from, size_t stride, uint16_t *to, size_t to_stride) {
    __m512i x[8], y[8];
#pragma GCC unroll 8
    for (int i = 0; i < 8; i++)
        x[i] = four_rows(from + (size_t)i * stride, stride);
#pragma GCC unroll 4
    for (int i = 0; i < 8; i += 2) {
        y[i] = _mm512_unpacklo_epi16(x[i], x[i + 1]);
        y[i + 1] = _mm512_unpackhi_epi16(x[i], x[i + 1]);
    }
#pragma GCC unroll 2
    for (int i = 0; i < 8; i += 4)
#pragma GCC unroll 2
        for (int j = 0; j < 2; j++) {
            x[i + 2 * j] = _mm512_unpacklo_epi32(y[i + j], y[i + j + 2]);
            x[i + 2 * j + 1] = _mm512_unpackhi_epi32(y[i + j], y[i + j + 2]);
        }
#pragma GCC unroll 4
    for (int i = 0; i < 4; i++) {
        _mm512_storeu_si512(to + (2 * i) * to_stride, _mm512_unpacklo_epi64(x[i], x[i + 4]));
        _mm512_storeu_si512(to + (2 * i + 1) * to_stride, _mm512_unpackhi_epi64(x[i], x[i + 4]));
    }
}

// Between products_begin and products_end: columns of rows, `rows` and `columns` multiples of 32.
static void columns_of_rows(const uint16_t *from, int stride, int rows, int columns, uint16_t *to,
                            int to_stride) {
    for (int i = 0; i < rows; i += 32)
        for (int k = 0; k < columns; k += 8) {
            transpose_32x8(from + (size_t)i * stride + k, (size_t)stride,
                           to + (size_t)k * to_stride + i, (size_t)to_stride);
            if (k % 32 == 24) products_keep_awake();
        }
}

#endif

#include "server/engine/bench/machine.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "common/base/threads.h"
#include "server/engine/bench/peak.h"
#include "server/engine/cpu/dispatch.h"

double rn_bench_least(double seconds, void (*work)(void *context), void *context) {
    double least = INFINITY;
    int64_t begin = rn_clock_ns(), now = begin;
    for (int calls = 0; calls < 3 || (double)(now - begin) * 1e-9 < seconds; calls++) {
        int64_t start = rn_clock_ns();
        work(context);
        now = rn_clock_ns();
        least = fmin(least, (double)(now - start) * 1e-9);
    }
    return least;
}

// ---- arithmetic -----------------------------------------------------------------------------

struct peak {
    rn_peak_function *function;
    size_t rounds;
    double macs;
    float sink;
};

static void run_peak(void *context) {
    struct peak *p = context;
    p->macs = p->function(p->rounds, &p->sink);
}

static double measure_peak(rn_peak_function *function, double seconds) {
    if (!function) return NAN;
    struct peak p = {.function = function, .rounds = 20000};
    double least = rn_bench_least(seconds, run_peak, &p);
    return p.macs / least * 1e-9;
}

#if defined(__x86_64__)
static rn_peak_function *fma_of(const char *kernels) {
    __builtin_cpu_init();
    if (strncmp(kernels, "avx2", 4) == 0 && __builtin_cpu_supports("fma")) return rn_peak_avx2;
    bool wide = strncmp(kernels, "avx512", 6) == 0 || strncmp(kernels, "amx", 3) == 0;
    if (wide && rn_cpu_has_avx512()) return rn_peak_avx512;
    return rn_peak_generic;
}

static void measure_units(double seconds, struct rn_bench_machine *m) {
    m->bf16_dot = measure_peak(rn_cpu_has_bf16() ? rn_peak_bf16 : NULL, seconds);
    bool amx = rn_cpu_has_amx();
    m->amx_bf16 = measure_peak(amx ? rn_peak_amx : NULL, seconds);
    m->amx_bf16_l1 = measure_peak(amx ? rn_peak_amx_l1 : NULL, seconds);
}
#else
static rn_peak_function *fma_of(const char *kernels) {
    (void)kernels;
    return rn_peak_generic;
}

static void measure_units(double seconds, struct rn_bench_machine *m) {
    (void)seconds;
    m->bf16_dot = m->amx_bf16 = m->amx_bf16_l1 = NAN;
}
#endif

// ---- memory ---------------------------------------------------------------------------------

#define LINES_A_CALL 65536
#define STREAMS 4                      // places at once, as the optimiser visits its arrays
#define STREAM_WORDS ((size_t)1 << 17) // words of each stream a call, or all

struct array {
    uint64_t *words;
    size_t lines; // of 8 words
    uint64_t state, sum;
};

// Addresses from a counter's hash: every load may start before the last one ends.
static void read_lines(void *context) {
    struct array *a = context;
    uint64_t sum = 0, x = a->state;
    for (int i = 0; i < LINES_A_CALL; i++) {
        x += 0x9e3779b97f4a7c15u;
        uint64_t hash = (x ^ x >> 32) * 0xd1342543de82ef95u >> 32;
        sum += a->words[(hash * a->lines >> 32) * 8];
    }
    a->state = x;
    a->sum += sum;
}

// The next part of each stream: its first word and its words.
static size_t next_part(struct array *a, size_t *ret_words) {
    size_t words = a->lines / STREAMS * 8, n = words < STREAM_WORDS ? words : STREAM_WORDS;
    size_t at = a->state + n <= words ? a->state : 0;
    a->state = at + n;
    *ret_words = n;
    return at;
}

static void read_stream(void *context) {
    struct array *a = context;
    size_t n, at = next_part(a, &n), stride = a->lines / STREAMS * 8;
    uint64_t sum[8] = {0};
    for (size_t i = at; i < at + n; i += 8)
        for (size_t stream = 0; stream < STREAMS; stream++)
            for (size_t j = 0; j < 8; j++)
                sum[j] += a->words[stream * stride + i + j];
    for (int j = 0; j < 8; j++)
        a->sum += sum[j];
}

static void update_stream(void *context) {
    struct array *a = context;
    size_t n, at = next_part(a, &n), stride = a->lines / STREAMS * 8;
    for (size_t i = at; i < at + n; i += 8)
        for (size_t stream = 0; stream < STREAMS; stream++)
            for (size_t j = 0; j < 8; j++)
                a->words[stream * stride + i + j] += 3;
}

static bool array_init(double bytes, struct array *a) {
    void *memory = NULL;
    *a = (struct array){.lines = bytes > 65536 ? (size_t)bytes / 64 : 1024};
    if (posix_memalign(&memory, 2u << 20, a->lines * 64) != 0) return false;
    memset(memory, 1, a->lines * 64);
    a->words = memory;
    return true;
}

static double measure(enum rn_bench_memory kind, double seconds, struct array *a) {
    static void (*const work[])(void *) = {read_lines, read_stream, update_stream};
    size_t words = a->lines / STREAMS * 8, n = words < STREAM_WORDS ? words : STREAM_WORDS;
    double bytes = (double)(n * STREAMS * sizeof(uint64_t));
    a->state = 0;
    double ns = rn_bench_least(seconds, work[kind], a) * 1e9;
    volatile uint64_t keep = a->sum;
    (void)keep;
    if (kind == RN_BENCH_LINES) return ns / LINES_A_CALL;
    return ns / (kind == RN_BENCH_UPDATE ? 2 * bytes : bytes);
}

double rn_bench_memory_ns(enum rn_bench_memory kind, double bytes, double seconds) {
    struct array a;
    if (!array_init(bytes, &a)) return NAN;
    double ns = measure(kind, seconds, &a);
    free(a.words);
    return ns;
}

static void measure_array(int index, double seconds, struct rn_bench_machine *m) {
    struct array a;
    m->random_line_ns[index] = m->stream_gbs[index] = NAN;
    if (!array_init(m->array_mb[index] * 1048576, &a)) return;
    m->random_line_ns[index] = measure(RN_BENCH_LINES, seconds, &a);
    m->stream_gbs[index] = 1 / measure(RN_BENCH_STREAM, seconds, &a);
    free(a.words);
}

void rn_bench_machine_measure(const char *kernels, double seconds, struct rn_bench_machine *m) {
    static const double sizes[RN_BENCH_ARRAYS] = {1, 8, 32, 512};
    double each = seconds / (4 + 2 * RN_BENCH_ARRAYS);
    m->cores = rn_usable_cores();
    m->fma = measure_peak(fma_of(kernels), each);
    measure_units(each, m);
    for (int i = 0; i < RN_BENCH_ARRAYS; i++) {
        m->array_mb[i] = sizes[i];
        measure_array(i, each, m);
    }
}

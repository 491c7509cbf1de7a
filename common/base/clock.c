#include "common/base/clock.h"

#include <stdbool.h>
#include <stddef.h>
#include <time.h>

static int64_t (*monotonic_source)(void);
static int64_t (*wall_source)(void);

static int64_t read_clock(clockid_t id, int64_t units_per_s) {
    struct timespec now = {0};
    clock_gettime(id, &now); // cannot fail for these ids
    return (int64_t)now.tv_sec * units_per_s + (int64_t)now.tv_nsec / (1000000000 / units_per_s);
}

int64_t rn_clock_ns(void) {
    return monotonic_source ? monotonic_source() : read_clock(CLOCK_MONOTONIC, 1000000000);
}

int64_t rn_clock_thread_ns(void) {
    return read_clock(CLOCK_THREAD_CPUTIME_ID, 1000000000);
}

int64_t rn_clock_wall_ms(void) {
    return wall_source ? wall_source() : read_clock(CLOCK_REALTIME, 1000);
}

static int64_t begin_ns, begin_wall_ms;

__attribute__((constructor)) static void begin(void) {
    begin_ns = rn_clock_ns();
    begin_wall_ms = rn_clock_wall_ms();
}

int64_t rn_clock_since_ms(int64_t then_wall_ms) {
    const int64_t wall_ms = rn_clock_wall_ms();
    const int64_t even_ms =
        begin_wall_ms + (rn_clock_ns() - begin_ns) / 1000000; // had nobody set it
    const bool was_before_it = wall_ms > even_ms ? then_wall_ms <= even_ms : then_wall_ms > wall_ms;
    return (was_before_it ? even_ms : wall_ms) - then_wall_ms;
}

void rn_clock_set_source(int64_t (*monotonic_ns)(void), int64_t (*wall_ms)(void)) {
    monotonic_source = monotonic_ns;
    wall_source = wall_ms;
    begin();
}

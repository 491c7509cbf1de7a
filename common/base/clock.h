// Time. Everything that measures or waits asks here, so that a test can set the time.
#ifndef RN_COMMON_BASE_CLOCK_H
#define RN_COMMON_BASE_CLOCK_H

#include <stdint.h>

// Monotonic time in nanoseconds since an arbitrary origin (CLOCK_MONOTONIC). Thread-safe.
int64_t rn_clock_ns(void);

// Wall time in milliseconds since 1970-01-01T00:00:00Z; may jump. Thread-safe.
int64_t rn_clock_wall_ms(void);

// For tests: replaces both clocks; NULL restores the system's. Call it before threads start.
void rn_clock_set_source(int64_t (*monotonic_ns)(void), int64_t (*wall_ms)(void));

#endif

// Time. Everything that measures or waits asks here, so that a test can set the time.
#ifndef RN_COMMON_BASE_CLOCK_H
#define RN_COMMON_BASE_CLOCK_H

#include <stdint.h>

// Monotonic time in nanoseconds since an arbitrary origin (CLOCK_MONOTONIC). Thread-safe.
int64_t rn_clock_ns(void);

// CPU time of the calling thread in nanoseconds: what it did, not how long it waited for a core.
int64_t rn_clock_thread_ns(void);

// Wall time in milliseconds since 1970-01-01T00:00:00Z; may jump. Thread-safe.
int64_t rn_clock_wall_ms(void);

// How long ago a moment of the wall clock was, ms. Where that clock was set while this process
// runs, what was stamped before is judged by the time that has passed: nothing gets old at once,
// nor stays young for as long as it was set back. Thread-safe.
int64_t rn_clock_since_ms(int64_t then_wall_ms);

// For tests: replaces both clocks; NULL restores the system's. Call it before threads start.
void rn_clock_set_source(int64_t (*monotonic_ns)(void), int64_t (*wall_ms)(void));

#endif

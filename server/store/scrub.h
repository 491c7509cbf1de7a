// Reading all that is stored, to see whether it is as it was written.
#ifndef RN_SERVER_STORE_SCRUB_H
#define RN_SERVER_STORE_SCRUB_H

#include <stdbool.h>
#include <stdint.h>

#include "common/base/status.h"

struct rn_scrub_result {
    uint64_t checked, damaged; // checkpoints, datasets and copies of records
    uint64_t unread;           // files and folders that are there and cannot be read
};
// Goes through the data folder DIR: sealed files and folders with a SHA256SUMS. Takes no lock: what
// is written or removed meanwhile is passed over. `keep_going` (may be NULL) is polled between
// files. Each that is damaged or cannot be read is logged as an error.
void rn_scrub(const char *dir, bool (*keep_going)(void *context), void *context,
              struct rn_scrub_result *ret_result);

// The same again and again on a thread of the lowest priority, once in `interval_s`; it waits while
// `is_idle` says no. Thread-safety: start and stop belong to one thread.
struct rn_scrubber;
enum rn_status rn_scrubber_start(const char *dir, int64_t interval_s,
                                 bool (*is_idle)(void *context), void *context,
                                 struct rn_scrubber **ret_scrubber,
                                 struct rn_error *err) RN_MUST_CHECK;
void rn_scrubber_result(struct rn_scrubber *scrubber, struct rn_scrub_result *ret_result);
void rn_scrubber_stop(struct rn_scrubber **scrubber);

#endif

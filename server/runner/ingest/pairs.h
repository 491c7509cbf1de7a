// Which photographs are worth matching.
#ifndef RN_SERVER_RUNNER_INGEST_PAIRS_H
#define RN_SERVER_RUNNER_INGEST_PAIRS_H

#include "common/dataset/photos.h"

#define RN_PAIRS_PARTNERS 12 // of a photograph, besides those near it
#define RN_PAIRS_NEAR 3      // before, and after, in the order of names that count upwards
#define RN_PAIRS_AROUND 8    // nearest on the ground, where GPS tells photographs' places apart

// Preemptive matching (Wu 2013, "Towards linear-time incremental structure from motion"): of each
// photograph the descriptors of the largest features are compared with those of all others, by
// brute force; the partners with the most matches are worth matching whole, and those near it: in
// order where photos->in_order, and on the ground where `placed`, as rn_pairs_are_placed.
// `database` is COLMAP's, with features of the photographs by name; `list` is written, a pair of
// names a line, as rn_pairs_rename has them. RN_ERROR_CORRUPT for a database that is not as
// COLMAP's; RN_ERROR_CANCELLED, RN_ERROR_IO, RN_ERROR_NO_MEMORY.
enum rn_status rn_pairs_choose(const struct rn_photos *photos, bool placed, const char *database,
                               const char *list, bool (*keep_going)(void *context), void *context,
                               size_t *ret_pairs, struct rn_error *err) RN_MUST_CHECK;

// Whether GPS says where most photographs were taken, so far apart that it tells which are near
// each other, as from the air; else it is off by more than that.
bool rn_pairs_are_placed(const struct rn_photos *photos);

// About how many that will be.
size_t rn_pairs_expected(const struct rn_photos *photos, bool placed);

// COLMAP reads a name in a list up to a blank. Gives photographs whose names it would not find
// names that it does, in its database (`listed`), or their own ones again. RN_ERROR_CORRUPT as
// above, RN_ERROR_NO_MEMORY.
enum rn_status rn_pairs_rename(const struct rn_photos *photos, const char *database, bool listed,
                               struct rn_error *err) RN_MUST_CHECK;

#endif

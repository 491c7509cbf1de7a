// Sparse points of photographs whose poses are known and whose source gives none: corners of each
// photograph, each placed at the depth at which its surroundings look alike from its neighbours
// (multiple-baseline stereo: Okutomi and Kanade, PAMI 1993, with normalised correlation).
#ifndef RN_COMMON_DATASET_TRIANGULATE_H
#define RN_COMMON_DATASET_TRIANGULATE_H

#include "common/dataset/dataset.h"
#include "common/dataset/exposure.h"

// Photographs beyond it are passed over, evenly.
#define RN_TRIANGULATE_PHOTOS 1000

// Small copies of photographs, grey ones and smaller ones in colour, and their corners. Owner: the
// caller; rn_triangulation_destroy.
struct rn_triangulation;

// For the views of `dataset`, which must outlive it, at full size; numbers the photographs anew
// (struct rn_frame's `photo`). *ret_triangulation is NULL where it is not called for: a dataset has
// sightings, or objects are cut out by alpha. `test_every` as in struct rn_import_options. Views
// that are not trained on say nothing of where points are and of what colour: what was found
// without them is looked for in them. RN_ERROR_NO_MEMORY.
enum rn_status rn_triangulation_create(struct rn_dataset *dataset, int test_every,
                                       struct rn_triangulation **ret_triangulation,
                                       struct rn_error *err) RN_MUST_CHECK;
void rn_triangulation_destroy(struct rn_triangulation **triangulation);

// Looks at one decoded photograph. Thread-safe for different photographs. NULL-safe; without memory
// for it a photograph is passed over.
void rn_triangulation_look(struct rn_triangulation *triangulation, const struct rn_frame *frame,
                           const struct rn_image *image);

// After all were looked at: *ret_count points, beside those that the dataset has, and where they
// were seen; of a million of its own only some stay, as there is room for so many (RN_POINTS_MAX).
// The same for any number of threads. `progress` as rn_dataset_import's. NULL-safe.
// RN_ERROR_CANCELLED, RN_ERROR_NO_MEMORY.
enum rn_status rn_triangulation_solve(struct rn_triangulation *triangulation, int threads,
                                      struct rn_dataset *dataset,
                                      bool (*progress)(void *context, size_t done, size_t total),
                                      void *context, size_t *ret_count,
                                      struct rn_error *err) RN_MUST_CHECK;

// The colours of each photograph that was looked at, to what was made of its dataset since
// (rn_exposures_create). NULL-safe, both.
void rn_triangulation_show(const struct rn_triangulation *triangulation,
                           struct rn_exposures *exposures);

#endif

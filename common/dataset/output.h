// What import and synthesis share: many images written into a new folder, in parallel. Internal to
// common/dataset.
#ifndef RN_COMMON_DATASET_OUTPUT_H
#define RN_COMMON_DATASET_OUTPUT_H

#include <stddef.h>

#include "common/base/status.h"
#include "common/image/image.h"

typedef enum rn_status (*rn_output_work)(void *context, size_t index, struct rn_error *err);
typedef bool (*rn_output_progress)(void *context, size_t done, size_t total);

// RN_ERROR_CONFLICT when the folder exists and is not empty.
enum rn_status rn_output_check_new(const char *folder, struct rn_error *err) RN_MUST_CHECK;

// Runs work(context, i, err) for every i below `count` on `threads` threads. The first failure, or
// a `progress` (may be NULL; one call at a time) that returns false, keeps further calls from
// starting and is the result; the latter is RN_ERROR_CANCELLED at `where`.
enum rn_status rn_output_run(int threads, size_t count, rn_output_work work, void *context,
                             rn_output_progress progress, void *progress_context, const char *where,
                             struct rn_error *err) RN_MUST_CHECK;

// Writes a new file that is on disk only after rn_output_sync.
enum rn_status rn_output_file(const char *path, const void *content, size_t size,
                              struct rn_error *err) RN_MUST_CHECK;
// Likewise a PNG file.
enum rn_status rn_output_png(const struct rn_image *image, const char *path, int level,
                             struct rn_error *err) RN_MUST_CHECK;
// Waits until everything written below `folder` is on disk: one wait instead of one an image.
enum rn_status rn_output_sync(const char *folder, struct rn_error *err) RN_MUST_CHECK;

#endif

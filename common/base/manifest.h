// A folder's files and their digests: SHA256SUMS, as `sha256sum -c` reads it.
#ifndef RN_COMMON_BASE_MANIFEST_H
#define RN_COMMON_BASE_MANIFEST_H

#include <stdbool.h>

#include "common/base/status.h"

// The SHA-256 of a file's bytes.
enum rn_status rn_manifest_digest(const char *path, char ret_sha256[65],
                                  struct rn_error *err) RN_MUST_CHECK;
// Calls `name` with each line's digest and name, the list itself not included, until it fails.
// RN_ERROR_NOT_FOUND when there is no list.
enum rn_status rn_manifest_read(const char *folder,
                                enum rn_status (*name)(void *context, const char *sha256,
                                                       const char *name, struct rn_error *err),
                                void *context, struct rn_error *err) RN_MUST_CHECK;
// Lists all visible files below the folder in FOLDER/SHA256SUMS.
enum rn_status rn_manifest_write(const char *folder, struct rn_error *err) RN_MUST_CHECK;
// Reads each file of the list. RN_ERROR_NOT_FOUND when there is no list, RN_ERROR_CORRUPT names the
// first file that is missing or not as it was written. `keep_going` (may be NULL) is polled between
// files: RN_ERROR_CANCELLED.
enum rn_status rn_manifest_check(const char *folder, bool (*keep_going)(void *context),
                                 void *context, struct rn_error *err) RN_MUST_CHECK;
// Checks FOLDER/name alone. RN_ERROR_NOT_FOUND when there is no list, or it does not name the file.
enum rn_status rn_manifest_check_file(const char *folder, const char *name,
                                      struct rn_error *err) RN_MUST_CHECK;

#endif

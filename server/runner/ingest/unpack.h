// Uploaded archives.
#ifndef RN_SERVER_RUNNER_INGEST_UNPACK_H
#define RN_SERVER_RUNNER_INGEST_UNPACK_H

#include <stdbool.h>
#include <stddef.h>

#include "common/base/status.h"

struct rn_unpack_limits {
    size_t max_bytes;   // of all files together
    size_t max_entries; // files and folders
};

// Unpacks a plain (uncompressed) tar into the existing folder `target`. Only files and folders
// with relative names are taken, hidden ones are passed over: links, devices, absolute names, ".."
// and names that are not UTF-8 give RN_ERROR_INVALID that names the entry; more than the limits
// allow gives RN_ERROR_LIMIT; a cut or damaged archive RN_ERROR_INVALID. `keep_going` (may be NULL)
// is polled between entries and blocks: RN_ERROR_CANCELLED. What was written before an error stays
// for the caller to remove.
enum rn_status rn_unpack(const char *archive, const char *target,
                         const struct rn_unpack_limits *limits, bool (*keep_going)(void *context),
                         void *context, struct rn_error *err) RN_MUST_CHECK;

#endif

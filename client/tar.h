// A plain tar (ustar), written piece by piece so that nothing but one file is open at a time.
#ifndef RN_CLIENT_TAR_H
#define RN_CLIENT_TAR_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "common/base/status.h"

// Thread-safety: one thread at a time. Owner: the caller; rn_tar_destroy.
struct rn_tar;

// An archive of files under `folder`. The list grows by rn_tar_add, the bytes come by rn_tar_read.
enum rn_status rn_tar_create(const char *folder, struct rn_tar **ret_tar,
                             struct rn_error *err) RN_MUST_CHECK;
void rn_tar_destroy(struct rn_tar **tar);

// Adds the regular file `name`, relative to the folder; a leading "./" is dropped and a name that
// was added before is skipped. RN_ERROR_INVALID for a name that leaves the folder or does not fit
// the format (255 bytes), RN_ERROR_NOT_FOUND, RN_ERROR_IO, RN_ERROR_NO_MEMORY. An order of names
// with equal ones side by side keeps the list free of repeats.
enum rn_status rn_tar_add(struct rn_tar *tar, const char *name, struct rn_error *err) RN_MUST_CHECK;

size_t rn_tar_files(const struct rn_tar *tar);
// Of the whole archive, known once the list is complete.
uint64_t rn_tar_size(const struct rn_tar *tar);
uint64_t rn_tar_sent(const struct rn_tar *tar);
// Copies the next bytes; 0 at the end, SIZE_MAX when a file cannot be read or has shrunk since it
// was added (rn_tar_error says which).
size_t rn_tar_read(struct rn_tar *tar, char *buffer, size_t capacity);
const struct rn_error *rn_tar_error(const struct rn_tar *tar);

#endif

// A plain tar (ustar, pax headers for longer names), written piece by piece so that nothing but one
// file is open at a time, and unpacked.
#ifndef RN_COMMON_BASE_TAR_H
#define RN_COMMON_BASE_TAR_H

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
// was added before is skipped. RN_ERROR_INVALID for a name that leaves the folder or has more
// than RN_TAR_NAME_MAX bytes, RN_ERROR_NOT_FOUND, RN_ERROR_IO, RN_ERROR_NO_MEMORY. An order of
// names with equal ones side by side keeps the list free of repeats.
#define RN_TAR_NAME_MAX 1000
enum rn_status rn_tar_add(struct rn_tar *tar, const char *name, struct rn_error *err) RN_MUST_CHECK;

// Of the whole archive, known once the list is complete.
uint64_t rn_tar_size(const struct rn_tar *tar);
uint64_t rn_tar_sent(const struct rn_tar *tar);
// Copies the next bytes; 0 at the end, SIZE_MAX when a file cannot be read or has shrunk since it
// was added (rn_tar_error says which).
size_t rn_tar_read(struct rn_tar *tar, char *buffer, size_t capacity);
// The next bytes are those from `offset` on, at most the archive's size. False: a file cannot be
// read (rn_tar_error).
bool rn_tar_seek(struct rn_tar *tar, uint64_t offset);
const struct rn_error *rn_tar_error(const struct rn_tar *tar);

// The header of POSIX.1-1988 (ustar) before a regular file's bytes, which are padded to whole
// blocks: numbers in octal, mode 0644, no owner. `name` has at most 100 bytes, or 155 and 100 on
// the two sides of a slash; sizes have 33 bits, as have times from 1970 on.
#define RN_TAR_BLOCK 512
void rn_tar_header(const char *name, uint64_t size_bytes, int64_t mtime_s, char ret[RN_TAR_BLOCK]);

struct rn_tar_contents {
    int64_t files, bytes;
};
// Puts the files of an archive of such headers under `folder`, which is there; each is flushed.
// RN_ERROR_CORRUPT: it is cut off, something else, or names what is no safe place
// (rn_path_is_safe_name); RN_ERROR_CANCELLED: `keep_going` (may be NULL) said no; RN_ERROR_IO,
// RN_ERROR_NO_SPACE. untar.c
enum rn_status rn_tar_unpack(const char *archive, const char *folder,
                             bool (*keep_going)(void *context), void *context,
                             struct rn_tar_contents *ret_contents,
                             struct rn_error *err) RN_MUST_CHECK;

#endif

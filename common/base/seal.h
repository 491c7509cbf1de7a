// Sealed files: a file that carries a digest of all of its own bytes.
//
// Near its beginning stands RN_SEAL, whose 64 digits are, once sealed, the SHA-256 of the whole
// file with zeros in their place. It is a member of a JSON object, so that a header or a record can
// hold it. Files without one are as good as their reader finds them.
#ifndef RN_COMMON_BASE_SEAL_H
#define RN_COMMON_BASE_SEAL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

#include "common/base/status.h"

#define RN_SEAL_ZEROS "0000000000000000000000000000000000000000000000000000000000000000"
#define RN_SEAL_KEY "\"sha256\":\""
#define RN_SEAL RN_SEAL_KEY RN_SEAL_ZEROS "\""
// The digits lie within this many bytes of the beginning.
#define RN_SEAL_REACH 4096

// Fills in the digits of a file that was written with RN_SEAL. `fd` is open for reading and
// writing; the caller syncs it. `path` is for errors. RN_ERROR_INVALID when there is no RN_SEAL.
enum rn_status rn_seal_close(int fd, const char *path, char ret_sha256[65],
                             struct rn_error *err) RN_MUST_CHECK;

// Checks a file by its seal; ret_sha256 is its digest. RN_ERROR_CORRUPT when a byte has changed.
// Of a file without a seal it is that of all bytes, and nothing is checked.
enum rn_status rn_seal_check(const char *path, char ret_sha256[65],
                             struct rn_error *err) RN_MUST_CHECK;
// The digits as they stand, unchecked; as rn_seal_check when there is no seal.
enum rn_status rn_seal_read(const char *path, char ret_sha256[65],
                            struct rn_error *err) RN_MUST_CHECK;

// A file that is checked while it is read, for who must not wait for the check. Owner: whoever
// opened it; one thread.
struct rn_sealed;
enum rn_status rn_sealed_open(const char *path, struct rn_sealed **ret_sealed, uint64_t *ret_size,
                              struct rn_error *err) RN_MUST_CHECK;
// Bytes read, 0 at the end. -1 is logged: an error of reading or, in place of the last bytes, that
// the file is not as it was written.
ssize_t rn_sealed_read(struct rn_sealed *sealed, uint8_t *bytes, size_t capacity);
void rn_sealed_close(struct rn_sealed **sealed);

#endif

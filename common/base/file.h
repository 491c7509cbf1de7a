// Files and folders: whole reads with a limit, atomic and durable writes.
//
// All functions are thread-safe; errors carry the path in `where`. Besides the statuses named
// below each may return RN_ERROR_IO, RN_ERROR_NOT_FOUND, RN_ERROR_NO_SPACE, RN_ERROR_NO_MEMORY.
#ifndef RN_COMMON_BASE_FILE_H
#define RN_COMMON_BASE_FILE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

#include "common/base/status.h"

// Reads a whole regular file. *ret_bytes is malloc'd, owned by the caller, and followed by a NUL
// that *ret_size does not count. RN_ERROR_LIMIT when the file is larger than max_bytes (nothing
// of that size is allocated), RN_ERROR_INVALID when it is a folder, pipe or device.
enum rn_status rn_file_read(const char *path, size_t max_bytes, uint8_t **ret_bytes,
                            size_t *ret_size, struct rn_error *err) RN_MUST_CHECK;

// Reads at most `capacity` leading bytes of a regular file into `bytes`. *ret_size is how many,
// *ret_file_size the whole file's size in bytes. RN_ERROR_INVALID as above.
enum rn_status rn_file_read_head(const char *path, uint8_t *bytes, size_t capacity,
                                 size_t *ret_size, uint64_t *ret_file_size,
                                 struct rn_error *err) RN_MUST_CHECK;

// Replaces or creates `path` so that a reader, and the disk after a power loss, sees the old
// content or the new one and never a part: temporary file in the same folder, fsync, rename,
// fsync of the folder. The temporary file is removed on failure. Mode 0666 less the umask.
enum rn_status rn_file_write_atomic(const char *path, const void *bytes, size_t size_bytes,
                                    struct rn_error *err) RN_MUST_CHECK;

// Writes all of it, however many calls that takes; false with errno where it cannot be.
bool rn_write_all(int fd, const void *bytes, size_t size_bytes) RN_MUST_CHECK;

// Creates a folder and the missing ones above it, durably. An existing folder is no error.
enum rn_status rn_mkdirs(const char *path, mode_t mode, struct rn_error *err) RN_MUST_CHECK;

// As rn_mkdirs below the folder `above`, with which `path` begins, and which is not made:
// RN_ERROR_NOT_FOUND where it is missing, as where someone moved it away.
enum rn_status rn_mkdirs_in(const char *above, const char *path, mode_t mode,
                            struct rn_error *err) RN_MUST_CHECK;

// As rn_mkdirs, of the last folder of `path` alone.
enum rn_status rn_mkdir(const char *path, mode_t mode, struct rn_error *err) RN_MUST_CHECK;

// As rename(2), of a file or folder, and durable: the new name is there after a power loss.
enum rn_status rn_file_rename(const char *from, const char *to, struct rn_error *err) RN_MUST_CHECK;

// Makes the names in a folder durable, and what was removed from it.
enum rn_status rn_folder_flush(const char *path, struct rn_error *err) RN_MUST_CHECK;

// Removes a file, or a folder with all it holds; links are removed, never followed. A missing
// path is no error. RN_ERROR_LIMIT for folders nested more than 64 deep.
enum rn_status rn_remove_tree(const char *path, struct rn_error *err) RN_MUST_CHECK;

// Removes as rn_remove_tree all that a folder holds; the folder itself is there all the time.
enum rn_status rn_folder_empty(const char *path, struct rn_error *err) RN_MUST_CHECK;

// Whether `name` may become one component of a path: 1..200 bytes of valid UTF-8, no '/', no
// control character, no leading '.'.
bool rn_path_is_safe_name(const char *name);

#endif

#include "common/base/seal.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/log.h"
#include "common/base/sha256.h"

#define DIGITS 64
#define BLOCK_BYTES (1 << 16)

static ssize_t read_at(int fd, void *bytes, size_t size, off_t at) {
    char *to = bytes;
    size_t got = 0;
    while (got < size) {
        ssize_t n = pread(fd, to + got, size - got, at + (off_t)got);
        if (n < 0 && errno == EINTR) continue;
        if (n < 0) return -1;
        if (n == 0) break;
        got += (size_t)n;
    }
    return (ssize_t)got;
}

// Whether a seal stands at `text`, of which one byte may be damaged.
static bool is_seal(const char *text) {
    const size_t key = sizeof RN_SEAL_KEY - 1;
    int wrong = text[key + DIGITS] != '"';
    for (size_t i = 0; i < key && wrong <= 1; i++)
        wrong += text[i] != RN_SEAL_KEY[i];
    return wrong <= 1;
}

// Where the digits begin; 0: there is no seal, -1: errno.
static off_t find_digits(int fd, char ret_digits[DIGITS + 1]) {
    const size_t key = sizeof RN_SEAL_KEY - 1;
    char head[RN_SEAL_REACH];
    ssize_t size = read_at(fd, head, sizeof head, 0);
    for (size_t at = 0; size > 0 && at + sizeof RN_SEAL - 1 <= (size_t)size; at++) {
        if (!is_seal(head + at)) continue;
        memcpy(ret_digits, head + at + key, DIGITS);
        ret_digits[DIGITS] = '\0';
        return (off_t)(at + key);
    }
    return size < 0 ? -1 : 0;
}

// Zeros in place of the digits at `hole` (0: none) of a block that lies at `at`.
static void blank(char *block, size_t size, off_t at, off_t hole) {
    for (off_t i = hole; hole > 0 && i < hole + DIGITS; i++)
        if (i >= at && i < at + (off_t)size) block[i - at] = '0';
}

static enum rn_status hash_file(int fd, const char *path, off_t hole, char ret_sha256[65],
                                struct rn_error *err) {
    char block[BLOCK_BYTES];
    struct rn_sha256 hash;
    rn_sha256_init(&hash);
    for (off_t at = 0;;) {
        ssize_t size = read_at(fd, block, sizeof block, at);
        if (size < 0) return rn_error_from_errno(err, errno, path, "read the file");
        if (size == 0) break;
        blank(block, (size_t)size, at, hole);
        rn_sha256_update(&hash, block, (size_t)size);
        at += size;
    }
    rn_sha256_final_hex(&hash, ret_sha256);
    return RN_OK;
}

enum rn_status rn_seal_close(int fd, const char *path, char ret_sha256[65], struct rn_error *err) {
    char digits[DIGITS + 1];
    off_t at = find_digits(fd, digits);
    if (at < 0) return rn_error_from_errno(err, errno, path, "read the file");
    if (at == 0)
        return rn_error_set(err, RN_ERROR_INVALID, path, "there is no place for the digest");
    enum rn_status status = hash_file(fd, path, at, ret_sha256, err);
    if (status) return status;
    for (size_t done = 0; done < DIGITS;) {
        ssize_t n = pwrite(fd, ret_sha256 + done, DIGITS - done, at + (off_t)done);
        if (n < 0 && errno == EINTR) continue;
        if (n <= 0) return rn_error_from_errno(err, n < 0 ? errno : EIO, path, "write the digest");
        done += (size_t)n;
    }
    return RN_OK;
}

static enum rn_status examine(const char *path, bool check, char ret_sha256[65],
                              struct rn_error *err) {
    char digits[DIGITS + 1] = "";
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0) return rn_error_from_errno(err, errno, path, "open the file");
    off_t at = find_digits(fd, digits);
    enum rn_status status = RN_OK;
    if (at < 0)
        status = rn_error_from_errno(err, errno, path, "read the file");
    else if (at > 0 && !check)
        memcpy(ret_sha256, digits, sizeof digits);
    else
        status = hash_file(fd, path, at, ret_sha256, err);
    close(fd);
    if (!status && at > 0 && strcmp(digits, ret_sha256) != 0)
        return rn_error_set(err, RN_ERROR_CORRUPT, path,
                            "is not as it was written: its bytes do not have its digest");
    return status;
}

enum rn_status rn_seal_check(const char *path, char ret_sha256[65], struct rn_error *err) {
    return examine(path, true, ret_sha256, err);
}

enum rn_status rn_seal_read(const char *path, char ret_sha256[65], struct rn_error *err) {
    return examine(path, false, ret_sha256, err);
}

// ---- while it is read -------------------------------------------------------------------------

struct rn_sealed {
    int fd;
    off_t at, size, hole; // of the digits; 0: no seal
    char digits[DIGITS + 1], path[PATH_MAX];
    struct rn_sha256 hash;
};

enum rn_status rn_sealed_open(const char *path, struct rn_sealed **ret_sealed, uint64_t *ret_size,
                              struct rn_error *err) {
    struct stat about;
    struct rn_sealed *sealed = calloc(1, sizeof *sealed);
    if (sealed == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, path, "no memory");
    sealed->fd = open(path, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
    if (sealed->fd >= 0) sealed->hole = find_digits(sealed->fd, sealed->digits);
    if (sealed->fd < 0 || sealed->hole < 0 || fstat(sealed->fd, &about) != 0) {
        enum rn_status status = rn_error_from_errno(err, errno, path, "open the file");
        rn_sealed_close(&sealed);
        return status;
    }
    snprintf(sealed->path, sizeof sealed->path, "%s", path);
    rn_sha256_init(&sealed->hash);
    sealed->size = about.st_size;
    *ret_size = (uint64_t)about.st_size;
    *ret_sealed = sealed;
    return RN_OK;
}

// The digits are blank for the digest alone: the reader has them as they stand.
static void digest_block(struct rn_sealed *sealed, const uint8_t *bytes, size_t size) {
    char head[RN_SEAL_REACH];
    size_t first = size;
    if (sealed->hole > 0 && sealed->at < RN_SEAL_REACH) {
        first = size < sizeof head ? size : sizeof head;
        memcpy(head, bytes, first);
        blank(head, first, sealed->at, sealed->hole);
        rn_sha256_update(&sealed->hash, head, first);
        rn_sha256_update(&sealed->hash, bytes + first, size - first);
    } else {
        rn_sha256_update(&sealed->hash, bytes, size);
    }
}

ssize_t rn_sealed_read(struct rn_sealed *sealed, uint8_t *bytes, size_t capacity) {
    char sha256[DIGITS + 1];
    if (sealed->at == sealed->size) return 0;
    ssize_t size = read_at(sealed->fd, bytes, capacity, sealed->at);
    if (size <= 0) {
        rn_log(RN_LOG_ERROR, "%s: %s", sealed->path, size < 0 ? strerror(errno) : "it has shrunk");
        return -1;
    }
    digest_block(sealed, bytes, (size_t)size);
    sealed->at += size;
    if (sealed->at < sealed->size || sealed->hole == 0) return size;
    rn_sha256_final_hex(&sealed->hash, sha256);
    if (strcmp(sha256, sealed->digits) == 0) return size;
    rn_log(RN_LOG_ERROR, "%s: is not as it was written: its bytes do not have its digest",
           sealed->path);
    return -1;
}

void rn_sealed_close(struct rn_sealed **sealed) {
    if (*sealed != NULL && (*sealed)->fd >= 0) close((*sealed)->fd);
    free(*sealed);
    *sealed = NULL;
}

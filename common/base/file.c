#include "common/base/file.h"
#include "common/base/utf8.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#define MAX_TREE_DEPTH 64
#define MAX_NAME_BYTES 200

static enum rn_status too_large(const char *path, size_t max_bytes, struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_LIMIT, path, "the file is larger than the limit of %zu bytes",
                        max_bytes);
}

// Fills `bytes` up to its capacity or the end of the file; -1 with errno on failure.
static ssize_t read_fully(int fd, uint8_t *bytes, size_t capacity) {
    size_t size = 0;
    while (size < capacity) {
        ssize_t got = read(fd, bytes + size, capacity - size);
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) return -1;
        if (got == 0) break;
        size += (size_t)got;
    }
    return (ssize_t)size;
}

// The file may be longer or shorter than fstat said (a file of /proc, one that grows): reads on
// until a read falls short.
static enum rn_status read_open(int fd, const char *path, size_t expected, size_t max_bytes,
                                uint8_t **ret_bytes, size_t *ret_size, struct rn_error *err) {
    size_t size = 0, capacity = expected + 1;
    uint8_t *bytes = NULL;
    for (;;) {
        uint8_t *grown = realloc(bytes, capacity + 1);
        if (!grown) {
            free(bytes);
            return rn_error_from_errno(err, ENOMEM, path, "read the file");
        }
        bytes = grown;
        ssize_t got = read_fully(fd, bytes + size, capacity - size);
        if (got < 0) {
            int errnum = errno;
            free(bytes);
            return rn_error_from_errno(err, errnum, path, "read the file");
        }
        size += (size_t)got;
        if (size > max_bytes) {
            free(bytes);
            return too_large(path, max_bytes, err);
        }
        if (size < capacity) break;
        capacity = capacity > max_bytes / 2 ? max_bytes + 1 : capacity * 2 + 4096;
    }
    bytes[size] = 0;
    *ret_bytes = bytes;
    *ret_size = size;
    return RN_OK;
}

static enum rn_status open_regular(const char *path, int *ret_fd, uint64_t *ret_size,
                                   struct rn_error *err) {
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK); // non-blocking: a pipe must not hang
    if (fd < 0) return rn_error_from_errno(err, errno, path, "open the file");
    struct stat info;
    enum rn_status status = RN_OK;
    if (fstat(fd, &info) < 0)
        status = rn_error_from_errno(err, errno, path, "examine the file");
    else if (!S_ISREG(info.st_mode))
        status = rn_error_set(err, RN_ERROR_INVALID, path, "this is not a regular file");
    if (status != RN_OK) {
        close(fd);
        return status;
    }
    *ret_fd = fd;
    *ret_size = (uint64_t)info.st_size;
    return RN_OK;
}

enum rn_status rn_file_read(const char *path, size_t max_bytes, uint8_t **ret_bytes,
                            size_t *ret_size, struct rn_error *err) {
    if (max_bytes > SSIZE_MAX - 2) max_bytes = SSIZE_MAX - 2;
    int fd = -1;
    uint64_t expected = 0;
    enum rn_status status = open_regular(path, &fd, &expected, err);
    if (status != RN_OK) return status;
    if (expected > max_bytes)
        status = too_large(path, max_bytes, err);
    else
        status = read_open(fd, path, (size_t)expected, max_bytes, ret_bytes, ret_size, err);
    close(fd);
    return status;
}

enum rn_status rn_file_read_head(const char *path, uint8_t *bytes, size_t capacity,
                                 size_t *ret_size, uint64_t *ret_file_size, struct rn_error *err) {
    int fd = -1;
    uint64_t file_size = 0;
    enum rn_status status = open_regular(path, &fd, &file_size, err);
    if (status != RN_OK) return status;
    ssize_t got = read_fully(fd, bytes, capacity);
    if (got < 0)
        status = rn_error_from_errno(err, errno, path, "read the file");
    else {
        *ret_size = (size_t)got;
        *ret_file_size = file_size;
    }
    close(fd);
    return status;
}

bool rn_write_all(int fd, const void *bytes, size_t size_bytes) {
    const char *at = bytes;
    while (size_bytes > 0) {
        ssize_t put = write(fd, at, size_bytes);
        if (put < 0 && errno == EINTR) continue;
        if (put == 0) errno = EIO;
        if (put <= 0) return false;
        at += put;
        size_bytes -= (size_t)put;
    }
    return true;
}

static int fsync_retry(int fd) {
    int rc;
    do
        rc = fsync(fd);
    while (rc < 0 && errno == EINTR);
    return rc;
}

// Copies the folder part of `path` ("." when there is none); false when it does not fit.
static bool folder_of(const char *path, char folder[PATH_MAX]) {
    const char *slash = strrchr(path, '/');
    size_t length = slash ? (size_t)(slash - path) : 0;
    if (length >= PATH_MAX) return false;
    if (length == 0) {
        strcpy(folder, slash ? "/" : ".");
        return true;
    }
    memcpy(folder, path, length);
    folder[length] = 0;
    return true;
}

static int fsync_folder(const char *folder) {
    int fd = open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (fd < 0) return -1;
    int rc = fsync_retry(fd), errnum = errno;
    close(fd);
    errno = errnum;
    return rc;
}

static int fsync_folder_of(const char *path) {
    char folder[PATH_MAX];
    if (folder_of(path, folder)) return fsync_folder(folder);
    errno = ENAMETOOLONG;
    return -1;
}

// ".NAME.PID-N.tmp" beside `path`: hidden, and unique among the live processes of the machine.
static bool temporary_name(const char *path, char temporary[PATH_MAX]) {
    static atomic_uint counter;
    const char *slash = strrchr(path, '/'), *name = slash ? slash + 1 : path;
    int length = snprintf(temporary, PATH_MAX, "%.*s.%s.%ld-%u.tmp", (int)(name - path), path, name,
                          (long)getpid(), atomic_fetch_add(&counter, 1));
    return length > 0 && length < PATH_MAX;
}

static int write_and_rename(int fd, const char *temporary, const char *path, const void *bytes,
                            size_t size) {
    int rc = rn_write_all(fd, bytes, size) ? 0 : -1;
    if (rc == 0) rc = fsync_retry(fd);
    int errnum = errno;
    if (close(fd) < 0 && rc == 0) {
        rc = -1;
        errnum = errno;
    }
    if (rc == 0 && (rc = rename(temporary, path)) < 0) errnum = errno;
    if (rc < 0) unlink(temporary);
    errno = errnum;
    return rc;
}

enum rn_status rn_file_write_atomic(const char *path, const void *bytes, size_t size_bytes,
                                    struct rn_error *err) {
    char temporary[PATH_MAX];
    if (!temporary_name(path, temporary))
        return rn_error_from_errno(err, ENAMETOOLONG, path, "write the file");
    int fd = open(temporary, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC | O_NOFOLLOW, 0666);
    if (fd < 0) return rn_error_from_errno(err, errno, path, "create the file");
    if (write_and_rename(fd, temporary, path, bytes, size_bytes) < 0)
        return rn_error_from_errno(err, errno, path, "write the file");
    if (fsync_folder_of(path) < 0)
        return rn_error_from_errno(err, errno, path, "flush the file's folder");
    return RN_OK;
}

enum rn_status rn_file_rename(const char *from, const char *to, struct rn_error *err) {
    if (rename(from, to) < 0) return rn_error_from_errno(err, errno, to, "rename the file");
    if (fsync_folder_of(to) < 0)
        return rn_error_from_errno(err, errno, to, "flush the file's folder");
    return RN_OK;
}

enum rn_status rn_folder_flush(const char *path, struct rn_error *err) {
    return fsync_folder(path) == 0 ? RN_OK
                                   : rn_error_from_errno(err, errno, path, "flush the folder");
}

static int make_folder(const char *path, mode_t mode) {
    if (mkdir(path, mode) == 0) return fsync_folder_of(path);
    if (errno != EEXIST) return -1;
    struct stat info;
    if (stat(path, &info) < 0) return -1;
    errno = ENOTDIR;
    return S_ISDIR(info.st_mode) ? 0 : -1;
}

enum rn_status rn_mkdir(const char *path, mode_t mode, struct rn_error *err) {
    return make_folder(path, mode) == 0
               ? RN_OK
               : rn_error_from_errno(err, errno, path, "create the folder");
}

// The first `there` bytes of `path` are not made.
static enum rn_status make_folders(const char *path, size_t there, mode_t mode,
                                   struct rn_error *err) {
    char partial[PATH_MAX];
    size_t length = strlen(path);
    while (length > 1 && path[length - 1] == '/')
        length--;
    if (length == 0 || length >= sizeof partial)
        return rn_error_from_errno(err, length ? ENAMETOOLONG : ENOENT, path, "create the folder");
    memcpy(partial, path, length);
    partial[length] = 0;
    for (size_t i = there + 1; i <= length; i++) {
        if (partial[i] != '/' && partial[i] != 0) continue;
        char kept = partial[i];
        partial[i] = 0;
        enum rn_status status = rn_mkdir(partial, mode, err);
        if (status != RN_OK) return status;
        partial[i] = kept;
    }
    return RN_OK;
}

enum rn_status rn_mkdirs(const char *path, mode_t mode, struct rn_error *err) {
    return make_folders(path, 0, mode, err);
}

enum rn_status rn_mkdirs_in(const char *above, const char *path, mode_t mode,
                            struct rn_error *err) {
    return make_folders(path, strlen(above), mode, err);
}

static enum rn_status remove_at(int folder, const char *name, const char *path, int depth,
                                struct rn_error *err);

static enum rn_status remove_entries(DIR *dir, const char *path, int depth, struct rn_error *err) {
    for (;;) {
        errno = 0;
        struct dirent *entry = readdir(dir);
        if (!entry) return errno ? rn_error_from_errno(err, errno, path, "list the folder") : RN_OK;
        if (strcmp(entry->d_name, ".") == 0 || strcmp(entry->d_name, "..") == 0) continue;
        enum rn_status status = remove_at(dirfd(dir), entry->d_name, path, depth + 1, err);
        if (status != RN_OK) return status;
    }
}

// Removes `name` in the open folder; `path` is the tree's root, for errors.
static enum rn_status remove_at(int folder, const char *name, const char *path, int depth,
                                struct rn_error *err) {
    if (unlinkat(folder, name, 0) == 0 || errno == ENOENT) return RN_OK;
    // EACCES: also of a confined process that may remove folders there, but no files.
    bool denied = errno == EACCES;
    if (errno != EISDIR && errno != EPERM && !denied)
        return rn_error_from_errno(err, errno, path, "remove the file");
    if (depth > MAX_TREE_DEPTH)
        return rn_error_set(err, RN_ERROR_LIMIT, path, "folders are nested more than %d deep",
                            MAX_TREE_DEPTH);
    int fd = openat(folder, name, O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC);
    if (fd < 0 && denied) return rn_error_from_errno(err, EACCES, path, "remove the file");
    if (fd < 0) return rn_error_from_errno(err, errno, path, "open the folder");
    DIR *dir = fdopendir(fd);
    if (!dir) {
        int errnum = errno;
        close(fd);
        return rn_error_from_errno(err, errnum, path, "open the folder");
    }
    enum rn_status status = remove_entries(dir, path, depth, err);
    closedir(dir);
    if (status == RN_OK && unlinkat(folder, name, AT_REMOVEDIR) < 0 && errno != ENOENT)
        status = rn_error_from_errno(err, errno, path, "remove the folder");
    return status;
}

enum rn_status rn_remove_tree(const char *path, struct rn_error *err) {
    return remove_at(AT_FDCWD, path, path, 0, err);
}

enum rn_status rn_folder_empty(const char *path, struct rn_error *err) {
    DIR *dir = opendir(path);
    if (!dir) return rn_error_from_errno(err, errno, path, "open the folder");
    enum rn_status status = remove_entries(dir, path, 0, err);
    closedir(dir);
    return status;
}

bool rn_path_is_safe_name(const char *name) {
    size_t size = strlen(name);
    if (size == 0 || size > MAX_NAME_BYTES || name[0] == '.') return false;
    for (const unsigned char *s = (const unsigned char *)name; *s;) {
        unsigned code = 0;
        int length = rn_utf8_decode((const char *)s, &code);
        if (length == 0 || code == '/' || code < 0x20 || (code >= 0x7f && code < 0xa0))
            return false;
        s += length;
    }
    return true;
}

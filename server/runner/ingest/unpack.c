#include "server/runner/ingest/unpack.h"

#include <archive.h>
#include <archive_entry.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/file.h"

enum { BLOCK_BYTES = 1 << 16, MAX_NAME_BYTES = 1024, MAX_DEPTH = 16 };

struct unpacking {
    struct archive *archive;
    const char *target;
    const struct rn_unpack_limits *limits;
    bool (*keep_going)(void *context);
    void *context;
    size_t entries;
    uint64_t bytes; // announced by the entries so far
};

// Takes "./" and slashes at the end off and checks each component. NULL when the name is refused;
// "" for what is passed over: the top folder, and hidden files.
static const char *clean_name(const char *name, char cleaned[MAX_NAME_BYTES]) {
    if (!name || *name == '/' || strlen(name) >= MAX_NAME_BYTES) return NULL;
    size_t length = 0;
    int depth = 0;
    while (*name) {
        size_t size = strcspn(name, "/");
        char part[MAX_NAME_BYTES];
        memcpy(part, name, size);
        part[size] = '\0';
        name += size + (name[size] == '/');
        if (size == 0 || strcmp(part, ".") == 0) continue;
        if (*part == '.' && strcmp(part, "..") != 0) return "";
        if (!rn_path_is_safe_name(part) || ++depth > MAX_DEPTH) return NULL;
        length += (size_t)snprintf(cleaned + length, MAX_NAME_BYTES - length, "%s%s",
                                   length ? "/" : "", part);
    }
    cleaned[length] = '\0';
    return cleaned;
}

static enum rn_status damaged(struct unpacking *unpacking, const char *where,
                              struct rn_error *err) {
    const char *text = archive_error_string(unpacking->archive);
    return rn_error_set(err, RN_ERROR_INVALID, where, "the tar is cut off or damaged: %s",
                        text ? text : "unknown error");
}

static enum rn_status make_folders(const struct unpacking *unpacking, const char *path,
                                   struct rn_error *err) {
    char folder[PATH_MAX];
    snprintf(folder, sizeof folder, "%s", path);
    char *slash = strrchr(folder, '/');
    if (slash) *slash = '\0';
    return rn_mkdirs_in(unpacking->target, folder, 0777, err);
}

static enum rn_status copy_data(struct unpacking *unpacking, int fd, const char *name,
                                const char *path, struct rn_error *err) {
    static char block[BLOCK_BYTES]; // one import a process
    for (;;) {
        if (unpacking->keep_going && !unpacking->keep_going(unpacking->context))
            return rn_error_set(err, RN_ERROR_CANCELLED, name, "cancelled");
        la_ssize_t got = archive_read_data(unpacking->archive, block, sizeof block);
        if (got == 0) return RN_OK;
        if (got < 0) return damaged(unpacking, name, err);
        if (!rn_write_all(fd, block, (size_t)got))
            return rn_error_from_errno(err, errno, path, "write");
    }
}

static enum rn_status unpack_file(struct unpacking *unpacking, const char *name, const char *path,
                                  struct rn_error *err) {
    enum rn_status status = make_folders(unpacking, path, err);
    if (status) return status;
    int fd = open(path, O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0666);
    if (fd < 0 && errno == EEXIST)
        return rn_error_set(err, RN_ERROR_INVALID, name, "the name occurs twice in the tar");
    if (fd < 0) return rn_error_from_errno(err, errno, path, "create");
    status = copy_data(unpacking, fd, name, path, err);
    if (close(fd) < 0 && !status) status = rn_error_from_errno(err, errno, path, "close");
    return status;
}

static enum rn_status check_limits(struct unpacking *unpacking, struct archive_entry *entry,
                                   const char *name, struct rn_error *err) {
    const struct rn_unpack_limits *limits = unpacking->limits;
    int64_t size = archive_entry_size(entry);
    if (++unpacking->entries > limits->max_entries)
        return rn_error_set(err, RN_ERROR_LIMIT, name, "the tar has more than %zu entries",
                            limits->max_entries);
    if (size < 0 || (uint64_t)size > limits->max_bytes - unpacking->bytes)
        return rn_error_set(err, RN_ERROR_LIMIT, name,
                            "the tar's files are larger than %zu bytes together",
                            limits->max_bytes);
    unpacking->bytes += (uint64_t)size;
    return RN_OK;
}

static enum rn_status unpack_entry(struct unpacking *unpacking, struct archive_entry *entry,
                                   struct rn_error *err) {
    char cleaned[MAX_NAME_BYTES], path[PATH_MAX];
    const char *raw = archive_entry_pathname_utf8(entry);
    if (!raw) raw = archive_entry_pathname(entry);
    const char *name = clean_name(raw, cleaned);
    if (!name)
        return rn_error_set(err, RN_ERROR_INVALID, raw ? raw : "tar",
                            "an entry's name must be relative, UTF-8, and without \"..\" and "
                            "control characters");
    enum rn_status status = check_limits(unpacking, entry, name, err);
    if (status || !*name) return status;
    if (archive_entry_hardlink(entry) || archive_entry_symlink(entry))
        return rn_error_set(err, RN_ERROR_INVALID, name,
                            "links are not taken; put the file itself into the tar");
    mode_t type = archive_entry_filetype(entry);
    if (type != AE_IFREG && type != AE_IFDIR)
        return rn_error_set(err, RN_ERROR_INVALID, name, "only files and folders are taken");
    if (snprintf(path, sizeof path, "%s/%s", unpacking->target, name) >= (int)sizeof path)
        return rn_error_set(err, RN_ERROR_LIMIT, name, "the path is too long");
    return type == AE_IFDIR ? rn_mkdirs_in(unpacking->target, path, 0777, err)
                            : unpack_file(unpacking, name, path, err);
}

static enum rn_status unpack_all(struct unpacking *unpacking, struct rn_error *err) {
    for (;;) {
        struct archive_entry *entry;
        int rc = archive_read_next_header(unpacking->archive, &entry);
        if (rc == ARCHIVE_EOF) break;
        // A warning: a name that this locale cannot show, which does not matter here.
        if (rc != ARCHIVE_OK && rc != ARCHIVE_WARN) return damaged(unpacking, "tar", err);
        enum rn_status status = unpack_entry(unpacking, entry, err);
        if (status) return status;
    }
    if (unpacking->entries) return RN_OK;
    return rn_error_set(err, RN_ERROR_INVALID, "tar", "the tar is empty");
}

// A tar ends with blocks of zeros; one that was cut between two files does not.
static enum rn_status check_end(const char *archive, struct rn_error *err) {
    char last[512] = {1};
    static const char zeros[sizeof last];
    int fd = open(archive, O_RDONLY | O_CLOEXEC);
    off_t end = fd < 0 ? -1 : lseek(fd, -(off_t)sizeof last, SEEK_END);
    bool whole = end >= 0 && read(fd, last, sizeof last) == (ssize_t)sizeof last &&
                 memcmp(last, zeros, sizeof last) == 0;
    if (fd >= 0) close(fd);
    if (whole) return RN_OK;
    return rn_error_set(err, RN_ERROR_INVALID, "tar",
                        "the tar is cut off: it lacks the zeros that tars end with");
}

enum rn_status rn_unpack(const char *archive, const char *target,
                         const struct rn_unpack_limits *limits, bool (*keep_going)(void *context),
                         void *context, struct rn_error *err) {
    struct unpacking unpacking = {.archive = archive_read_new(),
                                  .target = target,
                                  .limits = limits,
                                  .keep_going = keep_going,
                                  .context = context};
    if (!unpacking.archive) return rn_error_set(err, RN_ERROR_NO_MEMORY, archive, "out of memory");
    enum rn_status status = RN_OK;
    if (archive_read_support_format_tar(unpacking.archive) != ARCHIVE_OK ||
        archive_read_open_filename(unpacking.archive, archive, BLOCK_BYTES) != ARCHIVE_OK)
        status = damaged(&unpacking, archive, err);
    if (!status) status = unpack_all(&unpacking, err);
    if (!status) status = check_end(archive, err);
    archive_read_free(unpacking.archive);
    return status;
}

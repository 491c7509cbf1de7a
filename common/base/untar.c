// Archives that a backup is: regular files, by ustar headers.
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/base/file.h"
#include "common/base/tar.h"

#define BLOCK 512
#define MAX_NAME 300

struct archive {
    FILE *file;
    const char *name, *folder; // of the archive; where it goes
    bool (*keep_going)(void *context);
    void *context;
    struct rn_tar_contents contents;
};

static enum rn_status damaged(const struct archive *archive, const char *what,
                              struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_CORRUPT, archive->name,
                        "%s: it is no backup, or not a whole one", what);
}

static bool is_safe(const char *name) {
    char part[MAX_NAME];
    for (const char *at = name;; at++) {
        size_t size = strcspn(at, "/");
        if (size >= sizeof part) return false;
        snprintf(part, sizeof part, "%.*s", (int)size, at);
        if (!rn_path_is_safe_name(part)) return false;
        at += size;
        if (*at == '\0') return true;
    }
}

// Name and size out of a ustar header; false: it is none, or of something else than a file.
static bool read_header(const char block[BLOCK], char name[MAX_NAME], long long *ret_size) {
    char sum_text[9] = "", size_text[13] = "", *end;
    long sum = 8 * ' ';
    for (int i = 0; i < BLOCK; i++)
        sum += i >= 148 && i < 156 ? 0 : (unsigned char)block[i];
    memcpy(sum_text, block + 148, 8);
    memcpy(size_text, block + 124, 12);
    if (strtol(sum_text, NULL, 8) != sum || block[156] != '0') return false;
    *ret_size = strtoll(size_text, &end, 8);
    snprintf(name, MAX_NAME, "%.155s%s%.100s", block + 345, block[345] ? "/" : "", block);
    return end == size_text + 11 && *ret_size >= 0;
}

static enum rn_status copy_file(struct archive *archive, const char *path, long long size,
                                struct rn_error *err) {
    char bytes[65536];
    int fd = open(path, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
    if (fd < 0 && errno == EEXIST) return damaged(archive, "a name is there twice", err);
    if (fd < 0) return rn_error_from_errno(err, errno, path, "create");
    enum rn_status status = RN_OK;
    for (long long left = (size + BLOCK - 1) / BLOCK * BLOCK; status == RN_OK && left > 0;) {
        if (archive->keep_going != NULL && !archive->keep_going(archive->context)) {
            status = rn_error_set(err, RN_ERROR_CANCELLED, archive->name, "cancelled");
            break;
        }
        size_t wanted = left < (long long)sizeof bytes ? (size_t)left : sizeof bytes;
        size_t kept = size < (long long)wanted ? (size_t)size : wanted;
        if (fread(bytes, 1, wanted, archive->file) != wanted)
            status = damaged(archive, "its end is missing", err);
        else if (!rn_write_all(fd, bytes, kept))
            status = rn_error_from_errno(err, errno, path, "write");
        left -= (long long)wanted;
        size -= (long long)kept;
    }
    if (status == RN_OK && fsync(fd) != 0) status = rn_error_from_errno(err, errno, path, "write");
    close(fd);
    return status;
}

static enum rn_status unpack_one(struct archive *archive, const char block[BLOCK],
                                 struct rn_error *err) {
    char name[MAX_NAME], path[4400];
    long long size;
    if (!read_header(block, name, &size)) return damaged(archive, "a header is wrong", err);
    if (!is_safe(name)) return damaged(archive, "a name is not safe", err);
    int length = snprintf(path, sizeof path, "%s/%s", archive->folder, name);
    if (length >= (int)sizeof path) return damaged(archive, "a name is too long", err);
    char *slash = strrchr(path, '/');
    *slash = '\0';
    enum rn_status status = rn_mkdirs_in(archive->folder, path, 0700, err);
    *slash = '/';
    archive->contents.files++;
    archive->contents.bytes += size;
    return status == RN_OK ? copy_file(archive, path, size, err) : status;
}

static enum rn_status unpack(struct archive *archive, struct rn_error *err) {
    static const char zeros[BLOCK];
    char block[BLOCK];
    for (int ends = 0; ends < 2;) {
        if (fread(block, 1, BLOCK, archive->file) != BLOCK)
            return damaged(archive, "its end is missing", err);
        bool end = memcmp(block, zeros, BLOCK) == 0;
        if (!end && ends > 0) return damaged(archive, "something follows its end", err);
        ends += end;
        enum rn_status status = end ? RN_OK : unpack_one(archive, block, err);
        if (status != RN_OK) return status;
    }
    return RN_OK;
}

enum rn_status rn_tar_unpack(const char *name, const char *folder, bool (*keep_going)(void *),
                             void *context, struct rn_tar_contents *ret_contents,
                             struct rn_error *err) {
    struct archive archive = {.file = fopen(name, "rbe"),
                              .name = name,
                              .folder = folder,
                              .keep_going = keep_going,
                              .context = context};
    if (archive.file == NULL) return rn_error_from_errno(err, errno, name, "open");
    enum rn_status status = unpack(&archive, err);
    fclose(archive.file);
    if (status == RN_OK) *ret_contents = archive.contents;
    return status;
}

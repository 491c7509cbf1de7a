#include "common/base/tar.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/buf.h"

#define BLOCK RN_TAR_BLOCK
#define MAX_FILES 1000000
#define MAX_FILE_BYTES 077777777777 // eleven octal digits

struct member {
    char *name;
    uint64_t size_bytes;
};

struct rn_tar {
    char *folder;
    struct member *members;
    size_t count, capacity;
    uint64_t size, sent;
    // the position: member `next` is to be opened, or its `left` bytes and `padding` are to be sent
    size_t next;
    int file;
    uint64_t left;
    char block[4 * BLOCK]; // headers, padding or the end mark
    size_t block_size, block_used;
    struct rn_error error;
};

enum rn_status rn_tar_create(const char *folder, struct rn_tar **ret_tar, struct rn_error *err) {
    struct rn_tar *tar = calloc(1, sizeof *tar);
    if (!tar || !(tar->folder = strdup(folder))) {
        free(tar);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, folder, "memory ran out");
    }
    tar->file = -1;
    tar->size = 2 * BLOCK;
    *ret_tar = tar;
    return RN_OK;
}

void rn_tar_destroy(struct rn_tar **tar) {
    if (!*tar) return;
    for (size_t i = 0; i < (*tar)->count; i++)
        free((*tar)->members[i].name);
    free((*tar)->members);
    if ((*tar)->file >= 0) close((*tar)->file);
    free((*tar)->folder);
    free(*tar);
    *tar = NULL;
}

static uint64_t padded(uint64_t size) {
    return (size + BLOCK - 1) / BLOCK * BLOCK;
}

// Where the name is cut into ustar's prefix (155 bytes) and name (100 bytes); NULL: it cannot be.
static const char *split_name(const char *name) {
    size_t size = strlen(name);
    if (size <= 100) return name;
    for (const char *slash = strchr(name, '/'); slash; slash = strchr(slash + 1, '/'))
        if (slash - name <= 155 && strlen(slash + 1) <= 100 && slash[1]) return slash + 1;
    return NULL;
}

// The record of POSIX.1-2001 (pax) for a name that ustar has no place for, "SIZE path=NAME\n" with
// all of its own bytes counted, into `ret` (NULL: nowhere). Returns its size.
static size_t name_record(const char *name, char ret[2 * BLOCK]) {
    size_t size = strlen(" path=\n") + strlen(name), whole = size;
    while (whole < size + (size_t)snprintf(NULL, 0, "%zu", whole))
        whole++;
    if (ret) snprintf(ret, 2 * BLOCK, "%zu path=%s\n", whole, name);
    return whole;
}

// Bytes of a member's headers.
static size_t headers_size(const char *name) {
    return split_name(name) ? BLOCK : 2 * BLOCK + padded(name_record(name, NULL));
}

static bool leaves_folder(const char *name) {
    for (const char *part = name;; part++) {
        size_t size = strcspn(part, "/");
        if (size == 2 && memcmp(part, "..", 2) == 0) return true;
        part += size;
        if (!*part) return *name == '/' || !*name;
    }
}

static int open_member(const struct rn_tar *tar, const char *name, struct stat *ret_status) {
    char path[4096];
    int size = snprintf(path, sizeof path, "%s/%s", tar->folder, name);
    if (size < 0 || (size_t)size >= sizeof path) {
        errno = ENAMETOOLONG;
        return -1;
    }
    int file = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (file >= 0 && fstat(file, ret_status) == 0 && S_ISREG(ret_status->st_mode)) return file;
    if (file >= 0) {
        close(file);
        errno = EINVAL;
    }
    return -1;
}

enum rn_status rn_tar_add(struct rn_tar *tar, const char *name, struct rn_error *err) {
    struct stat status;
    while (strncmp(name, "./", 2) == 0)
        name += 2;
    if (tar->count && strcmp(tar->members[tar->count - 1].name, name) == 0) return RN_OK;
    if (leaves_folder(name))
        return rn_error_set(err, RN_ERROR_INVALID, name,
                            "lies outside of the dataset's folder; move it into the folder");
    if (strlen(name) > RN_TAR_NAME_MAX)
        return rn_error_set(err, RN_ERROR_INVALID, name,
                            "the name has more than %d bytes; shorten it", RN_TAR_NAME_MAX);
    int file = open_member(tar, name, &status);
    if (file < 0) return rn_error_from_errno(err, errno, name, "open it as a regular file");
    close(file);
    if (status.st_size > MAX_FILE_BYTES || tar->count == MAX_FILES)
        return rn_error_set(err, RN_ERROR_LIMIT, name, "the dataset is too large for an archive");
    if (tar->count == tar->capacity) {
        size_t capacity = tar->capacity ? 2 * tar->capacity : 64;
        struct member *members = realloc(tar->members, capacity * sizeof *members);
        if (!members) return rn_error_set(err, RN_ERROR_NO_MEMORY, name, "memory ran out");
        tar->members = members;
        tar->capacity = capacity;
    }
    struct member member = {.name = strdup(name), .size_bytes = (uint64_t)status.st_size};
    if (!member.name) return rn_error_set(err, RN_ERROR_NO_MEMORY, name, "memory ran out");
    tar->members[tar->count++] = member;
    tar->size += headers_size(name) + padded(member.size_bytes);
    return RN_OK;
}

uint64_t rn_tar_size(const struct rn_tar *tar) {
    return tar->size;
}

uint64_t rn_tar_sent(const struct rn_tar *tar) {
    return tar->sent;
}

const struct rn_error *rn_tar_error(const struct rn_tar *tar) {
    return &tar->error;
}

static void put_header(char type, const char *name, uint64_t size_bytes, int64_t mtime_s,
                       char ret[BLOCK]) {
    const char *last = split_name(name);
    memset(ret, 0, BLOCK);
    memcpy(ret, last, strlen(last));
    if (last > name) memcpy(ret + 345, name, (size_t)(last - name) - 1);
    snprintf(ret + 100, 8, "%07o", 0644);
    snprintf(ret + 108, 8, "%07o", 0);
    snprintf(ret + 116, 8, "%07o", 0);
    snprintf(ret + 124, 12, "%011llo", (unsigned long long)size_bytes);
    snprintf(ret + 136, 12, "%011llo", (unsigned long long)mtime_s);
    ret[156] = type;
    memcpy(ret + 257, "ustar\00000", 8);
    unsigned sum = 8 * ' '; // the sum's own field counts as blanks
    for (size_t i = 0; i < BLOCK; i++)
        sum += (unsigned char)ret[i];
    snprintf(ret + 148, 8, "%06o", sum);
    ret[155] = ' ';
}

void rn_tar_header(const char *name, uint64_t size_bytes, int64_t mtime_s, char ret[BLOCK]) {
    put_header('0', name, size_bytes, mtime_s, ret);
}

static void put_zeros(struct rn_tar *tar, size_t size) {
    memset(tar->block, 0, sizeof tar->block);
    tar->block_size = size;
    tar->block_used = 0;
}

static void put_headers(struct rn_tar *tar, const struct member *member) {
    const char *name = member->name;
    put_zeros(tar, headers_size(name));
    char *last = tar->block + tar->block_size - BLOCK;
    if (!split_name(name)) {
        put_header('x', "pax", name_record(name, tar->block + BLOCK), 0, tar->block);
        name = "long-name";
    }
    put_header('0', name, member->size_bytes, 0, last);
}

// Opens the next member and queues its header, or queues the end mark. False: failed or finished.
static bool advance(struct rn_tar *tar) {
    struct stat status;
    if (tar->next > tar->count) return false;
    if (tar->next == tar->count) {
        tar->next++;
        put_zeros(tar, 2 * BLOCK);
        return true;
    }
    const struct member *member = &tar->members[tar->next++];
    tar->file = open_member(tar, member->name, &status);
    if (tar->file < 0) {
        rn_error_from_errno(&tar->error, errno, member->name, "open it as a regular file");
        return false;
    }
    tar->left = member->size_bytes;
    put_headers(tar, member);
    return true;
}

static size_t read_file(struct rn_tar *tar, char *buffer, size_t capacity) {
    const struct member *member = &tar->members[tar->next - 1];
    if (capacity > tar->left) capacity = (size_t)tar->left;
    ssize_t got = capacity ? read(tar->file, buffer, capacity) : 0;
    if (got < 0) {
        rn_error_from_errno(&tar->error, errno, member->name, "read");
        return SIZE_MAX;
    }
    if (got == 0 && tar->left) {
        rn_error_set(&tar->error, RN_ERROR_IO, member->name, "became shorter while it was sent");
        return SIZE_MAX;
    }
    tar->left -= (uint64_t)got;
    if (!tar->left) {
        close(tar->file);
        tar->file = -1;
        put_zeros(tar, (size_t)(padded(member->size_bytes) - member->size_bytes));
    }
    return (size_t)got;
}

size_t rn_tar_read(struct rn_tar *tar, char *buffer, size_t capacity) {
    size_t filled = 0;
    while (filled < capacity && tar->error.status == RN_OK) {
        size_t ready = tar->block_size - tar->block_used;
        if (ready) {
            size_t part = ready < capacity - filled ? ready : capacity - filled;
            memcpy(buffer + filled, tar->block + tar->block_used, part);
            tar->block_used += part;
            filled += part;
        } else if (tar->file >= 0) {
            size_t got = read_file(tar, buffer + filled, capacity - filled);
            filled += got == SIZE_MAX ? 0 : got;
        } else if (!advance(tar)) {
            break;
        }
    }
    tar->sent += filled;
    return tar->error.status == RN_OK ? filled : SIZE_MAX;
}

bool rn_tar_seek(struct rn_tar *tar, uint64_t offset) {
    char skipped[16384];
    if (tar->sent == offset) return tar->error.status == RN_OK;
    if (tar->file >= 0) close(tar->file);
    tar->file = -1;
    tar->next = 0;
    tar->sent = tar->left = 0;
    tar->block_size = tar->block_used = 0;
    for (; tar->next < tar->count; tar->next++) { // whole members
        const struct member *member = &tar->members[tar->next];
        uint64_t span = headers_size(member->name) + padded(member->size_bytes);
        if (offset - tar->sent < span) break;
        tar->sent += span;
    }
    while (tar->sent < offset && tar->error.status == RN_OK) {
        uint64_t left = offset - tar->sent;
        if (rn_tar_read(tar, skipped, left < sizeof skipped ? (size_t)left : sizeof skipped) == 0)
            break;
    }
    return tar->error.status == RN_OK;
}

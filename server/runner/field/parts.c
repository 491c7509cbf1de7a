#include "server/runner/field/parts.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/base/file.h"
#include "proto/codec.h"

enum rn_status rn_parts_take(struct rn_parts *parts, int64_t begin, int64_t end, size_t count,
                             size_t *ret_units, struct rn_error *err) {
    int64_t first = (int64_t)parts->first, last = first + (int64_t)count - 1;
    if (begin < first || end > last || end < begin)
        return rn_error_set(err, RN_ERROR_INVALID, "part",
                            "%lld to %lld are not among %lld to %lld", (long long)begin,
                            (long long)end, (long long)first, (long long)last);
    parts->first = (size_t)begin;
    parts->begin = begin;
    *ret_units = (size_t)(end - begin + 1);
    return RN_OK;
}

enum rn_status rn_parts_file(const struct rn_parts *parts, size_t unit, char ret_path[PATH_MAX],
                             struct rn_error *err) {
    if (snprintf(ret_path, PATH_MAX, "%s/%05zu.%s", parts->folder, parts->first + unit,
                 parts->ending) >= PATH_MAX)
        return rn_error_set(err, RN_ERROR_LIMIT, parts->folder, "the path is too long");
    return RN_OK;
}

static enum rn_status remove_units(const struct rn_parts *parts, size_t units,
                                   struct rn_error *err) {
    char path[PATH_MAX];
    for (size_t i = 0; i < units; i++) {
        enum rn_status status = rn_parts_file(parts, i, path, err);
        if (status) return status;
        if (unlink(path) < 0 && errno != ENOENT)
            return rn_error_from_errno(err, errno, path, "remove what shows another step");
    }
    return RN_OK;
}

enum rn_status rn_parts_begin(const struct rn_parts *parts, int64_t step, size_t units,
                              struct rn_error *err) {
    char file[PATH_MAX], text[32];
    uint8_t *before = NULL;
    size_t size = 0;
    if (snprintf(file, sizeof file, "%s/.step", parts->folder) >= (int)sizeof file)
        return rn_error_set(err, RN_ERROR_LIMIT, parts->folder, "the path is too long");
    int length = snprintf(text, sizeof text, "%lld\n", (long long)step);
    bool same = rn_file_read(file, sizeof text, &before, &size, NULL) == RN_OK &&
                strcmp((const char *)before, text) == 0;
    free(before);
    if (same) return RN_OK;
    if (parts->begin != RN_ABSENT)
        return rn_error_set(err, RN_ERROR_CONFLICT, parts->folder,
                            "what the job has made shows another step");
    enum rn_status status = remove_units(parts, units, err);
    return status ? status : rn_file_write_atomic(file, text, (size_t)length, err);
}

bool rn_parts_has(const struct rn_parts *parts, size_t unit) {
    char file[PATH_MAX];
    struct rn_error unused;
    return rn_parts_file(parts, unit, file, &unused) != RN_OK || access(file, F_OK) == 0;
}

enum rn_status rn_parts_write(const struct rn_parts *parts, const char *path, const void *bytes,
                              size_t size, struct rn_error *err) {
    char own[PATH_MAX + 64];
    if (parts->begin == RN_ABSENT) return rn_file_write_atomic(path, bytes, size, err);
    snprintf(own, sizeof own, "%s/.part-%lld", parts->folder, (long long)parts->begin);
    enum rn_status status = rn_file_write_atomic(own, bytes, size, err);
    if (!status && rename(own, path) != 0)
        status = rn_error_from_errno(err, errno, path, "put it in place");
    return status;
}

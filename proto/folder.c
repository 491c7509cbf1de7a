#include "proto/folder.h"

#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/file.h"

#define MAX_FILE (1 << 20)

static enum rn_status join(const char *folder, const char *name, char ret_path[PATH_MAX],
                           struct rn_error *err) {
    if (snprintf(ret_path, PATH_MAX, "%s/%s", folder, name) < PATH_MAX) return RN_OK;
    return rn_error_set(err, RN_ERROR_LIMIT, folder, "the path is too long");
}

enum rn_status rn_folder_read(const char *folder, const char *name, const struct rn_table *table,
                              void *ret_message, struct rn_error *err) {
    char path[PATH_MAX];
    uint8_t *json = NULL;
    size_t size;
    enum rn_status status = join(folder, name, path, err);
    if (status == RN_OK) status = rn_file_read(path, MAX_FILE, &json, &size, err);
    if (status != RN_OK) return status;
    status = rn_decode(table, (const char *)json, size, ret_message, NULL, err);
    free(json);
    return status;
}

enum rn_status rn_folder_write(const char *folder, const char *name, const char *json,
                               struct rn_error *err) {
    char path[PATH_MAX];
    enum rn_status status = join(folder, name, path, err);
    return status ? status : rn_file_write_atomic(path, json, strlen(json), err);
}

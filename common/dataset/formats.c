#include "common/dataset/formats.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

#include "common/dataset/reader.h"

#define DEEPEST 3      // folders below one in which a dataset is looked for
#define MOST_INNER 999 // and how many of them

#define FORMATS(ROW)                                                                               \
    ROW(native)                                                                                    \
    ROW(multiscale)                                                                                \
    ROW(blender) ROW(ngp) ROW(nerfstudio) ROW(colmap) ROW(opensfm) ROW(bundler) ROW(llff)

#define DECLARE(name) extern const struct rn_format rn_format_##name;
#define ADDRESS(name) &rn_format_##name,

FORMATS(DECLARE)
const struct rn_format *const rn_formats[] = {FORMATS(ADDRESS) NULL};
_Static_assert(sizeof rn_formats / sizeof *rn_formats <= RN_FORMATS_MAX, "raise RN_FORMATS_MAX");

const struct rn_format *rn_format_find(const char *name) {
    for (size_t i = 0; rn_formats[i]; i++)
        if (strcmp(rn_formats[i]->name, name) == 0) return rn_formats[i];
    return NULL;
}

void rn_format_names(char *text, size_t capacity) {
    size_t used = 0;
    for (size_t i = 0; rn_formats[i] && used < capacity; i++)
        used += (size_t)snprintf(text + used, capacity - used, "%s%s", i ? ", " : "",
                                 rn_formats[i]->name);
}

static bool has_member(const char *folder, const struct rn_sign *sign) {
    char *path;
    json_t *root = NULL;
    if (asprintf(&path, "%s/%s", folder, sign->file) < 0) return false;
    bool found = rn_json_parse_file(path, true, &root, NULL) == RN_OK &&
                 json_object_get(root, sign->member) != NULL;
    json_decref(root);
    free(path);
    return found;
}

static bool bears_sign(const char *folder, int fd, const struct rn_format *format) {
    for (const struct rn_sign *sign = format->signs; sign->file; sign++)
        if (faccessat(fd, sign->file, F_OK, 0) == 0 && (!sign->member || has_member(folder, sign)))
            return true;
    return false;
}

static bool is_dataset(const char *folder) {
    const struct rn_format *found[RN_FORMATS_MAX];
    size_t count = 0;
    return rn_formats_recognise(folder, found, &count, NULL) == RN_OK && count;
}

static int is_folder(const struct dirent *entry) {
    bool may_be = entry->d_type == DT_DIR || entry->d_type == DT_LNK || entry->d_type == DT_UNKNOWN;
    return entry->d_name[0] != '.' && may_be;
}

// The first dataset so many folders below; malloc'd, NULL where there is none.
static char *find_at(const char *folder, int depth, int *left) {
    struct dirent **entries;
    char *found = NULL;
    int count = scandir(folder, &entries, is_folder, alphasort);
    for (int i = 0; i < count; i++) {
        char *path = NULL;
        if (!found && --*left >= 0 && asprintf(&path, "%s/%s", folder, entries[i]->d_name) >= 0)
            found = depth > 1          ? find_at(path, depth - 1, left)
                    : is_dataset(path) ? strdup(path)
                                       : NULL;
        free(path);
        free(entries[i]);
    }
    if (count >= 0) free(entries);
    return found;
}

char *rn_formats_find_below(const char *folder) {
    char *found = NULL;
    int left = MOST_INNER;
    for (int depth = 1; depth <= DEEPEST && !found; depth++)
        found = find_at(folder, depth, &left);
    return found;
}

// Names the nearest folder above a file that is of a format, else the one that the file is in.
static enum rn_status complain_of_file(const char *file, struct rn_error *err) {
    static const char *const archives[] = {".zip", ".tar", ".gz", ".tgz", ".7z", ".rar", NULL};
    char folder[256], first[256] = "";
    const char *slash, *dot = strrchr(file, '.');
    for (size_t i = 0; dot && archives[i]; i++)
        if (strcasecmp(dot, archives[i]) == 0)
            return rn_error_set(err, RN_ERROR_INVALID, file,
                                "is an archive: unpack it and give its folder");
    if (snprintf(folder, sizeof folder, "%s", file) >= (int)sizeof folder)
        return rn_error_set(err, RN_ERROR_INVALID, file, "is a file, not a folder");
    do {
        slash = strrchr(folder, '/');
        if (slash > folder)
            folder[slash - folder] = '\0';
        else
            snprintf(folder, sizeof folder, "%s", slash ? "/" : ".");
        if (!*first) snprintf(first, sizeof first, "%s", folder);
    } while (!is_dataset(folder) && slash > folder);
    if (is_dataset(folder))
        return rn_error_set(err, RN_ERROR_INVALID, file, "is a file; give the folder: %s", folder);
    return rn_error_set(err, RN_ERROR_INVALID, file,
                        "is a file; give the folder with all photographs, perhaps %s",
                        strcmp(first, ".") == 0 ? "where you are: ." : first);
}

enum rn_status rn_formats_recognise(const char *folder, const struct rn_format *ret_found[],
                                    size_t *ret_count, struct rn_error *err) {
    int fd = open(folder, O_PATH | O_DIRECTORY | O_CLOEXEC);
    if (fd < 0 && errno == ENOTDIR) return complain_of_file(folder, err);
    if (fd < 0) return rn_error_from_errno(err, errno, folder, "open the folder");
    size_t count = 0;
    for (size_t i = 0; rn_formats[i]; i++)
        if (bears_sign(folder, fd, rn_formats[i])) ret_found[count++] = rn_formats[i];
    close(fd);
    *ret_count = count;
    return RN_OK;
}

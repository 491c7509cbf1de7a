#include "common/base/manifest.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/buf.h"
#include "common/base/file.h"
#include "common/base/sha256.h"

#define LIST "SHA256SUMS"
#define MAX_LIST (256u << 20)
#define BLOCK_BYTES (1 << 16)

enum rn_status rn_manifest_digest(const char *path, char ret_sha256[65], struct rn_error *err) {
    char block[BLOCK_BYTES];
    struct rn_sha256 hash;
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    ssize_t got = 0;
    if (fd < 0) return rn_error_from_errno(err, errno, path, "open the file");
    rn_sha256_init(&hash);
    do {
        got = read(fd, block, sizeof block);
        if (got > 0) rn_sha256_update(&hash, block, (size_t)got);
    } while (got > 0 || (got < 0 && errno == EINTR));
    int errnum = errno;
    close(fd);
    if (got < 0) return rn_error_from_errno(err, errnum, path, "read the file");
    rn_sha256_final_hex(&hash, ret_sha256);
    return RN_OK;
}

static int is_visible(const struct dirent *entry) {
    return entry->d_name[0] != '.';
}

static enum rn_status list_files(const char *folder, const char *inner, struct rn_buf *list,
                                 struct rn_error *err);

// `name` is relative to the folder.
static enum rn_status list_entry(const char *folder, const char *name, struct rn_buf *list,
                                 struct rn_error *err) {
    char path[PATH_MAX], sha256[65];
    struct stat about;
    if (snprintf(path, sizeof path, "%s/%s", folder, name) >= (int)sizeof path)
        return rn_error_set(err, RN_ERROR_LIMIT, folder, "the path is too long");
    if (lstat(path, &about) != 0) return rn_error_from_errno(err, errno, path, "find the file");
    if (S_ISDIR(about.st_mode)) return list_files(folder, name, list, err);
    if (!S_ISREG(about.st_mode) || strcmp(name, LIST) == 0) return RN_OK;
    enum rn_status status = rn_manifest_digest(path, sha256, err);
    if (status == RN_OK) rn_buf_printf(list, "%s  %s\n", sha256, name);
    return status;
}

// The files of FOLDER/inner and below, in the order of their names. Not by fts(3), which crashes
// where memory ends.
static enum rn_status list_files(const char *folder, const char *inner, struct rn_buf *list,
                                 struct rn_error *err) {
    char *path = NULL;
    struct dirent **entries = NULL;
    if (asprintf(&path, "%s/%s", folder, inner) < 0)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, folder, "no memory");
    int count = scandir(path, &entries, is_visible, alphasort);
    enum rn_status status =
        count < 0 ? rn_error_from_errno(err, errno, path, "list the folder") : RN_OK;
    free(path);
    for (int i = 0; i < count; i++) {
        char *name = NULL;
        if (status == RN_OK &&
            asprintf(&name, "%s%s%s", inner, *inner ? "/" : "", entries[i]->d_name) < 0) {
            name = NULL;
            status = rn_error_set(err, RN_ERROR_NO_MEMORY, folder, "no memory");
        } else if (status == RN_OK) {
            status = list_entry(folder, name, list, err);
        }
        free(name);
        free(entries[i]);
    }
    free(entries);
    return status;
}

enum rn_status rn_manifest_write(const char *folder, struct rn_error *err) {
    char path[PATH_MAX];
    struct rn_buf list;
    if (snprintf(path, sizeof path, "%s/" LIST, folder) >= (int)sizeof path)
        return rn_error_set(err, RN_ERROR_LIMIT, folder, "the path is too long");
    rn_buf_init(&list, MAX_LIST);
    enum rn_status status = list_files(folder, "", &list, err);
    if (status == RN_OK) status = rn_buf_status(&list, LIST, err);
    if (status == RN_OK)
        status = rn_file_write_atomic(path, list.data ? (void *)list.data : "", list.size, err);
    rn_buf_finish(&list);
    return status;
}

static enum rn_status check_entry(const char *folder, const char *sha256, const char *name,
                                  struct rn_error *err) {
    char path[PATH_MAX], found[65] = "";
    if (snprintf(path, sizeof path, "%s/%s", folder, name) >= (int)sizeof path)
        return rn_error_set(err, RN_ERROR_CORRUPT, folder, "its " LIST " is damaged");
    enum rn_status status = rn_manifest_digest(path, found, err);
    if (status == RN_ERROR_NOT_FOUND)
        return rn_error_set(err, RN_ERROR_CORRUPT, path, "is missing; " LIST " names it");
    if (status == RN_OK && strcmp(found, sha256) != 0)
        return rn_error_set(err, RN_ERROR_CORRUPT, path,
                            "is not as it was written: its bytes do not have their digest");
    return status;
}

static enum rn_status read_list(const char *folder, char **ret_text, struct rn_error *err) {
    char path[PATH_MAX];
    uint8_t *text = NULL;
    size_t size;
    if (snprintf(path, sizeof path, "%s/" LIST, folder) >= (int)sizeof path)
        return rn_error_set(err, RN_ERROR_LIMIT, folder, "the path is too long");
    enum rn_status status = rn_file_read(path, MAX_LIST, &text, &size, err);
    if (status == RN_OK) *ret_text = (char *)text;
    return status;
}

static bool is_line(const char *line) {
    return strlen(line) > 66 && line[64] == ' ' && line[65] == ' ';
}

enum rn_status rn_manifest_read(const char *folder,
                                enum rn_status (*name)(void *context, const char *sha256,
                                                       const char *name, struct rn_error *err),
                                void *context, struct rn_error *err) {
    char *text = NULL, *rest = NULL;
    enum rn_status status = read_list(folder, &text, err);
    if (status != RN_OK) return status;
    for (char *line = strtok_r(text, "\n", &rest); status == RN_OK && line != NULL;
         line = strtok_r(NULL, "\n", &rest)) {
        if (!is_line(line)) {
            status = rn_error_set(err, RN_ERROR_CORRUPT, folder, "its " LIST " is damaged");
            break;
        }
        line[64] = '\0';
        status = name(context, line, line + 66, err);
    }
    free(text);
    return status;
}

struct check {
    const char *folder, *only; // only: the one file that is checked; NULL: all
    bool (*keep_going)(void *context);
    void *context;
    bool found;
};

static enum rn_status check_if_wanted(void *context, const char *sha256, const char *name,
                                      struct rn_error *err) {
    struct check *check = context;
    if (check->only != NULL && strcmp(check->only, name) != 0) return RN_OK;
    if (check->keep_going != NULL && !check->keep_going(check->context))
        return rn_error_set(err, RN_ERROR_CANCELLED, check->folder, "cancelled");
    check->found = true;
    return check_entry(check->folder, sha256, name, err);
}

enum rn_status rn_manifest_check(const char *folder, bool (*keep_going)(void *context),
                                 void *context, struct rn_error *err) {
    struct check check = {.folder = folder, .keep_going = keep_going, .context = context};
    return rn_manifest_read(folder, check_if_wanted, &check, err);
}

enum rn_status rn_manifest_check_file(const char *folder, const char *name, struct rn_error *err) {
    struct check check = {.folder = folder, .only = name};
    enum rn_status status = rn_manifest_read(folder, check_if_wanted, &check, err);
    if (status == RN_OK && !check.found)
        status = rn_error_set(err, RN_ERROR_NOT_FOUND, name, LIST " does not name it");
    return status;
}

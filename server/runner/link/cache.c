#include "server/runner/link/cache.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/file.h"
#include "common/base/log.h"

#define LOCK ".lock"

// Nobody else may put anything in, or another folder in its place.
static bool is_own(const char *folder) {
    struct stat about;
    return stat(folder, &about) == 0 && about.st_uid == geteuid() && !(about.st_mode & 022);
}

enum rn_status rn_cache_open(const char *folder, int64_t most_bytes, struct rn_cache *ret_cache,
                             struct rn_error *err) {
    struct rn_cache cache = {.most_bytes = most_bytes};
    char path[PATH_MAX + 16];
    if (!realpath(folder, cache.folder)) return rn_error_from_errno(err, errno, folder, "open");
    snprintf(path, sizeof path, "%s/..", cache.folder);
    if (!is_own(cache.folder) || !is_own(path))
        return rn_error_set(err, RN_ERROR_INVALID, folder, "others may write there");
    enum rn_status status = RN_OK;
    static const char *const inner[] = {"objects", "work"};
    for (int i = 0; i < 2 && !status; i++) {
        snprintf(path, sizeof path, "%s/%s", cache.folder, inner[i]);
        status = rn_mkdirs(path, 0700, err);
    }
    if (!status) *ret_cache = cache;
    return status;
}

static bool object_path(const struct rn_cache *cache, const char *sha256, char ret_path[PATH_MAX]) {
    return strlen(sha256) == 64 && strspn(sha256, "0123456789abcdef") == 64 &&
           snprintf(ret_path, PATH_MAX, "%s/objects/%s", cache->folder, sha256) < PATH_MAX;
}

bool rn_cache_take(const struct rn_cache *cache, const char *sha256, const char *path) {
    char object[PATH_MAX];
    if (!object_path(cache, sha256, object) || access(object, R_OK) != 0) return false;
    (void)utimensat(AT_FDCWD, object, NULL, 0); // used now
    return (unlink(path) == 0 || errno == ENOENT) && link(object, path) == 0;
}

void rn_cache_keep(const struct rn_cache *cache, const char *sha256, const char *path) {
    char object[PATH_MAX];
    if (!object_path(cache, sha256, object)) return;
    if (link(path, object) != 0 && errno != EEXIST)
        rn_log(RN_LOG_WARN, "%s is not kept: %s", path, strerror(errno));
}

// ---- bounds --------------------------------------------------------------------------------

struct object {
    char name[65];
    int64_t bytes;
    struct timespec used;
};

static int by_use(const void *a, const void *b) {
    const struct timespec *x = &((const struct object *)a)->used;
    const struct timespec *y = &((const struct object *)b)->used;
    if (x->tv_sec != y->tv_sec) return x->tv_sec < y->tv_sec ? -1 : 1;
    return x->tv_nsec < y->tv_nsec ? -1 : x->tv_nsec > y->tv_nsec;
}

static struct object *list_objects(DIR *folder, size_t *ret_count, int64_t *ret_bytes) {
    struct object *objects = NULL;
    size_t count = 0, room = 0;
    int64_t bytes = 0;
    struct dirent *entry;
    struct stat about;
    while ((entry = readdir(folder)) != NULL) {
        if (strlen(entry->d_name) != 64 ||
            fstatat(dirfd(folder), entry->d_name, &about, AT_SYMLINK_NOFOLLOW) != 0)
            continue;
        if (count == room) {
            struct object *grown = realloc(objects, (room = 2 * room + 64) * sizeof *objects);
            if (!grown) break;
            objects = grown;
        }
        objects[count] = (struct object){.bytes = about.st_size, .used = about.st_mtim};
        memcpy(objects[count++].name, entry->d_name, 65);
        bytes += about.st_size;
    }
    *ret_count = count;
    *ret_bytes = bytes;
    return objects;
}

void rn_cache_trim(const struct rn_cache *cache) {
    char path[PATH_MAX + 16];
    size_t count;
    int64_t bytes;
    snprintf(path, sizeof path, "%s/objects", cache->folder);
    DIR *folder = opendir(path);
    if (!folder) return;
    struct object *objects = list_objects(folder, &count, &bytes);
    if (count) qsort(objects, count, sizeof *objects, by_use);
    for (size_t i = 0; i < count && bytes > cache->most_bytes; i++)
        if (unlinkat(dirfd(folder), objects[i].name, 0) == 0) bytes -= objects[i].bytes;
    free(objects);
    closedir(folder);
}

// ---- a process's own folder ----------------------------------------------------------------

// -1: another process has it, or it cannot be locked.
static int lock_folder(const char *folder) {
    char path[PATH_MAX + 16];
    snprintf(path, sizeof path, "%s/" LOCK, folder);
    int fd = open(path, O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600);
    if (fd >= 0 && flock(fd, LOCK_EX | LOCK_NB) == 0) return fd;
    if (fd >= 0) close(fd);
    return -1;
}

static void remove_left_over(const char *work) {
    char path[PATH_MAX];
    struct dirent *entry;
    DIR *folder = opendir(work);
    if (!folder) return;
    while ((entry = readdir(folder)) != NULL) {
        if (!rn_path_is_safe_name(entry->d_name) ||
            snprintf(path, sizeof path, "%s/%s", work, entry->d_name) >= (int)sizeof path)
            continue;
        int lock = lock_folder(path);
        if (lock >= 0 && rn_remove_tree(path, NULL) != RN_OK) rn_log(RN_LOG_WARN, "%s stays", path);
        if (lock >= 0) close(lock);
    }
    closedir(folder);
}

enum rn_status rn_cache_work(const struct rn_cache *cache, const char *name,
                             char ret_path[PATH_MAX], int *ret_lock, struct rn_error *err) {
    char work[PATH_MAX + 16];
    snprintf(work, sizeof work, "%s/work", cache->folder);
    remove_left_over(work);
    if (!rn_path_is_safe_name(name) ||
        snprintf(ret_path, PATH_MAX, "%s/%s", work, name) >= PATH_MAX)
        return rn_error_set(err, RN_ERROR_INVALID, name, "is no name of a folder");
    enum rn_status status = rn_mkdirs(ret_path, 0700, err);
    if (status) return status;
    *ret_lock = lock_folder(ret_path);
    return *ret_lock >= 0 ? RN_OK
                          : rn_error_set(err, RN_ERROR_BUSY, ret_path, "another process has it");
}

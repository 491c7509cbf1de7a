#include "server/runner/scene/checkpoints.h"

#include <dirent.h>
#include <errno.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/base/file.h"
#include "common/base/log.h"
#include "proto/scene.h"

static const char format[] = "step-%09" PRId64 ".safetensors";

void rn_checkpoint_name(int64_t step, char ret_name[64]) {
    snprintf(ret_name, 64, format, step);
}

static enum rn_status join(const char *scene_folder, const char *name, char ret_path[PATH_MAX],
                           struct rn_error *err) {
    int length =
        snprintf(ret_path, PATH_MAX, "%s/checkpoints%s%s", scene_folder, *name ? "/" : "", name);
    return length < PATH_MAX ? RN_OK
                             : rn_error_set(err, RN_ERROR_LIMIT, scene_folder,
                                            "the path is longer than %d bytes", PATH_MAX - 1);
}

enum rn_status rn_checkpoint_path(const char *scene_folder, int64_t step, char ret_path[PATH_MAX],
                                  struct rn_error *err) {
    char name[64];
    rn_checkpoint_name(step, name);
    return join(scene_folder, name, ret_path, err);
}

// The step of a checkpoint's name, or -1.
static int64_t step_of(const char *name) {
    char *end, again[64];
    if (strncmp(name, "step-", 5) != 0) return -1;
    errno = 0;
    int64_t step = strtoll(name + 5, &end, 10);
    if (errno || step < 0) return -1;
    rn_checkpoint_name(step, again);
    return strcmp(again, name) == 0 ? step : -1;
}

// Calls visit for each file of the folder.
static enum rn_status each_file(const char *scene_folder,
                                void (*visit)(void *context, const char *name), void *context,
                                struct rn_error *err) {
    char folder[PATH_MAX];
    enum rn_status status = join(scene_folder, "", folder, err);
    if (status) return status;
    DIR *dir = opendir(folder);
    if (!dir) return rn_error_from_errno(err, errno, folder, "open the folder");
    struct dirent *entry;
    while ((entry = readdir(dir)))
        visit(context, entry->d_name);
    closedir(dir);
    return RN_OK;
}

static void remove_file(const char *scene_folder, const char *name) {
    char path[PATH_MAX];
    struct rn_error err = {0};
    if (join(scene_folder, name, path, &err)) return;
    if (unlink(path) < 0 && errno != ENOENT)
        rn_log(RN_LOG_WARN, "%s cannot be removed: %s", path, strerror(errno));
}

static void remove_if_temporary(void *context, const char *name) {
    if (*name == '.' && strstr(name, ".tmp")) remove_file(context, name);
}

enum rn_status rn_checkpoints_prepare(const char *scene_folder, struct rn_error *err) {
    char folder[PATH_MAX];
    enum rn_status status = join(scene_folder, "", folder, err);
    if (!status) status = rn_mkdir(folder, 0777, err);
    if (!status && snprintf(folder, PATH_MAX, "%s/marks", scene_folder) < PATH_MAX)
        status = rn_mkdir(folder, 0777, err);
    if (status) return status;
    return each_file(scene_folder, remove_if_temporary, (void *)scene_folder, err);
}

struct newest {
    int64_t before, step;
};

static void take_newest(void *context, const char *name) {
    struct newest *newest = context;
    int64_t step = step_of(name);
    if (step > newest->step && step < newest->before) newest->step = step;
}

enum rn_status rn_checkpoints_newest(const char *scene_folder, int64_t before, int64_t *ret_step,
                                     struct rn_error *err) {
    struct newest newest = {.before = before, .step = -1};
    enum rn_status status = each_file(scene_folder, take_newest, &newest, err);
    if (status) return status;
    if (newest.step < 0)
        return rn_error_set(err, RN_ERROR_NOT_FOUND, scene_folder,
                            "the scene has no checkpoint that can be read; train it again");
    *ret_step = newest.step;
    return RN_OK;
}

void rn_checkpoints_prune(const char *scene_folder) {
    int64_t step = INT64_MAX;
    for (int kept = 0;; kept++) {
        if (rn_checkpoints_newest(scene_folder, step, &step, NULL)) return;
        char name[64];
        rn_checkpoint_name(step, name);
        if (kept >= RN_CHECKPOINTS_KEPT) remove_file(scene_folder, name);
    }
}

bool rn_checkpoint_is_damaged(enum rn_status status, const struct rn_error *err, const char *path) {
    // `where` may be cut.
    size_t length = strlen(err->where);
    return status == RN_ERROR_CORRUPT && length > 0 && strncmp(err->where, path, length) == 0;
}

void rn_checkpoint_set_aside(const char *scene_folder, int64_t step, const struct rn_error *why,
                             char ret_told[512]) {
    char path[PATH_MAX], aside[PATH_MAX + 16], name[64];
    rn_checkpoint_name(step, name);
    snprintf(ret_told, 512, "%s: %.200s", name, why->text);
    if (rn_checkpoint_path(scene_folder, step, path, NULL)) return;
    snprintf(aside, sizeof aside, "%s.damaged", path);
    rn_log(RN_LOG_ERROR, "%s: %s; it is set aside as %s", path, why->text, aside);
    if (rename(path, aside) < 0)
        rn_log(RN_LOG_WARN, "%s cannot be renamed: %s", path, strerror(errno));
}

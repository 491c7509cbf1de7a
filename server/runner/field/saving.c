#include "server/runner/field/saving.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <unistd.h>

#include "proto/marks.h"
#include "server/runner/scene/checkpoints.h"

// Makes a rename in a folder of the scene durable. -1 and errno on failure.
static int sync_folder(const char *scene_folder, const char *name) {
    char path[PATH_MAX];
    snprintf(path, sizeof path, "%s/%s", scene_folder, name);
    int fd = open(path, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    int rc = fd < 0 ? -1 : fsync(fd), errnum = errno;
    if (fd >= 0) close(fd);
    errno = errnum;
    return rc;
}

// The file bears the step at which it is written, which completing the step under way may raise:
// it is written under this name and renamed.
static enum rn_status fresh_path(const char *folder, char ret_path[PATH_MAX],
                                 struct rn_error *err) {
    if (snprintf(ret_path, PATH_MAX, "%s/checkpoints/.fresh.tmp", folder) >= PATH_MAX)
        return rn_error_set(err, RN_ERROR_LIMIT, folder, "the path is too long");
    return RN_OK;
}

bool rn_saving_holds(const struct rn_saving *saving, const struct rn_trainer *trainer) {
    return saving->begun ? rn_trainer_save_stage(trainer) == RN_SAVE_READS
                         : saving->wanted || saving->mark_wanted;
}

// The one begun last, or that could not be begun.
static void no_longer_wanted(struct rn_saving *saving) {
    if (saving->is_mark)
        saving->mark_wanted = false;
    else
        saving->wanted = false;
}

static enum rn_status begin(struct rn_saving *saving, struct rn_trainer *trainer,
                            const char *folder, struct rn_error *err) {
    char fresh[PATH_MAX];
    enum rn_status status = fresh_path(folder, fresh, err);
    saving->is_mark = !saving->wanted;
    if (!status)
        status = rn_trainer_save_begin(trainer, saving->is_mark ? RN_SAVE_FIELD : RN_SAVE_ALL,
                                       fresh, &saving->begun, err);
    if (status || !saving->begun) return status;
    no_longer_wanted(saving);
    saving->sha256[0] = '\0';
    rn_trainer_progress(trainer, &saving->progress);
    return RN_OK;
}

static enum rn_status end(struct rn_saving *saving, struct rn_trainer *trainer, const char *folder,
                          struct rn_error *err) {
    char fresh[PATH_MAX], path[PATH_MAX];
    const struct rn_progress *p = &saving->progress;
    saving->begun = false;
    enum rn_status status = rn_trainer_save_end(trainer, saving->sha256, err);
    if (status) return status;
    status = fresh_path(folder, fresh, err);
    if (status) return status;
    struct rn_mark mark = {.train_seconds = p->train_seconds, .step = p->step};
    status = saving->is_mark ? rn_mark_path(folder, &mark, path, err)
                             : rn_checkpoint_path(folder, p->step, path, err);
    if (!status && (rename(fresh, path) < 0 ||
                    sync_folder(folder, saving->is_mark ? "marks" : "checkpoints") < 0))
        status = rn_error_from_errno(err, errno, path, "put the checkpoint in place");
    if (status) unlink(fresh);
    if (status) return status;
    if (saving->is_mark)
        rn_marks_prune(folder, p->step);
    else
        rn_checkpoints_prune(folder);
    return RN_OK;
}

enum rn_status rn_saving_go_on(struct rn_saving *saving, struct rn_trainer *trainer,
                               const char *folder, bool *ret_saved, struct rn_error *err) {
    *ret_saved = false;
    enum rn_status status = RN_OK;
    if (!saving->begun) {
        status = begin(saving, trainer, folder, err);
        if (status) no_longer_wanted(saving);
        return status;
    }
    if (rn_trainer_save_stage(trainer) != RN_SAVE_OVER) return RN_OK;
    status = end(saving, trainer, folder, err);
    if (status) no_longer_wanted(saving);
    *ret_saved = !status;
    return status;
}

enum rn_status rn_saving_finish(struct rn_saving *saving, struct rn_trainer *trainer,
                                const char *folder, struct rn_error *err) {
    struct rn_progress now;
    enum rn_status status = RN_OK;
    if (saving->begun) status = end(saving, trainer, folder, err);
    rn_trainer_progress(trainer, &now);
    bool is_the_one =
        !saving->is_mark && saving->sha256[0] != '\0' && saving->progress.step == now.step;
    if (!status && is_the_one) return RN_OK;
    saving->wanted = true;
    while (!saving->begun) {
        status = begin(saving, trainer, folder, err);
        if (status) return status;
    }
    return end(saving, trainer, folder, err);
}

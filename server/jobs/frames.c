// Where the pictures of a path job lie. A runner may write its own scene's folder alone, so while
// one works on a job they are lent to it: jobs/ID/frames is scenes/SCENE/frames/ID until the job is
// over.
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/file.h"
#include "common/base/log.h"
#include "server/jobs/inside.h"

struct places {
    char *shelf, *lent, *kept;
};

static bool find_places(struct rn_control *control, const struct rn_task *task,
                        struct places *places) {
    const char *scene = task->row.scene, *job = task->row.id;
    places->shelf = rn_store_path(control->store, "scenes/%s/frames", scene);
    places->lent = rn_store_path(control->store, "scenes/%s/frames/%s", scene, job);
    places->kept = rn_store_path(control->store, "jobs/%s/frames", job);
    return places->shelf != NULL && places->lent != NULL && places->kept != NULL;
}

static void free_places(struct places *places) {
    free(places->shelf);
    free(places->lent);
    free(places->kept);
}

enum rn_status rn_frames_lend(struct rn_control *control, const struct rn_task *task,
                              char **ret_folder, struct rn_error *err) {
    struct places places;
    enum rn_status status = find_places(control, task, &places)
                                ? rn_mkdirs(places.shelf, 0700, err)
                                : rn_error_set(err, RN_ERROR_NO_MEMORY, "frames", "no memory");
    // They may be there already: from an attempt of a daemon that was killed.
    if (status == RN_OK && rename(places.kept, places.lent) != 0 && errno != ENOENT)
        status = rn_error_from_errno(err, errno, places.lent, "lending the frames");
    if (status == RN_OK) {
        *ret_folder = places.lent;
        places.lent = NULL;
    }
    free_places(&places);
    return status;
}

void rn_frames_take_back(struct rn_control *control, const struct rn_task *task) {
    struct places places;
    if (task->row.type != RN_JOB_PATH) return;
    if (find_places(control, task, &places) && rename(places.lent, places.kept) != 0 &&
        errno != ENOENT)
        rn_log(RN_LOG_WARN, "the frames of job %s stay in %s: %s", task->row.id, places.lent,
               strerror(errno));
    free_places(&places);
}

// Where the pictures of a path job lie, the scores of an evaluation on other machines, and what an
// export wrote. A runner may write its own scene's folder alone, so while one works on a job they
// are lent to it: jobs/ID/frames is scenes/SCENE/frames/ID until the job is over.
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/file.h"
#include "common/base/log.h"
#include "proto/names.h"
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
                              struct rn_error *err) {
    struct places places;
    enum rn_status status =
        find_places(control, task, &places)
            ? rn_mkdirs_in(rn_store_folder(control->store), places.shelf, 0700, err)
            : rn_error_set(err, RN_ERROR_NO_MEMORY, "frames", "no memory");
    // They may be there already: from an attempt of a daemon that was killed.
    if (status == RN_OK && rename(places.kept, places.lent) != 0 && errno != ENOENT)
        status = rn_error_from_errno(err, errno, places.lent, "lend the frames");
    free_places(&places);
    return status;
}

// What a killed runner had not written to its end: hidden, as is the step that all show, or
// partial.
static bool is_rest(const char *name) {
    size_t size = strlen(name);
    if (size > 8 && strcmp(name + size - 8, ".partial") == 0) return true;
    return *name == '.' && strcmp(name, ".") != 0 && strcmp(name, "..") != 0 &&
           strcmp(name, ".step") != 0;
}

// Of a job that is over: rests are removed, the bytes of all else are counted.
static int64_t clear_and_count(const char *path) {
    int64_t bytes = 0;
    struct dirent *entry;
    struct stat about;
    DIR *folder = opendir(path);
    if (folder == NULL) return 0;
    while ((entry = readdir(folder)) != NULL)
        if (is_rest(entry->d_name) && unlinkat(dirfd(folder), entry->d_name, 0) == 0)
            continue;
        else if (fstatat(dirfd(folder), entry->d_name, &about, AT_SYMLINK_NOFOLLOW) == 0 &&
                 S_ISREG(about.st_mode))
            bytes += about.st_size;
    closedir(folder);
    return bytes;
}

static bool has_rests(const char *path) {
    bool found = false;
    struct dirent *entry;
    DIR *folder = opendir(path);
    if (folder == NULL) return false;
    while (!found && (entry = readdir(folder)) != NULL)
        found = is_rest(entry->d_name);
    closedir(folder);
    return found;
}

static void clear_over(struct rn_control *control, struct rn_job_row *row) {
    struct rn_error err = {0};
    char *kept = rn_store_path(control->store, "jobs/%s/frames", row->id);
    bool over = rn_job_is_over(row->state) && rn_task_find(control, row->id) == NULL;
    if (kept != NULL && over && has_rests(kept)) {
        row->size_bytes = clear_and_count(kept);
        rn_log(RN_LOG_INFO, "what an earlier daemon left half written of job %s is removed",
               row->id);
        if (rn_store_update(control->store, &rn_jobs_table, row, &err) != RN_OK)
            rn_log(RN_LOG_WARN, "%s: %s", err.where, err.text);
    }
    free(kept);
}

void rn_frames_clear(struct rn_control *control) {
    static const enum rn_job_type types[] = {RN_JOB_PATH, RN_JOB_EXPORT};
    for (size_t i = 0; i < sizeof types / sizeof types[0]; i++) {
        struct rn_query query = {.equal = {{"type", rn_job_type_names[types[i]]}}};
        struct rn_error err = {0};
        void *rows = NULL;
        size_t count = 0;
        if (rn_store_list(control->store, &rn_jobs_table, &query, &rows, &count, &err) != RN_OK)
            rn_log(RN_LOG_WARN, "what is left of jobs cannot be listed: %s", err.text);
        for (size_t k = 0; k < count; k++)
            clear_over(control, &((struct rn_job_row *)rows)[k]);
        rn_rows_finish(&rn_jobs_table, rows, count);
    }
}

// They are in the result.
static void drop_scores(struct rn_control *control, const struct rn_task *task) {
    struct places places;
    struct rn_error err = {0};
    if (find_places(control, task, &places) && rn_remove_tree(places.lent, &err) != RN_OK)
        rn_task_log(task, RN_LOG_WARN, "%s: %s", err.where, err.text);
    free_places(&places);
}

// Of a path job's folder: a frame, or the note of the step that all of them show.
static bool is_made(const char *name) {
    return strcmp(name, ".step") == 0 || rn_frame_index(name) >= 0;
}

void rn_frames_hand_on(struct rn_control *control, const char *from, const char *to) {
    char *made = rn_store_path(control->store, "jobs/%s/frames", from);
    char *begun = rn_store_path(control->store, "jobs/%s/frames", to);
    struct dirent *entry;
    DIR *folder = made != NULL ? opendir(made) : NULL;
    int target = begun != NULL ? open(begun, O_RDONLY | O_DIRECTORY | O_CLOEXEC) : -1;
    while (folder != NULL && target >= 0 && (entry = readdir(folder)) != NULL)
        if (is_made(entry->d_name) &&
            linkat(dirfd(folder), entry->d_name, target, entry->d_name, 0) != 0)
            rn_log(RN_LOG_WARN, "job %s: %s of job %s is made anew: %s", to, entry->d_name, from,
                   strerror(errno));
    if (folder != NULL) closedir(folder);
    if (target >= 0) close(target);
    free(made);
    free(begun);
}

void rn_frames_take_back(struct rn_control *control, struct rn_task *task) {
    struct places places;
    if (task->row.type == RN_JOB_EVAL) drop_scores(control, task);
    if (task->row.type != RN_JOB_PATH && task->row.type != RN_JOB_EXPORT) return;
    struct rn_error err = {0};
    // There for good before the record speaks of them.
    if (find_places(control, task, &places)) {
        enum rn_status status = rn_file_rename(places.lent, places.kept, &err);
        if (status != RN_OK && status != RN_ERROR_NOT_FOUND)
            rn_log(RN_LOG_WARN, "the frames of job %s stay in %s: %s", task->row.id, places.lent,
                   err.text);
    }
    if (places.kept != NULL) task->row.size_bytes = clear_and_count(places.kept);
    free_places(&places);
}

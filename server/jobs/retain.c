// What is removed by itself, where the options say so: the frames and films of paths that ended
// longer ago than they are kept, and the oldest ones beyond the room that all of them may take. The
// job stays, and says so. Pictures that a link shows are kept.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/log.h"
#include "server/jobs/inside.h"

#define LOOK_NS 10000000000ll

static bool is_linked(struct rn_control *control, const char *job) {
    void *rows = NULL;
    size_t count = 0;
    struct rn_query query = {.equal = {{"job", job}}, .limit = 1};
    if (rn_store_list(control->store, &rn_tokens, &query, &rows, &count, NULL) != RN_OK)
        return true;
    rn_rows_finish(&rn_tokens, rows, count);
    return count > 0;
}

// The record last: what a crash or a failure leaves of the pictures counts, and a later look
// removes it.
static void remove_pictures(struct rn_control *control, struct rn_job_row *row, const char *why) {
    struct rn_error err = {0};
    char *folder = rn_store_path(control->store, "jobs/%s/frames", row->id);
    int64_t bytes = row->size_bytes;
    row->size_bytes = 0;
    enum rn_status status = folder == NULL
                                ? rn_error_set(&err, RN_ERROR_NO_MEMORY, row->id, "no memory")
                                : rn_store_check_folder(control->store, &err);
    if (status == RN_OK) status = rn_folder_empty(folder, &err); // a request may look at any time
    if (status == RN_OK) status = rn_folder_flush(folder, &err);
    if (status == RN_OK || status == RN_ERROR_NOT_FOUND)
        status = rn_store_update(control->store, &rn_jobs_table, row, &err);
    if (status == RN_OK)
        rn_log(RN_LOG_INFO, "the pictures of job %s are removed, %lld bytes: %s", row->id,
               (long long)bytes, why);
    else
        rn_log(RN_LOG_WARN, "the pictures of job %s: %s", row->id, err.text);
    free(folder);
}

// Newest first: what still fits stays.
static void retain(struct rn_control *control, struct rn_job_row *rows, size_t count) {
    const struct rn_control_options *options = &control->options;
    int64_t kept = 0;
    for (size_t i = 0; i < count; i++) {
        struct rn_job_row *row = &rows[i];
        if (row->size_bytes == 0 || !rn_job_is_over(row->state)) continue;
        if (rn_task_find(control, row->id) != NULL) continue; // its record is not yet on disk
        bool old = options->retain_pictures_s > 0 &&
                   rn_clock_since_ms(row->finished_ms) > options->retain_pictures_s * 1000;
        bool over = options->retain_bytes > 0 && kept + row->size_bytes > options->retain_bytes;
        if ((old || over) && !is_linked(control, row->id))
            remove_pictures(control, row, old ? "--retain-pictures" : "--retain-space");
        else
            kept += row->size_bytes;
    }
}

void rn_retain_work(struct rn_control *control) {
    const struct rn_control_options *options = &control->options;
    int64_t now_ns = rn_clock_ns();
    if (options->retain_pictures_s == 0 && options->retain_bytes == 0) return;
    if (control->stopping || now_ns < control->next_retain_ns) return;
    const int64_t age_ns = options->retain_pictures_s * 1000000000ll;
    control->next_retain_ns = now_ns + (age_ns > 0 && age_ns < LOOK_NS ? age_ns : LOOK_NS);
    struct rn_query query = {.equal = {{"type", rn_job_type_names[RN_JOB_PATH]}}};
    struct rn_error err = {0};
    void *rows = NULL;
    size_t count = 0;
    if (rn_store_list(control->store, &rn_jobs_table, &query, &rows, &count, &err) != RN_OK)
        rn_log(RN_LOG_WARN, "what may be removed cannot be listed: %s", err.text);
    retain(control, rows, count);
    rn_rows_finish(&rn_jobs_table, rows, count);
}

// Jobs that render many pictures of the scene, one after another: camera paths and evaluations.
//
// A job waits in the host's list, is prepared when its turn comes, and is then done unit by unit.
// A kind of job says what a unit is; all else stands once, in work.c. Thread-safety: owned by the
// host's thread.
#ifndef RN_SERVER_RUNNER_FIELD_WORK_H
#define RN_SERVER_RUNNER_FIELD_WORK_H

#include "server/runner/field/host.h"

struct rn_work;

// What differs between the kinds. Each `work` is the kind's own struct, whose first member is
// struct rn_work. On failure `err` is filled and the job has failed.
struct rn_work_kind {
    size_t size; // of the kind's struct, bytes
    // Counts the units (work->total > 0) and takes what they need.
    enum rn_status (*prepare)(struct rn_work *work, struct rn_field *field, struct rn_error *err);
    // All units show work->step from here on, and the first one is next. NULL: nothing to do.
    enum rn_status (*begin)(struct rn_work *work, struct rn_error *err);
    // Unit work->done.
    enum rn_status (*unit)(struct rn_work *work, struct rn_field *field,
                           const struct rn_field_info *info, struct rn_error *err);
    // The job's result as JSON, to be freed, after its last unit.
    enum rn_status (*result)(struct rn_work *work, struct rn_field *field, char **ret_json,
                             struct rn_error *err);
    void (*release)(struct rn_work *work); // what the kind owns; of a job in any state
};

struct rn_work {
    const struct rn_work_kind *kind;
    char job[RN_ID_MAX];
    bool prepared;
    size_t done, total; // units
    double *render_ms;  // of the units that were rendered
    size_t rendered;    // how many
    uint64_t nonfinite; // rays of them that were replaced
    double began_s, reported_s;
    int64_t step; // the training step that all units show
    double at;    // training seconds to look back at; NAN: as it is now
    struct rn_host *host;
    struct rn_watch watch;
    struct rn_work *next;
};

// Appends a job of this kind; the rest of its struct is zero. NULL: out of memory, which the daemon
// was told.
struct rn_work *rn_work_append(struct rn_host *host, const struct rn_work_kind *kind,
                               const char *job);
// What a unit's rendering polls: interactive renders do not wait for it. `work`: struct rn_work *.
bool rn_work_keep_going(void *work);
// Milliseconds that such renders took, in all: what they took within a unit is none of its own.
double rn_work_lent_ms(const struct rn_work *work);
// rn_render for the job, which lets them go first; its time is its own.
enum rn_status rn_work_render(struct rn_work *work, struct rn_field *field,
                              const struct rn_render_options *options,
                              struct rn_render_result *ret_result,
                              struct rn_error *err) RN_MUST_CHECK;
// Notes that a unit was rendered: its time and its rays that were replaced.
void rn_work_rendered(struct rn_work *work, double render_ms, uint64_t nonfinite_rays);
// Renders the frame's camera over the scene's background and scores it beside its photograph; notes
// that it was rendered.
enum rn_status rn_work_score(struct rn_work *work, struct rn_field *field,
                             const struct rn_field_info *info, const struct rn_frame *frame,
                             struct rn_view_score *ret_score, struct rn_error *err) RN_MUST_CHECK;
// Evenly spaced views of a split at the finest scale, `wanted` at most; returns how many.
int rn_work_choose_views(const struct rn_dataset *dataset, enum rn_split split, int wanted,
                         const struct rn_frame **ret_frames);

#endif

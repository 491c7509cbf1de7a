// A training's checkpoint or mark on its way to disk, block by block between slices of other work.
#ifndef RN_SERVER_RUNNER_FIELD_SAVING_H
#define RN_SERVER_RUNNER_FIELD_SAVING_H

#include <stdbool.h>

#include "server/engine/engine.h"

// Thread-safety: owned by the runner's thread. Zero: nothing is being saved.
struct rn_saving {
    bool wanted;                 // a checkpoint is to be begun
    bool mark_wanted;            // a mark is (proto/marks.h), after that
    bool begun;                  // one is being written
    bool is_mark;                // the one begun last
    struct rn_progress progress; // of it
    char sha256[65];             // of its parameters, when it is in place
};

static inline bool rn_saving_is_busy(const struct rn_saving *saving) {
    return saving->wanted || saving->mark_wanted || saving->begun;
}
// Whether training must wait, to leave the step that is saved as it is.
bool rn_saving_holds(const struct rn_saving *saving, const struct rn_trainer *trainer);
// Goes on a little. *ret_saved: the one begun is in place under SCENE/checkpoints or SCENE/marks,
// others pruned.
// After an error nothing is under way.
enum rn_status rn_saving_go_on(struct rn_saving *saving, struct rn_trainer *trainer,
                               const char *scene_folder, bool *ret_saved,
                               struct rn_error *err) RN_MUST_CHECK;
// Waits for what is under way, then saves the current step, unless that is the one.
enum rn_status rn_saving_finish(struct rn_saving *saving, struct rn_trainer *trainer,
                                const char *scene_folder, struct rn_error *err) RN_MUST_CHECK;

#endif

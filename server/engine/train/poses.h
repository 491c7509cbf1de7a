// The photographs' cameras, moved while the field is trained (effect pose-refinement): in turns,
// between steps, each a pass over the photographs that a render may cut short.
#ifndef RN_ENGINE_TRAIN_POSES_H
#define RN_ENGINE_TRAIN_POSES_H

#include "server/engine/scene/pose.h"

struct rn_trainer;
struct rn_pose_view; // of one photograph, in a pass

// Owner: whoever has the trainer; rn_poses_finish.
struct rn_poses {
    // How each training photograph's camera was moved from the dataset's: rn_pose_move, unit the
    // bounds' radius. NULL where poses are not refined. fp32, as in checkpoints.
    float (*moves)[RN_POSE_UNKNOWNS];
    int turns; // that are over
    // The pass under way: its views, those done, and which of the measurement's it is.
    struct rn_pose_view *views;
    int view_count, next, pass;
    double gain; // dB, as the effect has it
    bool gain_known;
};
void rn_poses_finish(struct rn_poses *poses);
// Before training begins or goes on: room for the moves where they are refined. RN_ERROR_NO_MEMORY.
enum rn_status rn_trainer_allocate_poses(struct rn_trainer *trainer,
                                         struct rn_error *err) RN_MUST_CHECK;

// Whether the gain is to be measured, or cameras are to be moved, before the next step.
bool rn_trainer_poses_due(const struct rn_trainer *trainer);
// Does so, until it is done or preempted; to be called again while *ret_busy. RN_ERROR_NO_MEMORY.
enum rn_status rn_trainer_refine_poses(struct rn_trainer *trainer, bool *ret_busy,
                                       struct rn_error *err) RN_MUST_CHECK;
// Where a training camera is now, as the dataset has it else.
struct rn_camera rn_trainer_pose(const struct rn_trainer *trainer, int frame,
                                 const struct rn_camera *camera);

#endif

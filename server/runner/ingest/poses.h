// Poses for photographs that have none: found by COLMAP, from frames of a film by FFmpeg too.
#ifndef RN_SERVER_RUNNER_INGEST_POSES_H
#define RN_SERVER_RUNNER_INGEST_POSES_H

#include "common/base/program.h"
#include "common/dataset/photos.h"

// What an import tells while it looks for poses. Thread-safety: one thread.
struct rn_poses_order {
    const char *source; // as rn_photos_read takes it
    const char *masks;  // of rn_read_options
    const char *work;   // an existing folder: files below it are moved, others copied
    int threads;        // 0: all
    struct rn_problems *problems;
    bool (*keep_going)(void *context);
    // Of a stage, of which `done` of `total` pieces are done; total 0: not known.
    void (*stage)(void *context, const char *name, size_t done, size_t total);
    void *context;
};

// Makes a folder in COLMAP's layout, `images`, `masks` and `sparse`, whose path is below `work`;
// malloc'd. *ret_photos: what was looked at, by the names in `images`; rn_photos_finish.
// RN_ERROR_NOT_FOUND without photographs, RN_ERROR_INVALID where no poses are found,
// rn_program_run's statuses.
enum rn_status rn_poses_find(const struct rn_poses_order *order, char **ret_folder,
                             struct rn_photos *ret_photos, struct rn_error *err) RN_MUST_CHECK;

// Tells which photographs found a place in `dataset`, read from that folder, and what to do about
// those that did not.
void rn_poses_tell(const struct rn_photos *photos, const struct rn_dataset *dataset,
                   struct rn_problems *problems);

// Keeps the model of such a folder as a tar in another: RN_POSES_MODEL.
#define RN_POSES_MODEL "colmap.tar"
enum rn_status rn_poses_keep(const char *folder, const char *target,
                             struct rn_error *err) RN_MUST_CHECK;

// The sharpest frames of a film, two a second and at most RN_FILM_FRAMES in all, each the sharpest
// of its stretch, as FRAME_NNNNNN.jpg in `folder`. Sharpness: the mean squared Laplacian of the
// frame at 480 pixels of width. rn_program_run's statuses; RN_ERROR_INVALID for a film without
// frames.
#define RN_FILM_FRAMES 240
enum rn_status rn_film_frames(const struct rn_poses_order *order, const char *film,
                              const char *folder, struct rn_error *err) RN_MUST_CHECK;

#endif

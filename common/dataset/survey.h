// What a look at all photographs of a capture says of it, before anything is trained.
#ifndef RN_COMMON_DATASET_SURVEY_H
#define RN_COMMON_DATASET_SURVEY_H

#include "common/dataset/dataset.h"

// Thread-safety: rn_survey_look for different frames, else one thread. Owner: the caller;
// rn_survey_destroy.
struct rn_survey;

// Numbers that are not known are NAN.
struct rn_findings {
    double blurred; // photographs that are far less sharp than those that their camera took before
                    // and after; of photographs alone of their camera nothing is known
    double duplicates;      // photographs that show what another shows, from the same place
    double looking_away;    // cameras whose axis does not meet the bounds
    double exposure_spread; // by how much 90 % of the photographs differ at most, less 1
    double azimuth_gap_deg; // the widest angle about up from which nothing was photographed
    double elevation_min_deg, elevation_max_deg; // from which it was, at the bounds' centre
    double reprojection_px, reprojection_median_px, reprojection_p95_px; // of the sparse points
    double reprojection_worst_px; // mean of the photograph in which it is largest
    double train_bytes;           // memory of a training with `standard`
};

// What a training with `standard` takes of a capture as an import would keep it: by the preset and
// a formula of the photographs' pixels.
struct rn_training_cost {
    int views[RN_SPLIT_COUNT];
    int width, height;   // of the largest photograph that is kept
    int scales;          // that are kept of each
    int reduced;         // times that it makes photographs smaller to train on them
    double bytes;        // of memory
    double load_seconds; // CPU time before its first step, about
    double seconds;      // from that on
};
struct rn_training_cost rn_training_cost(const struct rn_dataset *dataset,
                                         const struct rn_import_options *kept);

// For the frames of a dataset, which must outlive it. RN_ERROR_NO_MEMORY.
enum rn_status rn_survey_create(const struct rn_dataset *dataset, struct rn_survey **ret_survey,
                                struct rn_error *err) RN_MUST_CHECK;
void rn_survey_destroy(struct rn_survey **survey);
// Looks at a decoded frame, one of the dataset's as they lay when the survey began; `hidden`: its
// mask leaves nothing of it. NULL-safe.
void rn_survey_look(struct rn_survey *survey, const struct rn_frame *frame,
                    const struct rn_image *image, bool hidden);
// What was seen of the frames that `dataset` still has, and the figures of its poses, which are all
// there is where nothing was looked at; what is worth knowing also goes into `problems` (optional),
// with names. `kept`: how an import would keep them, which a training's memory is of.
// RN_ERROR_NO_MEMORY.
enum rn_status rn_survey_conclude(struct rn_survey *survey, struct rn_dataset *dataset,
                                  const struct rn_import_options *kept,
                                  struct rn_problems *problems, struct rn_findings *ret_findings,
                                  struct rn_error *err) RN_MUST_CHECK;
// The same of photographs without poses (rn_photos_frames): what pictures alone say.
enum rn_status rn_survey_conclude_photos(struct rn_survey *survey, const struct rn_dataset *frames,
                                         struct rn_problems *problems,
                                         struct rn_findings *ret_findings,
                                         struct rn_error *err) RN_MUST_CHECK;

#endif

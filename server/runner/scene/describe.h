// The engine's and the dataset's structs as messages.
#ifndef RN_SERVER_RUNNER_SCENE_DESCRIBE_H
#define RN_SERVER_RUNNER_SCENE_DESCRIBE_H

#include "common/dataset/dataset.h"
#include "proto/dataset.h"
#include "proto/job.h"
#include "proto/report.h"
#include "server/engine/engine.h"

// JSON of rn_scene_description_table; malloc'd. `held_out` may be NULL.
enum rn_status rn_describe_scene(const struct rn_field_info *info, const char *held_out,
                                 char **ret_json, struct rn_error *err) RN_MUST_CHECK;
// JSON of rn_dataset_contents_table: the imported `dataset` and the reader's report on `source`,
// which was read from the folder `root`; places in the report are relative to it.
enum rn_status rn_describe_dataset(const struct rn_dataset *dataset, int64_t size_bytes,
                                   const struct rn_dataset *source, const char *root,
                                   const struct rn_problems *problems,
                                   const struct rn_findings *survey, char **ret_json,
                                   struct rn_error *err) RN_MUST_CHECK;
// JSON of rn_dataset_report_table: of `source`, as above; `kept` as of rn_dataset_report_fill.
enum rn_status rn_describe_report(const struct rn_dataset *source, const char *root,
                                  const struct rn_problems *problems,
                                  const struct rn_findings *survey,
                                  const struct rn_import_options *kept, char **ret_json,
                                  struct rn_error *err) RN_MUST_CHECK;
// The same of photographs without poses (rn_photos_frames).
enum rn_status rn_describe_photos_report(const struct rn_dataset *frames, const char *root,
                                         const struct rn_problems *problems,
                                         const struct rn_findings *survey, char **ret_json,
                                         struct rn_error *err) RN_MUST_CHECK;
// The engine's part of the progress; paused, yielded and evaluating_first are the caller's.
struct rn_train_progress rn_describe_progress(const struct rn_progress *progress,
                                              const struct rn_train_config *config);
// A preset with the options put over it and checked.
enum rn_status rn_configure(const struct rn_train_options *options, bool multi_scale,
                            struct rn_train_config *ret_config, struct rn_error *err) RN_MUST_CHECK;
// Takes every "root/" out of a text: what was found inside a folder is told as it is named there.
void rn_make_relative(char *text, const char *root);
// Resident memory of this process, bytes; 0 when it cannot be told.
int64_t rn_resident_bytes(void);

#endif

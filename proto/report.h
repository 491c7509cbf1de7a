// A reader's findings as the message that `validate`, imports and dataset records show.
#ifndef RN_PROTO_REPORT_H
#define RN_PROTO_REPORT_H

#include "common/dataset/dataset.h"
#include "proto/dataset.h"

// Fills *ret_report from what was read, the problems on the way, a survey (optional), and, before
// an import, what it would keep by `kept` and by some other options (NULL: nothing of these). The
// caller finishes it with rn_message_finish(&rn_dataset_report_table). At most
// RN_REPORT_PROBLEMS_MAX problems are listed; `dropped` counts the others. RN_ERROR_NO_MEMORY
// (nothing to finish then).
enum rn_status rn_dataset_report_fill(const struct rn_dataset *dataset,
                                      const struct rn_problems *problems,
                                      const struct rn_findings *survey,
                                      const struct rn_import_options *kept,
                                      struct rn_dataset_report_record *ret_report,
                                      struct rn_error *err) RN_MUST_CHECK;

// The same of photographs without poses (rn_photos_frames), of which there are no bounds, and
// nothing is told of a training.
enum rn_status rn_photos_report_fill(const struct rn_dataset *frames,
                                     const struct rn_problems *problems,
                                     const struct rn_findings *survey,
                                     struct rn_dataset_report_record *ret_report,
                                     struct rn_error *err) RN_MUST_CHECK;

// The problems alone, for when nothing could be read: as above.
enum rn_status rn_report_problems_fill(const struct rn_problems *problems,
                                       struct rn_dataset_report_record *ret_report,
                                       struct rn_error *err) RN_MUST_CHECK;

struct rn_bounds_record rn_describe_bounds(const struct rn_bounds *bounds);

#endif

// What an import would keep, told before it is made.
#ifndef RN_SERVER_RUNNER_INGEST_VALIDATE_H
#define RN_SERVER_RUNNER_INGEST_VALIDATE_H

#include "common/dataset/dataset.h"

// JSON of rn_validation_table: what an import of `source` by these options would keep.
enum rn_status rn_describe_validation(struct rn_dataset *source, const char *root,
                                      const struct rn_import_options *options,
                                      struct rn_problems *problems, char **ret_json,
                                      struct rn_error *err) RN_MUST_CHECK;
// The same of photographs without poses below `root`, which are called by `name`: what pictures
// alone say. `masks` as of rn_read_options.
enum rn_status rn_describe_photos(const char *root, const char *name, const char *masks,
                                  int threads, struct rn_problems *problems, char **ret_json,
                                  struct rn_error *err) RN_MUST_CHECK;

#endif

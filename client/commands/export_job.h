// Exports that a job of the daemon makes: meshes, and scenes for viewing.
#ifndef RN_CLIENT_COMMANDS_EXPORT_JOB_H
#define RN_CLIENT_COMMANDS_EXPORT_JOB_H

#include "client/api.h"
#include "proto/job.h"

// Has the scene exported with these options, in a job that is followed, and writes what it made
// into the file. Complains.
enum rn_exit rn_export_by_job(struct rn_client *client, const char *scene,
                              const struct rn_export_options *options, const char *file);
// Writes what a job of type export made, or makes now, into the file. Complains, also of a job that
// exports nothing and of a file of another kind.
enum rn_exit rn_export_of_job(struct rn_client *client, const char *job, const char *file);

// What the planes of a file for viewing are kept as: "planes in 8 bits a value by blocks".
void rn_format_planes(int64_t bits, char *ret_text, size_t capacity);

#endif

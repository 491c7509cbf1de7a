// Submitting jobs, for the verbs that do.
#ifndef RN_CLIENT_COMMANDS_SUBMIT_H
#define RN_CLIENT_COMMANDS_SUBMIT_H

#include "client/api.h"
#include "proto/job.h"

// POSTs a job request's JSON. Complains when it is refused. On success the job's id, and its JSON,
// malloc'd, the caller's to free.
enum rn_exit rn_submit(struct rn_client *client, const char *body, char ret_job[RN_ID_MAX],
                       char **ret_json);

#endif

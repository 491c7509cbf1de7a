// Sending a dataset's archive, over as many connections as it takes.
#ifndef RN_CLIENT_COMMANDS_UPLOAD_H
#define RN_CLIENT_COMMANDS_UPLOAD_H

#include "client/client.h"
#include "common/base/tar.h"
#include "proto/dataset.h"

// Sends the archive, going on where a lost connection left it, and asks for its import under
// `name`; the ingest job's id. Complains. Gives up when nothing has arrived for two minutes or it
// is interrupted, and leaves nothing of it in the daemon then, as far as that answers.
enum rn_exit rn_upload(struct rn_client *client, struct rn_tar *tar, const char *name,
                       const struct rn_ingest_options *options, char ret_job[RN_ID_MAX]);

#endif

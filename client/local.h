// ripnerf-runner on this machine, for verbs that need no daemon.
#ifndef RN_CLIENT_LOCAL_H
#define RN_CLIENT_LOCAL_H

#include "client/client.h"
#include "common/base/buf.h"

// Runs the runner that lies where the daemon looks for it, with the arguments argv[1..] (NULL at
// the end; argv[0] is filled in), and takes its standard output, the report: `report` is
// initialised here and the caller's to finish. RN_EXIT_OK, RN_EXIT_USAGE or RN_EXIT_FAILED as the
// runner ended; a report may have come all the same. Complains when it could not be run. What it
// says on its standard error goes to this program's or, where `quiet`, is left out but for its own
// complaint, which becomes one of this program's.
enum rn_exit rn_local_run(const char **argv, bool quiet, struct rn_buf *report);

#endif

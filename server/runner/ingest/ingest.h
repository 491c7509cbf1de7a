// Modes ingest and poses: one dataset, unpacked, read, imported, described; in mode poses those of
// its photographs are found first. Or, in mode ingest, a scene (adopt.h).
#ifndef RN_SERVER_RUNNER_INGEST_INGEST_H
#define RN_SERVER_RUNNER_INGEST_INGEST_H

#include "server/runner/sandbox/profile.h"

// Waits for an `ingest` message, does the work, answers with `done` or `failed`. The exit code.
// `profile`: what it is confined to; NULL: nothing.
int rn_ingest_run(int fd, const char *mode, const struct rn_profile *profile);

#endif

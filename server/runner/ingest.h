// Mode ingest: one dataset, unpacked, read, imported, described.
#ifndef RN_SERVER_RUNNER_INGEST_H
#define RN_SERVER_RUNNER_INGEST_H

#include <stdbool.h>

// Waits for an `ingest` message, does the work, answers with `done` or `failed`. The exit code.
int rn_ingest_run(int fd, bool sandbox);

#endif

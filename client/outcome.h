// How a job went, in a line for people.
#ifndef RN_CLIENT_OUTCOME_H
#define RN_CLIENT_OUTCOME_H

#include <stddef.h>

#include "proto/job.h"

// What a job that has ended came to: its figures, or why it failed; "" where nothing is known.
// Thread-safety: one job, one thread.
void rn_format_outcome(const struct rn_job *job, char *ret_text, size_t capacity);

#endif

// What a training will take: as `train --estimate` tells, and what a report knows before.
#ifndef RN_CLIENT_COMMANDS_ESTIMATE_H
#define RN_CLIENT_COMMANDS_ESTIMATE_H

#include "client/client.h"
#include "proto/dataset.h"

// Follows an estimate job to its end and prints what it found.
enum rn_exit rn_wait_for_estimate(struct rn_client *client, const char *job);

// A line: what `standard` takes by formula.
void rn_print_expected(const struct rn_expected *expected);
// A table: what an import by some options would keep, and what `standard` takes of that.
void rn_print_choices(const struct rn_import_choice *choices, size_t count);
// A line, where any training has ended in the daemon: what `standard` takes by those.
void rn_print_past(const struct rn_expected_past *past);

#endif

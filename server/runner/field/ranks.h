// Runners that train together (server/engine/kernels/exchange.h). Rank 0 is the daemon's runner, as
// any other. The others have no daemon: they make what rank 0 trains, and follow it.
#ifndef RN_SERVER_RUNNER_FIELD_RANKS_H
#define RN_SERVER_RUNNER_FIELD_RANKS_H

#include "server/runner/field/host.h"

// Rank 0: makes a trainer on all ranks, from a checkpoint or, where `path` is NULL, anew. As
// rn_trainer_restore and rn_trainer_create; so too without other ranks.
enum rn_status rn_ranks_make_trainer(struct rn_host *host, const struct rn_train_config *config,
                                     const char *path, struct rn_trainer **ret_trainer,
                                     struct rn_error *err) RN_MUST_CHECK;
// Rank 0: lets the others end.
void rn_ranks_part(const struct rn_exchange *exchange);

// The others: trains what rank 0 does, until it parts. The exit code.
int rn_ranks_run(const struct rn_exchange *exchange, const struct rn_profile *profile);

#endif

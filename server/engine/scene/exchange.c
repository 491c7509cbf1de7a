// The module that joins ranks.
#include "server/engine/kernels/exchange.h"

#include <dlfcn.h>

#include "server/engine/scene/module.h"
#include "server/engine/scene/scene.h"

enum rn_status rn_exchange_open(const struct rn_exchange **ret_exchange, struct rn_error *err) {
    void *module =
        rn_module_open("RIPNERF_MPI_MODULE", "ripnerf-mpi.so", "engine/mpi/ripnerf-mpi.so");
    rn_exchange_join_function *join = NULL;
    if (module) *(void **)&join = dlsym(module, RN_EXCHANGE_SYMBOL);
    const char *why = join ? NULL : dlerror();
    if (!join)
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, "ranks",
                            "the MPI module is not installed (%s): build with libopenmpi-dev, or "
                            "train without --ranks",
                            why ? why : "no reason given");
    const struct rn_exchange *exchange = join();
    if (!exchange || exchange->version != RN_EXCHANGE_VERSION)
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, "ranks",
                            "the MPI module does not join the ranks; install all of one build");
    *ret_exchange = exchange;
    return RN_OK;
}

void rn_engine_join(struct rn_engine *engine, const struct rn_exchange *exchange) {
    engine->exchange = exchange && exchange->ranks > 1 ? exchange : NULL;
}

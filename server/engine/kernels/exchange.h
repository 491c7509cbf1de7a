// Ranks: processes that train one field together, each on its own share of every step. What they
// tell each other goes through one table of functions, which the module ripnerf-mpi.so makes; with
// one rank there is none. C ABI.
//
// All ranks call the same functions in the same order, from one thread. A rank that is lost takes
// the others with it: none of the functions returns then, and training goes on from a checkpoint.
#ifndef RN_ENGINE_KERNELS_EXCHANGE_H
#define RN_ENGINE_KERNELS_EXCHANGE_H

#include <stddef.h>
#include <stdint.h>

#define RN_EXCHANGE_VERSION 1
#define RN_EXCHANGE_SYMBOL "rn_exchange_join"
#define RN_MAX_RANKS 16

struct rn_exchange {
    int version;
    int rank, ranks;
    // The bytes of rank 0 become everybody's. Waiting for them takes no processor for long.
    void (*broadcast)(void *bytes, size_t size);
    // Parts of `bytes`, one a rank, of sizes[rank] bytes each, lie one after another: each rank has
    // its own there, and all of them afterwards.
    void (*gather)(void *bytes, const size_t sizes[RN_MAX_RANKS]);
    // Each number becomes the largest of all ranks'.
    void (*maxima)(uint32_t *numbers, size_t count);
    void (*leave)(void);   // all together, at the end
    void (*abandon)(void); // ends all ranks at once; does not return
};

// What the module has under RN_EXCHANGE_SYMBOL: joins the ranks that were started together. NULL:
// more than RN_MAX_RANKS, or the ranks cannot be joined.
typedef const struct rn_exchange *rn_exchange_join_function(void);

#endif

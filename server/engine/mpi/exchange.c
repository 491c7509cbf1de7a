// Ranks over MPI: the module's only file, and the only one that knows MPI.
#include <mpi.h>
#include <stdio.h>
#include <time.h>

#include "server/engine/kernels/exchange.h"

#define AWAKE_S 0.002   // of waiting for a word of rank 0's, before the processor is let go
#define SLEEP_NS 200000 // then, between two looks

rn_exchange_join_function rn_exchange_join;

static struct rn_exchange exchange;

// In a training words come within a step; while rank 0 renders or rests they may take minutes.
static void broadcast(void *bytes, size_t size) {
    MPI_Request request;
    const struct timespec nap = {.tv_nsec = SLEEP_NS};
    int done = 0;
    MPI_Ibcast(bytes, (int)size, MPI_BYTE, 0, MPI_COMM_WORLD, &request);
    double begin = MPI_Wtime();
    for (MPI_Test(&request, &done, MPI_STATUS_IGNORE); !done;
         MPI_Test(&request, &done, MPI_STATUS_IGNORE))
        if (MPI_Wtime() - begin > AWAKE_S) nanosleep(&nap, NULL);
}

static void gather(void *bytes, const size_t sizes[RN_MAX_RANKS]) {
    int counts[RN_MAX_RANKS], offsets[RN_MAX_RANKS], at = 0;
    for (int rank = 0; rank < exchange.ranks; rank++) {
        counts[rank] = (int)sizes[rank];
        offsets[rank] = at;
        at += counts[rank];
    }
    MPI_Allgatherv(MPI_IN_PLACE, 0, MPI_BYTE, bytes, counts, offsets, MPI_BYTE, MPI_COMM_WORLD);
}

static void maxima(uint32_t *numbers, size_t count) {
    MPI_Allreduce(MPI_IN_PLACE, numbers, (int)count, MPI_UINT32_T, MPI_MAX, MPI_COMM_WORLD);
}

static void leave(void) {
    MPI_Finalize();
}

static void abandon(void) {
    MPI_Abort(MPI_COMM_WORLD, 1);
}

const struct rn_exchange *rn_exchange_join(void) {
    int provided;
    if (MPI_Init_thread(NULL, NULL, MPI_THREAD_FUNNELED, &provided) != MPI_SUCCESS) return NULL;
    exchange = (struct rn_exchange){.version = RN_EXCHANGE_VERSION,
                                    .broadcast = broadcast,
                                    .gather = gather,
                                    .maxima = maxima,
                                    .leave = leave,
                                    .abandon = abandon};
    MPI_Comm_rank(MPI_COMM_WORLD, &exchange.rank);
    MPI_Comm_size(MPI_COMM_WORLD, &exchange.ranks);
    if (exchange.ranks > RN_MAX_RANKS) {
        if (exchange.rank == 0)
            fprintf(stderr, "%d ranks: at most %d train together\n", exchange.ranks, RN_MAX_RANKS);
        MPI_Finalize();
        return NULL;
    }
    // Connections are made by the first word between two ranks: all of them here, before a runner
    // gives up the right to make any.
    uint8_t hello[RN_MAX_RANKS] = {0}, heard[RN_MAX_RANKS];
    MPI_Alltoall(hello, 1, MPI_BYTE, heard, 1, MPI_BYTE, MPI_COMM_WORLD);
    MPI_Barrier(MPI_COMM_WORLD);
    return &exchange;
}

// Inside of server/slurm: what its threads share, under slurm->lock.
#ifndef RN_SERVER_SLURM_INSIDE_H
#define RN_SERVER_SLURM_INSIDE_H

#include <limits.h>
#include <pthread.h>

#include "proto/join.h"
#include "proto/names.h"
#include "server/slurm/porter.h"
#include "server/slurm/slurm.h"

// A runner that was asked for, from before its submission until its job is over. Its folder is
// DATA/slurm/NAME:
//   join    the secret of the next connection (proto/join.h)
//   scene   a link to the scene's folder, by which the runner writes: without it, it cannot
//   script  what the node runs; it has the secret, and there is no `join`, without a shared folder
//   job     Slurm's number of it
struct rn_place {
    struct rn_place *next;
    int number; // of its rn_process
    char name[RN_JOIN_NAME_MAX];
    char scene[RN_ID_MAX];
    bool helps;
    char *dataset, *train, *log; // as rn_order has them; NULL: not known
    struct rn_porter *porter;    // once it is there, where no folder is shared
    int64_t memory_bytes;        // that it needs; 0: not known
    int gpus;                    // -1: not known
    int ranks;                   // nodes that train together: 1, or what the training asks for
    bool spare;                  // of an earlier daemon, and nobody has asked for it yet
    bool given_up;               // nobody waits for it any more: its job is to be cancelled
    int64_t job;                 // Slurm's number; 0: not submitted
    int64_t not_before_ns;       // of the next submission
    struct rn_join join;         // said is "" once it was
    int fd;                      // of its connection, until it was handed over; -1
    bool joined;
    bool hung_up;                             // its connection has ended: why is wanted soon
    bool asked;                               // Slurm was asked after its job since it has one
    bool over;                                // its job has ended
    char state[24], reason[160], machine[64]; // as Slurm has them
    int exit_code, exit_signal;
    struct rn_error refusal; // status RN_OK: none
};

struct rn_slurm {
    struct rn_executor base;
    struct rn_executor *local;
    char *data, *folder, *runner, *partition, *account, *flags, *host;
    char *cache; // where nodes keep what they fetch; NULL: a folder is shared
    int64_t cache_bytes;
    int64_t time_s, gpus, memory_bytes;
    int threads;
    bool sandbox;
    uint16_t port;
    int listener;

    pthread_mutex_t lock;
    pthread_cond_t work; // there is something for the clerk
    struct rn_place *places;
    int last_number;
    int64_t spares_until_ns;
    void (*news)(void *context);
    void *news_context;
    bool quit;
    int wake_fd; // ends the door's wait
    pthread_t clerk, door;
    bool clerk_runs, door_runs;
};

// place.c: what lies on the disk.

char *rn_place_path(const struct rn_slurm *slurm, const struct rn_place *place, const char *name);
// Makes the folder, with everything but `job`.
enum rn_status rn_place_furnish(struct rn_slurm *slurm, struct rn_place *place,
                                const char *scene_folder, struct rn_error *err) RN_MUST_CHECK;
// A new secret for another connection, left in the shared folder.
enum rn_status rn_place_invite(struct rn_slurm *slurm, struct rn_place *place,
                               struct rn_error *err) RN_MUST_CHECK;
// Keeps the number of its job for the next daemon.
enum rn_status rn_place_sign(struct rn_slurm *slurm, const struct rn_place *place,
                             struct rn_error *err) RN_MUST_CHECK;
// From here on what its runner writes to the scene is lost, and the scene's lock is free.
void rn_place_fence(struct rn_slurm *slurm, const struct rn_place *place);
void rn_place_free(struct rn_place *place);
// Adds the places of an earlier daemon, as spare ones; what cannot be one is removed.
enum rn_status rn_place_find_all(struct rn_slurm *slurm, struct rn_error *err) RN_MUST_CHECK;

// door.c: the thread that lets runners in.
enum rn_status rn_door_open(struct rn_slurm *slurm, const char *listen,
                            struct rn_error *err) RN_MUST_CHECK;
void *rn_door_serve(void *slurm);

// clerk.c: the thread that talks to Slurm, by its commands.
// That they are there, and that `flags` (of sbatch, by spaces; NULL: none) are not too many.
enum rn_status rn_clerk_check(const char *flags, struct rn_error *err) RN_MUST_CHECK;
void *rn_clerk_serve(void *slurm);

// slurm.c: tells whoever watches. Not under the lock.
void rn_slurm_tell(struct rn_slurm *slurm);

#endif

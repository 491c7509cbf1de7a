// One life of the daemon, in a process of its own: its threads, its clock, its runners and clients.
#ifndef RN_SIM_LIFE_H
#define RN_SIM_LIFE_H

#include <stdbool.h>
#include <stdint.h>

#include "server/jobs/control.h"
#include "tests/sim/world.h"

struct sim_life {
    struct rn_store *store;
    struct rn_control *control;
    bool open; // for clients
    int busy;  // calls of clients that are under way
};
extern struct sim_life life;
// Forks one: how it ended. `last`: it ends when all jobs are over, and its records are made anew
// from their copies.
enum sim_end sim_live(bool last);

// ---- threads.c: which of all that could go on does is drawn; time passes when nothing can
// -------- Runs `first` and what it starts, until it has ended.
void sim_threads_run(void (*first)(void *context));
void sim_thread_begin(void (*run)(void *context), void *context);
void sim_sleep(int64_t ns);

// ---- files.c ----
void sim_connect(int ret_ends[2]);
bool sim_readable(int fd);
int sim_open_descriptors(void);

// ---- vfs.c: SQLite on the simulated disk ----
void sim_vfs_register(void);
int64_t sim_vfs_memory(void); // that SQLite holds

// ---- runners.c ----
struct rn_executor *sim_executor(void);
// Those of the daemon before are orphans now, or gone with the power.
void sim_runners_survive(void);
// When the next one does something, INT64_MAX: none does; and one that does now, drawn.
int64_t sim_runners_due(void);
bool sim_runners_step(void);

// ---- clients.c ----
void sim_clients_begin(int count);
// All pictures that were asked for have been answered.
void sim_pictures_check(void);

// ---- promises.c ----
// An event of the daemon's, as it is published.
void sim_heard(const char *name, const char *json);
// After a start: all that was promised is there, and nothing else. `rebuilt`: from the copies,
// which tokens and keys have none of.
void sim_promises_check(bool rebuilt);
struct sim_job *sim_job_find(const char *id);
// Counts for each job whether it is lost with this runner.
void sim_lost_with(const struct sim_runner *runner);
struct sim_thing *sim_thing_find(struct sim_thing *things, int count, const char *id);
void sim_thing_promise(struct sim_thing *things, int *count, const char *id,
                       enum sim_promise promise);

#endif

// What outlives a daemon: the disk, the clock, the runners it left behind, and what was promised to
// its clients.
//
// Each life of the daemon is a process of its own, forked from the one that keeps the world, which
// lies in memory that both share. A crash is that process's _exit; everything random comes from one
// generator in the world, so a seed is a history.
#ifndef RN_SIM_WORLD_H
#define RN_SIM_WORLD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "proto/names.h"
#include "tests/sim/disk.h"

#define SIM_RUNNERS 64
#define SIM_JOBS 16384
#define SIM_THINGS 4096 // of each kind that is promised
#define SIM_DATA "/data"

// A runner: a process of its own, which a daemon's end does not end at once.
struct sim_runner {
    bool alive, orphan; // orphan: its daemon is gone
    int pid;
    char mode[16], scene[RN_ID_MAX], folder[96];
    bool locked, opening, load, hangs;      // locked: it holds its scene
    int64_t next_ns, hangs_ns;              // when it does something; since when it does nothing
    int64_t give_up_ns;                     // opening: it waits for the scene's lock until then
    char train[RN_ID_MAX], work[RN_ID_MAX]; // jobs that it has begun and not ended
    enum rn_job_type work_type;
    bool of_scene; // an import
    bool paused, saves_last;
    int step, target, saved_step; // of the training
    int unasked;                  // times in a row that it went on with it unasked
    int done, total;              // of the other job
    char places[3][96];           // of an import: source, target, work; of a path: its frames
    int64_t renders[8];           // numbers of pictures that are asked for
    int render_count;
};

// What a job's clients know of it.
struct sim_job {
    char id[RN_ID_MAX], scene[RN_ID_MAX], dataset[RN_ID_MAX];
    enum rn_job_type type;
    enum rn_job_state state; // announced last
    bool doubt;              // it could not be written when it was announced
    bool may_fail;           // a runner said so, or too many were lost
    bool found;              // by the check after a start
    int losses;              // of its runners
};

enum sim_promise { SIM_IN_DOUBT, SIM_KEPT, SIM_GONE, SIM_FOUND };
// A record that clients write and delete themselves.
struct sim_thing {
    char id[RN_ID_MAX];
    enum sim_promise promise;
};
struct sim_key {
    char key[24], job[RN_ID_MAX];
};

struct sim_figures {
    uint64_t transitions, kills, power_losses, stops, histories, lives, steps, requests, refused;
    uint64_t full_disks, runners, runners_lost, pictures, rebuilds, virtual_ms;
};

enum sim_end { SIM_STOPPED = 10, SIM_KILLED, SIM_NO_POWER, SIM_VIOLATION };

struct sim_world {
    uint64_t seed, random;
    int64_t now_ns, wall_ms; // wall_ms: at now_ns 0
    int64_t life_end_ns;     // the daemon is asked to stop then
    long crash_after;        // calls that change the disk, until the crash; 0: none
    enum sim_end crash;
    bool calm;  // no faults and no new wishes any more
    bool week;  // one life of seven days
    bool trace; // tells what happens
    bool in_runner;
    int next_pid;
    int pause_ms; // between two requests of a client, at most
    struct sim_disk disk;
    struct sim_runner runners[SIM_RUNNERS];
    struct sim_job jobs[SIM_JOBS];
    int job_count;
    struct sim_thing scenes[SIM_THINGS], datasets[SIM_THINGS], paths[SIM_THINGS],
        tokens[SIM_THINGS];
    int scene_count, dataset_count, path_count, token_count;
    struct sim_key keys[SIM_THINGS];
    int key_count;
    struct sim_figures figures;
    char violation[512];
};
extern struct sim_world *sim;

uint64_t sim_random(void);
int sim_below(int n);        // 0 .. n - 1
bool sim_chance(int one_in); // true once in so many
// Writes down what is wrong and ends the life.
_Noreturn void sim_violated(const char *fmt, ...) __attribute__((format(printf, 1, 2)));
void sim_tell(const char *fmt, ...) __attribute__((format(printf, 1, 2)));
// The daemon's process ends here and now.
_Noreturn void sim_crash(enum sim_end end);

#endif

// Inside of server/jobs. Everything here is used with control->lock held.
#ifndef RN_SERVER_JOBS_INSIDE_H
#define RN_SERVER_JOBS_INSIDE_H

#include <pthread.h>

#include "common/base/log.h"
#include "common/base/turns.h"
#include "proto/wire_messages.h"
#include "server/jobs/control.h"

#define RN_MAX_STALLS 3
#define RN_RING_EVENTS 1024
#define RN_RING_BYTES (4u << 20)
#define RN_MAX_RECENT 64
#define RN_MAX_GPUS 16
#define RN_MAX_WANTED 16

struct rn_ladder; // ladder.c

// An unfinished job (and a finished one until its last record is on disk).
struct rn_task {
    struct rn_task *next; // in the order of creation
    struct rn_job_row row;
    struct rn_ring *ring;
    struct rn_runner *runner;           // NULL: no runner has it
    bool sent;                          // the runner was told to begin
    bool finish;                        // `finish` was asked for
    bool dirty;                         // the row on disk is older
    bool progressed;                    // this attempt has brought something
    bool automatic;                     // nobody asked for it: it makes way for what is asked for
    bool began;                         // train: its runner has parameters, which can be rendered
    int64_t not_before_ns;              // of the next start
    struct rn_train_progress live;      // train: the latest report; step RN_ABSENT before
    int64_t live_done;                  // others: the latest report
    double live_left_s;                 // path: what its runner expects to need; NAN: not known
    int64_t handed;                     // path: frames from this one on are other runners'
    uint8_t *told;                      // path: a bit a frame that this attempt has told of,
    size_t told_bytes;                  // up to the last of them
    struct rn_nonfinite live_nonfinite; // all: the latest report
    struct rn_ladder *ladder;           // ladder: what it knows; NULL before it works
    // Ingest: the records that come with its next state, or NULL.
    struct rn_dataset_row *makes;
    struct rn_scene_row *makes_scene;
    struct rn_checkpoint_row *makes_checkpoint;
};

struct rn_waiter {
    struct rn_parked *parked;
    struct rn_waiter *next;
};

// One picture being made, for all who asked for it.
struct rn_render {
    struct rn_render *next;
    int64_t number;
    char etag[RN_ETAG_MAX]; // empty: not to be shared or cached
    int64_t step;           // that the etag speaks of
    struct rn_waiter *waiters;
    int64_t begin_ns;
    struct rn_render_request request;
    bool sent;
};

// The last picture by a deadline that a runner has made: what it is told of it with the next one.
struct rn_last_timed {
    int64_t number, deadline_ns;
    double asked_ms, kept_ms; // as rn_wire_rendered; NAN: it told none
    double needed_ms;         // as rn_wire_render; NAN: nothing new
};

enum rn_runner_state {
    RN_RUNNER_AWAITED,  // a remote one: asked for, and not there yet
    RN_RUNNER_STARTING, // no hello, or not opened yet
    RN_RUNNER_READY,
    RN_RUNNER_ENDING, // asked to end
};

struct rn_runner {
    struct rn_runner *next;
    char mode[8]; // "field", "ingest", "poses", "probe"
    char scene[RN_ID_MAX];
    char *folder; // of the scene, by the name that the runner has for it
    struct rn_process process;
    struct rn_whereabouts where; // of a remote one; of one here, why it is not remote
    struct rn_wire_reader reader;
    struct rn_wire_writer writer;
    enum rn_runner_state state;
    struct rn_task *train, *work; // work: path, eval or ingest
    struct rn_render *renders;
    struct rn_last_timed timed; // picture
    int64_t memory_bytes;
    char gpu[16];                // "cuda:0"; "" before it has asked for any
    int64_t gpu_bytes;           // that it holds there, or has been granted
    struct rn_wire_reserve wish; // what it waits for; bytes 0: nothing
    int64_t turn;                // of the wish
    bool rests;                  // was told to give what it holds back, and has not yet
    int64_t last_used_ns;
    int64_t heard_ns;      // when it said something, or when nothing was expected of it
    int64_t deadline_ns;   // it must have opened, or ended, by then
    int64_t looked_ns;     // late.c: when it was looked at last,
    int64_t used_ns;       // and what it had had of processors
    char helps[RN_ID_MAX]; // the path job of which it makes frames beside its runner; "" = none
    bool helping;          // it has some to make
    int64_t asked_ns;      // when it was asked for
    int64_t hung_up_ns;    // when its connection ended unasked; 0: it has not
    bool broken;           // the connection is of no more use
    bool hangs;            // it has not answered in time
    bool held;             // it stands still for a picture of another one
};

struct rn_recent {
    char id[RN_ID_MAX];
    struct rn_ring *ring;
};

// A GPU, and what all runners together may hold of it.
struct rn_gpu {
    char name[16];
    int64_t capacity_bytes;
};

struct rn_control {
    struct rn_control_options options;
    struct rn_store *store;
    struct rn_executor *executor;
    pthread_mutex_t lock, turn; // rn_control_lock
    pthread_t thread;
    bool thread_runs, stopping, quit;
    bool unread; // a runner has said more than was read in a turn
    int wake_fd;
    struct rn_task *tasks;
    struct rn_runner *runners;
    struct rn_ring *ring; // of all jobs
    struct rn_recent recent[RN_MAX_RECENT];
    unsigned recent_next;
    int64_t next_render;
    int64_t next_measure_ns, next_retain_ns;
    struct rn_runner_device device;
    char curve_wanted[RN_MAX_WANTED][RN_ID_MAX]; // scenes to measure in idle time, newest first
    int curves_wanted;
    int64_t last_over_ns; // when a job ended
    struct rn_gpu gpus[RN_MAX_GPUS];
    int64_t next_turn;
    bool schedule_due;
    struct rn_turns turns; // of pictures by a deadline and of runners that stand still for them
    struct rn_control_stats stats;
};

// Whoever waits holds the turn, so that the one who has the lock and wants it back at once, as the
// supervising thread does while runners talk, comes behind: nobody waits longer than for one turn.
static inline void rn_control_lock(struct rn_control *control) {
    pthread_mutex_lock(&control->turn);
    pthread_mutex_lock(&control->lock);
    pthread_mutex_unlock(&control->turn);
}
static inline void rn_control_unlock(struct rn_control *control) {
    pthread_mutex_unlock(&control->lock);
}

// document.c
enum rn_status rn_document_job(struct rn_control *control, struct rn_job_row *row, char **ret_json,
                               struct rn_error *err) RN_MUST_CHECK;

// task.c
struct rn_task *rn_task_find(struct rn_control *control, const char *id);
// The unfinished training job of a scene, or any unfinished job of it.
struct rn_task *rn_task_training(struct rn_control *control, const char *scene);
struct rn_task *rn_task_of_scene(struct rn_control *control, const char *scene);
// A task that is in no list; rn_task_free.
enum rn_status rn_task_create(struct rn_task **ret_task, struct rn_error *err) RN_MUST_CHECK;
// It has the row (moved in) and stands at the end of the list; cannot fail: the row may be on disk.
void rn_task_add(struct rn_control *control, struct rn_task *task, struct rn_job_row *row);
// Publishes its state as it is.
void rn_task_announce(struct rn_control *control, struct rn_task *task);
// The one function that makes a transition: one record, one event. When the record cannot be
// written, nothing changes and the error is returned; with `must` (it has happened, whatever the
// disk says) the record is written later.
enum rn_status rn_task_apply(struct rn_control *control, struct rn_task *task,
                             enum rn_job_event event, bool must,
                             struct rn_error *err) RN_MUST_CHECK;
void rn_task_happened(struct rn_control *control, struct rn_task *task, enum rn_job_event event);
// Ends a job with a problem.
// Logs "job ID: TEXT" in the job's trace.
void rn_task_log(const struct rn_task *task, enum rn_log_level level, const char *fmt, ...)
    RN_PRINTF(3, 4);
void rn_task_fail(struct rn_control *control, struct rn_task *task, const struct rn_error *err);
// Its runner is gone: another attempt, or the end. NULL when the daemon had ended.
void rn_task_lost(struct rn_control *control, struct rn_task *task, const struct rn_ending *ending);
// Whether a runner works on it, and not only is waited for.
bool rn_task_is_attached(const struct rn_task *task);
void rn_task_detach(struct rn_task *task);
void rn_task_publish(struct rn_control *control, struct rn_task *task, const char *name,
                     const char *json, bool latest);
// Writes what a full disk left unwritten of a scene's jobs: some of it needs the scene's record.
enum rn_status rn_task_settle_scene(struct rn_control *control, const char *scene,
                                    struct rn_error *err) RN_MUST_CHECK;
// Writes late records, and forgets finished tasks.
void rn_tasks_tidy(struct rn_control *control);
void rn_task_free(struct rn_task *task);
// Follows from the record and its training job.
enum rn_scene_state rn_scene_state_of(const struct rn_scene_row *row, const struct rn_task *task);

// runner.c
enum rn_status rn_runner_start(struct rn_control *control, const struct rn_order *order,
                               struct rn_runner **ret_runner, struct rn_error *err) RN_MUST_CHECK;
// Another one of the scene, whose log is the job's; one that helps renders beside the first.
enum rn_status rn_runner_start_for(struct rn_control *control, const struct rn_scene_row *scene,
                                   const char *job, bool helps, struct rn_runner **ret_runner,
                                   struct rn_error *err) RN_MUST_CHECK;
// The scene's runner; started when there is none. RN_ERROR_BUSY while an old one is ending. With
// `load` the scene's parameters are loaded for pictures.
enum rn_status rn_runner_for_scene(struct rn_control *control, const char *scene, bool load,
                                   struct rn_runner **ret_runner,
                                   struct rn_error *err) RN_MUST_CHECK;
// One that opens the task's dataset and a folder of its own, which goes with the task.
enum rn_status rn_runner_for_estimate(struct rn_control *control, const struct rn_task *task,
                                      struct rn_runner **ret_runner,
                                      struct rn_error *err) RN_MUST_CHECK;
// Its process is there: talks to it from here on.
void rn_runner_connected(struct rn_runner *runner);
// It has not opened its scene yet, and gets as long again.
void rn_runner_more_time(struct rn_runner *runner);
enum rn_status rn_runner_open(struct rn_control *control, struct rn_runner *runner,
                              const struct rn_scene_row *scene, bool load,
                              struct rn_error *err) RN_MUST_CHECK;
struct rn_runner *rn_runner_find(struct rn_control *control, const char *scene);
void rn_runner_post(struct rn_control *control, struct rn_runner *runner, enum rn_wire_type type,
                    const void *message);
void rn_runner_post_job(struct rn_control *control, struct rn_runner *runner,
                        enum rn_wire_type type, const char *job);
// Tells the runner to make these frames of a path job.
enum rn_status rn_runner_post_part(struct rn_control *control, struct rn_runner *runner,
                                   const struct rn_task *task, int64_t begin, int64_t end,
                                   struct rn_error *err) RN_MUST_CHECK;
// Tells the runner which trace the task is part of, for what it logs; before it begins.
void rn_runner_post_trace(struct rn_control *control, struct rn_runner *runner,
                          const struct rn_task *task);
// Tells the runner to begin the task; it is attached and the runner ready.
void rn_runner_begin(struct rn_control *control, struct rn_task *task);
void rn_runner_shutdown(struct rn_control *control, struct rn_runner *runner);
bool rn_runner_is_idle(const struct rn_runner *runner);
// Whether it does one import, and ends.
bool rn_runner_imports(const struct rn_runner *runner);
// Whether it is there for one job that is of no scene, and ends with it: an import, an estimate.
bool rn_runner_is_for_one(const struct rn_runner *runner);
// The idle runner that was used longest ago, of those on this machine or on others; with `gpu` not
// NULL, of those that hold memory there.
struct rn_runner *rn_runner_oldest_idle(struct rn_control *control, bool remote, const char *gpu);
// Removes it from the list; what it had is lost or, when `now`, simply ended.
void rn_runner_remove(struct rn_control *control, struct rn_runner *runner, bool now);
// The daemon ends and a remote runner does not: its jobs are the next daemon's.
void rn_runner_release(struct rn_control *control, struct rn_runner *runner);

// remote.c: runners on other machines.
// Goes on with what is known of one; true when it is to be removed.
bool rn_remote_is_lost(struct rn_control *control, struct rn_runner *runner);
// Whether it is known how a runner ended whose connection has.
bool rn_remote_is_settled(struct rn_control *control, struct rn_runner *runner);

// helpers.c: a path over several runners.
// Asks for runners to help paths that take long, and lets go of those whose job is over.
void rn_helpers_work(struct rn_control *control);
// It is ready, or has made its frames: gives it others, or lets it go.
void rn_helper_go_on(struct rn_control *control, struct rn_runner *runner);

// message.c
void rn_runner_receive(struct rn_control *control, struct rn_runner *runner,
                       const struct rn_wire_message *message);
// Deletes the records of a scene's checkpoints but for the newest; the files are the runner's.
enum rn_status rn_task_prune_checkpoints(struct rn_control *control, const char *scene, size_t kept,
                                         struct rn_error *err);

// gpu.c: memory of GPUs is counted here before a runner takes it.
void rn_gpu_reserve(struct rn_control *control, struct rn_runner *runner,
                    const struct rn_wire_reserve *reserve);
// Answers those whose turn it is, and ends idle runners to make room for them.
void rn_gpu_share(struct rn_control *control);

// metrics.c: keeps a figure of a job; those of later steps, which a restart has undone, go.
enum rn_status rn_metric_record(struct rn_control *control, const char *job,
                                const struct rn_metric_event *metric,
                                struct rn_error *err) RN_MUST_CHECK;

// estimate.c: a calibration's JSON becomes an estimate's; and what was estimated of a training goes
// into its result, with the truth, where there is an estimate of it.
enum rn_status rn_estimate_make(struct rn_control *control, char **calibration_to_estimate,
                                struct rn_error *err) RN_MUST_CHECK;
void rn_estimate_check_training(struct rn_control *control, struct rn_job_row *train);

// submit.c: a job as the API submits one.
// The nodes that a training of these options, JSON, asks for; 1 where they cannot be read.
int rn_train_ranks(const char *options);
enum rn_status rn_task_submit(struct rn_control *control, const struct rn_submission *wanted,
                              struct rn_task **ret_task, struct rn_error *err) RN_MUST_CHECK;
// The job that was submitted under its key, or a new one.
enum rn_status rn_task_submit_once(struct rn_control *control, const struct rn_submission *wanted,
                                   char ret_id[RN_ID_MAX], struct rn_error *err) RN_MUST_CHECK;
// Cancels a job as its user would; NULL is none. Whether it is still about to end.
bool rn_task_cancel(struct rn_control *control, struct rn_task *task);
// Removes a scene of that name, with its files. As rn_control_delete_scene.
enum rn_status rn_task_delete_scene(struct rn_control *control, const char *reference,
                                    struct rn_error *err) RN_MUST_CHECK;

// ladder.c: goes on with the ladders that are there; whether a training is one of theirs.
void rn_ladders_work(struct rn_control *control);
bool rn_ladder_has(const struct rn_control *control, const char *job);
void rn_ladder_free(struct rn_ladder *ladder);

// idle.c: a scene has new parameters; its curve was measured; what there is time for; someone wants
// something.
void rn_idle_want_curve(struct rn_control *control, const char *scene);
void rn_idle_has_curve(struct rn_control *control, const char *scene);
void rn_idle_work(struct rn_control *control);
void rn_idle_stop(struct rn_control *control);

// retain.c
void rn_retain_work(struct rn_control *control);

// late.c: whether one is to be ended because it should have answered, opened or ended by now.
bool rn_runner_is_late(struct rn_control *control, struct rn_runner *runner, int64_t now_ns);

// schedule.c
void rn_schedule(struct rn_control *control);

// hold.c
// While a picture is made by a deadline, and until the next one where they follow one another, what
// other runners train or work at on the same cores stands still, but for its turns.
void rn_hold_others(struct rn_control *control);
// How long until that changes by itself, at most `most_ms`.
int rn_hold_timeout_ms(const struct rn_control *control, int most_ms);
// A picture was made, and is about to be sent: if it was by a deadline, the next one may be near.
void rn_hold_after(struct rn_control *control, const struct rn_render *render);
// render.c
void rn_render_send(struct rn_control *control, struct rn_runner *runner);
void rn_render_done(struct rn_control *control, struct rn_runner *runner,
                    const struct rn_wire_rendered *rendered, const uint8_t *blob, size_t size);
void rn_render_failed(struct rn_control *control, struct rn_runner *runner, int64_t number,
                      const struct rn_error *err);
void rn_render_fail_all(struct rn_control *control, struct rn_runner *runner,
                        const struct rn_error *err);

void rn_control_wake(struct rn_control *control);

// ---- frames.c ----

// Puts a path job's frames where its runner may write them: frames/JOB in its scene's folder.
enum rn_status rn_frames_lend(struct rn_control *control, const struct rn_task *task,
                              struct rn_error *err) RN_MUST_CHECK;
// And back, nothing where none are lent; counts their bytes.
void rn_frames_take_back(struct rn_control *control, struct rn_task *task);
// Before anything runs: of jobs that are over, what was left half written by a daemon that did not
// yet remove it at their end.
void rn_frames_clear(struct rn_control *control);
// What a path job that is over has made becomes what another begins with: links, so that both have
// it. Before the other is scheduled. What cannot be linked is made anew.
void rn_frames_hand_on(struct rn_control *control, const char *from, const char *to);

#endif

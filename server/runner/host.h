// Mode field: one scene, its engine, the jobs that work on it.
//
// One thread does everything: it alternates slices of work with messages, so that a render or a
// cancel waits for one slice at most. Thread-safety of all structs: owned by that thread.
#ifndef RN_SERVER_RUNNER_HOST_H
#define RN_SERVER_RUNNER_HOST_H

#include "proto/curve.h"
#include "proto/wire_messages.h"
#include "server/engine/engine.h"
#include "server/runner/link.h"

#define RN_SLICE_MS 10.0 // of training between two looks at the inbox

struct rn_training;
struct rn_work;

// What the scene's runner has learnt; zero at the start. Owned by the host.
struct rn_pace {
    struct rn_curve_record record; // the scene's; of 0 points: it has none
    bool looked;                   // for it
    double slowness;               // of pictures by a deadline (engine/render/within.h); 0: unknown
    double margin_ns;              // kept free at a deadline's end, as the last ones taught
    double encode_ns[2];           // a pixel, of each rn_picture_format; 0: unknown
};
struct rn_host {
    struct rn_link link;
    struct rn_wire_open place; // folders and defaults; what `open` said
    bool opened;
    int lock_fd; // of SCENE/lock, -1 before open

    struct rn_engine *engine;
    struct rn_engine_options engine_options; // texts point into engine_device, engine_kernels
    char engine_device[16], engine_kernels[32];
    int64_t reserves;       // of a GPU's memory that were asked for
    struct rn_watch *watch; // of the job that loads; NULL: none

    struct rn_dataset *dataset;   // NULL until first needed
    bool dataset_is_sound;        // its files were checked
    struct rn_field *loaded;      // from a checkpoint; NULL while it trains
    struct rn_training *training; // NULL without a training job
    char digest[65];              // of the checkpoint that was loaded or written last
    char set_aside[512];          // the damaged checkpoint found last, and why; "" = none
    struct rn_work *works;        // path, eval and curve jobs, in order; the first is worked on
    struct rn_pace pace;
};

// Runs mode field until the link closes or the daemon asks for the end, confined to `profile`
// unless it is NULL. The exit code.
int rn_host_run(int fd, const struct rn_profile *profile);

// What jobs and renders need of the host; each is a no-op when it is there already.
enum rn_status rn_host_need_engine(struct rn_host *host, const char *device, const char *kernels,
                                   int threads, struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_host_need_dataset(struct rn_host *host, struct rn_error *err) RN_MUST_CHECK;
// The same, and its files are as they were imported (read whole, once a runner). RN_ERROR_CORRUPT
// names the first that is not.
enum rn_status rn_host_need_sound_dataset(struct rn_host *host, struct rn_error *err) RN_MUST_CHECK;
// Loads the newest good checkpoint for rendering; damaged ones are set aside.
enum rn_status rn_host_load(struct rn_host *host, struct rn_error *err) RN_MUST_CHECK;
// The field to render, RN_ERROR_CONFLICT when there is none yet. Valid until the next slice.
enum rn_status rn_host_field(struct rn_host *host, struct rn_field **ret_field,
                             struct rn_error *err) RN_MUST_CHECK;

// Serves one interactive render that waits in the inbox; for long computations to call in between.
void rn_host_serve_render(struct rn_host *host);

// ---- training.c ----

// Starts or continues the job; a failure is reported to the daemon.
void rn_training_start(struct rn_host *host, const struct rn_wire_train *train);
bool rn_training_is(const struct rn_host *host, const char *job);
bool rn_training_runs(const struct rn_host *host);      // there and not paused
bool rn_training_is_busy(const struct rn_host *host);   // has something to do, be it to save
bool rn_training_is_ending(const struct rn_host *host); // was cancelled
struct rn_field *rn_training_field(struct rn_training *training);
void rn_training_slice(struct rn_host *host); // about RN_SLICE_MS of work
void rn_training_pause(struct rn_host *host);
void rn_training_resume(struct rn_host *host);
void rn_training_finish(struct rn_host *host);
void rn_training_cancel(struct rn_host *host);
void rn_training_save(struct rn_host *host); // before the end; without a message when it fails
// Time that a running training has given away.
void rn_training_yielded(struct rn_host *host, double seconds);
void rn_training_drop(struct rn_host *host);

// ---- work.c; path.c, eval.c: the kinds of it ----

// Takes over what the request owns.
void rn_work_add_path(struct rn_host *host, struct rn_wire_path *request);
void rn_work_add_eval(struct rn_host *host, const struct rn_wire_eval *request);
void rn_work_add_curve(struct rn_host *host, const struct rn_wire_curve *curve);
void rn_work_unit(struct rn_host *host);                    // one frame or view of the first job
bool rn_work_cancel(struct rn_host *host, const char *job); // false: no such job
void rn_work_drop_all(struct rn_host *host);

// ---- picture.c ----

// Serves one interactive render, whatever comes of it.
void rn_picture_serve(struct rn_host *host, const struct rn_wire_render *render,
                      int64_t arrived_ns);
// The distance that depth value 65535 stands for: to the far side of the scene's sphere.
double rn_depth_scale(const struct rn_camera *camera, const struct rn_bounds *bounds);
// Encodes the one output asked for. png_level: 0..9.
enum rn_status rn_picture_encode(const struct rn_render_result *result, enum rn_output_kind output,
                                 enum rn_picture_format format, int quality, int png_level,
                                 double depth_scale, uint8_t **ret_bytes, size_t *ret_size,
                                 struct rn_error *err) RN_MUST_CHECK;

#endif

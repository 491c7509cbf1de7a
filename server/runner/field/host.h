// Mode field: one scene, its engine, the jobs that work on it.
//
// One thread does everything: it alternates slices of work with messages, so that a render or a
// cancel waits for one slice at most. Thread-safety of all structs: owned by that thread.
#ifndef RN_SERVER_RUNNER_FIELD_HOST_H
#define RN_SERVER_RUNNER_FIELD_HOST_H

#include "common/base/turns.h"
#include "proto/curve.h"
#include "proto/marks.h"
#include "proto/wire_messages.h"
#include "server/engine/engine.h"
#include "server/runner/field/pace.h"
#include "server/runner/link/link.h"

#define RN_SLICE_MS                                                                                \
    10.0 // of training between two looks at the inbox, and at most what a picture
         // waits for it where it has a turn of its own

struct rn_training;
struct rn_calibrating;
struct rn_work;

// What the scene's runner has learnt; zero at the start. Owned by the host.
struct rn_pace {
    struct rn_curve_record record; // the scene's; of 0 points: it has none
    bool looked;                   // for it
    double slowness;               // of pictures by a deadline (engine/render/within.h); 0: unknown
    double ray_ms;                 // likewise, of fog; 0: there is none
    struct rn_pace_end end;        // of deadlines
    double encode_ns[RN_FORMAT_EXR + 1]; // a pixel, of each rn_picture_format; 0: unknown
    // What JPEGs of a quality lose, mean square, by one whose picture was expected to be so good.
    int jpeg_quality;
    double jpeg_error, jpeg_psnr, jpeg_density; // density: bytes a pixel
};
struct rn_host {
    struct rn_link link;
    struct rn_wire_open place; // folders and defaults; what `open` said
    bool opened;
    int lock_fd; // of SCENE/lock, -1 before open

    const struct rn_exchange *exchange; // other ranks, that train with this one; NULL: none
    struct rn_engine *engine;
    struct rn_engine_options engine_options; // texts point into engine_device, engine_kernels
    char engine_device[16], engine_kernels[32];
    int64_t reserves;       // of a GPU's memory that were asked for
    struct rn_watch *watch; // of the job that loads; NULL: none

    struct rn_lpips *lpips;     // for evaluations; NULL: nobody has named its weights
    struct rn_dataset *dataset; // NULL until first needed
    bool dataset_is_sound;      // its files were checked
    struct rn_field *loaded;    // from a checkpoint; NULL while it trains
    struct rn_field *marked;    // as of `mark`, what was looked back at last; NULL: nothing was
    struct rn_mark mark;
    struct rn_training *training;       // NULL without a training job
    struct rn_calibrating *calibrating; // NULL without an estimate job
    char digest[65];                    // of the checkpoint that was loaded or written last
    char set_aside[512];                // the damaged checkpoint found last, and why; "" = none
    struct rn_work *works;              // path, eval, ... jobs, in order; the first is worked on
    struct rn_pace pace;
    struct rn_turns turns; // of interactive renders and of what works
    int64_t lent_ns;       // to renders that jobs let go first, in all
    int64_t clock_ns;      // this machine's rn_clock_ns is so much ahead of the daemon's
};

// Runs mode field until the link closes or the daemon asks for the end (*ret_told), confined to
// `profile` unless it is NULL, as the first of `exchange`'s ranks unless that is. The exit code.
int rn_host_run(int fd, const struct rn_profile *profile, const struct rn_exchange *exchange,
                bool *ret_told);

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
// The same as of a training second, NAN: of now. RN_ERROR_INVALID at "#/at" where nothing was kept
// near it. One past field is kept in memory, the one asked for last.
enum rn_status rn_host_field_at(struct rn_host *host, double at, struct rn_field **ret_field,
                                struct rn_error *err) RN_MUST_CHECK;

// Serves one interactive render that waits in the inbox; for long computations to call in between.
void rn_host_serve_render(struct rn_host *host);

// ---- training.c ----

// Starts or continues the job; a failure is reported to the daemon.
void rn_training_start(struct rn_host *host, const struct rn_wire_train *train);
bool rn_training_is(const struct rn_host *host, const char *job);
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

// Makes the engine that a training asks for; errors point at its options.
enum rn_status rn_host_need_engine_for(struct rn_host *host, const struct rn_train_options *options,
                                       struct rn_error *err) RN_MUST_CHECK;

// ---- calibrate.c: what an estimate is made of ----

void rn_calibration_start(struct rn_host *host, const struct rn_wire_train *estimate);
void rn_calibration_slice(struct rn_host *host);                   // about RN_SLICE_MS of work
bool rn_calibration_cancel(struct rn_host *host, const char *job); // false: no such job
void rn_calibration_drop(struct rn_host *host);

// ---- work.c, and its kinds, a file each ----

// Takes over what the request owns.
void rn_work_add_path(struct rn_host *host, struct rn_wire_path *request);
void rn_work_add_eval(struct rn_host *host, struct rn_wire_eval *request); // takes it over
void rn_work_add_curve(struct rn_host *host, const struct rn_wire_curve *curve);
void rn_work_add_effects(struct rn_host *host, const struct rn_wire_effects *effects);
void rn_work_add_doctor(struct rn_host *host, const struct rn_wire_doctor *doctor);
void rn_work_add_export(struct rn_host *host, struct rn_wire_export *request); // takes it over
void rn_work_add_scene_export(struct rn_host *host, struct rn_wire_export *request); // likewise
void rn_work_unit(struct rn_host *host);                    // one frame or view of the first job
bool rn_work_cancel(struct rn_host *host, const char *job); // false: no such job
void rn_work_drop_all(struct rn_host *host);

// ---- picture.c ----

// Serves one interactive render, whatever comes of it.
void rn_picture_serve(struct rn_host *host, const struct rn_wire_render *render,
                      int64_t arrived_ns);
// The distance that depth value 65535 stands for: to the far side of the scene's sphere.
double rn_depth_scale(const struct rn_camera *camera, const struct rn_bounds *bounds);
// What is to be rendered for a file of that format; an EXR takes all that it holds, over black.
void rn_picture_choose(enum rn_output_kind output, enum rn_picture_format format,
                       struct rn_render_options *options);
// A request's box into `ret_box`, which the options borrow; none, where it has none.
void rn_picture_crop(const double crop[6], struct rn_box *ret_box,
                     struct rn_render_options *options);
// How a picture becomes a file.
struct rn_picture_file {
    enum rn_output_kind output; // of an EXR all that rn_picture_choose chose
    enum rn_picture_format format;
    int jpeg_quality, png_level; // 1..100; 0..9
    double depth_scale;          // rn_depth_scale
};
// *ret_bytes is malloc'd, the caller's to free. *ret_high: the end of the scale of a heat map's
// colours, NAN of what is none.
enum rn_status rn_picture_encode(const struct rn_render_result *result,
                                 const struct rn_picture_file *file, uint8_t **ret_bytes,
                                 size_t *ret_size, double *ret_high,
                                 struct rn_error *err) RN_MUST_CHECK;

#endif

// Jobs, scenes and their runners: what the API calls.
//
// One lock guards all state; it is held for short sections (records are written under it). One
// thread supervises the runners. JSON texts returned are malloc'd and the caller's.
#ifndef RN_SERVER_JOBS_CONTROL_H
#define RN_SERVER_JOBS_CONTROL_H

#include "proto/estimate.h"
#include "proto/render.h"
#include "server/http/message.h"
#include "server/http/ring.h"
#include "server/jobs/executor.h"
#include "server/jobs/machine.h"
#include "server/store/store.h"

// Thread-safety: any thread, but for create, drain and destroy.
struct rn_control;

struct rn_control_options {
    int training_slots;         // jobs that train at once
    int max_queued;             // unfinished jobs
    int max_loaded;             // scenes with a runner
    int64_t memory_limit_bytes; // of all runners together; 0: none
    int64_t gpu_memory_bytes;   // of all runners together on each GPU; 0: what is free
    bool gpu_deterministic;     // the same bytes from a GPU every time
    int64_t keep_alive_s;       // an idle runner is ended after this long
    int64_t runner_timeout_s;   // a busy runner that says nothing for so long is ended
    int64_t curve_after_s;      // idle time until the curve of a new scene is measured; 0: never
    int64_t retain_pictures_s;  // frames of paths are removed so long after their end; 0: never
    int64_t retain_bytes;       // of all of them; 0: any
    int threads;                // of each runner; 0: all cores
    int path_runners;           // on one path or evaluation, where they are on other machines
    int64_t max_frames, max_pixels, import_time_s; // of an import
    int64_t max_upload_bytes, max_upload_entries;
    const char *version; // static text
};

// Requeues what an earlier daemon left unfinished and starts supervising. The store and executor
// outlive the control.
enum rn_status rn_control_create(const struct rn_control_options *options, struct rn_store *store,
                                 struct rn_executor *executor, struct rn_control **ret_control,
                                 struct rn_error *err) RN_MUST_CHECK;
// Takes up unfinished jobs whose records were added since, as a new daemon would.
enum rn_status rn_control_adopt(struct rn_control *control, struct rn_error *err) RN_MUST_CHECK;
// Asks all runners to save and end, waits for up to timeout_ms, kills the rest. Waiting renders
// are answered. Unfinished jobs are requeued by the next daemon.
void rn_control_drain(struct rn_control *control, int64_t timeout_ms);
void rn_control_destroy(struct rn_control **control);

// ---- jobs -------------------------------------------------------------------------------------

struct rn_submission {
    enum rn_job_type type;
    const char *dataset;  // train: id or name; ingest: the new dataset's name, NULL of a scene
    const char *scene;    // train, ingest: the new scene's name; path, eval: id or name
    const char *source;   // ingest: the directory, NULL with `spooled`; validate: the tar, which
                          // stays; path: the path's JSON
    const char *spooled;  // ingest: an uploaded tar or scene, taken over on success
    int64_t upload_bytes; // of it
    const char *options;  // JSON
    const char *key, *digest;       // what makes it once, and a digest of the request; NULL: none
    const struct rn_caller *caller; // whose job it is, within its quotas; NULL: nobody's
    const char *traceparent;        // that it is part of (common/base/trace.h); NULL, "": of none
};
// The job's JSON; it is on disk. RN_ERROR_CONFLICT (name taken, scene training, key used for
// another request), RN_ERROR_NOT_FOUND, RN_ERROR_BUSY when the queue or the caller's quota of jobs
// is full, RN_ERROR_LIMIT when its quota of bytes is, RN_ERROR_NO_SPACE.
enum rn_status rn_control_submit(struct rn_control *control, const struct rn_submission *submission,
                                 char ret_id[RN_ID_MAX], char **ret_json,
                                 struct rn_error *err) RN_MUST_CHECK;
// What the caller's token has: unfinished jobs, and bytes on disk.
enum rn_status rn_control_usage(struct rn_control *control, const char *token, int64_t *ret_jobs,
                                int64_t *ret_bytes, struct rn_error *err) RN_MUST_CHECK;
// RN_JOB_PAUSE, _RESUME, _FINISH or _CANCEL. RN_ERROR_CONFLICT names the current state.
enum rn_status rn_control_command(struct rn_control *control, const char *id,
                                  enum rn_job_event event, char **ret_json,
                                  struct rn_error *err) RN_MUST_CHECK;
// Goes on with a paused job. Of a path job that has failed or was cancelled a new one, the
// caller's, makes the frames that are missing: *ret_id is its id, else "". As rn_control_submit and
// _command.
enum rn_status rn_control_go_on(struct rn_control *control, const char *id,
                                const struct rn_caller *caller, char ret_id[RN_ID_MAX],
                                char **ret_json, struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_control_job_json(struct rn_control *control, const char *id, char **ret_json,
                                   struct rn_error *err) RN_MUST_CHECK;
// The same from a row that was read before; progress is the latest.
enum rn_status rn_control_row_json(struct rn_control *control, struct rn_job_row *row,
                                   char **ret_json, struct rn_error *err) RN_MUST_CHECK;
// The held-out figures of a job, oldest first: a list of MetricEvent.
enum rn_status rn_control_metrics_json(struct rn_control *control, const char *id, char **ret_json,
                                       struct rn_error *err) RN_MUST_CHECK;
// The events of a job, or of all when id is NULL. A reference.
enum rn_status rn_control_events(struct rn_control *control, const char *id,
                                 struct rn_ring **ret_ring, struct rn_error *err) RN_MUST_CHECK;

// ---- scenes and datasets ----------------------------------------------------------------------

enum rn_status rn_control_scene_json(struct rn_control *control, struct rn_scene_row *row,
                                     char **ret_json, struct rn_error *err) RN_MUST_CHECK;
// Removes record and files. RN_ERROR_CONFLICT while an unfinished job or (datasets) a scene uses
// it.
enum rn_status rn_control_delete_scene(struct rn_control *control, const char *reference,
                                       struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_control_delete_dataset(struct rn_control *control, const char *reference,
                                         struct rn_error *err) RN_MUST_CHECK;

// What a training with `standard` of a dataset (its record) takes by those that have ended here.
enum rn_status rn_control_past(struct rn_control *control, const char *record,
                               struct rn_expected_past *ret_past,
                               struct rn_error *err) RN_MUST_CHECK;

// ---- rendering --------------------------------------------------------------------------------

#define RN_ETAG_MAX 72
// The strong tag of a picture, known before it is rendered: scene, checkpoint's bytes, request,
// kernels and version. Empty while the scene trains, and before the device is known. `request` is
// settled. RN_ERROR_CONFLICT when there is nothing to render yet.
enum rn_status rn_control_etag(struct rn_control *control, const struct rn_scene_row *scene,
                               const struct rn_render_request *request, char ret_etag[RN_ETAG_MAX],
                               struct rn_error *err) RN_MUST_CHECK;
// Answers the HTTP request with a picture: at once with an error, or later by parking it. Equal
// requests of a scene at rest share one computation.
void rn_control_render(struct rn_control *control, const struct rn_scene_row *scene,
                       const struct rn_render_request *render, const char *etag,
                       struct rn_request *request, struct rn_reply *reply);

// ---- what it does -----------------------------------------------------------------------------

struct rn_control_stats {
    uint64_t jobs_ended[RN_JOB_INTERRUPTED + 1]; // by state reached: succeeded, failed, ...
    unsigned jobs_open[RN_JOB_INTERRUPTED + 1];
    unsigned runners, scenes_loaded, renders_waiting;
    int64_t memory_bytes, gpu_memory_bytes;
    uint64_t runners_started, runners_lost;
    uint64_t scenes_rested;                             // gave a GPU's memory up for others
    uint64_t nonfinite_rays, steps_rejected, rollbacks; // of all jobs
    uint64_t checkpoints_damaged;                       // found when they were loaded
    uint64_t renders, renders_failed, renders_cancelled;
    uint64_t render_ms_buckets[10]; // cumulative is made by the reader; bounds below
    double render_ms_sum;
    bool can_start; // a runner could be started when last tried
    bool probed;    // the device is known, or cannot be
};
extern const double rn_render_ms_bounds[9]; // upper bounds; the last bucket has none
void rn_control_stats(struct rn_control *control, struct rn_control_stats *ret_stats);

struct rn_runner_device {
    char device[16], name[128], kernels[32], available[128];
    int64_t threads;
    bool films; // can be made of a path's frames
};
// Whether scenes are trained on other machines.
bool rn_control_spreads(const struct rn_control *control);
// Empty until the probe has answered.
void rn_control_device(struct rn_control *control, struct rn_runner_device *ret_device);

#endif

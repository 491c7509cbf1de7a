// What daemon and runner say to each other.
//
// The runner speaks first (hello). One runner holds one scene (mode field) or does one import (mode
// ingest) or describes the device (mode probe). Jobs are named by the daemon's ids, renders by
// numbers of the daemon's. Every job that was started ends in exactly one `done` or `failed`; every
// render in one `rendered` or `failed`. A runner that works is never silent for long: the daemon
// ends one that is. The runner exits when the socket closes.
#ifndef RN_PROTO_WIRE_MESSAGES_H
#define RN_PROTO_WIRE_MESSAGES_H

#include "common/base/trace.h"
#include "proto/dataset.h"
#include "proto/incident.h"
#include "proto/job.h"
#include "proto/render.h"
#include "proto/wire.h"

enum rn_wire_type {
    // daemon -> runner                       struct
    RN_WIRE_OPEN = 1, // field: first         rn_wire_open -> opened or failed (no job, no request)
    RN_WIRE_TRAIN,    // start or continue    rn_wire_train
    RN_WIRE_PATH,     //                      rn_wire_path
    RN_WIRE_EVAL,     //                      rn_wire_eval
    RN_WIRE_INGEST,   // mode ingest          rn_wire_ingest
    RN_WIRE_PAUSE,    // training jobs        rn_wire_job -> state paused, checkpoint
    RN_WIRE_RESUME,   //                      rn_wire_job -> state running
    RN_WIRE_FINISH,   // training jobs        rn_wire_job -> checkpoint, done (finished_by finish)
    RN_WIRE_CANCEL,   // a job or a render    rn_wire_cancel -> failed (status "cancelled")
    RN_WIRE_RENDER,   //                      rn_wire_render -> rendered or failed
    RN_WIRE_SHUTDOWN, // save and exit        rn_wire_empty -> checkpoint of a running training, EOF
    RN_WIRE_GRANT,    // answers reserve      rn_wire_grant
    RN_WIRE_REST,     // between pictures     rn_wire_empty -> reserve of 0; takes it again itself
    RN_WIRE_CURVE,    //                      rn_wire_curve
    RN_WIRE_ESTIMATE, //                      rn_wire_train -> done (rn_calibration)
    RN_WIRE_EFFECTS,  //                      rn_wire_effects
    RN_WIRE_EXPORT,   //                      rn_wire_export
    RN_WIRE_HAVE,     // carry.h: of a file   rn_wire_file
    RN_WIRE_PIECE,    // of one, both ways    rn_wire_file; blob: its bytes from offset on
    RN_WIRE_DOCTOR,   //                      rn_wire_doctor
    RN_WIRE_TRACE,    // before a job of one  rn_wire_trace
    // runner -> daemon
    RN_WIRE_HELLO = 64, //                    rn_wire_hello
    RN_WIRE_OPENED,     //                    rn_wire_opened
    RN_WIRE_STATE,      //                    rn_wire_state
    RN_WIRE_PROGRESS,   // every half second  rn_wire_progress
    RN_WIRE_METRIC,     // after evaluation   rn_wire_metric
    RN_WIRE_CHECKPOINT, // after each write   rn_wire_checkpoint
    RN_WIRE_FRAME,      // a frame, or a score, is on disk: rn_wire_frame
    RN_WIRE_RENDERED,   // blob: the file     rn_wire_rendered
    RN_WIRE_DONE,       //                    rn_wire_done
    RN_WIRE_FAILED,     //                    rn_wire_failed
    RN_WIRE_INFO,       // mode probe         rn_wire_info, then EOF
    RN_WIRE_INCIDENT,   // training           rn_wire_incident
    RN_WIRE_ALIVE,      // nothing else said  rn_wire_empty, every RN_WIRE_ALIVE_S while it works
    RN_WIRE_RESERVE,    // before it is taken rn_wire_reserve -> grant, unless bytes is 0
    RN_WIRE_RESOLVED,   // path, eval: budget rn_wire_resolved, before the first picture
    RN_WIRE_WANT,       // carry.h            rn_wire_file
    RN_WIRE_GONE,       // a file was removed rn_wire_file
    RN_WIRE_SAID,       // for the job's log  rn_wire_empty; blob: the text
};

#define RN_WIRE_PROTOCOL 8
#define RN_WIRE_ALIVE_S 2

struct rn_wire_empty {
    char unused[1];
};

// Modes of a runner that imports: poses looks for poses first.
#define RN_MODE_INGEST "ingest"
#define RN_MODE_POSES "poses"

struct rn_wire_hello {
    char version[32];
    int64_t protocol; // RN_WIRE_PROTOCOL
    char mode[16];    // "field", "ingest", "poses", "probe"
    int64_t pid;
};

// Locks the scene's folder (RN_ERROR_BUSY when another process holds it) and reads the dataset's
// dataset.json. RN_ERROR_UNSUPPORTED names both versions where the daemon's is another. With
// `load`, the newest good checkpoint is loaded for rendering (RN_ERROR_NOT_FOUND when there is
// none); without, a `train` message is to follow.
struct rn_wire_open {
    char *scene_folder;   // owned; is made when it does not exist
    char *dataset_folder; // owned
    bool load;
    char device[16], kernels[32]; // "" = auto
    int64_t threads;              // absent or 0 = all
    int64_t memory_limit_bytes;   // absent or 0 = none
    bool gpu_deterministic;       // a GPU trains the same bytes every time
    bool helps;                   // renders beside the runner that holds the scene: takes no lock
    char version[32];             // the daemon's; "" = absent: not compared
    int64_t protocol;             // RN_WIRE_PROTOCOL, absent with it
    int64_t clock_ns;             // the daemon's rn_clock_ns now; absent: the runner's clock is its
};
struct rn_wire_opened {
    bool loaded;
    int64_t steps;
    double train_seconds, psnr; // psnr NAN = null
    char parameters_sha256[65]; // "" = absent
    char digest[65];            // of the checkpoint's bytes; "" = absent
    char set_aside[512];        // the damaged checkpoint that was passed over; "" = none
    int64_t memory_bytes;
};

// Continues from the newest good checkpoint when there is one, else starts. While it loads, no
// other message is served. A `state` running with the scene's description says that it trains.
struct rn_wire_train {
    char job[RN_ID_MAX];
    struct rn_train_options options;
};
// Renders frames first..last of the path into `folder` (%05d.png), skipping those that are there.
// With `begin` only frames begin..end of them, beside the runner that has them all, which makes
// what of these is missing when it comes to them, and the film.
struct rn_wire_path {
    char job[RN_ID_MAX];
    char *folder; // owned
    struct rn_path_document camera_path;
    struct rn_path_options options;
    int64_t begin, end; // absent: all
};
// With `folder` the score of each picture is kept there (%05d.json), and those that are there are
// taken as they are; `begin` as above.
struct rn_wire_eval {
    char job[RN_ID_MAX];
    char *folder; // owned; NULL = absent
    struct rn_eval_options options;
    int64_t begin, end; // absent: all
};
// Measures the scene's curve into SCENE/curve.json. Result: JSON of rn_curve_record_table.
struct rn_wire_curve {
    char job[RN_ID_MAX];
    struct rn_curve_options options;
};
// Measures what the scene's effects bring, in trainings as the scene's own was asked for, into
// SCENE/effects.json. Result: JSON of rn_effects_record_table.
struct rn_wire_effects {
    char job[RN_ID_MAX];
    struct rn_effects_options options;
    struct rn_train_options train;
};
// Examines the scene's newest checkpoint. Result: JSON of rn_doctor_table.
struct rn_wire_doctor {
    char job[RN_ID_MAX];
    struct rn_doctor_job_options options;
};
// Writes the scene as another program's file into `folder`. Result: JSON of rn_export_result_table.
struct rn_wire_export {
    char job[RN_ID_MAX];
    char *folder; // owned
    struct rn_export_options options;
};
// Imports `source` (a directory, or a plain tar that is unpacked under `work`) into `target`, which
// must not exist. `work` is removed at the end. Result: JSON of rn_dataset_contents_table. With
// `scene` the source is a file for viewing, the target a scene's folder, and the result JSON of
// rn_wire_checkpoint: what was taken in. With `validate` nothing is kept and no picture decoded;
// the result is JSON of rn_validation_table.
struct rn_wire_ingest {
    char job[RN_ID_MAX], name[RN_NAME_MAX];
    char *source, *target, *work; // owned
    struct rn_ingest_options options;
    int64_t max_bytes, max_entries; // of the tar's contents
    // Absent or 0 = no limit.
    int64_t max_frames, max_pixels; // of all frames together
    int64_t max_seconds;            // that the import takes
    int64_t memory_limit_bytes;     // of the process
    int64_t threads;                // absent or 0 = all
    bool scene;
    bool validate;
};

struct rn_wire_job {
    char job[RN_ID_MAX];
};
// The trace that a job is part of, for what is logged of it.
struct rn_wire_trace {
    char job[RN_ID_MAX];
    char traceparent[RN_TRACE_MAX];
};
struct rn_wire_cancel {
    char job[RN_ID_MAX]; // "" with a request
    int64_t request;     // RN_ABSENT with a job
};
struct rn_wire_render {
    int64_t request;
    struct rn_render_request render; // format is set
    // When a picture within a time must have been handed back, by the daemon's rn_clock_ns. Absent:
    // no such budget.
    int64_t deadline_ns;
    // Of the picture by a deadline before it: rendered.kept_ms, and how late its last byte was
    // handed to the socket. NAN: nothing is known.
    double needed_ms;
};

struct rn_wire_state {
    char job[RN_ID_MAX];
    int state;           // RN_JOB_RUNNING or RN_JOB_PAUSED
    char *scene;         // training: JSON of rn_scene_description_table; NULL otherwise
    int64_t steps;       // training: the step it goes on from
    char set_aside[512]; // the damaged checkpoint that was passed over; "" = none
};
struct rn_wire_progress {
    char job[RN_ID_MAX];
    char *progress; // JSON, owned
};
struct rn_wire_metric {
    char job[RN_ID_MAX];
    struct rn_metric_event metric;
};
struct rn_wire_checkpoint {
    char job[RN_ID_MAX];
    int64_t step, size_bytes;
    char file[64]; // under checkpoints/ of the scene's folder; the newest two are kept
    char parameters_sha256[65];
    char digest[65];            // of the file's bytes; "" = absent
    double train_seconds, psnr; // psnr NAN = null
    char *scene;                // JSON of rn_scene_description_table
};
struct rn_wire_incident {
    char job[RN_ID_MAX];
    struct rn_incident_event incident; // file "" when it could not be written
};
struct rn_wire_frame {
    char job[RN_ID_MAX];
    int64_t index;
};
struct rn_wire_rendered {
    int64_t request, step, samples, width, height;
    int format;                            // enum rn_picture_format
    double queue_ms, render_ms, encode_ms; // queue_ms: in the runner
    bool training;                         // parameters may change: the picture is not to be cached
    char effects[96];                      // of the camera, that are on; "" = none
    int64_t cones;                         // that a pixel is the mean of
    double at;                             // training seconds looked back at; NAN of now
    double scale_high;                     // the end of a heat map's scale; NAN of other pictures
    // Of a budget; "" and NAN without one.
    char setting[96];                      // that was used
    double expected_psnr, expected_spread; // against photographs, of this picture
    char curve[16];                        // where that is from: "measured", "stale", "preset"
    bool missed;                           // the budget could not be met by any point
    double kept_ms; // of a deadline, when the picture was rendered, but for its file; NAN: none
};
// A path's or evaluation's options with the settings that its budget has become, which the job
// keeps: all of its pictures are made with them, also after an interruption.
struct rn_wire_resolved {
    char job[RN_ID_MAX];
    char *options; // JSON
};
struct rn_wire_done {
    char job[RN_ID_MAX];
    char *result; // JSON of the job type's result
};
struct rn_wire_failed {
    char job[RN_ID_MAX]; // "" when it is not about a job
    int64_t request;     // RN_ABSENT when it is not about a render
    char status[24];     // rn_status_name
    char where[256], text[512];
};
// Memory that the runner will hold of a GPU in all; it holds none while it waits for the grant.
struct rn_wire_reserve {
    int64_t number;     // of the grant that answers
    char device[16];    // "cuda:0"
    int64_t bytes;      // 0: what it held is given back
    int64_t free_bytes; // there, for all processes
    bool patient;       // it waits until working runners have finished
};
// What it may hold: `bytes` of the reserve, or less where it cannot have them.
struct rn_wire_grant {
    int64_t number, bytes;
};
// A file of a scene or dataset, where no folder is shared.
struct rn_wire_file {
    char root[8];    // RN_CARRY_DATASET, RN_CARRY_SCENE
    char path[256];  // below it
    int64_t size;    // of the file, bytes; as all below: 0 where it says nothing
    int64_t offset;  // of a piece
    char sha256[65]; // of the file: with `have`, and the last piece; "" = absent
};
struct rn_wire_info {
    char device[16], device_name[128], kernels[32], available[128]; // available: comma separated
    int64_t threads;
    bool films; // the module that makes them is installed
};

// The table of a type; NULL for an unknown one.
const struct rn_table *rn_wire_table(int type);
// A short name for logs: "open", ...; "unknown".
const char *rn_wire_type_name(int type);

// Encodes `message` with the type's table and queues it.
enum rn_status rn_wire_post(struct rn_wire_writer *writer, enum rn_wire_type type,
                            const void *message, const void *blob, size_t blob_size,
                            struct rn_error *err) RN_MUST_CHECK;
// Decodes a message that has the type's table. As rn_decode; finish with
// rn_message_finish(rn_wire_table(type), ret).
enum rn_status rn_wire_take(const struct rn_wire_message *message, void *ret_decoded,
                            struct rn_error *err) RN_MUST_CHECK;

#endif

// The words of the API: types, states and event names, each as an enum and its one spelling.
#ifndef RN_PROTO_NAMES_H
#define RN_PROTO_NAMES_H

#include "common/base/names.h"

enum rn_job_type {
    RN_JOB_TRAIN,
    RN_JOB_PATH,
    RN_JOB_EVAL,
    RN_JOB_INGEST,
    RN_JOB_CURVE,
    RN_JOB_ESTIMATE,
    RN_JOB_EFFECTS,
    RN_JOB_EXPORT,
    RN_JOB_LADDER,
    RN_JOB_DOCTOR,
    RN_JOB_VALIDATE
};
extern const char *const rn_job_type_names[]; // "train", "path", "eval", ...

enum rn_job_state {
    RN_JOB_QUEUED,
    RN_JOB_RUNNING,
    RN_JOB_PAUSED,
    RN_JOB_CANCELLING,
    RN_JOB_SUCCEEDED,
    RN_JOB_FAILED,
    RN_JOB_CANCELLED,
    RN_JOB_INTERRUPTED,
};
extern const char *const rn_job_state_names[]; // "queued", "running", ...

enum rn_scene_state {
    RN_SCENE_NEW,
    RN_SCENE_TRAINING,
    RN_SCENE_PAUSED,
    RN_SCENE_READY,
    RN_SCENE_FAILED,
};
extern const char *const rn_scene_state_names[]; // "new", "training", ...

enum rn_finished_by {
    RN_FINISHED_TIME,
    RN_FINISHED_STEPS,
    RN_FINISHED_PSNR,
    RN_FINISHED_REQUEST,
    RN_FINISHED_PLATEAU
};
extern const char *const rn_finished_by_names[]; // "time", "steps", "psnr", "finish", "plateau"

enum rn_output_kind {
    RN_OUTPUT_KIND_RGB,
    RN_OUTPUT_KIND_DEPTH,
    RN_OUTPUT_KIND_ALPHA,
    RN_OUTPUT_KIND_NORMAL,
    RN_OUTPUT_KIND_COST, // this and the next: heat maps
    RN_OUTPUT_KIND_LEVEL,
    RN_OUTPUT_KIND_FOOTPRINT,
};
// With which lens a view is rendered: none, or its photograph's.
enum rn_lens_choice { RN_LENS_CHOICE_PINHOLE, RN_LENS_CHOICE_AS_TAKEN };
extern const char *const rn_lens_choice_names[]; // "pinhole", "as-taken"
enum rn_colours_choice { RN_COLOURS_EVEN, RN_COLOURS_AS_TAKEN };
extern const char *const rn_colours_choice_names[]; // "even", "as-taken"
extern const char *const rn_output_kind_names[];    // "rgb", "depth", "alpha", ...
extern const char *const rn_output_kind_units[];    // of a heat map's scale; NULL of the others

// An EXR holds colour as linear light times alpha, alpha, depth and normals.
enum rn_picture_format { RN_FORMAT_PNG, RN_FORMAT_JPEG, RN_FORMAT_PNG16, RN_FORMAT_EXR };
extern const char *const rn_picture_format_names[];      // "png", "jpeg", "png16", "exr"
extern const char *const rn_picture_format_extensions[]; // "png", "jpg", "png", "exr"
extern const char *const rn_picture_format_types[];      // "image/png", ...
// Which frame of a path a file of this name holds, 12 of "00012.png"; -1: none.
int rn_frame_index(const char *name);

// What a token allows; each holds the ones before it.
enum rn_scope { RN_SCOPE_READ, RN_SCOPE_RENDER, RN_SCOPE_TRAIN, RN_SCOPE_ADMIN };
extern const char *const rn_scope_names[]; // "read", "render", "train", "admin"

// Server-sent events.
#define RN_EVENT_STATE "state"
#define RN_EVENT_PROGRESS "progress"
#define RN_EVENT_METRIC "metric"
#define RN_EVENT_FRAME "frame"
#define RN_EVENT_INCIDENT "incident"

// Prefixes of ids; RN_ID_RANDOM base32 characters (a-z2-7) follow.
#define RN_ID_DATASET "ds_"
#define RN_ID_SCENE "sc_"
#define RN_ID_JOB "job_"
#define RN_ID_UPLOAD "up_"
#define RN_ID_PATH "path_"
#define RN_ID_TOKEN "tok_"
#define RN_ID_RANDOM 12
#define RN_ID_MAX 24   // an id with its NUL fits
#define RN_NAME_MAX 65 // a name with its NUL fits

#endif

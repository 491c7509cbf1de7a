// Events, frames, and what the daemon says about itself.
#ifndef RN_PROTO_EVENT_H
#define RN_PROTO_EVENT_H

#include "proto/codec.h"
#include "proto/token.h"
#include "proto/names.h"

// Data of a `frame` event and item of a frame list.
struct rn_frame_event {
    int64_t index;
    char url[256];
};
extern const struct rn_table rn_frame_event_table;

// Data of a `progress` event on /v1/events.
struct rn_job_progress_event {
    char job[RN_ID_MAX];
    char *progress; // JSON, owned
};
extern const struct rn_table rn_job_progress_event_table;

// GET /v1/info
struct rn_limits_record {
    int64_t max_body_bytes, max_upload_bytes, max_upload_entries, max_queued_jobs,
        max_training_jobs, max_render_pixels, max_scenes_loaded;
};
struct rn_info {
    char executor[16]; // "slurm"; "" = absent: this machine
    char version[32], device[16], device_name[128], kernels[32];
    char available_kernels[16][32];
    size_t available_kernel_count;
    int64_t threads;
    bool films; // can be made of a path's frames
    double uptime_s;
    int64_t memory_limit_bytes;
    char *roots; // JSON array of strings, owned
    struct rn_limits_record limits;
    struct rn_token_record you; // who asks; its id is "" with the daemon's own token
    char effects[32][32];       // that a training can be asked for, or to do without
    size_t effect_count;
};
extern const struct rn_table rn_info_table;
// JSON array of strings (for roots); malloc'd.
enum rn_status rn_encode_strings(const char *const *strings, size_t count, char **ret_json,
                                 struct rn_error *err) RN_MUST_CHECK;

#endif

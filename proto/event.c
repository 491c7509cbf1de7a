#include "proto/event.h"

#define S struct rn_frame_event
static const struct rn_field_spec frame_event[] = {
    RN_F_INT(S, index, RN_REQUIRED, 0, 99999),
    RN_F_TEXT(S, url, RN_REQUIRED, NULL),
};
const struct rn_table rn_frame_event_table = RN_TABLE(S, "a frame", frame_event);
#undef S

#define S struct rn_job_progress_event
static const struct rn_field_spec progress_event[] = {
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
    RN_F_JSON(S, progress, RN_REQUIRED | RN_IS_OBJECT),
};
const struct rn_table rn_job_progress_event_table = RN_TABLE(S, "a progress event", progress_event);
#undef S

#define S struct rn_limits_record
static const struct rn_field_spec limits[] = {
    RN_F_INT(S, max_body_bytes, RN_REQUIRED, 1, INFINITY),
    RN_F_INT(S, max_upload_bytes, RN_REQUIRED, 1, INFINITY),
    RN_F_INT(S, max_upload_entries, RN_REQUIRED, 1, INFINITY),
    RN_F_INT(S, max_queued_jobs, RN_REQUIRED, 1, INFINITY),
    RN_F_INT(S, max_training_jobs, RN_REQUIRED, 1, INFINITY),
    RN_F_INT(S, max_render_pixels, RN_REQUIRED, 1, INFINITY),
    RN_F_INT(S, max_scenes_loaded, RN_REQUIRED, 1, INFINITY),
};
static const struct rn_table limits_table = RN_TABLE(S, "limits", limits);
#undef S

#define S struct rn_info
static const struct rn_field_spec info[] = {
    RN_F_TEXT(S, version, RN_REQUIRED, NULL),
    RN_F_TEXT(S, device, RN_REQUIRED, NULL),
    RN_F_TEXT(S, device_name, RN_REQUIRED, NULL),
    RN_F_TEXT(S, kernels, RN_REQUIRED, NULL),
    RN_F_TEXTS(S, available_kernels, available_kernel_count, RN_REQUIRED),
    RN_F_INT(S, threads, RN_REQUIRED, 0, INFINITY),
    RN_F_BOOL(S, films, 0),
    RN_F_NUMBER(S, uptime_s, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, memory_limit_bytes, RN_REQUIRED, 0, INFINITY),
    RN_F_JSON(S, roots, RN_REQUIRED),
    RN_F_OBJECT(S, limits, RN_REQUIRED, &limits_table),
    RN_F_OBJECT(S, you, RN_REQUIRED, &rn_token_table),
    RN_F_TEXTS(S, effects, effect_count, 0),
    RN_F_TEXT(S, executor, 0, NULL),
};
const struct rn_table rn_info_table = RN_TABLE(S, "information", info);
#undef S

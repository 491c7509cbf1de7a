#include "proto/wire_messages.h"

#include <stdlib.h>

#define PATH_BYTES 4095

#define S struct rn_wire_empty
static const struct rn_table empty_table = {.title = "an empty message", .size = sizeof(S)};
#undef S

#define S struct rn_wire_hello
static const struct rn_field_spec hello[] = {
    RN_F_TEXT(S, version, RN_REQUIRED, NULL),
    RN_F_INT(S, protocol, RN_REQUIRED, 1, INFINITY),
    RN_F_TEXT(S, mode, RN_REQUIRED, NULL),
    RN_F_INT(S, pid, RN_REQUIRED, 1, INFINITY),
};
static const struct rn_table hello_table = RN_TABLE(S, "hello", hello);
#undef S

#define S struct rn_wire_open
static const struct rn_field_spec open_fields[] = {
    RN_F_STRING(S, scene_folder, RN_REQUIRED, PATH_BYTES),
    RN_F_STRING(S, dataset_folder, RN_REQUIRED, PATH_BYTES),
    RN_F_BOOL(S, load, RN_REQUIRED),
    RN_F_TEXT(S, device, 0, NULL),
    RN_F_TEXT(S, kernels, 0, NULL),
    RN_F_INT(S, threads, 0, 0, 1024),
    RN_F_INT(S, memory_limit_bytes, 0, 0, INFINITY),
    RN_F_BOOL(S, gpu_deterministic, 0),
    RN_F_BOOL(S, helps, 0),
    RN_F_TEXT(S, version, 0, NULL),
    RN_F_INT(S, protocol, 0, 1, INFINITY),
    RN_F_INT(S, clock_ns, 0, 0, INFINITY),
};
static const struct rn_table open_table = RN_TABLE(S, "open", open_fields);
#undef S

#define S struct rn_wire_opened
static const struct rn_field_spec opened[] = {
    RN_F_BOOL(S, loaded, RN_REQUIRED),
    RN_F_INT(S, steps, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, train_seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, psnr, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_TEXT(S, parameters_sha256, 0, NULL),
    RN_F_TEXT(S, digest, 0, NULL),
    RN_F_TEXT(S, set_aside, 0, NULL),
    RN_F_INT(S, memory_bytes, RN_REQUIRED, 0, INFINITY),
};
static const struct rn_table opened_table = RN_TABLE(S, "opened", opened);
#undef S

#define S struct rn_wire_train
static const struct rn_field_spec train[] = {
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
    RN_F_OBJECT(S, options, RN_REQUIRED, &rn_train_options_table),
};
static const struct rn_table train_table = RN_TABLE(S, "train", train);
#undef S

#define S struct rn_wire_path
static const struct rn_field_spec path[] = {
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
    RN_F_STRING(S, folder, RN_REQUIRED, PATH_BYTES),
    RN_F_PATH(S, camera_path, RN_REQUIRED),
    RN_F_OBJECT(S, options, RN_REQUIRED, &rn_path_options_table),
    RN_F_INT(S, begin, 0, 0, INFINITY),
    RN_F_INT(S, end, 0, 0, INFINITY),
};
static const struct rn_table path_table = RN_TABLE(S, "path", path);
#undef S

#define S struct rn_wire_eval
static const struct rn_field_spec eval[] = {
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
    RN_F_STRING(S, folder, 0, PATH_BYTES),
    RN_F_OBJECT(S, options, RN_REQUIRED, &rn_eval_options_table),
    RN_F_INT(S, begin, 0, 0, INFINITY),
    RN_F_INT(S, end, 0, 0, INFINITY),
};
static const struct rn_table eval_table = RN_TABLE(S, "eval", eval);
#undef S

#define S struct rn_wire_curve
static const struct rn_field_spec curve[] = {
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
    RN_F_OBJECT(S, options, RN_REQUIRED, &rn_curve_options_table),
};
static const struct rn_table curve_table = RN_TABLE(S, "curve", curve);
#undef S

#define S struct rn_wire_effects
static const struct rn_field_spec effects[] = {
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
    RN_F_OBJECT(S, options, RN_REQUIRED, &rn_effects_options_table),
    RN_F_OBJECT(S, train, RN_REQUIRED, &rn_train_options_table),
};
static const struct rn_table effects_table = RN_TABLE(S, "effects", effects);
#undef S

#define S struct rn_wire_doctor
static const struct rn_field_spec doctor[] = {
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
    RN_F_OBJECT(S, options, RN_REQUIRED, &rn_doctor_job_options_table),
};
static const struct rn_table doctor_table = RN_TABLE(S, "doctor", doctor);
#undef S

#define S struct rn_wire_export
static const struct rn_field_spec export[] = {
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
    RN_F_STRING(S, folder, RN_REQUIRED, PATH_BYTES),
    RN_F_OBJECT(S, options, RN_REQUIRED, &rn_export_options_table),
};
static const struct rn_table export_table = RN_TABLE(S, "export", export);
#undef S

#define S struct rn_wire_trace
static const struct rn_field_spec trace[] = {
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
    RN_F_TEXT(S, traceparent, RN_REQUIRED, NULL),
};
static const struct rn_table trace_table = RN_TABLE(S, "trace", trace);
#undef S

#define S struct rn_wire_resolved
static const struct rn_field_spec resolved[] = {
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
    RN_F_JSON(S, options, RN_REQUIRED | RN_IS_OBJECT),
};
static const struct rn_table resolved_table = RN_TABLE(S, "resolved", resolved);
#undef S

#define S struct rn_wire_ingest
static const struct rn_field_spec ingest[] = {
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
    RN_F_TEXT(S, name, RN_REQUIRED, NULL),
    RN_F_STRING(S, source, RN_REQUIRED, PATH_BYTES),
    RN_F_STRING(S, target, RN_REQUIRED, PATH_BYTES),
    RN_F_STRING(S, work, RN_REQUIRED, PATH_BYTES),
    RN_F_OBJECT(S, options, RN_REQUIRED, &rn_ingest_options_table),
    RN_F_INT(S, max_bytes, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, max_entries, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, max_frames, 0, 0, INFINITY),
    RN_F_INT(S, max_pixels, 0, 0, INFINITY),
    RN_F_INT(S, max_seconds, 0, 0, INFINITY),
    RN_F_INT(S, memory_limit_bytes, 0, 0, INFINITY),
    RN_F_INT(S, threads, 0, 0, 1024),
    RN_F_BOOL(S, scene, 0),
    RN_F_BOOL(S, validate, 0),
};
static const struct rn_table ingest_table = RN_TABLE(S, "ingest", ingest);
#undef S

#define S struct rn_wire_job
static const struct rn_field_spec job[] = {
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
};
static const struct rn_table job_table = RN_TABLE(S, "job", job);
#undef S

#define S struct rn_wire_cancel
static const struct rn_field_spec cancel[] = {
    RN_F_TEXT(S, job, 0, NULL),
    RN_F_INT(S, request, 0, 0, INFINITY),
};
static const struct rn_table cancel_table = RN_TABLE(S, "cancel", cancel);
#undef S

#define S struct rn_wire_render
static const struct rn_field_spec render[] = {
    RN_F_INT(S, request, RN_REQUIRED, 0, INFINITY),
    RN_F_OBJECT(S, render, RN_REQUIRED, &rn_render_request_table),
    RN_F_INT(S, deadline_ns, 0, 0, INFINITY),
    RN_F_NUMBER(S, needed_ms, 0, -INFINITY, INFINITY),
};
static const struct rn_table render_table = RN_TABLE(S, "render", render);
#undef S

#define S struct rn_wire_state
static const struct rn_field_spec state[] = {
    RN_F_TEXT(S, job, RN_REQUIRED, NULL), RN_F_NAME(S, state, RN_REQUIRED, rn_job_state_names),
    RN_F_JSON(S, scene, RN_IS_OBJECT),    RN_F_INT(S, steps, 0, 0, INFINITY),
    RN_F_TEXT(S, set_aside, 0, NULL),
};
static const struct rn_table state_table = RN_TABLE(S, "state", state);
#undef S

#define S struct rn_wire_progress
static const struct rn_field_spec progress[] = {
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
    RN_F_JSON(S, progress, RN_REQUIRED | RN_IS_OBJECT),
};
static const struct rn_table progress_table = RN_TABLE(S, "progress", progress);
#undef S

#define S struct rn_wire_metric
static const struct rn_field_spec metric[] = {
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
    RN_F_OBJECT(S, metric, RN_REQUIRED, &rn_metric_event_table),
};
static const struct rn_table metric_table = RN_TABLE(S, "metric", metric);
#undef S

#define S struct rn_wire_checkpoint
static const struct rn_field_spec checkpoint[] = {
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
    RN_F_INT(S, step, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, size_bytes, RN_REQUIRED, 0, INFINITY),
    RN_F_TEXT(S, file, RN_REQUIRED, NULL),
    RN_F_TEXT(S, parameters_sha256, RN_REQUIRED, NULL),
    RN_F_TEXT(S, digest, 0, NULL),
    RN_F_NUMBER(S, train_seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, psnr, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_JSON(S, scene, RN_REQUIRED | RN_IS_OBJECT),
};
static const struct rn_table checkpoint_table = RN_TABLE(S, "checkpoint", checkpoint);
#undef S

#define S struct rn_wire_incident
static const struct rn_field_spec incident[] = {
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
    RN_F_OBJECT(S, incident, RN_REQUIRED, &rn_incident_event_table),
};
static const struct rn_table incident_table = RN_TABLE(S, "incident", incident);
#undef S

#define S struct rn_wire_frame
static const struct rn_field_spec frame[] = {
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
    RN_F_INT(S, index, RN_REQUIRED, 0, 99999),
};
static const struct rn_table frame_table = RN_TABLE(S, "frame", frame);
#undef S

#define S struct rn_wire_rendered
static const struct rn_field_spec rendered[] = {
    RN_F_INT(S, request, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, step, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, samples, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, width, RN_REQUIRED, 1, INFINITY),
    RN_F_INT(S, height, RN_REQUIRED, 1, INFINITY),
    RN_F_NAME(S, format, RN_REQUIRED, rn_picture_format_names),
    RN_F_NUMBER(S, queue_ms, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, render_ms, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, encode_ms, RN_REQUIRED, 0, INFINITY),
    RN_F_BOOL(S, training, RN_REQUIRED),
    RN_F_TEXT(S, effects, 0, NULL),
    RN_F_INT(S, cones, RN_REQUIRED, 0, 256),
    RN_F_NUMBER(S, at, 0, 0, INFINITY),
    RN_F_NUMBER(S, scale_high, 0, 0, INFINITY),
    RN_F_TEXT(S, setting, 0, NULL),
    RN_F_NUMBER(S, expected_psnr, 0, -INFINITY, INFINITY),
    RN_F_NUMBER(S, expected_spread, 0, 0, INFINITY),
    RN_F_TEXT(S, curve, 0, NULL),
    RN_F_BOOL(S, missed, RN_REQUIRED),
    RN_F_NUMBER(S, kept_ms, 0, 0, INFINITY),
};
static const struct rn_table rendered_table = RN_TABLE(S, "rendered", rendered);
#undef S

#define S struct rn_wire_done
static const struct rn_field_spec done[] = {
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
    RN_F_JSON(S, result, RN_REQUIRED | RN_IS_OBJECT),
};
static const struct rn_table done_table = RN_TABLE(S, "done", done);
#undef S

#define S struct rn_wire_failed
static const struct rn_field_spec failed[] = {
    RN_F_TEXT(S, job, 0, NULL),
    RN_F_INT(S, request, 0, 0, INFINITY),
    RN_F_TEXT(S, status, RN_REQUIRED, NULL),
    RN_F_TEXT(S, where, RN_REQUIRED, NULL),
    RN_F_TEXT(S, text, RN_REQUIRED, NULL),
};
static const struct rn_table failed_table = RN_TABLE(S, "failed", failed);
#undef S

#define S struct rn_wire_reserve
static const struct rn_field_spec reserve[] = {
    RN_F_INT(S, number, RN_REQUIRED, 0, INFINITY),
    RN_F_TEXT(S, device, RN_REQUIRED, NULL),
    RN_F_INT(S, bytes, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, free_bytes, RN_REQUIRED, 0, INFINITY),
    RN_F_BOOL(S, patient, RN_REQUIRED),
};
static const struct rn_table reserve_table = RN_TABLE(S, "reserve", reserve);
#undef S

#define S struct rn_wire_grant
static const struct rn_field_spec grant[] = {
    RN_F_INT(S, number, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, bytes, RN_REQUIRED, 0, INFINITY),
};
static const struct rn_table grant_table = RN_TABLE(S, "grant", grant);
#undef S

#define S struct rn_wire_info
static const struct rn_field_spec info[] = {
    RN_F_TEXT(S, device, RN_REQUIRED, NULL),    RN_F_TEXT(S, device_name, RN_REQUIRED, NULL),
    RN_F_TEXT(S, kernels, RN_REQUIRED, NULL),   RN_F_TEXT(S, available, RN_REQUIRED, NULL),
    RN_F_INT(S, threads, RN_REQUIRED, 1, 1024), RN_F_BOOL(S, films, 0),
};
static const struct rn_table info_table = RN_TABLE(S, "info", info);
#undef S

#define S struct rn_wire_file
static const struct rn_field_spec file[] = {
    RN_F_TEXT(S, root, RN_REQUIRED, NULL),
    RN_F_TEXT(S, path, RN_REQUIRED, NULL),
    RN_F_INT(S, size, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, offset, RN_REQUIRED, 0, INFINITY),
    RN_F_TEXT(S, sha256, 0, NULL),
};
static const struct rn_table file_table = RN_TABLE(S, "file", file);
#undef S

static const struct {
    const char *name;
    const struct rn_table *table;
} kinds[] = {
    [RN_WIRE_OPEN] = {"open", &open_table},
    [RN_WIRE_TRAIN] = {"train", &train_table},
    [RN_WIRE_PATH] = {"path", &path_table},
    [RN_WIRE_EVAL] = {"eval", &eval_table},
    [RN_WIRE_INGEST] = {"ingest", &ingest_table},
    [RN_WIRE_PAUSE] = {"pause", &job_table},
    [RN_WIRE_RESUME] = {"resume", &job_table},
    [RN_WIRE_FINISH] = {"finish", &job_table},
    [RN_WIRE_CANCEL] = {"cancel", &cancel_table},
    [RN_WIRE_RENDER] = {"render", &render_table},
    [RN_WIRE_SHUTDOWN] = {"shutdown", &empty_table},
    [RN_WIRE_GRANT] = {"grant", &grant_table},
    [RN_WIRE_REST] = {"rest", &empty_table},
    [RN_WIRE_CURVE] = {"curve", &curve_table},
    [RN_WIRE_ESTIMATE] = {"estimate", &train_table},
    [RN_WIRE_EFFECTS] = {"effects", &effects_table},
    [RN_WIRE_EXPORT] = {"export", &export_table},
    [RN_WIRE_DOCTOR] = {"doctor", &doctor_table},
    [RN_WIRE_TRACE] = {"trace", &trace_table},
    [RN_WIRE_HELLO] = {"hello", &hello_table},
    [RN_WIRE_OPENED] = {"opened", &opened_table},
    [RN_WIRE_STATE] = {"state", &state_table},
    [RN_WIRE_PROGRESS] = {"progress", &progress_table},
    [RN_WIRE_METRIC] = {"metric", &metric_table},
    [RN_WIRE_CHECKPOINT] = {"checkpoint", &checkpoint_table},
    [RN_WIRE_FRAME] = {"frame", &frame_table},
    [RN_WIRE_RENDERED] = {"rendered", &rendered_table},
    [RN_WIRE_DONE] = {"done", &done_table},
    [RN_WIRE_FAILED] = {"failed", &failed_table},
    [RN_WIRE_INFO] = {"info", &info_table},
    [RN_WIRE_INCIDENT] = {"incident", &incident_table},
    [RN_WIRE_ALIVE] = {"alive", &empty_table},
    [RN_WIRE_RESERVE] = {"reserve", &reserve_table},
    [RN_WIRE_RESOLVED] = {"resolved", &resolved_table},
    [RN_WIRE_HAVE] = {"have", &file_table},
    [RN_WIRE_PIECE] = {"piece", &file_table},
    [RN_WIRE_WANT] = {"want", &file_table},
    [RN_WIRE_GONE] = {"gone", &file_table},
    [RN_WIRE_SAID] = {"said", &empty_table},
};

static bool is_known(int type) {
    return type > 0 && (size_t)type < sizeof kinds / sizeof *kinds && kinds[type].name;
}

const struct rn_table *rn_wire_table(int type) {
    return is_known(type) ? kinds[type].table : NULL;
}

const char *rn_wire_type_name(int type) {
    return is_known(type) ? kinds[type].name : "unknown";
}

enum rn_status rn_wire_post(struct rn_wire_writer *writer, enum rn_wire_type type,
                            const void *message, const void *blob, size_t blob_size,
                            struct rn_error *err) {
    char *json;
    size_t size;
    enum rn_status status = rn_encode(rn_wire_table((int)type), message, &json, &size, err);
    if (status) return status;
    status = rn_wire_queue(writer, (int)type, json, size, blob, blob_size, err);
    free(json);
    return status;
}

enum rn_status rn_wire_take(const struct rn_wire_message *message, void *ret_decoded,
                            struct rn_error *err) {
    const struct rn_table *table = rn_wire_table(message->type);
    if (!table)
        return rn_error_set(err, RN_ERROR_INVALID, "wire", "unknown message type %d",
                            message->type);
    return rn_decode(table, message->json, message->json_size, ret_decoded, NULL, err);
}

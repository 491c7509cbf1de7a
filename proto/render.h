// POST /v1/scenes/{id}/render and camera paths.
#ifndef RN_PROTO_RENDER_H
#define RN_PROTO_RENDER_H

#include "common/math/camera.h"
#include "common/settings/curve.h"
#include "proto/codec.h"
#include "proto/names.h"

struct rn_size {
    int64_t width, height;
};

struct rn_render_request {
    struct rn_camera camera; // of width 0 = absent
    char view[264];          // "test:12"; "" = absent
    int64_t scale;
    int lens;             // enum rn_lens_choice, of a view; a camera has its own
    struct rn_size size;  // absent = the camera's own
    int output;           // enum rn_output_kind
    double background[3]; // first one NAN = as trained
    int format;           // enum rn_picture_format
    int64_t jpeg_quality;
    union rn_setting_value settings[RN_RENDER_SETTINGS];
};
extern const struct rn_table rn_render_request_table;
// As rn_decode; also checks that there is exactly one of camera and view, and the like.
enum rn_status rn_render_request_decode(const char *json, size_t size,
                                        struct rn_render_request *ret_request,
                                        struct rn_field_errors *errors,
                                        struct rn_error *err) RN_MUST_CHECK;
// Writes the defaults into what is absent (scale, lens, output, jpeg_quality, settings that are the
// same for every scene; `format` where the request has none), so that equal pictures have equal
// texts when encoded.
void rn_render_request_settle(struct rn_render_request *request, enum rn_picture_format format);

// POST /v1/camera-paths, and the record.
struct rn_camera_path_request {
    char name[RN_NAME_MAX];
    struct rn_path_document path;
};
extern const struct rn_table rn_camera_path_request_table;
struct rn_camera_path_record {
    char id[RN_ID_MAX], name[RN_NAME_MAX], created_at[RN_TIME_MAX];
    struct rn_path_document path;
};
extern const struct rn_table rn_camera_path_record_table;
// An entry of the list: the record without its path.
struct rn_camera_path_summary {
    char id[RN_ID_MAX], name[RN_NAME_MAX], created_at[RN_TIME_MAX];
};
extern const struct rn_table rn_camera_path_summary_table;

#endif

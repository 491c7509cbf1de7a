// POST /v1/scenes/{id}/render and camera paths.
#ifndef RN_PROTO_RENDER_H
#define RN_PROTO_RENDER_H

#include "common/math/camera.h"
#include "common/settings/curve.h"
#include "common/settings/optics.h"
#include "proto/codec.h"
#include "proto/names.h"

// What is wrong with a time to look back at beside a budget.
#define RN_AT_ALONE "is of a past that no curve was measured for; leave the budget out"

struct rn_size {
    int64_t width, height;
};

// Effects of the camera (common/settings/optics.h), as they are asked for.
struct rn_optics_request {
    union rn_setting_value values[RN_OPTICS_SETTINGS];
};
extern const struct rn_table rn_optics_table;
// As a struct; what is absent is none. RN_ERROR_INVALID: one that goes with another alone.
enum rn_status rn_optics_of_request(const struct rn_optics_request *request,
                                    struct rn_optics *ret_optics,
                                    struct rn_error *err) RN_MUST_CHECK;

#define RN_JPEG_QUALITY 90 // where none is asked for

struct rn_render_request {
    struct rn_camera camera; // of width 0 = absent
    char view[264];          // "test:12"; "" = absent
    int64_t scale;
    int lens;             // enum rn_lens_choice, of a view; a camera has its own
    int colours;          // enum rn_colours_choice, of a view
    double at;            // training seconds to look back at (proto/marks.h); NAN = as it is now
    struct rn_size size;  // absent = the camera's own
    int output;           // enum rn_output_kind
    double background[3]; // first one NAN = as trained
    double crop[6];       // what is seen: low corner, then high one, dataset units; NAN = all
    int format;           // enum rn_picture_format
    int64_t jpeg_quality;
    struct rn_optics_request optics;
    union rn_setting_value settings[RN_RENDER_SETTINGS];
};
extern const struct rn_table rn_render_request_table;
// What is wrong with a format for that output (enum rn_picture_format, enum rn_output_kind, or
// absent); NULL: nothing.
const char *rn_picture_format_check(int format, int output);
// Likewise with a box, whose first number is NAN where there is none.
const char *rn_crop_check(const double crop[6]);
// As rn_decode; also checks that there is exactly one of camera and view, and the like.
enum rn_status rn_render_request_decode(const char *json, size_t size,
                                        struct rn_render_request *ret_request,
                                        struct rn_field_errors *errors,
                                        struct rn_error *err) RN_MUST_CHECK;
// Writes the defaults into what is absent (scale, lens, colours, output, jpeg_quality, settings
// that are the same for every scene; `format` where the request has none), so that equal pictures
// have equal texts when encoded.
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

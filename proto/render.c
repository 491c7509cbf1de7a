#include "proto/render.h"

#include "proto/checks.h"

#define S struct rn_size
static const struct rn_field_spec size[] = {
    RN_F_INT(S, width, RN_REQUIRED, 1, 16384),
    RN_F_INT(S, height, RN_REQUIRED, 1, 16384),
};
static const struct rn_table size_table = RN_TABLE(S, "a size", size);
#undef S

const struct rn_table rn_optics_table = {.title = "effects of the camera",
                                         .size = sizeof(struct rn_optics_request),
                                         .settings = &rn_optics_settings,
                                         .settings_offset =
                                             offsetof(struct rn_optics_request, values),
                                         .as_options = true};

enum rn_status rn_optics_of_request(const struct rn_optics_request *request,
                                    struct rn_optics *ret_optics, struct rn_error *err) {
    struct rn_optics optics = {0};
    rn_settings_put(&rn_optics_settings, request->values, &optics);
    enum rn_status status = rn_optics_check(&optics, err);
    if (status == RN_OK) *ret_optics = optics;
    return status;
}

#define S struct rn_render_request
static const struct rn_field_spec request[] = {
    RN_F_CAMERA(S, camera, 0),
    RN_F_TEXT(S, view, 0, rn_check_view),
    RN_F_INT(S, scale, 0, 0, 15),
    RN_F_NAME(S, lens, 0, rn_lens_choice_names),
    RN_F_NAME(S, colours, 0, rn_colours_choice_names),
    RN_F_NUMBER(S, at, RN_OVER_MIN, 0, 31536000),
    RN_F_OBJECT(S, size, 0, &size_table),
    RN_F_NAME(S, output, 0, rn_output_kind_names),
    RN_F_NUMBERS(S, background, 0, 0, 1),
    RN_F_NUMBERS(S, crop, 0, -INFINITY, INFINITY),
    RN_F_NAME(S, format, 0, rn_picture_format_names),
    RN_F_INT(S, jpeg_quality, 0, 1, 100),
    RN_F_OBJECT(S, optics, 0, &rn_optics_table),
};
const struct rn_table rn_render_request_table =
    RN_TABLE_OF_SETTINGS(S, "a render request", request, &rn_render_settings, settings, 11, true);
#undef S

const char *rn_picture_format_check(int format, int output) {
    output = rn_name_or(output, RN_OUTPUT_KIND_RGB);
    if (output == RN_OUTPUT_KIND_DEPTH && format == RN_FORMAT_JPEG) return "must be png for depth";
    if (output != RN_OUTPUT_KIND_RGB && format == RN_FORMAT_EXR)
        return "an exr holds colour, alpha, depth and normals: leave output out";
    return NULL;
}

const char *rn_crop_check(const double crop[6]) {
    for (int i = 0; i < 3 && !isnan(crop[0]); i++)
        if (!(crop[i] < crop[3 + i])) return "must be a low corner and a high one, of a box";
    return NULL;
}

// What a table cannot say.
static const char *check_request(const struct rn_render_request *r, const char **ret_pointer) {
    static const char *const pointers[] = {"", "#/within_ms", "#/render_psnr", "#/quality"};
    enum rn_budget_kind kind = RN_BUDGET_NONE;
    const char *wrong = rn_budget_check(r->settings, &kind);
    *ret_pointer = pointers[kind];
    if (wrong) return wrong;
    *ret_pointer = "#/at";
    if (kind != RN_BUDGET_NONE && !isnan(r->at)) return RN_AT_ALONE;
    *ret_pointer = "#/view";
    if (!*r->view == !r->camera.width) return "exactly one of camera and view must be given";
    *ret_pointer = "#/scale";
    if (r->camera.width && rn_int_or(r->scale, 0) != 0) return "goes with view only";
    *ret_pointer = "#/colours";
    if (r->camera.width && rn_name_or(r->colours, RN_COLOURS_EVEN) != RN_COLOURS_EVEN)
        return "as-taken goes with view only: no photograph was taken by that camera";
    *ret_pointer = "#/format";
    wrong = rn_picture_format_check(r->format, r->output);
    if (wrong) return wrong;
    *ret_pointer = "#/crop";
    wrong = rn_crop_check(r->crop);
    if (wrong) return wrong;
    struct rn_optics optics;
    if (rn_optics_of_request(&r->optics, &optics, NULL)) {
        *ret_pointer = "#/optics/focus";
        return "must be given with an aperture: how far away what is sharp lies";
    }
    *ret_pointer = "#/optics/shutter";
    return optics.shutter > 0 ? "goes with a camera path: a single picture has no motion" : NULL;
}

enum rn_status rn_render_request_decode(const char *json, size_t json_size,
                                        struct rn_render_request *ret_request,
                                        struct rn_field_errors *errors, struct rn_error *err) {
    struct rn_render_request decoded;
    enum rn_status status =
        rn_decode(&rn_render_request_table, json, json_size, &decoded, errors, err);
    if (status) return status;
    const char *pointer, *wrong = check_request(&decoded, &pointer);
    if (wrong) {
        rn_field_errors_add(errors, pointer, "%s", wrong);
        rn_message_finish(&rn_render_request_table, &decoded);
        return rn_error_set(err, RN_ERROR_INVALID, pointer, "%s", wrong);
    }
    *ret_request = decoded;
    return RN_OK;
}

void rn_render_request_settle(struct rn_render_request *r, enum rn_picture_format format) {
    r->scale = rn_int_or(r->scale, 0);
    r->lens = rn_name_or(r->lens, RN_LENS_CHOICE_PINHOLE);
    r->colours = rn_name_or(r->colours, RN_COLOURS_EVEN);
    r->output = rn_name_or(r->output, RN_OUTPUT_KIND_RGB);
    r->format = rn_name_or(r->format, (int)format);
    if (r->output == RN_OUTPUT_KIND_DEPTH) r->format = RN_FORMAT_PNG;
    r->jpeg_quality = rn_int_or(r->jpeg_quality, RN_JPEG_QUALITY);
    for (size_t i = 0; i < RN_RENDER_SETTINGS; i++) {
        const struct rn_setting *row = &rn_render_settings.rows[i];
        if (rn_setting_is_absent(row, &r->settings[i]) && !isnan(row->settled))
            r->settings[i] = rn_setting_of_number(row, row->settled);
    }
}

#define S struct rn_camera_path_request
static const struct rn_field_spec path_request[] = {
    RN_F_TEXT(S, name, RN_REQUIRED, rn_check_name),
    RN_F_PATH(S, path, RN_REQUIRED),
};
const struct rn_table rn_camera_path_request_table =
    RN_TABLE(S, "a camera path request", path_request);
#undef S

#define S struct rn_camera_path_record
static const struct rn_field_spec path_record[] = {
    RN_F_TEXT(S, id, RN_REQUIRED, NULL),
    RN_F_TEXT(S, name, RN_REQUIRED, NULL),
    RN_F_TEXT(S, created_at, RN_REQUIRED, NULL),
    RN_F_PATH(S, path, RN_REQUIRED),
};
const struct rn_table rn_camera_path_record_table = RN_TABLE(S, "a camera path", path_record);
#undef S

#define S struct rn_camera_path_summary
static const struct rn_field_spec path_summary[] = {
    RN_F_TEXT(S, id, RN_REQUIRED, NULL),
    RN_F_TEXT(S, name, RN_REQUIRED, NULL),
    RN_F_TEXT(S, created_at, RN_REQUIRED, NULL),
};
const struct rn_table rn_camera_path_summary_table =
    RN_TABLE(S, "an entry of the camera paths", path_summary);
#undef S

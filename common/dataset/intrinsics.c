#include "common/dataset/intrinsics.h"

#include <math.h>
#include <string.h>

#define SAME 1e-3     // two focal lengths that mean one
#define MAX_ANGLE 3.1 // radians
#define HUGE_PX 1e7

enum { SIMPLE = 3 }; // so many of the members NeRF-synthetic has too
static const char *const members[] = {"camera_angle_x",
                                      "w",
                                      "h",
                                      "camera_model",
                                      "fl_x",
                                      "fl_y",
                                      "cx",
                                      "cy",
                                      "camera_angle_y",
                                      "x_fov",
                                      "y_fov",
                                      "k1",
                                      "k2",
                                      "k3",
                                      "k4",
                                      "k5",
                                      "k6",
                                      "p1",
                                      "p2",
                                      "distortion_params",
                                      "is_fisheye",
                                      NULL};

static const char *const coefficients[] = {"k1", "k2", "k3", "k4", "p1", "p2", "k5", "k6"};
enum { COEFFICIENTS = 8, LISTED = 6 }; // the first are distortion_params, in this order

// Members that change the picture in a way that is not followed here.
static const char *const refused[] = {"rolling_shutter",
                                      "transform_matrix_start",
                                      "transform_matrix_end",
                                      "ftheta_p0",
                                      "latlong",
                                      "orthographic",
                                      "equirectangular",
                                      "from_mitsuba",
                                      "normal_mts_args",
                                      "white_transparent",
                                      "black_transparent",
                                      "fix_premult",
                                      "driver_parameters",
                                      "n_extra_learnable_dims",
                                      NULL};

// A member that says no, with false, 0 or an array of zeros, changes nothing.
static bool says_no(const json_t *value) {
    if (json_is_array(value)) {
        for (size_t i = 0; i < json_array_size(value); i++)
            if (!says_no(json_array_get(value, i))) return false;
        return true;
    }
    return json_is_false(value) || json_is_null(value) ||
           (json_is_number(value) && json_number_value(value) == 0);
}

bool rn_intrinsics_given(const struct rn_json *object) {
    struct rn_json ignored;
    for (size_t i = SIMPLE; members[i]; i++)
        if (rn_json_find(object, members[i], &ignored)) return true;
    for (size_t i = 0; refused[i]; i++)
        if (rn_json_find(object, refused[i], &ignored)) return true;
    return false;
}

void rn_intrinsics_warn_unknown(struct rn_reader *reader, const struct rn_json *object,
                                const char *const *own) {
    const char *known[96];
    const char *const *lists[] = {own, refused, members};
    size_t count = 0;
    for (size_t i = 0; i < 3; i++)
        for (const char *const *name = lists[i]; *name && count < 95; name++)
            known[count++] = *name;
    known[count] = NULL;
    rn_reader_warn_unknown(reader, object, known);
}

static enum rn_status refuse(const struct rn_json *object, struct rn_error *err) {
    struct rn_json member;
    for (size_t i = 0; refused[i]; i++)
        if (rn_json_find(object, refused[i], &member) && !says_no(member.value))
            return rn_json_error(&member, RN_ERROR_INVALID, err,
                                 "changes what a pixel shows in a way that is not followed here; "
                                 "to go without it, take it out of the file");
    return RN_OK;
}

static bool differ(const struct rn_json *a, const struct rn_json *b) {
    if (json_is_number(a->value) && json_is_number(b->value))
        return json_number_value(a->value) != json_number_value(b->value);
    return !json_equal(a->value, b->value);
}

// The object in which a member is to be read, or NULL where it stands in none.
static const struct rn_json *place_of(struct rn_reader *reader, const struct rn_intrinsics *from,
                                      const char *key) {
    struct rn_json of_root, of_frame;
    bool in_root = rn_json_find(&from->root, key, &of_root);
    bool in_frame = rn_json_find(&from->frame, key, &of_frame);
    if (in_root && in_frame && differ(&of_root, &of_frame) && rn_reader_says(reader, key)) {
        char where[256];
        rn_json_where(&of_frame, where);
        rn_problems_add(reader->problems, RN_SEVERITY_WARNING, where,
                        "is %g here and %g for the whole file; the %s is used, and so wherever "
                        "this recurs",
                        json_number_value(of_frame.value), json_number_value(of_root.value),
                        from->frame_wins ? "frame's" : "file's");
    }
    if (in_root && in_frame) return from->frame_wins ? &from->frame : &from->root;
    return in_frame ? &from->frame : in_root ? &from->root : NULL;
}

// `fallback` where the member is not there; *ret_member then has no value.
static enum rn_status number(struct rn_reader *reader, const struct rn_intrinsics *from,
                             const char *key, double min, double max, double fallback,
                             double *ret_value, struct rn_json *ret_member, struct rn_error *err) {
    const struct rn_json *at = place_of(reader, from, key);
    *ret_value = fallback;
    if (ret_member) *ret_member = (struct rn_json){0};
    if (at && ret_member) (void)rn_json_find(at, key, ret_member);
    return at ? rn_json_number(at, key, min, max, ret_value, err) : RN_OK;
}

// One axis' focal length by each of its names; what is said twice and differently is told.
static enum rn_status read_focal(struct rn_reader *reader, const struct rn_intrinsics *from,
                                 const char *const keys[3], double size, double *ret_focal,
                                 struct rn_error *err) {
    static const double limits[3][2] = {{0.06, 177}, {1e-6, HUGE_PX}, {1e-3, MAX_ANGLE}};
    double found = 0;
    const char *first = NULL;
    for (int i = 0; i < 3; i++) {
        double value;
        struct rn_json at;
        enum rn_status status =
            number(reader, from, keys[i], limits[i][0], limits[i][1], 0, &value, &at, err);
        if (status) return status;
        if (!at.value) continue;
        double focal =
            i == 1 ? value : rn_camera_focal_from_fov(i == 0 ? value * M_PI / 180 : value, size);
        if (first && fabs(focal / found - 1) > SAME && rn_reader_says(reader, keys[i])) {
            char where[256];
            rn_json_where(&at, where);
            rn_problems_add(reader->problems, RN_SEVERITY_WARNING, where,
                            "%s means a focal length of %.6g pixels, %s one of %.6g; the latter is "
                            "used",
                            keys[i], focal, first, found);
        }
        if (first) continue;
        first = keys[i];
        found = focal;
    }
    *ret_focal = found;
    return RN_OK;
}

static enum rn_status read_size(struct rn_reader *reader, const struct rn_intrinsics *from,
                                const struct rn_frame *frame, double size[2], char where[256],
                                struct rn_error *err) {
    const struct rn_camera *camera = &frame->camera;
    struct rn_json wide, high;
    enum rn_status status;
    if ((status = number(reader, from, "w", 1, RN_CAMERA_MAX_SIZE, camera->width, &size[0], &wide,
                         err)) ||
        (status = number(reader, from, "h", 1, RN_CAMERA_MAX_SIZE, camera->height, &size[1], &high,
                         err)))
        return status;
    if (!wide.value != !high.value)
        return rn_json_error(wide.value ? &wide : &high, RN_ERROR_INVALID, err,
                             "stands without %s; both or neither", wide.value ? "h" : "w");
    if (wide.value)
        rn_json_where(&wide, where);
    else
        rn_json_where(&from->root, where);
    return RN_OK;
}

static enum rn_status read_coefficients(struct rn_reader *reader, const struct rn_intrinsics *from,
                                        double values[COEFFICIENTS], struct rn_error *err) {
    memset(values, 0, COEFFICIENTS * sizeof *values);
    const struct rn_json *at = place_of(reader, from, "distortion_params");
    enum rn_status status =
        at ? rn_json_matrix(at, "distortion_params", 0, LISTED, values, err) : RN_OK;
    for (int i = 0; i < COEFFICIENTS && status == RN_OK; i++)
        status = number(reader, from, coefficients[i], -1e3, 1e3, values[i], &values[i], NULL, err);
    return status;
}

static const struct {
    const char *name;
    enum rn_lens lens;
} models[] = {{"SIMPLE_PINHOLE", RN_LENS_POLYNOMIAL}, {"PINHOLE", RN_LENS_POLYNOMIAL},
              {"SIMPLE_RADIAL", RN_LENS_POLYNOMIAL},  {"RADIAL", RN_LENS_POLYNOMIAL},
              {"OPENCV", RN_LENS_POLYNOMIAL},         {"FULL_OPENCV", RN_LENS_OPENCV},
              {"OPENCV_FISHEYE", RN_LENS_FISHEYE},    {"EQUIRECTANGULAR", RN_LENS_EQUIRECTANGULAR}};

// The kind of lens by camera_model and is_fisheye.
static enum rn_status read_model(struct rn_reader *reader, const struct rn_intrinsics *from,
                                 enum rn_lens *ret_lens, struct rn_error *err) {
    const struct rn_json *at = place_of(reader, from, "camera_model");
    const struct rn_json *fisheye_at = place_of(reader, from, "is_fisheye");
    struct rn_json member;
    const char *name = NULL;
    bool fisheye = false;
    enum rn_status status = RN_OK;
    if (fisheye_at) status = rn_json_boolean(fisheye_at, "is_fisheye", &fisheye, err);
    if (status == RN_OK && at) status = rn_json_text(at, "camera_model", 64, &name, err);
    if (status) return status;
    *ret_lens = fisheye ? RN_LENS_FISHEYE : RN_LENS_POLYNOMIAL;
    if (!name) return RN_OK;
    size_t i = 0, count = sizeof models / sizeof *models;
    while (i < count && strcmp(models[i].name, name) != 0)
        i++;
    (void)rn_json_find(at, "camera_model", &member);
    if (i == count)
        return rn_json_error(&member, RN_ERROR_INVALID, err,
                             "is \"%s\", a lens that is not known here: undistort the photographs, "
                             "or export them with another camera model",
                             name);
    if (fisheye && models[i].lens != RN_LENS_FISHEYE)
        return rn_json_error(&member, RN_ERROR_INVALID, err,
                             "is \"%s\", but is_fisheye is true: only one can hold", name);
    *ret_lens = models[i].lens;
    return RN_OK;
}

static enum rn_status set_lens(const struct rn_intrinsics *from, enum rn_lens lens,
                               const double values[COEFFICIENTS], struct rn_camera *camera,
                               struct rn_error *err) {
    bool none = true, higher = values[2] != 0 || values[3] != 0;
    for (int i = 0; i < COEFFICIENTS; i++)
        none = none && values[i] == 0;
    if (lens == RN_LENS_POLYNOMIAL && higher && !from->plain_polynomial)
        return rn_json_error(&from->root, RN_ERROR_INVALID, err,
                             "k3 is %g and k4 is %g, but a perspective lens of instant-ngp has k1, "
                             "k2, p1 and p2 alone: say with camera_model what they mean",
                             values[2], values[3]);
    if (lens == RN_LENS_POLYNOMIAL && !higher) lens = none ? RN_LENS_PINHOLE : RN_LENS_OPENCV;
    const struct rn_lens_model *model = &rn_lens_models[lens];
    camera->lens = lens;
    memset(camera->lens_k, 0, sizeof camera->lens_k);
    for (int i = 0; i < COEFFICIENTS; i++) {
        int at = 0;
        while (at < model->count && strcmp(model->parameters[at], coefficients[i]) != 0)
            at++;
        if (at < model->count)
            camera->lens_k[at] = values[i];
        else if (values[i] != 0)
            return rn_json_error(&from->root, RN_ERROR_INVALID, err,
                                 "%s is %g, but a %s lens has no %s", coefficients[i], values[i],
                                 rn_lens_names[lens], coefficients[i]);
    }
    return RN_OK;
}

void rn_intrinsics_set_sphere(struct rn_camera *camera) {
    camera->lens = RN_LENS_EQUIRECTANGULAR;
    memset(camera->lens_k, 0, sizeof camera->lens_k);
    camera->fx = camera->width / (2 * M_PI);
    camera->fy = camera->height / M_PI;
    camera->cx = 0.5 * camera->width;
    camera->cy = 0.5 * camera->height;
}

enum rn_status rn_intrinsics_read(struct rn_reader *reader, const struct rn_intrinsics *from,
                                  struct rn_frame *frame, struct rn_error *err) {
    static const char *const across[3] = {"x_fov", "fl_x", "camera_angle_x"};
    static const char *const down[3] = {"y_fov", "fl_y", "camera_angle_y"};
    struct rn_camera *camera = &frame->camera;
    enum rn_lens lens;
    double size[2], values[COEFFICIENTS];
    char where[256];
    enum rn_status status;
    if ((status = refuse(&from->root, err)) || (status = refuse(&from->frame, err)) ||
        (status = read_model(reader, from, &lens, err)) ||
        (status = read_coefficients(reader, from, values, err)) ||
        (status = read_size(reader, from, frame, size, where, err)))
        return status;
    if (lens == RN_LENS_EQUIRECTANGULAR) {
        rn_intrinsics_set_sphere(camera);
        return RN_OK;
    }
    if ((status = set_lens(from, lens, values, camera, err)) ||
        (status = read_focal(reader, from, across, size[0], &camera->fx, err)) ||
        (status = read_focal(reader, from, down, size[1], &camera->fy, err)) ||
        (status = number(reader, from, "cx", -HUGE_PX, HUGE_PX, 0.5 * size[0], &camera->cx, NULL,
                         err)) ||
        (status =
             number(reader, from, "cy", -HUGE_PX, HUGE_PX, 0.5 * size[1], &camera->cy, NULL, err)))
        return status;
    if (!(camera->fx > 0)) {
        struct rn_json missing = {NULL, from->root.file, &from->root, "fl_x", 0};
        return rn_json_error(&missing, RN_ERROR_INVALID, err,
                             "is missing, and so are camera_angle_x and x_fov");
    }
    if (!(camera->fy > 0)) camera->fy = camera->fx;
    return rn_reader_fit(reader, where, size[0], size[1], frame, err);
}

// Dataset readers: what is read, and what is refused with which file and field.
#include <math.h>
#include <sys/stat.h>
#include <turbojpeg.h>
#include <unistd.h>

#include "common/math/vector.h"
#include "tests/unit/common/dataset_fixture.h"

// The only error among the problems is at `where` (relative to the folder) and says `text`.
static void assert_one_error(const char *where, const char *text) {
    ck_assert_uint_eq(problems.errors, 1);
    for (size_t i = 0; i < problems.count; i++) {
        const struct rn_problem *problem = &problems.items[i];
        if (problem->severity != RN_SEVERITY_ERROR) continue;
        ck_assert_str_eq(problem->where + strlen(folder) + 1, where);
        ck_assert_msg(strstr(problem->text, text) != NULL, "%s", problem->text);
    }
}

START_TEST(blender) {
    put_image("train/r_0.png", 8, 6);
    put_image("train/r 1 \xc3\xa9.png", 8, 6);
    put_png("test/a.b.png", 4, 2, PNG_COLOR_TYPE_RGB, 8, PNG_INTERLACE_NONE);
    put_transforms("train", FRAME("./train/r_0") "," FRAME("train/r 1 \xc3\xa9"));
    put_transforms("test", FRAME("./test/a.b.png"));
    read_ok(folder);
    ck_assert_str_eq(dataset->format->name, "blender");
    ck_assert_str_eq(dataset->name, folder + strlen("/tmp/"));
    ck_assert_uint_eq(dataset->frame_count, 3);
    ck_assert_int_eq(dataset->view_count[RN_SPLIT_TRAIN], 2);
    ck_assert_int_eq(dataset->view_count[RN_SPLIT_VAL], 0);
    ck_assert_int_eq(dataset->scale_count, 1);
    ck_assert_uint_eq(problems.errors + problems.warnings, 0);
    const struct rn_frame *frame = rn_dataset_frame(dataset, RN_SPLIT_TRAIN, 1, 0);
    ck_assert_str_eq(frame->name, "r 1 \xc3\xa9");
    ck_assert(frame->has_alpha);
    ck_assert_double_eq(frame->loss_weight, 1);
    const struct rn_camera *camera = &frame->camera;
    ck_assert_int_eq(camera->width, 8);
    ck_assert_int_eq(camera->height, 6);
    ck_assert_double_eq_tol(camera->fx, 4 / tan(0.45), 1e-12);
    ck_assert_double_eq(camera->fy, camera->fx);
    ck_assert_double_eq(camera->cx, 4);
    ck_assert_double_eq(camera->cy, 3);
    struct rn_ray ray = rn_camera_ray(camera, 4, 3); // along -z, as OpenGL cameras look
    ck_assert_double_eq(ray.direction[2], -1);
    ck_assert_double_eq(ray.origin[0], 0.5);
    ray = rn_camera_ray(camera, 4, 0);
    ck_assert_double_gt(ray.direction[1], 0); // the picture's top is up
    frame = rn_dataset_frame(dataset, RN_SPLIT_TEST, 0, 0);
    ck_assert_str_eq(frame->name, "a.b");
    ck_assert(!frame->has_alpha);
    ck_assert_ptr_null(rn_dataset_frame(dataset, RN_SPLIT_TEST, 1, 0));
    ck_assert_ptr_null(rn_dataset_frame(dataset, RN_SPLIT_TEST, 0, 1));
}
END_TEST

START_TEST(bounds_and_report) {
    put_png("train/r_0.png", 8, 6, PNG_COLOR_TYPE_RGB_ALPHA, 8, PNG_INTERLACE_NONE);
    put_transforms("train", FRAME("./train/r_0"));
    read_ok(folder);
    ck_assert_int_eq(dataset->bounds.source, RN_BOUNDS_LAYOUT);
    ck_assert_double_eq(dataset->bounds.radius, 1.5);
    struct rn_dataset_report report;
    rn_dataset_describe(dataset, &report);
    double distance = sqrt(0.25 + 0.0625 + 16);
    ck_assert_double_eq_tol(report.camera_distance_min, distance, 1e-12);
    ck_assert_double_eq_tol(report.footprint_max, distance * tan(0.45) / 4 / sqrt(M_PI), 1e-12);
    ck_assert_double_eq(report.looking_at_bounds, 1);
    ck_assert_int_eq(report.usable[RN_SPLIT_TRAIN], 1);
    ck_assert_int_eq(report.with_alpha, 1);
    ck_assert_int_eq(report.width_max, 8);
    ck_assert_int_eq(report.height_min, 6);
}
END_TEST

// Cameras far from the origin that look at (100, 0, 0) from either side.
START_TEST(bounds_from_cameras) {
    put_image("train/r_0.png", 8, 6);
    put_transforms("train", "{\"file_path\":\"train/r_0\",\"transform_matrix\":"
                            "[[1,0,0,100],[0,1,0,0],[0,0,1,8],[0,0,0,1]]},"
                            "{\"file_path\":\"train/r_0\",\"transform_matrix\":"
                            "[[1,0,0,100],[0,0,-1,-8],[0,1,0,0],[0,0,0,1]]}");
    read_ok(folder);
    ck_assert_int_eq(dataset->bounds.source, RN_BOUNDS_CAMERAS);
    ck_assert_double_eq_tol(dataset->bounds.centre[0], 100, 1e-9);
    ck_assert_double_eq_tol(dataset->bounds.centre[2], 0, 1e-9);
    ck_assert_double_eq_tol(dataset->bounds.radius, 4, 1e-9);
    ck_assert_uint_eq(problems.warnings, 1);
    ck_assert(strstr(problems.items[problems.count - 1].text, "no camera looks") != NULL);
}
END_TEST

// A camera at (0.5, 0.25, 4), whose photographs the layout's sphere covers in part, or whole where
// the field of view is narrow.
START_TEST(photographs_of_more_than_the_sphere) {
    static const struct {
        int colour_type;
        const char *angle;
        size_t warnings;
    } cases[] = {{PNG_COLOR_TYPE_RGB, "0.9", 1},
                 {PNG_COLOR_TYPE_RGB, "0.4", 0},
                 {PNG_COLOR_TYPE_RGB_ALPHA, "0.9", 0}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        char *text;
        put_png("train/r_0.png", 8, 6, cases[i].colour_type, 8, PNG_INTERLACE_NONE);
        ck_assert(asprintf(&text, "{\"camera_angle_x\":%s,\"frames\":[%s]}", cases[i].angle,
                           FRAME("train/r_0")) > 0);
        put_text("transforms_train.json", text);
        free(text);
        read_ok(folder);
        ck_assert_int_eq(dataset->bounds.source, RN_BOUNDS_LAYOUT);
        ck_assert_uint_eq(problems.warnings, cases[i].warnings);
        for (size_t k = 0; k < problems.count; k++) {
            if (problems.items[k].severity != RN_SEVERITY_WARNING) continue;
            ck_assert_ptr_nonnull(strstr(problems.items[k].text, "covers only 64 %"));
            // One axis: a unit ahead of the camera, and one and a half times as wide.
            ck_assert_ptr_nonnull(strstr(problems.items[k].text, // to its last word
                                         ": 0.5,0.25,3,1.5 reaches 1.5 times the cameras' mean "
                                         "distance"));
        }
        rn_dataset_destroy(&dataset);
        rn_problems_finish(&problems);
        problems = (struct rn_problems){0};
    }
}
END_TEST

#define SIDE 64

// A photograph whose middle, `half` pixels to each side, is opaque.
static void put_cut_out(const char *name, int half) {
    struct rn_image image = noise(SIDE, SIDE, 1);
    for (int i = 0; i < SIDE * SIDE; i++) {
        int x = abs(2 * (i % SIDE) + 1 - SIDE), y = abs(2 * (i / SIDE) + 1 - SIDE);
        image.pixels[4 * i + 3] = x < 2 * half && y < 2 * half ? 255 : 0;
    }
    ck_assert_int_eq(rn_image_write_png(&image, in_folder(name), 1, &err), RN_OK);
    rn_image_finish(&image);
}

#define AHEAD(file)                                                                                \
    "{\"file_path\":\"" file "\",\"transform_matrix\":[[1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]]}"

// Seen from 4 away: what is cut out fits the layout's sphere, or is larger or far smaller than it.
START_TEST(a_sphere_that_fits_what_is_cut_out) {
    static const int halves[] = {16, 30, 4};
    put_cut_out("train/r_0.png", halves[_i]);
    put_cut_out("train/r_1.png", halves[_i]);
    put_transforms("train", AHEAD("train/r_0") "," AHEAD("train/r_1"));
    read_ok(folder);
    ck_assert_uint_eq(problems.errors + problems.warnings, 0);
    ck_assert_int_eq(dataset->bounds.source, RN_BOUNDS_LAYOUT);
    if (_i == 0) ck_assert_double_eq(dataset->bounds.radius, 1.5);
    if (_i == 0) return;
    double corner = 4 * sin(atan(sqrt(2) * halves[_i] * tan(0.45) / (SIDE / 2)));
    ck_assert_double_eq(rn_dot(dataset->bounds.centre, dataset->bounds.centre), 0);
    ck_assert_double_gt(dataset->bounds.radius, corner);
    ck_assert_double_lt(dataset->bounds.radius, 1.2 * corner);
    ck_assert_ptr_nonnull(strstr(problems.items[problems.count - 1].text, "does not fit"));
}
END_TEST

// Photographs of a capture, from two sides: the ball of what they cut out, whatever its layout.
START_TEST(a_ball_of_what_photographs_cut_out) {
    put_cut_out("train/r_0.png", 8);
    put_cut_out("train/r_1.png", 8);
    put_text("transforms.json",
             "{\"fl_x\":64,\"fl_y\":64,\"cx\":32,\"cy\":32,\"w\":64,\"h\":64,\"frames\":[" AHEAD(
                 "train/r_0.png") ",{\"file_path\":\"train/r_1.png\",\"transform_matrix\":"
                                  "[[0,0,1,4],[1,0,0,0],[0,1,0,0],[0,0,0,1]]}]}");
    read_ok(folder);
    double corner = 4 * sin(atan(sqrt(2) * 8 / 64));
    ck_assert_int_eq(dataset->bounds.source, RN_BOUNDS_OUTLINES);
    ck_assert_double_lt(rn_dot(dataset->bounds.centre, dataset->bounds.centre), 1e-18);
    ck_assert_double_gt(dataset->bounds.radius, corner);
    ck_assert_double_lt(dataset->bounds.radius, 1.2 * corner);
}
END_TEST

// As many tools write: of such photographs nothing is cut out, and none is imported with alpha.
START_TEST(alpha_that_is_opaque_everywhere) {
    static const char *const names[] = {"train/r_0.png", "train/r_1.png"};
    for (int i = 0; i < 2; i++)
        put_cut_out(names[i], _i == 1 && i == 1 ? SIDE / 2 - 1 : SIDE / 2);
    put_transforms("train", AHEAD("train/r_0") "," AHEAD("train/r_1"));
    read_ok(folder);
    ck_assert_int_eq(dataset->frames[0].has_alpha, _i == 1);
    ck_assert_int_eq(dataset->frames[1].has_alpha, _i == 1);
    if (_i == 0) ck_assert_ptr_nonnull(strstr(problems.items[problems.count - 2].text, "opaque"));
    struct rn_import_options options = {.scales = 1, .threads = 1};
    struct rn_dataset *made = NULL;
    ck_assert_int_eq(rn_dataset_import(dataset, "made", &options, in_folder("made"), &problems,
                                       NULL, NULL, &err),
                     RN_OK);
    ck_assert_int_eq(rn_dataset_read(in_folder("made"), NULL, &made, &err), RN_OK);
    ck_assert_int_eq(made->frames[0].has_alpha, _i == 1);
    rn_dataset_destroy(&made);
}
END_TEST

START_TEST(find_view) {
    put_image("train/r_0.png", 8, 6);
    put_image("train/x/r_0.png", 8, 6);
    put_image("train/7.png", 8, 6);
    put_transforms("train", FRAME("train/r_0") "," FRAME("train/7") "," FRAME("train/x/r_0"));
    read_ok(folder);
    static const struct {
        const char *view;
        enum rn_status status;
        int index;
    } cases[] = {
        {"train:0", RN_OK, 0},
        {"train:2", RN_OK, 2},
        {"train:7", RN_OK, 1}, // no view 7: the name
        {"train:r_0", RN_ERROR_CONFLICT, 0},
        {"train:r_1", RN_ERROR_NOT_FOUND, 0},
        {"test:0", RN_ERROR_NOT_FOUND, 0},
        {"train:99999999999999999999", RN_ERROR_NOT_FOUND, 0},
        {"train", RN_ERROR_INVALID, 0},
        {"train:", RN_ERROR_INVALID, 0},
        {"tra:0", RN_ERROR_INVALID, 0},
        {":0", RN_ERROR_INVALID, 0},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        const struct rn_frame *frame = NULL;
        enum rn_status status = rn_dataset_find_view(dataset, cases[i].view, 0, &frame, &err);
        ck_assert_msg(status == cases[i].status, "%s: %s", cases[i].view, rn_status_name(status));
        if (status == RN_OK) ck_assert_int_eq(frame->index, cases[i].index);
    }
}
END_TEST

START_TEST(unknown_fields_warn_once) {
    put_image("train/r_0.png", 8, 6);
    const char *frame = "{\"file_path\":\"train/r_0\",\"rotation\":0.1,\"blur\":1,"
                        "\"transform_matrix\":" POSE "}";
    char frames[1024];
    snprintf(frames, sizeof frames, "%s,%s", frame, frame);
    put_transforms("train", frames);
    read_ok(folder);
    ck_assert_uint_eq(problems.errors, 0);
    ck_assert_uint_eq(problems.warnings, 1);
    const char *where = problems.items[0].where + strlen(folder) + 1;
    ck_assert_str_eq(where, "transforms_train.json#/frames/0/blur");
}
END_TEST

#define BAD_POSE(matrix) "{\"file_path\":\"train/r_0\",\"transform_matrix\":" matrix "}"
#define AT_POSE "transforms_train.json#/frames/1/transform_matrix"
#define AT_FILE "transforms_train.json#/frames/1/file_path"

static const struct {
    const char *frame, *where, *text;
} bad_frames[] = {
    {BAD_POSE("[[NaN,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]]"), AT_POSE "/0/0", "finite"},
    {BAD_POSE("[[1,0,0,0],[0,1,0,-Infinity],[0,0,1,4],[0,0,0,1]]"), AT_POSE "/1/3", "finite"},
    {BAD_POSE("[[2,0,0,0],[0,2,0,0],[0,0,2,4],[0,0,0,1]]"), AT_POSE, "rotation"},
    {BAD_POSE("[[1,0.1,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]]"), AT_POSE, "rotation"},
    {BAD_POSE("[[-1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]]"), AT_POSE, "mirrored"},
    {BAD_POSE("[[1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,1,1]]"), AT_POSE "/3", "0 0 0 1"},
    {BAD_POSE("[[1,0,0,0],[0,1,0,0],[0,0,1,4]]"), AT_POSE, "4 rows"},
    {BAD_POSE("[[1,0,0,0],[0,1,0,0],[0,0,1],[0,0,0,1]]"), AT_POSE "/2", "4 numbers"},
    {BAD_POSE("[[1,0,0,\"0\"],[0,1,0,0],[0,0,1,4],[0,0,0,1]]"), AT_POSE "/0/3", "finite number"},
    {BAD_POSE("null"), AT_POSE, "4 rows"},
    {"{\"file_path\":\"train/r_0\"}", AT_POSE, "missing"},
    {"{\"transform_matrix\":" POSE "}", AT_FILE, "missing"},
    {"17", "transforms_train.json#/frames/1", "object"},
    {FRAME("train/none"), AT_FILE, "none.png, which does not exist"},
    {FRAME("train/gone"), AT_FILE, "gone.png, which does not exist: the link there leads nowhere"},
    {FRAME("train/../../r_0"), AT_FILE, "\"..\""},
    {FRAME(".."), AT_FILE, "\"..\""},
    {FRAME("/etc/passwd"), AT_FILE, "absolute"},
    {FRAME("train/r\\n0"), AT_FILE, "control character"},
    {FRAME("train/"), AT_FILE, "no file"},
    {FRAME(""), AT_FILE, "0 bytes"},
    {FRAME("train/folder"), AT_FILE, "no regular file"},
    {FRAME("train/pipe"), AT_FILE, "no regular file"},
    {FRAME("train/empty"), AT_FILE, "empty.png"},
    {FRAME("train/text"), AT_FILE, "text.png"},
    {FRAME("train/short"), AT_FILE, "short.png"},
    {FRAME("train/huge"), AT_FILE, "100000 x 100000"},
    {FRAME("train/cmyk.jpg"), AT_FILE, "CMYK"},
};

static void put_cmyk(const char *name) {
    static const unsigned char pixels[8 * 6 * 4];
    tjhandle handle = tjInitCompress();
    unsigned char *bytes = NULL;
    unsigned long size = 0;
    ck_assert_int_eq(
        tjCompress2(handle, pixels, 8, 0, 6, TJPF_CMYK, &bytes, &size, TJSAMP_444, 90, 0), 0);
    put_bytes(name, bytes, size);
    tjFree(bytes);
    tjDestroy(handle);
}

static void put_bad_files(void) {
    static const uint8_t huge[] = {0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n', 0,   0, 0,    13,
                                   'I',  'H', 'D', 'R', 0,    1,    0x86, 0xa0, 0,   1, 0x86, 0xa0,
                                   8,    6,   0,   0,   0,    0,    0,    0,    0,   0, 0,    0,
                                   0,    'I', 'D', 'A', 'T',  0x35, 0xaf, 0x06, 0x1e};
    uint8_t with_sum[sizeof huge];
    memcpy(with_sum, huge, sizeof huge);
    uint32_t sum = 0xffffffffu; // CRC-32 of type and data
    for (size_t i = 12; i < 29; i++) {
        sum ^= huge[i];
        for (int bit = 0; bit < 8; bit++)
            sum = sum >> 1 ^ (sum & 1 ? 0xedb88320u : 0);
    }
    sum = ~sum;
    for (int i = 0; i < 4; i++)
        with_sum[29 + i] = (uint8_t)(sum >> (24 - 8 * i));
    put_bytes("train/huge.png", with_sum, sizeof with_sum);
    put_bytes("train/empty.png", "", 0);
    put_text("train/text.png", "this is no picture");
    put_image("train/short.png", 8, 6);
    truncate_file("train/short.png", 20);
    put_cmyk("train/cmyk.jpg");
    in_folder("train/folder.png/x");
    ck_assert_int_eq(mkfifo(in_folder("train/pipe.png"), 0600), 0);
    ck_assert_int_eq(symlink("nowhere.png", in_folder("train/gone.png")), 0);
}

START_TEST(bad_frame) {
    put_image("train/r_0.png", 8, 6);
    put_bad_files();
    char frames[2048];
    snprintf(frames, sizeof frames, "%s,%s,%s", FRAME("train/r_0"), bad_frames[_i].frame,
             FRAME("train/r_0"));
    put_transforms("train", frames);
    read_ok(folder);
    assert_one_error(bad_frames[_i].where, bad_frames[_i].text);
    ck_assert_int_eq(dataset->unusable[RN_SPLIT_TRAIN], 1);
    ck_assert_int_eq(dataset->view_count[RN_SPLIT_TRAIN], 2);
    ck_assert_ptr_null(rn_dataset_frame(dataset, RN_SPLIT_TRAIN, 1, 0));
    ck_assert_ptr_nonnull(rn_dataset_frame(dataset, RN_SPLIT_TRAIN, 2, 0));
}
END_TEST

START_TEST(unusual_images_are_usable) {
    put_png("i/interlaced.png", 8, 6, PNG_COLOR_TYPE_RGB, 8, PNG_INTERLACE_ADAM7);
    put_png("i/deep.png", 8, 6, PNG_COLOR_TYPE_RGB_ALPHA, 16, PNG_INTERLACE_NONE);
    put_png("i/palette.png", 8, 6, PNG_COLOR_TYPE_PALETTE, 8, PNG_INTERLACE_NONE);
    put_transforms("train", FRAME("i/interlaced") "," FRAME("i/deep") "," FRAME("i/palette"));
    read_ok(folder);
    ck_assert_uint_eq(problems.errors + problems.warnings, 0);
    size_t told = 0;
    for (size_t i = 0; i < problems.count; i++)
        told += strstr(problems.items[i].text, "16 bits") &&
                strstr(problems.items[i].where, "transforms_train.json#/frames/1/file_path");
    ck_assert_uint_eq(told, 1);
    ck_assert_int_eq(dataset->view_count[RN_SPLIT_TRAIN], 3);
    ck_assert(rn_dataset_frame(dataset, RN_SPLIT_TRAIN, 1, 0)->has_alpha);
    ck_assert(!rn_dataset_frame(dataset, RN_SPLIT_TRAIN, 2, 0)->has_alpha);
}
END_TEST

START_TEST(size_differs_from_the_json) {
    put_image("train/r_0.png", 8, 6);
    put_image("train/r_1.png", 8, 5);
    put_text("transforms_train.json", "{\"camera_angle_x\":0.9,\"w\":8,\"h\":6,\"frames\":[" FRAME(
                                          "train/r_0") "," FRAME("train/r_1") "]}");
    read_ok(folder);
    assert_one_error("transforms_train.json#/frames/1", "8x5 pixels, the file says 8x6");
    ck_assert_int_eq(dataset->view_count[RN_SPLIT_TRAIN], 1);
}
END_TEST

START_TEST(sizes_differ_among_images) {
    put_image("train/r_0.png", 8, 6);
    put_image("train/r_1.png", 16, 12);
    put_transforms("train", FRAME("train/r_0") "," FRAME("train/r_1"));
    read_ok(folder);
    ck_assert_uint_eq(problems.errors, 0);
    ck_assert_uint_eq(problems.warnings, 1);
    const struct rn_frame *big = rn_dataset_frame(dataset, RN_SPLIT_TRAIN, 1, 0);
    ck_assert_double_eq_tol(big->camera.fx, 8 / tan(0.45), 1e-12);
}
END_TEST

static const struct {
    const char *json, *where, *text;
} bad_documents[] = {
    {"{\"camera_angle_x\":0.9,\"frames\":[", "transforms_train.json:1", "not valid JSON"},
    {"{\"camera_angle_x\":0.9,\"frames\":[],\n\"frames\":[]}", "transforms_train.json:2",
     "duplicate"},
    {"{\"camera_angle_x\":0.9,\"frames\":[" FRAME("train/r_0") "]} trailing",
     "transforms_train.json:1", "not valid JSON"},
    {"[1]", "transforms_train.json#", "object"},
    {"", "transforms_train.json:1", "not valid JSON"},
    {"{\"frames\":[]}", "transforms_train.json#/camera_angle_x", "missing"},
    {"{\"camera_angle_x\":NaN,\"frames\":[]}", "transforms_train.json#/camera_angle_x", "finite"},
    {"{\"camera_angle_x\":0,\"frames\":[]}", "transforms_train.json#/camera_angle_x", "is 0"},
    {"{\"camera_angle_x\":3.2,\"frames\":[]}", "transforms_train.json#/camera_angle_x", "is 3.2"},
    {"{\"camera_angle_x\":\"1\",\"frames\":[]}", "transforms_train.json#/camera_angle_x", "number"},
    {"{\"camera_angle_x\":0.9}", "transforms_train.json#/frames", "missing"},
    {"{\"camera_angle_x\":0.9,\"frames\":{}}", "transforms_train.json#/frames", "array"},
    {"{\"camera_angle_x\":0.9,\"w\":8,\"frames\":[]}", "transforms_train.json#/h", "missing"},
    {"{\"camera_angle_x\":0.9,\"frames\":[\"\xff\"]}", "transforms_train.json:1", "not valid JSON"},
};

START_TEST(bad_document) {
    put_image("train/r_0.png", 8, 6);
    put_text("transforms_train.json", bad_documents[_i].json);
    ck_assert_int_eq(rn_dataset_read(folder, &problems, &dataset, &err), RN_ERROR_INVALID);
    ck_assert_ptr_null(dataset);
    ck_assert_str_eq(err.where + strlen(folder) + 1, bad_documents[_i].where);
    ck_assert_msg(strstr(err.text, bad_documents[_i].text) != NULL, "%s", err.text);
}
END_TEST

START_TEST(no_usable_view) {
    put_transforms("train", "");
    ck_assert_int_eq(rn_dataset_read(folder, &problems, &dataset, &err), RN_ERROR_INVALID);
    ck_assert_str_eq(err.where, folder);
    ck_assert_msg(strstr(err.text, "no usable training view") != NULL, "%s", err.text);
    ck_assert_msg(strstr(err.text, "#/frames has no views") != NULL, "%s", err.text);
    rn_problems_finish(&problems);
    put_transforms("train", FRAME("train/gone"));
    ck_assert_int_eq(rn_dataset_read(folder, NULL, &dataset, NULL), RN_ERROR_INVALID);
    ck_assert_int_eq(rn_dataset_read(folder, &problems, &dataset, &err), RN_ERROR_INVALID);
    ck_assert_msg(strstr(err.text, "/frames/0/file_path") != NULL, "%s", err.text);
    ck_assert_uint_eq(problems.errors, 1);
}
END_TEST

START_TEST(no_dataset) {
    ck_assert_int_eq(rn_dataset_read(folder, NULL, &dataset, &err), RN_ERROR_NOT_FOUND);
    ck_assert(strstr(err.text, "transforms_train.json") != NULL);
    ck_assert_int_eq(symlink("nowhere", in_folder("transforms.json")), 0);
    ck_assert_int_eq(rn_dataset_read(folder, NULL, &dataset, &err), RN_ERROR_NOT_FOUND);
    ck_assert_str_eq(err.where + strlen(folder) + 1, "transforms.json");
    ck_assert(strstr(err.text, "leads nowhere; put there what it led to") != NULL);
    ck_assert_int_eq(rn_dataset_read(in_folder("gone"), NULL, &dataset, &err), RN_ERROR_NOT_FOUND);
    put_text("file", "x");
    ck_assert_int_eq(rn_dataset_read(in_folder("file"), NULL, &dataset, &err), RN_ERROR_INVALID);
    char advice[256];
    snprintf(advice, sizeof advice, "is a file; give the folder with all photographs, perhaps %s",
             folder);
    ck_assert_str_eq(err.text, advice);
    put_text("transforms_train.json", "{");
    ck_assert_int_eq(truncate(in_folder("transforms_train.json"), (64L << 20) + 1), 0);
    ck_assert_int_eq(rn_dataset_read(folder, NULL, &dataset, &err), RN_ERROR_LIMIT);
    ck_assert_str_eq(err.where + strlen(folder) + 1, "transforms_train.json");
}
END_TEST

START_TEST(problems_are_bounded) {
    for (int i = 0; i < 2000; i++)
        rn_problems_add(&problems, i % 2 ? RN_SEVERITY_ERROR : RN_SEVERITY_WARNING, "here", "%d",
                        i);
    ck_assert_uint_eq(problems.errors, 1000);
    ck_assert_uint_eq(problems.warnings, 1000);
    ck_assert_uint_eq(problems.count + problems.dropped, 2000);
    ck_assert_uint_le(problems.count, 500);
    ck_assert_str_eq(problems.items[7].text, "7");
}
END_TEST

// ---- multi-scale

#define MS_FILES "[\"i/000_d0.png\",\"i/000_d1.png\",\"i/001_d0.png\",\"i/001_d1.png\"]"
#define MS_POSES "[" POSE "," POSE "," POSE "," POSE "]"
#define MS(files, poses, widths, heights, focals, labels, rest)                                    \
    "{\"train\":{\"file_path\":" files ",\"cam2world\":" poses ",\"width\":" widths                \
    ",\"height\":" heights ",\"focal\":" focals ",\"label\":" labels rest "}}"
#define MS_GOOD(rest)                                                                              \
    MS(MS_FILES, MS_POSES, "[8,4,8,4]", "[6,3,6,3]", "[10,5,10,5]", "[0,1,0,1]", rest)

static void put_multiscale(const char *json) {
    put_image("i/000_d0.png", 8, 6);
    put_image("i/000_d1.png", 4, 3);
    put_image("i/001_d0.png", 8, 6);
    put_image("i/001_d1.png", 4, 3);
    put_text("metadata.json", json);
}

START_TEST(multiscale) {
    put_multiscale(MS_GOOD(",\"near\":[2,2,2,2],\"far\":[6,6,6,6],\"lossmult\":[1,4,1,4.5]"));
    read_ok(folder);
    ck_assert_uint_eq(problems.errors + problems.warnings, 0);
    ck_assert_str_eq(dataset->format->name, "multiscale");
    ck_assert(!dataset->premultiplied_scales);
    ck_assert_uint_eq(dataset->frame_count, 4);
    ck_assert_int_eq(dataset->view_count[RN_SPLIT_TRAIN], 2);
    ck_assert_int_eq(dataset->scale_count, 2);
    const struct rn_frame *frame = rn_dataset_frame(dataset, RN_SPLIT_TRAIN, 1, 1);
    ck_assert_str_eq(frame->name, "001");
    ck_assert_double_eq(frame->loss_weight, 4.5);
    ck_assert_double_eq(frame->camera.fx, 5);
    ck_assert_double_eq(frame->camera.cy, 1.5);
    ck_assert_int_eq(frame->camera.width, 4);
    ck_assert_double_eq(frame->camera.world_from_camera[2][2], -1);
    const struct rn_frame *found;
    ck_assert_int_eq(rn_dataset_find_view(dataset, "train:001", 1, &found, &err), RN_OK);
    ck_assert_ptr_eq(found, frame);
}
END_TEST

START_TEST(multiscale_default_weight) {
    put_multiscale(MS_GOOD(""));
    read_ok(folder);
    ck_assert_double_eq(rn_dataset_frame(dataset, RN_SPLIT_TRAIN, 0, 0)->loss_weight, 1);
    ck_assert_double_eq(rn_dataset_frame(dataset, RN_SPLIT_TRAIN, 0, 1)->loss_weight, 4);
}
END_TEST

static const struct {
    const char *json, *where, *text;
    bool fatal;
} bad_multiscale[] = {
    {MS(MS_FILES, MS_POSES, "[8,4,8,5]", "[6,3,6,3]", "[10,5,10,5]", "[0,1,0,1]", ""),
     "metadata.json#/train/width/3", "4x3 pixels, the file says 5x3", false},
    {MS(MS_FILES, MS_POSES, "[8,4,8,4]", "[6,3,6,99]", "[10,5,10,5]", "[0,1,0,1]", ""),
     "metadata.json#/train/height/3", "says 4x99", false},
    {MS(MS_FILES, MS_POSES, "[8,4,8,4]", "[6,3,6,3]", "[10,5,10,0]", "[0,1,0,1]", ""),
     "metadata.json#/train/focal/3", "is 0", false},
    {MS(MS_FILES, "[" POSE "," POSE "," POSE ",[]]", "[8,4,8,4]", "[6,3,6,3]", "[10,5,10,5]",
        "[0,1,0,1]", ""),
     "metadata.json#/train/cam2world/3", "4 rows", false},
    {MS("[\"i/000_d0.png\",\"i/000_d1.png\",\"i/001_d0.png\",\"../x.png\"]", MS_POSES, "[8,4,8,4]",
        "[6,3,6,3]", "[10,5,10,5]", "[0,1,0,1]", ""),
     "metadata.json#/train/file_path/3", "\"..\"", false},
    {MS_GOOD(",\"lossmult\":[1,1,1,-1]"), "metadata.json#/train/lossmult/3", "is -1", false},
    {MS_GOOD(",\"lossmult\":[1]"), "metadata.json#/train/lossmult", "1 elements, file_path has 4",
     true},
    {MS(MS_FILES, MS_POSES, "[8,4,8]", "[6,3,6,3]", "[10,5,10,5]", "[0,1,0,1]", ""),
     "metadata.json#/train/width", "3 elements, file_path has 4", true},
    {MS(MS_FILES, MS_POSES, "[8,4,8,4]", "[6,3,6,3]", "[10,5,10,5]", "[0,1,0,-1]", ""),
     "metadata.json#/train/label/3", "is -1", true},
    {"{\"train\":{\"file_path\":[]}}", "metadata.json#/train/cam2world", "missing", true},
    {"{\"train\":3}", "metadata.json#/train", "object", true},
    {"{\"train\":{},\"train\":{}}", "metadata.json:1", "duplicate", true},
};

START_TEST(bad_multiscale_document) {
    put_multiscale(bad_multiscale[_i].json);
    if (!bad_multiscale[_i].fatal) {
        read_ok(folder);
        assert_one_error(bad_multiscale[_i].where, bad_multiscale[_i].text);
        ck_assert_uint_eq(dataset->frame_count, 3);
        return;
    }
    ck_assert_int_eq(rn_dataset_read(folder, &problems, &dataset, &err), RN_ERROR_INVALID);
    ck_assert_str_eq(err.where + strlen(folder) + 1, bad_multiscale[_i].where);
    ck_assert_msg(strstr(err.text, bad_multiscale[_i].text) != NULL, "%s", err.text);
}
END_TEST

START_TEST(multiscale_focal_conflict) {
    put_multiscale(MS_GOOD(",\"pix2cam\":[[[0.1,0,-0.4],[0,-0.1,0.3],[0,0,-1]],"
                           "[[0.2,0,-0.4],[0,-0.2,0.3],[0,0,-1]],"
                           "[[0.1,0,-0.4],[0,-0.1,0.3],[0,0,-1]],"
                           "[[0.25,0,-0.4],[0,-0.25,0.3],[0,0,-1]]]"));
    read_ok(folder);
    ck_assert_uint_eq(problems.warnings, 1);
    for (size_t i = 0; i < problems.count; i++)
        if (problems.items[i].severity == RN_SEVERITY_WARNING)
            ck_assert_str_eq(problems.items[i].where + strlen(folder) + 1,
                             "metadata.json#/train/pix2cam/3");
}
END_TEST

// ---- native

#define NATIVE_CAMERA                                                                              \
    "{\"world_from_camera\":[[1,0,0,0],[0,1,0,0],[0,0,1,-4]],\"axes\":\"opencv\",\"width\":8,"     \
    "\"height\":6,\"fx\":9,\"fy\":10,\"cx\":4,\"cy\":3}"
#define NATIVE_FRAME(index, rest)                                                                  \
    "{\"name\":\"a\",\"file\":\"images/a.png\",\"split\":\"train\",\"index\":" #index              \
    ",\"scale\":0,\"loss_weight\":1,\"camera\":" NATIVE_CAMERA rest "}"
#define NATIVE(version, bounds, frames, rest)                                                      \
    "{\"format\":\"ripnerf-dataset\",\"version\":" #version ",\"name\":\"n\",\"source\":{"         \
    "\"layout\":\"blender\",\"downscale\":\"straight\"},\"bounds\":{\"centre\":[0,0,1],"           \
    "\"radius\":" bounds ",\"source\":\"given\"},\"frames\":[" frames "]" rest "}"

START_TEST(native) {
    put_image("images/a.png", 8, 6);
    put_text("dataset.json",
             NATIVE(1, "2.5", NATIVE_FRAME(3, "") "," NATIVE_FRAME(1, ",\"gain\":[1,1.25,1]"), ""));
    read_ok(folder);
    ck_assert_str_eq(dataset->format->name, "native");
    ck_assert_str_eq(dataset->name, "n");
    ck_assert(!dataset->premultiplied_scales);
    ck_assert_double_eq(dataset->bounds.radius, 2.5);
    ck_assert_double_eq(dataset->bounds.centre[2], 1);
    ck_assert_int_eq(dataset->bounds.source, RN_BOUNDS_GIVEN);
    ck_assert_int_eq(dataset->frames[0].index, 1); // sorted
    ck_assert_double_eq(dataset->frames[1].camera.fy, 10);
    ck_assert_double_eq(dataset->frames[0].gain[1], 1.25);
    ck_assert_double_eq(dataset->frames[1].gain[1], 0); // not measured
}
END_TEST

static const struct {
    const char *json, *where, *text;
} bad_native[] = {
    {NATIVE(2, "2.5", NATIVE_FRAME(0, ""), ""), "dataset.json#/version", "is 2"},
    {NATIVE(1, "0", NATIVE_FRAME(0, ""), ""), "dataset.json#/bounds/radius", "is 0"},
    {NATIVE(1, "2", NATIVE_FRAME(0, ""), ",\"extra\":1"), "dataset.json#/extra", "known"},
    {NATIVE(1, "2", NATIVE_FRAME(0, "") "," NATIVE_FRAME(0, ""), ""), NULL, "two images"},
    {NATIVE(1, "2", NATIVE_FRAME(0, ",\"extra\":1"), ""), NULL, "/frames/0/extra"},
    {NATIVE(1, "2", NATIVE_FRAME(-1, ""), ""), NULL, "/frames/0/index"},
    {NATIVE(1, "2", NATIVE_FRAME(0, ",\"gain\":[1,0,1]"), ""), NULL, "/frames/0/gain"},
    {NATIVE(1, "2", NATIVE_FRAME(0, ",\"gain\":[1,1]"), ""), NULL, "/frames/0/gain"},
};

START_TEST(bad_native_document) {
    put_image("images/a.png", 8, 6);
    put_text("dataset.json", bad_native[_i].json);
    ck_assert_int_eq(rn_dataset_read(folder, &problems, &dataset, &err), RN_ERROR_INVALID);
    if (bad_native[_i].where)
        ck_assert_str_eq(err.where + strlen(folder) + 1, bad_native[_i].where);
    ck_assert_msg(strstr(err.text, bad_native[_i].text) != NULL, "%s", err.text);
}
END_TEST

// What a list of names has no room for ends with dots, and within no character.
START_TEST(long_problems) {
    char text[900] = "a";
    for (int i = 0; i < 400; i++)
        strcpy(text + _i + 2 * i, "\xc3\xa9");
    rn_problems_add(&problems, RN_SEVERITY_INFO, text, "%s", text);
    rn_problems_add(&problems, RN_SEVERITY_INFO, "\xff", "\xff");
    for (int i = 0; i < 2; i++) {
        const char *both[] = {problems.items[0].where, problems.items[0].text};
        size_t length = strlen(both[i]);
        ck_assert_str_eq(both[i] + length - 5, "\xc3\xa9...");
    }
    ck_assert_str_eq(problems.items[1].where, "?");
    ck_assert_str_eq(problems.items[1].text, "?");
}
END_TEST

#define COUNT(table) ((int)(sizeof table / sizeof *table))

int main(void) {
    Suite *suite = suite_create("dataset");
    TCase *tests = tcase_create("dataset");
    tcase_add_checked_fixture(tests, setup, teardown);
    tcase_add_test(tests, blender);
    tcase_add_loop_test(tests, long_problems, 0, 2);
    tcase_add_test(tests, bounds_and_report);
    tcase_add_test(tests, bounds_from_cameras);
    tcase_add_test(tests, photographs_of_more_than_the_sphere);
    tcase_add_loop_test(tests, a_sphere_that_fits_what_is_cut_out, 0, 3);
    tcase_add_test(tests, a_ball_of_what_photographs_cut_out);
    tcase_add_loop_test(tests, alpha_that_is_opaque_everywhere, 0, 2);
    tcase_add_test(tests, find_view);
    tcase_add_test(tests, unknown_fields_warn_once);
    tcase_add_loop_test(tests, bad_frame, 0, COUNT(bad_frames));
    tcase_add_test(tests, unusual_images_are_usable);
    tcase_add_test(tests, size_differs_from_the_json);
    tcase_add_test(tests, sizes_differ_among_images);
    tcase_add_loop_test(tests, bad_document, 0, COUNT(bad_documents));
    tcase_add_test(tests, no_usable_view);
    tcase_add_test(tests, no_dataset);
    tcase_add_test(tests, problems_are_bounded);
    tcase_add_test(tests, multiscale);
    tcase_add_test(tests, multiscale_default_weight);
    tcase_add_loop_test(tests, bad_multiscale_document, 0, COUNT(bad_multiscale));
    tcase_add_test(tests, multiscale_focal_conflict);
    tcase_add_test(tests, native);
    tcase_add_loop_test(tests, bad_native_document, 0, COUNT(bad_native));
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}

// transforms.json of instant-ngp and nerfstudio: whose intrinsics hold, what lenses mean, splits,
// missing photographs, paths of another machine; and intrinsics beyond NeRF-synthetic's there.
#include <math.h>

#include "tests/unit/common/dataset_fixture.h"

#define AT(file) "{\"file_path\":\"" file "\",\"transform_matrix\":" POSE "}"
#define WITH(file, more) "{\"file_path\":\"" file "\"," more ",\"transform_matrix\":" POSE "}"

static void put_document(const char *members, const char *frames) {
    char *text;
    ck_assert(asprintf(&text, "{%s,\"frames\":[%s]}", members, frames) > 0);
    put_text("transforms.json", text);
    free(text);
    put_image("images/a.png", 40, 30);
    put_image("images/b.png", 40, 30);
}

static void read_named(const char *format) {
    struct rn_read_options options = {.format = format};
    rn_dataset_destroy(&dataset);
    rn_problems_finish(&problems);
    enum rn_status status = rn_dataset_read_as(folder, &options, &problems, &dataset, &err);
    ck_assert_msg(status == RN_OK, "%s: %s", err.where, err.text);
}

static void assert_told(enum rn_severity severity, const char *where, const char *text) {
    for (size_t i = 0; i < problems.count; i++)
        if (problems.items[i].severity == severity && strstr(problems.items[i].where, where) &&
            strstr(problems.items[i].text, text))
            return;
    for (size_t i = 0; i < problems.count; i++)
        printf("%s: %s\n", problems.items[i].where, problems.items[i].text);
    ck_abort_msg("nothing says \"%s\" at \"%s\"", text, where);
}

#define LENS "\"fl_x\":50,\"fl_y\":60,\"cx\":19,\"cy\":16,\"w\":40.0,\"h\":30"

START_TEST(intrinsics_and_lens) {
    put_document(
        "// a comment\n\"aabb_scale\":4,/* \"k1\": 7, */\"k1\":0.1,\"k2\":-0.2,\"p1\":0.01,"
        "\"p2\":0.02,\"url\":\"a//b\"," LENS,
        AT("images/b.png") "," AT("./images/a.png"));
    read_ok(folder);
    ck_assert_str_eq(dataset->format->name, "instant-ngp");
    ck_assert_uint_eq(problems.errors, 0);
    assert_told(RN_SEVERITY_WARNING, "#/url", "not a field");
    ck_assert_str_eq(dataset->frames[0].name, "a"); // by name, not as listed
    const struct rn_camera *camera = &dataset->frames[0].camera;
    ck_assert_int_eq(camera->lens, RN_LENS_OPENCV);
    const double k[] = {0.1, -0.2, 0.01, 0.02, 0};
    for (int i = 0; i < 5; i++)
        ck_assert_double_eq(camera->lens_k[i], k[i]);
    ck_assert_double_eq(camera->fx, 50);
    ck_assert_double_eq(camera->fy, 60);
    ck_assert_double_eq(camera->cx, 19);
    ck_assert_double_eq(camera->cy, 16);
    ck_assert_double_eq(camera->world_from_camera[1][1], -1);
    ck_assert_double_eq(camera->world_from_camera[2][3], 4);
}
END_TEST

// The image's size may differ from the document's when its shape does not.
START_TEST(scaled_images) {
    put_document("\"fl_x\":100,\"cx\":30,\"cy\":32,\"w\":80,\"h\":60", AT("images/a"));
    read_ok(folder);
    ck_assert_str_eq(dataset->format->name, "nerfstudio");
    assert_told(RN_SEVERITY_INFO, "#/w", "80x60 pixels");
    ck_assert_double_eq(dataset->frames[0].camera.fx, 50);
    ck_assert_double_eq(dataset->frames[0].camera.fy, 50);
    ck_assert_double_eq(dataset->frames[0].camera.cx, 15);
    ck_assert_double_eq(dataset->frames[0].camera.cy, 16);
}
END_TEST

START_TEST(said_twice) {
    put_document("\"aabb_scale\":1,\"camera_angle_x\":0.9," LENS,
                 AT("images/a.png") "," WITH("images/b.png", "\"fl_x\":55"));
    read_ok(folder);
    assert_told(RN_SEVERITY_WARNING, "camera_angle_x", "41.4");
    assert_told(RN_SEVERITY_WARNING, "camera_angle_x", "50");
    assert_told(RN_SEVERITY_WARNING, "frames/1/fl_x", "is 55 here and 50");
    ck_assert_double_eq(dataset->frames[1].camera.fx, 55);
    read_named("nerfstudio");
    ck_assert_double_eq(dataset->frames[1].camera.fx, 50);
}
END_TEST

static const struct {
    const char *members;
    enum rn_lens lens;
    int at;
    double value;
} lenses[] = {
    {"\"camera_model\":\"OPENCV\"", RN_LENS_PINHOLE, 0, 0},
    {"\"camera_model\":\"OPENCV\",\"k3\":0.1", RN_LENS_POLYNOMIAL, 2, 0.1},
    {"\"camera_model\":\"OPENCV\",\"k1\":0,\"k4\":0.2", RN_LENS_POLYNOMIAL, 3, 0.2},
    {"\"camera_model\":\"FULL_OPENCV\",\"k4\":0.2", RN_LENS_OPENCV, 5, 0.2},
    {"\"camera_model\":\"OPENCV_FISHEYE\",\"k4\":0.2,\"p1\":0", RN_LENS_FISHEYE, 3, 0.2},
    {"\"is_fisheye\":true,\"k3\":0.2", RN_LENS_FISHEYE, 2, 0.2},
    {"\"distortion_params\":[0.1,0,0,0,0,0.3]", RN_LENS_OPENCV, 3, 0.3},
    {"\"camera_model\":\"EQUIRECTANGULAR\"", RN_LENS_EQUIRECTANGULAR, 0, 0},
};

START_TEST(lens_by_model) {
    char *members;
    ck_assert(asprintf(&members, "%s," LENS, lenses[_i].members) > 0);
    put_document(members, AT("images/a.png"));
    free(members);
    read_ok(folder);
    ck_assert_uint_eq(problems.errors + problems.warnings, 0);
    ck_assert_int_eq(dataset->frames[0].camera.lens, lenses[_i].lens);
    ck_assert_double_eq(dataset->frames[0].camera.lens_k[lenses[_i].at], lenses[_i].value);
}
END_TEST

static const struct {
    const char *members, *frame, *where, *text;
} refusals[] = {
    {"\"aabb_scale\":1,\"k3\":0.1", "\"x\":0", "transforms.json#", "k3 is 0.1"},
    {"\"camera_model\":\"FISHEYE624\"", "\"x\":0", "#/camera_model", "FISHEYE624"},
    {"\"camera_model\":\"OPENCV\",\"is_fisheye\":true", "\"x\":0", "#/camera_model", "only one"},
    {"\"camera_model\":\"OPENCV_FISHEYE\",\"p1\":0.1", "\"x\":0", "transforms.json#", "no p1"},
    {"\"k1\":\"a\"", "\"x\":0", "#/k1", "number"},
    {"\"k1\":NaN", "\"x\":0", "#/k1", "number"},
    {"\"rolling_shutter\":[0,0,1]", "\"x\":0", "#/rolling_shutter", "not followed"},
    {"\"x\":0", "\"transform_matrix_start\":[1]", "transform_matrix_start", "not followed"},
    {"\"y_fov\":200", "\"x\":0", "#/y_fov", "is 200"},
};

START_TEST(refused) {
    char *members, *frames;
    ck_assert(asprintf(&members, "%s," LENS, refusals[_i].members) > 0);
    ck_assert(asprintf(&frames, WITH("images/a.png", "%s"), refusals[_i].frame) > 0);
    put_document(members, frames);
    ck_assert_int_eq(rn_dataset_read(folder, &problems, &dataset, &err), RN_ERROR_INVALID);
    assert_told(RN_SEVERITY_ERROR, refusals[_i].where, refusals[_i].text);
    free(members);
    free(frames);
}
END_TEST

START_TEST(portrait_is_told) {
    put_document(LENS, AT("images/a.png") "," AT("images/c.png"));
    put_image("images/c.png", 30, 40);
    read_ok(folder);
    assert_told(RN_SEVERITY_ERROR, "#/w", "says 40x30 pixels");
    ck_assert_uint_eq(dataset->frame_count, 1);
}
END_TEST

START_TEST(missing_photographs) {
    put_document("\"aabb_scale\":4," LENS,
                 AT("images/0.png") "," AT("images/a.png") "," AT("images/b.png"));
    read_ok(folder);
    ck_assert_uint_eq(problems.errors, 0);
    assert_told(RN_SEVERITY_WARNING, "frames/0/file_path", "does not exist");
    ck_assert_int_eq(dataset->unusable[RN_SPLIT_TRAIN], 1);
    ck_assert_int_eq(dataset->frames[0].index, 0); // the missing one has no place in the order
    read_named("nerfstudio");
    ck_assert_uint_eq(problems.errors, 1);
    ck_assert_int_eq(dataset->frames[0].index, 1);
}
END_TEST

START_TEST(paths_of_another_machine) {
    put_document(LENS, AT("/home/someone/capture/images/a.png") "," AT("..\\\\images\\\\b.png"));
    read_ok(folder);
    ck_assert_uint_eq(problems.errors, 0);
    assert_told(RN_SEVERITY_INFO, "file_path", "found by its name");
    ck_assert_uint_eq(dataset->frame_count, 2);
    ck_assert_ptr_null(strstr(dataset->frames[0].path, "someone"));
    put_document(LENS, AT("images/a.png") "," AT("../../etc/passwd.png"));
    rn_dataset_destroy(&dataset);
    read_ok(folder);
    assert_told(RN_SEVERITY_ERROR, "frames/1/file_path", "leaves the dataset's folder");
}
END_TEST

// As where photographs were moved and their document was not; and no slash is doubled in what is
// told.
START_TEST(photographs_in_another_folder) {
    char slashed[256];
    snprintf(slashed, sizeof slashed, "%s/", folder);
    put_document(LENS, AT("capture/images/a.png") "," AT("./elsewhere/gone.png"));
    read_ok(slashed);
    ck_assert_uint_eq(dataset->frame_count, 1);
    ck_assert_str_eq(dataset->frames[0].path, in_folder("images/a.png"));
    assert_told(RN_SEVERITY_INFO, "file_path", "found by its name");
    assert_told(RN_SEVERITY_ERROR, "frames/1/file_path", in_folder("elsewhere/gone.png"));
}
END_TEST

START_TEST(splits_by_lists) {
    put_document(LENS
                 ",\"train_filenames\":[\"./images/b.png\"],\"test_filenames\":[\"images/a.png\"]",
                 AT("images/a.png") "," AT("images/b.png") "," AT("images/c.png"));
    read_ok(folder);
    ck_assert_uint_eq(problems.errors, 0);
    assert_told(RN_SEVERITY_INFO, "transforms.json", "1 frames are in none");
    const struct rn_frame *frame = rn_dataset_frame(dataset, RN_SPLIT_TEST, 0, 0);
    ck_assert_str_eq(frame->name, "a");
    ck_assert_int_eq(dataset->view_count[RN_SPLIT_TRAIN], 1);
}
END_TEST

// A photograph in several lists is a test photograph before all; what no frame has is told.
START_TEST(lists_that_disagree) {
    put_document(LENS
                 ",\"train_filenames\":[\"images/a.png\",\"images/b.png\"],\"val_filenames\":"
                 "[\"images/b.png\",\"images/gone.png\"],\"test_filenames\":[\"images/b.png\"]",
                 AT("images/a.png") "," AT("images/b.png"));
    read_ok(folder);
    assert_told(RN_SEVERITY_WARNING, "#/val_filenames/0", "is in train_filenames too");
    assert_told(RN_SEVERITY_WARNING, "transforms.json", "1 names in its lists of file names");
    assert_told(RN_SEVERITY_WARNING, "transforms.json", "images/gone.png");
    ck_assert_int_eq(dataset->view_count[RN_SPLIT_TRAIN], 1);
    ck_assert_int_eq(dataset->view_count[RN_SPLIT_VAL], 0);
    ck_assert_int_eq(dataset->view_count[RN_SPLIT_TEST], 1);
    put_document(LENS ",\"val_filenames\":\"images/a.png\"", AT("images/a.png"));
    rn_dataset_destroy(&dataset);
    ck_assert_int_eq(rn_dataset_read(folder, &problems, &dataset, &err), RN_ERROR_INVALID);
    ck_assert_ptr_nonnull(strstr(err.where, "#/val_filenames"));
}
END_TEST

// Each frame has a lens, a size and a focal length of its own.
START_TEST(intrinsics_by_frame) {
    put_document("\"camera_model\":\"OPENCV\"",
                 WITH("images/a.png",
                      "\"fl_x\":50,\"fl_y\":51,\"cx\":19,\"cy\":14,\"w\":40,\"h\":30,"
                      "\"k1\":0.1") "," WITH("images/b.png", "\"fl_x\":120,\"w\":80,\"h\":60"));
    read_ok(folder);
    ck_assert_uint_eq(problems.errors + problems.warnings, 0);
    const struct rn_camera *a = &dataset->frames[0].camera, *b = &dataset->frames[1].camera;
    ck_assert_double_eq(a->fy, 51);
    ck_assert_double_eq(a->cx, 19);
    ck_assert_int_eq(a->lens, RN_LENS_OPENCV);
    ck_assert_double_eq(a->lens_k[0], 0.1);
    ck_assert_double_eq(b->fx, 60); // its image has 40x30 pixels
    ck_assert_double_eq(b->fy, 60);
    ck_assert_double_eq(b->cx, 20);
    ck_assert_int_eq(b->lens, RN_LENS_PINHOLE);
}
END_TEST

#define PLY(kind, count, xyz)                                                                      \
    "ply\nformat " kind " 1.0\ncomment made up\nelement vertex " count "\nproperty " xyz           \
    " x\nproperty " xyz " y\nproperty " xyz " z\nproperty uchar red\nproperty short nx\n"          \
    "property uchar green\nproperty uchar blue\nelement face 0\nproperty list uchar int i\n"       \
    "end_header\n"

static void put_named_points(void) {
    put_document(LENS ",\"ply_file_path\":\"./points.ply\"", AT("images/a.png"));
}

static void assert_named_points(void) {
    const struct rn_points *points = &dataset->points;
    ck_assert_uint_eq(problems.errors + problems.warnings, 0);
    ck_assert_uint_eq(points->count, 2);
    ck_assert_uint_eq(points->sighting_count, 0);
    ck_assert_double_eq(points->items[1].position[0], -4.5);
    ck_assert_double_eq(points->items[1].position[2], 6);
    ck_assert_uint_eq(points->items[1].colour[0], 7);
    ck_assert_uint_eq(points->items[1].colour[2], 9);
    ck_assert_float_lt(points->items[0].error, 0);
    ck_assert_uint_eq(dataset->document_count, 2);
}

START_TEST(named_points) {
    char bytes[1024];
    size_t size;
    const double vertices[2][3] = {{1, 2, 3}, {-4.5, 5, 6}};
    const uint8_t rest[5] = {7, 0, 0, 8, 9};
    put_named_points();
    if (_i == 0)
        put_text("points.ply",
                 PLY("ascii", "4", "float") "1 2 3 7 0 8 9\n-4.5 5 6 7 0 8 9\n2e12 0 0 1 1 1 1\n"
                                            "nan 0 0 1 1 1 1\n");
    size = strlen(strcpy(bytes, PLY("binary_little_endian", "2", "double")));
    for (int i = 0; i < 2; i++, size += 29) {
        memcpy(bytes + size, vertices[i], 24);
        memcpy(bytes + size + 24, rest, 5);
    }
    if (_i) put_bytes("points.ply", bytes, size);
    read_ok(folder);
    assert_named_points();
}
END_TEST

static const struct {
    const char *text, *where, *say;
} bad_points[] = {
    {"", "points.ply:0", "does not end"},
    {"plane\n", "points.ply:1", "no PLY file"},
    {"ply\nformat ascii 1.0\nelement vertex 2\n", "points.ply:3", "does not end"},
    {"ply\nformat binary_big_endian 1.0\n", "points.ply:2", "save it as ascii"},
    {"ply\nformat ascii 1.0\nelement face 2\n", "points.ply:3", "before its vertices"},
    {"ply\nformat ascii 1.0\nelement vertex x\n", "points.ply:3", "how many"},
    {"ply\nelement vertex 1\nproperty list uchar int x\n", "points.ply:3", "not read"},
    {"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n", "points.ply:5",
     "x, y and z"},
    {PLY("ascii", "9223372036854775808", "float") "1 2 3 7 0 8 9\n", "points.ply",
     "9223372036854775808 vertices, but has room for 1"},
    {PLY("ascii", "2", "float") "10 2 3 7 0 8 9\n1 2 3 7 0 8 9", "vertex 2 of 2", "not whole"},
    {PLY("ascii", "2", "float") "1 2 3 7 0 8 9\n1 2 3 7 0 8      \n", "vertex 2 of 2", "not whole"},
};

START_TEST(bad_named_points) {
    put_named_points();
    put_text("points.ply", bad_points[_i].text);
    enum rn_status status = rn_dataset_read(folder, &problems, &dataset, &err);
    ck_assert(status == RN_ERROR_INVALID || status == RN_ERROR_UNSUPPORTED);
    ck_assert_msg(strstr(err.where, bad_points[_i].where) != NULL, "%s", err.where);
    ck_assert_msg(strstr(err.text, bad_points[_i].say) != NULL, "%s", err.text);
}
END_TEST

START_TEST(points_that_are_not_there) {
    put_named_points();
    read_ok(folder);
    assert_told(RN_SEVERITY_WARNING, "#/ply_file_path", "there are no sparse points");
    put_document(LENS ",\"ply_file_path\":\"../../x/points.ply\",\"fisheye_crop_radius\":9",
                 AT("images/a.png"));
    rn_dataset_destroy(&dataset);
    ck_assert_int_eq(rn_dataset_read(folder, &problems, &dataset, &err), RN_ERROR_INVALID);
    ck_assert_ptr_nonnull(strstr(err.text, "leaves the dataset's folder"));
    assert_told(RN_SEVERITY_WARNING, "#/fisheye_crop_radius", "is not followed");
}
END_TEST

START_TEST(no_focal_length) {
    put_document("\"k1\":0.1", AT("images/a.png"));
    ck_assert_int_eq(rn_dataset_read(folder, &problems, &dataset, &err), RN_ERROR_INVALID);
    assert_told(RN_SEVERITY_ERROR, "#/fl_x", "is missing");
}
END_TEST

// In NeRF-synthetic's files, such members are used as well, or refused.
START_TEST(synthetic_with_intrinsics) {
    put_image("a.png", 40, 30);
    put_text("transforms_train.json",
             "{\"camera_angle_x\":0.9,\"fl_x\":50,\"cx\":19,\"k1\":0.1,\"frames\":[" AT("a") "]}");
    read_ok(folder);
    const struct rn_camera *camera = &dataset->frames[0].camera;
    ck_assert_double_eq(camera->fx, 50);
    ck_assert_double_eq(camera->cx, 19);
    ck_assert_int_eq(camera->lens, RN_LENS_OPENCV);
    assert_told(RN_SEVERITY_WARNING, "camera_angle_x", "the latter is used");
    put_text("transforms_train.json",
             "{\"camera_angle_x\":0.9,\"frames\":[" WITH("a", "\"rolling_shutter\":[1,0,0]") "]}");
    rn_dataset_destroy(&dataset);
    ck_assert_int_eq(rn_dataset_read(folder, &problems, &dataset, &err), RN_ERROR_INVALID);
    assert_told(RN_SEVERITY_ERROR, "rolling_shutter", "not followed");
}
END_TEST

int main(void) {
    Suite *suite = suite_create("transforms");
    TCase *tests = tcase_create("transforms");
    tcase_add_checked_fixture(tests, setup, teardown);
    tcase_add_test(tests, intrinsics_and_lens);
    tcase_add_test(tests, scaled_images);
    tcase_add_test(tests, said_twice);
    tcase_add_loop_test(tests, lens_by_model, 0, sizeof lenses / sizeof *lenses);
    tcase_add_loop_test(tests, refused, 0, sizeof refusals / sizeof *refusals);
    tcase_add_test(tests, portrait_is_told);
    tcase_add_test(tests, missing_photographs);
    tcase_add_test(tests, paths_of_another_machine);
    tcase_add_test(tests, photographs_in_another_folder);
    tcase_add_test(tests, splits_by_lists);
    tcase_add_test(tests, lists_that_disagree);
    tcase_add_test(tests, intrinsics_by_frame);
    tcase_add_loop_test(tests, named_points, 0, 2);
    tcase_add_loop_test(tests, bad_named_points, 0, sizeof bad_points / sizeof *bad_points);
    tcase_add_test(tests, points_that_are_not_there);
    tcase_add_test(tests, no_focal_length);
    tcase_add_test(tests, synthetic_with_intrinsics);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}

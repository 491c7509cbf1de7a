// poses_bounds.npy: its order, axes, sizes and depths, and files that are cut or not what they say.
#include "tests/unit/common/dataset_fixture.h"

#define DOCUMENT "poses_bounds.npy"
#define COLUMNS 17

static double rows[3][COLUMNS];

// Looks along +z from (i, 2, 3): down is +y, right +x, backwards -z; 80x60 pixels, focal 100.
static void fill_rows(void) {
    for (int i = 0; i < 3; i++) {
        const double row[COLUMNS] = {0, 1, 0, i, 60, 1, 0, 0, 2, 80, 0, 0, -1, 3, 100, 1.5, 9 + i};
        memcpy(rows[i], row, sizeof row);
    }
}

static size_t npy(char *bytes, int version, const char *description) {
    size_t prefix = version == 1 ? 10 : 12, size = strlen(description);
    memcpy(bytes, "\x93NUMPY", 6);
    bytes[6] = (char)version;
    bytes[7] = 0;
    for (size_t i = 8; i < prefix; i++)
        bytes[i] = (char)(i == 8 ? size & 255 : i == 9 ? size >> 8 : 0);
    memcpy(bytes + prefix, description, size);
    memcpy(bytes + prefix + size, rows, sizeof rows);
    return prefix + size + sizeof rows;
}

#define DESCRIPTION(type, order, shape)                                                            \
    "{'descr': '" type "', 'fortran_order': " order ", 'shape': " shape ", }          \n"
#define GOOD DESCRIPTION("<f8", "False", "(3, 17)")

static void put_rows(int version, const char *description) {
    char bytes[1024];
    size_t size = npy(bytes, version, description);
    put_bytes(DOCUMENT, bytes, size);
}

static void put_photos(const char *images, int width, int height) {
    static const char *const names[] = {"b.png", "a.PNG", "10.png"};
    char name[64];
    for (int i = 0; i < 3; i++) {
        snprintf(name, sizeof name, "%s/%s", images, names[i]);
        put_image(name, width, height);
    }
    snprintf(name, sizeof name, "%s/notes.txt", images);
    put_text(name, "no photograph");
}

static void put_capture(void) {
    fill_rows();
    put_rows(1, GOOD);
    put_photos("images_2", 40, 30);
}

START_TEST(rows_go_with_sorted_names) {
    put_capture();
    put_rows(_i, GOOD);
    read_ok(folder);
    ck_assert_str_eq(dataset->format->name, "llff");
    ck_assert_uint_eq(problems.errors + problems.warnings, 0);
    ck_assert_uint_eq(problems.count, 2); // that photographs are half the size, how they were taken
    ck_assert_uint_eq(dataset->frame_count, 3);
    ck_assert_uint_eq(dataset->document_count, 1);
    ck_assert_str_eq(dataset->documents[0], DOCUMENT);
    static const char *const order[] = {"10", "a", "b"};
    for (int i = 0; i < 3; i++) {
        const struct rn_frame *frame = &dataset->frames[i];
        const double pose[3][4] = {{1, 0, 0, i}, {0, 1, 0, 2}, {0, 0, 1, 3}};
        ck_assert_str_eq(frame->name, order[i]);
        ck_assert_int_eq(frame->index, i);
        for (int j = 0; j < 12; j++)
            ck_assert_double_eq((&frame->camera.world_from_camera[0][0])[j], (&pose[0][0])[j]);
        ck_assert_double_eq(frame->camera.fx, 50);
        ck_assert_double_eq(frame->camera.cx, 20);
        ck_assert_double_eq(frame->camera.cy, 15);
        ck_assert_double_eq(frame->near, 1.5);
        ck_assert_double_eq(frame->far, 9 + i);
    }
}
END_TEST

START_TEST(depths_are_kept) {
    put_capture();
    read_ok(folder);
    struct rn_import_options options = {.scales = 1, .threads = 1};
    ck_assert_int_eq(
        rn_dataset_import(dataset, "x", &options, in_folder("out"), NULL, NULL, NULL, &err), RN_OK);
    rn_dataset_destroy(&dataset);
    read_ok(in_folder("out"));
    ck_assert_double_eq(dataset->frames[1].near, 1.5);
    ck_assert_double_eq(dataset->frames[1].far, 10);
    ck_assert(dataset->premultiplied_scales);
}
END_TEST

static const struct {
    const char *description, *text;
} bad_headers[] = {
    {DESCRIPTION("<f4", "False", "(3, 17)"), "float64"},
    {DESCRIPTION(">f8", "False", "(3, 17)"), "float64"},
    {DESCRIPTION("<f8", "True", "(3, 17)"), "C order"},
    {DESCRIPTION("<f8", "False", "(3, 15)"), "N x 17"},
    {DESCRIPTION("<f8", "False", "(51,)"), "N x 17"},
    {DESCRIPTION("<f8", "False", "(4, 17)"), "after 3 of its 4 rows"},
    {DESCRIPTION("<f8", "False", "(9223372036854775808, 17)"), "after 3 of its 92233720"},
    {DESCRIPTION("<f8", "False", "(2, 17)"), "has 2 poses"},
    {DESCRIPTION("<f8", "False", "(0, 17)"), "has no rows"},
    {"{}", "describes no array"},
};

static void assert_fails(const char *text) {
    ck_assert_int_eq(rn_dataset_read(folder, &problems, &dataset, &err), RN_ERROR_INVALID);
    ck_assert_msg(strstr(err.where, DOCUMENT) != NULL, "%s", err.where);
    ck_assert_msg(strstr(err.text, text) != NULL, "%s", err.text);
}

START_TEST(bad_header) {
    put_capture();
    put_rows(1, bad_headers[_i].description);
    assert_fails(bad_headers[_i].text);
}
END_TEST

START_TEST(cut_anywhere) {
    char bytes[1024];
    put_capture();
    size_t size = npy(bytes, 1, GOOD);
    for (size_t cut = 0; cut < size; cut += cut < 90 ? 1 : 37) {
        put_bytes(DOCUMENT, bytes, cut);
        ck_assert_int_eq(rn_dataset_read(folder, &problems, &dataset, &err), RN_ERROR_INVALID);
        ck_assert_msg(strstr(err.where, DOCUMENT) != NULL, "%s", err.where);
    }
}
END_TEST

static const struct {
    int column;
    double value;
    const char *text;
} bad_values[] = {{3, NAN, "non-finite"},  {0, 0.5, "not a rotation"}, {12, 1, "mirrored"},
                  {14, 0, "focal"},        {14, NAN, "focal"},         {4, 0, "80 x 0 pixels"},
                  {4, 80, "80x80 pixels"}, {9, INFINITY, "inf x 60"},  {15, 0, "the depths 0"},
                  {16, 1, "to 1"},         {16, INFINITY, "to inf"}};

static const struct rn_problem *first_error(void) {
    size_t i = 0;
    while (i < problems.count && problems.items[i].severity != RN_SEVERITY_ERROR)
        i++;
    ck_assert_uint_lt(i, problems.count);
    return &problems.items[i];
}

START_TEST(bad_row) {
    put_capture();
    rows[1][bad_values[_i].column] = bad_values[_i].value;
    put_rows(1, GOOD);
    read_ok(folder);
    ck_assert_uint_eq(problems.errors, 1);
    ck_assert_msg(strstr(first_error()->where, "row 1") != NULL, "%s", first_error()->where);
    ck_assert_msg(strstr(first_error()->text, bad_values[_i].text) != NULL, "%s",
                  first_error()->text);
    ck_assert_uint_eq(dataset->frame_count, 2);
    ck_assert_int_eq(dataset->frames[1].index, 2);
}
END_TEST

START_TEST(portrait_among_landscapes) {
    put_capture();
    put_image("images_2/a.PNG", 30, 40);
    read_ok(folder);
    ck_assert_uint_eq(problems.errors, 1);
    ck_assert_ptr_nonnull(strstr(first_error()->text, "says 80x60 pixels"));
}
END_TEST

// The folder whose count is right is taken; without one, all counts are told.
START_TEST(photo_folders) {
    put_capture();
    put_image("images/one.png", 80, 60);
    read_ok(folder);
    ck_assert_ptr_nonnull(strstr(dataset->frames[0].path, "images_2/"));
    rn_dataset_destroy(&dataset);
    put_image("images_2/z.png", 40, 30);
    assert_fails("1 in images, 4 in images_2");
}
END_TEST

// The camera of the model beside the poses: of the same size and focal length it is theirs.
static const struct {
    const char *cameras;
    double lens;
} lenses[] = {
    {"1 SIMPLE_RADIAL 80 60 100 42 28 -0.5\n", -0.5},
    {"1 SIMPLE_PINHOLE 80 60 100 42 28\n", 0},
    {"1 SIMPLE_RADIAL 80 60 101 42 28 -0.5\n", 0},
    {"1 SIMPLE_RADIAL 60 80 100 42 28 -0.5\n", 0},
    {"1 SIMPLE_RADIAL 80 60 100 42 28 -0.5\n2 SIMPLE_RADIAL 80 60 100 42 28 -0.5\n", 0},
    {"1 SIMPLE_RADIAL 80 60 100 42\n", 0},
};

START_TEST(lens_of_the_model_beside) {
    put_capture();
    put_text("sparse/0/cameras.txt", lenses[_i].cameras);
    struct rn_read_options options = {.format = "llff"};
    ck_assert_int_eq(rn_dataset_read_as(folder, &options, &problems, &dataset, &err), RN_OK);
    const struct rn_camera *camera = &dataset->frames[1].camera;
    ck_assert_int_eq(camera->lens, lenses[_i].lens != 0 ? RN_LENS_OPENCV : RN_LENS_PINHOLE);
    ck_assert_double_eq(camera->lens_k[0], lenses[_i].lens);
    ck_assert_double_eq(camera->fx, 50);
    ck_assert_double_eq(camera->cx, lenses[_i].lens != 0 ? 21 : 20);
    ck_assert_uint_eq(problems.count, lenses[_i].lens != 0 ? 3 : 2);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("llff");
    TCase *tests = tcase_create("llff");
    tcase_add_checked_fixture(tests, setup, teardown);
    tcase_add_loop_test(tests, rows_go_with_sorted_names, 1, 4);
    tcase_add_test(tests, depths_are_kept);
    tcase_add_loop_test(tests, bad_header, 0, sizeof bad_headers / sizeof *bad_headers);
    tcase_add_test(tests, cut_anywhere);
    tcase_add_loop_test(tests, bad_row, 0, sizeof bad_values / sizeof *bad_values);
    tcase_add_test(tests, portrait_among_landscapes);
    tcase_add_test(tests, photo_folders);
    tcase_add_loop_test(tests, lens_of_the_model_beside, 0, sizeof lenses / sizeof *lenses);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}

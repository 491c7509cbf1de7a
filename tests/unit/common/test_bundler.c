// Bundler's bundle.out and list.txt: poses, lens, who sees what, and what is not sound.
#include "tests/unit/common/dataset_fixture.h"

enum { WIDTH = 40, HEIGHT = 30 };

#define HEAD "# Bundle file v0.3\n"
#define AHEAD "1 0 0\n0 1 0\n0 0 1\n"   // looks along -z
#define TURNED "0 0 1\n0 1 0\n-1 0 0\n" // looks along x
#define FIRST "50 0.1 -0.03\n" AHEAD "0 0 -4\n"
#define SECOND "60 0 0\n" TURNED "1 2 -5\n"
#define NOT_PLACED "0 0 0\n0 0 0\n0 0 0\n0 0 0\n0 0 0\n"
// The first sees it at x/z = 0.125, y/z = 0.0625 of its axes.
#define POINT "0.5 0.25 0\n10 20 300\n2 0 7 6.2621355056762695 3.1310677528381348 1 8 -1.5 2.5\n"
#define LIST "images/b.png 0 50\nimages/a.png\n"
#define GOOD HEAD "2 1\n" FIRST SECOND POINT

static void put_capture(const char *document, const char *list) {
    put_text("bundle.out", document);
    put_text("list.txt", list);
    put_image("images/a.png", WIDTH, HEIGHT);
    put_image("images/b.png", WIDTH, HEIGHT);
}

START_TEST(cameras_and_poses) {
    put_capture(HEAD "2 0\n" FIRST SECOND, LIST);
    read_ok(folder);
    ck_assert_str_eq(dataset->format->name, "bundler");
    ck_assert_uint_eq(problems.errors + problems.warnings, 0);
    ck_assert_uint_eq(dataset->document_count, 2);
    ck_assert_uint_eq(dataset->frame_count, 2);
    ck_assert_str_eq(dataset->frames[0].name, "a"); // by name, not as they stand
    // Columns right, down, forwards and the centre -R^T t.
    const double turned[3][4] = {{0, 0, 1, -5}, {0, -1, 0, -2}, {1, 0, 0, -1}};
    const double ahead[3][4] = {{1, 0, 0, 0}, {0, -1, 0, 0}, {0, 0, -1, 4}};
    assert_pose(&dataset->frames[0], turned);
    assert_pose(&dataset->frames[1], ahead);
    const struct rn_camera *camera = &dataset->frames[1].camera;
    ck_assert_double_eq(camera->fx, 50);
    ck_assert_double_eq(camera->fy, 50);
    ck_assert_double_eq(camera->cx, 20);
    ck_assert_double_eq(camera->cy, 15);
    ck_assert_int_eq(camera->lens, RN_LENS_OPENCV);
    ck_assert_double_eq(camera->lens_k[0], 0.1);
    ck_assert_double_eq(camera->lens_k[1], -0.03);
    ck_assert_int_eq(dataset->frames[0].camera.lens, RN_LENS_PINHOLE);
}
END_TEST

START_TEST(points_are_where_they_were_seen) {
    put_capture(GOOD, LIST);
    read_ok(folder);
    const struct rn_points *points = &dataset->points;
    ck_assert_uint_eq(points->count, 1);
    ck_assert_uint_eq(points->sighting_count, 2);
    ck_assert_uint_eq(points->items[0].colour[2], 255);
    ck_assert_uint_eq(points->sightings[1].photo, 1);
    ck_assert_float_eq_tol(points->sightings[1].x, 0.5F - 1.5F / WIDTH, 1e-6F);
    ck_assert_float_eq_tol(points->sightings[1].y, 0.5F - 2.5F / HEIGHT, 1e-6F);
    // By the lens: f (1 + k1 r^2 + k2 r^4) x, upwards; only the first photograph sees it there.
    points->sightings[1] = points->sightings[0];
    struct rn_reprojection found;
    ck_assert_int_eq(rn_dataset_reproject(dataset, &found, &err), RN_OK);
    ck_assert_uint_eq(found.sightings, 2);
    ck_assert_double_lt(found.mean_px, 1e-5);
}
END_TEST

// Bundler's own folders; photographs by their names alone; one that was not placed.
START_TEST(within_a_project) {
    put_text("bundle/bundle.out",
             HEAD "3 1\n" FIRST NOT_PLACED SECOND "0 0 0\n1 2 3\n2 1 0 0 0 2 0 1 1\n");
    put_text("list.txt", "./b.png 0 50\r\ngone.png\na 7.png 0 60\n");
    put_image("b.png", WIDTH, HEIGHT);
    put_image("images/a 7.png", WIDTH, HEIGHT);
    read_ok(folder);
    ck_assert_uint_eq(problems.errors, 0);
    ck_assert(problems_tell(RN_SEVERITY_WARNING, "1 of its 3 photographs"));
    ck_assert_uint_eq(dataset->frame_count, 2);
    ck_assert_str_eq(dataset->frames[0].name, "b"); // "./b.png" comes before "a 7.png"
    ck_assert_str_eq(dataset->frames[1].name, "a 7");
    ck_assert_uint_eq(dataset->points.sighting_count, 1);
    ck_assert_uint_eq(dataset->points.sightings[0].photo, 2);
}
END_TEST

// One photograph is left out, the other read.
static const struct {
    const char *camera, *where, *text;
} bad_cameras[] = {
    {"50 nan 0\n" AHEAD "0 0 0\n", "bundle.out:3", "k1 and k2"},
    {"50 0 1e9\n" AHEAD "0 0 0\n", "bundle.out:3", "k1 and k2"},
    {"-50 0 0\n" AHEAD "0 0 0\n", "bundle.out:3", "focal"},
    {"nan 0 0\n" AHEAD "0 0 0\n", "bundle.out:3", "focal"},
    {"50 0 0\n" AHEAD "0 nan 0\n", "bundle.out:3", "finite"},
    {"50 0 0\n" AHEAD "0 inf 0\n", "bundle.out:3", "finite"},
    {"50 0 0\n0 0 0\n0 0 0\n0 0 0\n0 0 0\n", "bundle.out:3", "rotation"},
    {"50 0 0\n1 0 0\n0 1 0\n0 0 -1\n0 0 0\n", "bundle.out:3", "mirrored"},
};

START_TEST(bad_camera) {
    char *text;
    ck_assert(asprintf(&text, HEAD "2 0\n%s" SECOND, bad_cameras[_i].camera) > 0);
    put_capture(text, LIST);
    free(text);
    read_ok(folder);
    ck_assert_uint_eq(dataset->frame_count, 1);
    ck_assert_uint_eq(problems.errors, 1);
    for (size_t i = 0; i < problems.count; i++)
        if (problems.items[i].severity == RN_SEVERITY_ERROR) {
            ck_assert_msg(strstr(problems.items[i].where, bad_cameras[_i].where) != NULL, "%s: %s",
                          problems.items[i].where, problems.items[i].text);
            ck_assert_msg(strstr(problems.items[i].text, bad_cameras[_i].text) != NULL, "%s",
                          problems.items[i].text);
        }
}
END_TEST

#define RUBBISH "6 0 0\n1 0 0\n0 x 0\n0 0 1\n0 0 0\n"
static const struct {
    const char *document, *list, *where, *text;
} bad_documents[] = {
    {"", LIST, "bundle.out", "v0.3"},
    {"# Bundle file v0.1\n2 0\n", LIST, "bundle.out:1", "v0.3"},
    {HEAD "0 0\n", "", "bundle.out:2", "no cameras"},
    {HEAD "-1 0\n", LIST, "bundle.out:2", "-1 cameras"},
    {HEAD "2.5 0\n", LIST, "bundle.out:2", "2.5 cameras"},
    {HEAD "nan 0\n", LIST, "bundle.out:2", "nan cameras"},
    {HEAD "9223372036854775808 0\n", LIST, "bundle.out:2", "9223372036854775808 cameras"},
    {HEAD "2 9223372036854775808\n" FIRST SECOND, LIST, "bundle.out:2",
     "9223372036854775808 points"},
    {HEAD "2 1\n" FIRST SECOND "0 0 0\n1 2 3\n9223372036854775808 0 1 2 3\n", LIST, "bundle.out:15",
     "9223372036854775808 sightings"},
    {HEAD "2 1\n" FIRST SECOND, LIST, "bundle.out:12", "ends behind"},
    {HEAD "2 0\n" FIRST RUBBISH, LIST, "bundle.out:10", "than a number"},
    {GOOD, "images/b.png\n", "list.txt", "names 1 photographs"},
    {GOOD, LIST "images/c.png\n", "list.txt", "names 3 photographs"},
    {GOOD, "images/b.png\nimages/a.pn", "list.txt:2", "ends within"},
};

START_TEST(bad_document) {
    put_capture(bad_documents[_i].document, bad_documents[_i].list);
    ck_assert_int_eq(rn_dataset_read(folder, &problems, &dataset, &err), RN_ERROR_INVALID);
    ck_assert_msg(strstr(err.where, bad_documents[_i].where) != NULL, "%s", err.where);
    ck_assert_msg(strstr(err.text, bad_documents[_i].text) != NULL, "%s", err.text);
}
END_TEST

START_TEST(without_a_list) {
    put_text("bundle.out", GOOD);
    ck_assert_int_eq(rn_dataset_read(folder, &problems, &dataset, &err), RN_ERROR_NOT_FOUND);
    ck_assert_ptr_nonnull(strstr(err.text, "list.txt"));
}
END_TEST

START_TEST(what_is_left_out_is_told) {
    put_capture(HEAD "2 3\n" FIRST SECOND "nan 0 0\n1 2 3\n1 0 0 1 1\n0 0 2e12\n1 2 3\n1 0 0 1 1\n"
                     "1 0 0\n1 2 3\n4 0 0 1 1 2 0 1 1 -1 0 1 1 1 0 nan 1\n",
                LIST);
    read_ok(folder);
    ck_assert(problems_tell(RN_SEVERITY_WARNING,
                            "3 of its sightings are by photographs that it does not"));
    ck_assert(problems_tell(RN_SEVERITY_WARNING, "2 of its 3 points"));
    ck_assert_uint_eq(dataset->points.count, 1);
    ck_assert_uint_eq(dataset->points.sighting_count, 1);
    ck_assert_uint_eq(dataset->points.sightings[0].point, 0);
}
END_TEST

START_TEST(cut_anywhere) {
    const char *whole = GOOD;
    put_capture(whole, LIST);
    for (size_t size = 0; size < strlen(whole); size++) {
        put_bytes("bundle.out", whole, size);
        ck_assert_int_eq(rn_dataset_read(folder, &problems, &dataset, &err), RN_ERROR_INVALID);
    }
}
END_TEST

#define COUNT(table) ((int)(sizeof table / sizeof *table))

int main(void) {
    Suite *suite = suite_create("bundler");
    TCase *tests = tcase_create("bundler");
    tcase_add_checked_fixture(tests, setup, teardown);
    tcase_add_test(tests, cameras_and_poses);
    tcase_add_test(tests, points_are_where_they_were_seen);
    tcase_add_test(tests, within_a_project);
    tcase_add_loop_test(tests, bad_camera, 0, COUNT(bad_cameras));
    tcase_add_loop_test(tests, bad_document, 0, COUNT(bad_documents));
    tcase_add_test(tests, without_a_list);
    tcase_add_test(tests, what_is_left_out_is_told);
    tcase_add_test(tests, cut_anywhere);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}

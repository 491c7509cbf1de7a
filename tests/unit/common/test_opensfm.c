// OpenSfM's reconstruction.json and tracks.csv: poses, lenses, who sees what, and what is not
// sound.
#include <math.h>

#include "tests/unit/common/dataset_fixture.h"

enum { WIDTH = 40, HEIGHT = 30 };

#define CAMERA(members) "{\"width\":400,\"height\":300," members "}"
#define BROWN                                                                                      \
    CAMERA("\"projection_type\":\"brown\",\"focal_x\":0.8,\"focal_y\":0.9,\"c_x\":0.01,\"c_y\":"   \
           "-0.02,\"k1\":0.1,\"k2\":-0.03,\"p1\":0.002,\"p2\":0.001,\"k3\":0.01")
#define SHOT(camera, rotation, translation)                                                        \
    "{\"camera\":\"" camera "\",\"rotation\":[" rotation "],\"translation\":[" translation         \
    "],\"orientation\":1,\"capture_time\":0}"
#define MODEL(cameras, shots, points)                                                              \
    "{\"cameras\":{" cameras "},\"shots\":{" shots "},\"points\":{" points "},"                    \
    "\"reference_lla\":{\"latitude\":1,\"longitude\":2,\"altitude\":3}}"
#define SHOTS                                                                                      \
    "\"b.png\":" SHOT("c", "0,1.5707963267948966,0", "1,2,5") ",\"a.png\":" SHOT("c", "0,0,0",     \
                                                                                 "0,0,4")
#define POINTS                                                                                     \
    "\"7\":{\"coordinates\":[0.5,0.25,0],\"color\":[10,20,300]},"                                  \
    "\"11\":{\"coordinates\":[-0.5,0.5,0.25]}"
#define GOOD MODEL("\"c\":" BROWN, SHOTS, POINTS)

static void put_capture(const char *document) {
    put_text("reconstruction.json", document);
    put_image("images/a.png", WIDTH, HEIGHT);
    put_image("images/b.png", WIDTH, HEIGHT);
}

START_TEST(cameras_and_poses) {
    put_capture("[" MODEL("", "", "") "," GOOD "]");
    read_ok(folder);
    ck_assert_str_eq(dataset->format->name, "opensfm");
    ck_assert_uint_eq(problems.errors, 0);
    ck_assert(problems_tell(RN_SEVERITY_WARNING, "has 2 models"));
    ck_assert_uint_eq(problems.warnings, 1);
    ck_assert_uint_eq(dataset->frame_count, 2);
    ck_assert_str_eq(dataset->frames[0].name, "a"); // by name, not as they stand
    const double ahead[3][4] = {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, -4}};
    // x = R X + t with R = [[0,0,1],[0,1,0],[-1,0,0]].
    const double turned[3][4] = {{0, 0, -1, 5}, {0, 1, 0, -2}, {1, 0, 0, -1}};
    assert_pose(&dataset->frames[0], ahead);
    assert_pose(&dataset->frames[1], turned);
    const struct rn_camera *camera = &dataset->frames[0].camera; // a tenth of the model's pixels
    ck_assert_double_eq_tol(camera->fx, 32, 1e-12);
    ck_assert_double_eq_tol(camera->fy, 36, 1e-12);
    ck_assert_double_eq_tol(camera->cx, 20.4, 1e-12);
    ck_assert_double_eq_tol(camera->cy, 14.2, 1e-12);
    ck_assert_int_eq(camera->lens, RN_LENS_OPENCV);
    const double k[] = {0.1, -0.03, 0.002, 0.001, 0.01, 0, 0, 0};
    for (int i = 0; i < 8; i++)
        ck_assert_double_eq(camera->lens_k[i], k[i]);
}
END_TEST

// Where OpenSfM's brown camera `a` sees a point: a share of the longer side, from the middle.
static void brown(const double at[3], double seen[2]) {
    double x = at[0] / (at[2] + 4), y = at[1] / (at[2] + 4), s = x * x + y * y;
    double radial = 1 + s * (0.1 + s * (-0.03 + s * 0.01));
    seen[0] = 0.8 * (x * radial + 2 * 0.002 * x * y + 0.001 * (s + 2 * x * x)) + 0.01;
    seen[1] = 0.9 * (y * radial + 0.002 * (s + 2 * y * y) + 2 * 0.001 * x * y) - 0.02;
}

START_TEST(points_are_where_they_were_seen) {
    static const double points[2][3] = {{0.5, 0.25, 0}, {-0.5, 0.5, 0.25}};
    double seen[2][2];
    char text[512];
    for (int i = 0; i < 2; i++)
        brown(points[i], seen[i]);
    snprintf(text, sizeof text,
             "OPENSFM_TRACKS_VERSION_v2\n"
             "a.png\t7\t0\t%.17g\t%.17g\t0.001\t1\t2\t3\t-1\t-1\n"
             "a.png\t8\t1\t0\t0\t0.001\t1\t2\t3\t-1\t-1\n"
             "gone.png\t7\t1\t0\t0\t0.001\t1\t2\t3\t-1\t-1\n"
             "a.png\t11\t2\t%.17g\t%.17g\t0.001\t1\t2\t3\t-1\t-1\n",
             seen[0][0], seen[0][1], seen[1][0], seen[1][1]);
    put_capture("[" GOOD "]");
    put_text("tracks.csv", text);
    read_ok(folder);
    ck_assert_uint_eq(problems.errors + problems.warnings, 0);
    ck_assert_uint_eq(dataset->document_count, 2);
    ck_assert_uint_eq(dataset->points.count, 2);
    ck_assert_uint_eq(dataset->points.sighting_count, 2);
    ck_assert_uint_eq(dataset->points.items[0].colour[2], 255);
    struct rn_reprojection found;
    ck_assert_int_eq(rn_dataset_reproject(dataset, &found, &err), RN_OK);
    ck_assert_uint_eq(found.sightings, 2);
    ck_assert_double_lt(found.mean_px, 1e-5); // sightings are kept in single precision
    ck_assert(problems_tell(RN_SEVERITY_INFO, "mean reprojection error 0.0000 px"));
    ck_assert(!problems_tell(RN_SEVERITY_INFO, "as the model says"));
}
END_TEST

// OpenDroneMap's folder: OpenSfM's one, within, beside the photographs.
START_TEST(within_a_project) {
    put_text("opensfm/reconstruction.json", "[" GOOD "]");
    put_text("opensfm/tracks.csv", "a.png\t7\t0\t0.1\t0.2\t1\t2\t3\n"); // of an old version
    put_image("images/a.png", WIDTH, HEIGHT);
    put_image("images/b.png", WIDTH, HEIGHT);
    read_ok(folder);
    ck_assert_uint_eq(dataset->frame_count, 2);
    ck_assert_uint_eq(dataset->points.sighting_count, 1);
    ck_assert_float_eq(dataset->points.sightings[0].x, 0.6F);
    ck_assert_float_eq_tol(dataset->points.sightings[0].y, 0.5F + 0.2F * 4 / 3, 1e-6F);
}
END_TEST

static const struct {
    const char *camera;
    enum rn_lens lens;
    double fx, fy;
} lenses[] = {
    {CAMERA("\"focal\":0.8"), RN_LENS_PINHOLE, 32, 32},
    {CAMERA("\"projection_type\":\"perspective\",\"focal\":0.8,\"k1\":0.1,\"k2\":0"),
     RN_LENS_OPENCV, 32, 32},
    {CAMERA("\"projection_type\":\"simple_radial\",\"focal_x\":0.8,\"focal_y\":0.9,\"k1\":0.1"),
     RN_LENS_OPENCV, 32, 36},
    {CAMERA("\"projection_type\":\"fisheye\",\"focal\":0.8,\"k1\":0,\"k2\":0"), RN_LENS_FISHEYE, 32,
     32},
    {CAMERA("\"projection_type\":\"fisheye_opencv\",\"focal_x\":0.8,\"focal_y\":0.8,\"k4\":0.1"),
     RN_LENS_FISHEYE, 32, 32},
    {CAMERA("\"projection_type\":\"spherical\""), RN_LENS_EQUIRECTANGULAR, WIDTH / (2 * M_PI),
     HEIGHT / M_PI},
};

START_TEST(lens) {
    char *text;
    ck_assert(
        asprintf(&text, "[{\"cameras\":{\"c\":%s},\"shots\":{" SHOTS "}}]", lenses[_i].camera) > 0);
    put_capture(text);
    free(text);
    read_ok(folder);
    ck_assert_uint_eq(problems.errors + problems.warnings, 0);
    ck_assert_int_eq(dataset->frames[0].camera.lens, lenses[_i].lens);
    ck_assert_double_eq_tol(dataset->frames[0].camera.fx, lenses[_i].fx, 1e-12);
    ck_assert_double_eq_tol(dataset->frames[0].camera.fy, lenses[_i].fy, 1e-12);
    ck_assert_uint_eq(dataset->points.count, 0);
}
END_TEST

// One photograph is left out, the other read.
static const struct {
    const char *camera, *shot, *where, *text;
} bad_shots[] = {
    {BROWN, SHOT("d", "0,0,0", "0,0,4"), "#/0/shots/b.png/camera", "not among"},
    {BROWN, SHOT("c", "0,NaN,0", "0,0,4"), "#/0/shots/b.png/rotation", "finite"},
    {BROWN, SHOT("c", "0,0", "0,0,4"), "#/0/shots/b.png/rotation", "3"},
    {BROWN, SHOT("c", "1e300,0,0", "0,0,4"), "#/0/shots/b.png/rotation", "finite"},
    {BROWN, SHOT("c", "0,0,0", "0,0,Infinity"), "#/0/shots/b.png/translation", "finite"},
    {BROWN, "{\"camera\":\"c\",\"rotation\":[0,0,0]}", "#/0/shots/b.png/translation", "missing"},
    {BROWN, "7", "#/0/shots/b.png", ""},
    {CAMERA("\"focal\":0"), SHOT("e", "0,0,0", "0,0,4"), "#/0/cameras/e/focal", "is 0"},
    {CAMERA("\"projection_type\":\"dual\",\"focal\":1"), SHOT("e", "0,0,0", "0,0,4"),
     "#/0/cameras/e/projection_type", "\"dual\""},
    {"{\"width\":9223372036854775808,\"height\":3,\"focal\":1}", SHOT("e", "0,0,0", "0,0,4"), "",
     ""},
    {"{\"width\":300,\"height\":400,\"focal\":1}", SHOT("e", "0,0,0", "0,0,4"), "#/0/shots/b.png",
     "300x400"},
};

START_TEST(bad_shot) {
    char *text;
    ck_assert(asprintf(&text,
                       "[{\"cameras\":{\"c\":" BROWN ",\"e\":%s},\"shots\":{\"a.png\":" SHOT(
                           "c", "0,0,0", "0,0,4") ",\"b.png\":%s}}]",
                       bad_shots[_i].camera, bad_shots[_i].shot) > 0);
    put_capture(text);
    free(text);
    enum rn_status status = rn_dataset_read(folder, &problems, &dataset, &err);
    if (!*bad_shots[_i].where) { // no number of JSON: the document itself is bad
        ck_assert_int_eq(status, RN_ERROR_INVALID);
        return;
    }
    ck_assert_msg(status == RN_OK, "%s: %s", err.where, err.text);
    ck_assert_uint_eq(dataset->frame_count, 1);
    ck_assert_uint_eq(problems.errors, 1);
    for (size_t i = 0; i < problems.count; i++)
        if (problems.items[i].severity == RN_SEVERITY_ERROR) {
            ck_assert_msg(strstr(problems.items[i].where, bad_shots[_i].where) != NULL, "%s: %s",
                          problems.items[i].where, problems.items[i].text);
            ck_assert_msg(strstr(problems.items[i].text, bad_shots[_i].text) != NULL, "%s",
                          problems.items[i].text);
        }
}
END_TEST

static const struct {
    const char *document, *tracks, *where, *text;
} bad_documents[] = {
    {"{}", "", "reconstruction.json", ""},
    {"[]", "", "reconstruction.json", ""},
    {"[7]", "", "reconstruction.json", ""},
    {"[{\"shots\":{" SHOTS "}}]", "", "#/0/cameras", "missing"},
    {"[" MODEL("\"c\":" BROWN, "", "") "]", "", "#/0/shots", "0 photographs"},
    {"[" GOOD "]", "a.png\t7\t0\t0.1\n", "tracks.csv", "line 1"},
    {"[" GOOD "]", "OPENSFM_TRACKS_VERSION_v2\na.png\t7\t0\tx\t0\n", "tracks.csv", "line 2"},
    {"[" GOOD "]", "a.png\t7\t0\tnan\t0\n", "tracks.csv", "line 1"},
    {"[" GOOD "]", "a.png\t7\t0\t0\t0\na.png\t7\t0\t1\t2", "tracks.csv", "line 2"},
};

START_TEST(bad_document) {
    put_capture(bad_documents[_i].document);
    put_text("tracks.csv", bad_documents[_i].tracks);
    ck_assert_int_eq(rn_dataset_read(folder, &problems, &dataset, &err), RN_ERROR_INVALID);
    ck_assert_msg(strstr(err.where, bad_documents[_i].where) != NULL, "%s", err.where);
    ck_assert_msg(strstr(err.text, bad_documents[_i].text) != NULL, "%s", err.text);
}
END_TEST

START_TEST(points_that_are_not_finite) {
    put_capture("[" MODEL(
        "\"c\":" BROWN, SHOTS,
        "\"1\":{\"coordinates\":[NaN,0,0]},\"9\":{\"coordinates\":[0,-2e12,0]}," POINTS) "]");
    read_ok(folder);
    ck_assert_uint_eq(dataset->points.count, 2);
    ck_assert(problems_tell(RN_SEVERITY_WARNING, "2 of its 4 points"));
}
END_TEST

START_TEST(cut_anywhere) {
    const char *whole = "[" GOOD "]";
    put_capture(whole);
    for (size_t size = 0; size < strlen(whole); size++) {
        put_bytes("reconstruction.json", whole, size);
        ck_assert_int_eq(rn_dataset_read(folder, &problems, &dataset, &err), RN_ERROR_INVALID);
    }
}
END_TEST

#define COUNT(table) ((int)(sizeof table / sizeof *table))

int main(void) {
    Suite *suite = suite_create("opensfm");
    TCase *tests = tcase_create("opensfm");
    tcase_add_checked_fixture(tests, setup, teardown);
    tcase_add_test(tests, cameras_and_poses);
    tcase_add_test(tests, points_are_where_they_were_seen);
    tcase_add_test(tests, within_a_project);
    tcase_add_loop_test(tests, lens, 0, COUNT(lenses));
    tcase_add_loop_test(tests, bad_shot, 0, COUNT(bad_shots));
    tcase_add_loop_test(tests, bad_document, 0, COUNT(bad_documents));
    tcase_add_test(tests, points_that_are_not_finite);
    tcase_add_test(tests, cut_anywhere);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}

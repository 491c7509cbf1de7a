// Where the scene is: kinds of capture made up, each known, at the origin and where surveys are.
#include <math.h>

#include "common/dataset/reader.h"
#include "tests/unit/common/dataset_fixture.h"

#define CAMERAS 40
#define POINTS 400

static struct rn_frame frames[CAMERAS];
static struct rn_point points[POINTS];
static struct rn_dataset scene;
static struct rn_scene_place place;
static const double utm[3] = {500123.25, 4649776.5, 117.125};

// Uniform in -1 to 1.
static double draw(int what, int which) {
    return ldexp(rn_rng_draw(7, (uint64_t)what, (uint64_t)which).v[0], -31) - 1;
}

// A camera at `eye` that looks at `target`, z up, or lying on its side; somewhat askew.
static void put_camera(int i, const double eye[3], const double target[3], bool sideways,
                       const double offset[3]) {
    struct rn_camera *c = &frames[i].camera;
    const double up[3] = {0.03 * draw(9, i), 0.03 * draw(10, i), 1};
    *c =
        (struct rn_camera){.width = 640, .height = 480, .fx = 500, .fy = 500, .cx = 320, .cy = 240};
    ck_assert_int_eq(rn_camera_look_at(eye, target, up, c->world_from_camera), RN_OK);
    for (int r = 0; r < 3; r++) {
        double right = c->world_from_camera[r][0];
        if (sideways) c->world_from_camera[r][0] = c->world_from_camera[r][1];
        if (sideways) c->world_from_camera[r][1] = -right;
        c->world_from_camera[r][3] += offset[r];
    }
    ck_assert_int_eq(rn_camera_check(c, "", &err), RN_OK);
}

static void put_point(int i, double x, double y, double z, const double offset[3]) {
    points[i] = (struct rn_point){.position = {x + offset[0], y + offset[1], z + offset[2]}};
}

// What each kind of capture looks at and from where; `around` in -1 to 1 for the point's draws.
static void put_capture(enum rn_capture_kind kind, bool sideways, const double offset[3]) {
    bool looked_down = kind == RN_CAPTURE_OBJECT || kind == RN_CAPTURE_OUTDOOR;
    for (int i = 0; i < CAMERAS; i++) {
        double a = 2 * M_PI * i / CAMERAS, c = cos(a), s = sin(a);
        const double ring[3] = {4 * c, 4 * s, 1.5}, middle[3] = {0.1 * s, 0, 0.05 * c};
        const double row[3] = {0.05 * i, 0.3 * s, 0}, ahead[3] = {0.05 * i, 9, 0.1 * c};
        const double inside[3] = {0.5 * s, 0.5 * c, 1}, out[3] = {3 * c, 3 * s, 1};
        const double high[3] = {i % 8, (double)i / 8, 6};
        const double below[3] = {i % 8 + 4 * sin(M_PI / 2 * i),
                                 (double)i / 8 + 4 * cos(M_PI / 2 * i), 0};
        const double *eyes[] = {ring, row, inside, ring, high};
        const double *targets[] = {middle, ahead, out, middle, below};
        put_camera(i, eyes[kind], targets[kind], sideways, offset);
        frames[i].held = sideways && !looked_down ? 6 : 1; // nothing else tells then
    }
    for (int i = 0; i < POINTS; i++) {
        double x = draw(0, i), y = draw(1, i), z = draw(2, i);
        if (kind == RN_CAPTURE_OBJECT) put_point(i, 0.5 + x, y, z, offset);
        if (kind == RN_CAPTURE_FORWARD) put_point(i, 1 + 3 * x, 9 + 0.2 * y, 2 * z, offset);
        if (kind == RN_CAPTURE_ROOM) put_point(i, copysign(3, x), 3 * y, 1.2 + z, offset);
        if (kind == RN_CAPTURE_OUTDOOR)
            put_point(i, i % 4 ? x : 30 * x, i % 4 ? y : 30 * y, z, offset);
        if (kind == RN_CAPTURE_DRONE) put_point(i, 4 + 5 * x, 3 + 4 * y, 0.1 * z, offset);
    }
    points[0].position[0] += 1000; // as a wrong match makes them
    scene = (struct rn_dataset){.frames = frames,
                                .frame_count = CAMERAS,
                                .points = {.items = points, .count = POINTS},
                                .name = (char *)"scene"};
    ck_assert_int_eq(rn_dataset_find_place(&scene, &place, &err), RN_OK);
}

static const double origin[3] = {0, 0, 0};

// Whether the evidence is told in these words.
static bool told(const char *words) {
    struct rn_reader reader = {.problems = &problems, .folder = "scene"};
    rn_reader_tell_place(&reader, &place);
    return strstr(problems.items[problems.count - 1].text, words) != NULL;
}

START_TEST(kinds) {
    put_capture((enum rn_capture_kind)(_i / 2), _i % 2, origin);
    ck_assert_int_eq(place.lie.kind, _i / 2);
    ck_assert_int_eq(place.bounds.source, RN_BOUNDS_POINTS);
    ck_assert_double_gt(place.lie.up[2], cos(3 * M_PI / 180));
    bool forward = place.lie.kind == RN_CAPTURE_FORWARD;
    ck_assert(told(forward ? "(over the threshold of 0.9)" : "(under the threshold of 0.9)"));
    ck_assert(
        told(place.miss > 0.25 ? "(over the threshold of 25 %)" : "(under the threshold of 25 %)"));
    ck_assert(told(place.beyond > 0.1 ? "(over the threshold of 10 %)"
                                      : "(under the threshold of 10 %)"));
}
END_TEST

// The object's cube has its middle at (0.5, 0, 0) and corners sqrt(3) away.
START_TEST(bounds_are_the_objects) {
    put_capture(_i ? RN_CAPTURE_OUTDOOR : RN_CAPTURE_OBJECT, false, origin);
    ck_assert_double_eq_tol(place.bounds.centre[0], _i ? 0 : 0.5, 0.2);
    ck_assert_double_eq_tol(place.bounds.centre[1], 0, 0.2);
    ck_assert_double_gt(place.bounds.radius, 1.2);
    ck_assert_double_lt(place.bounds.radius, _i ? 3 : 1.8);
}
END_TEST

START_TEST(far_from_the_origin) {
    put_capture((enum rn_capture_kind)_i, false, origin);
    struct rn_scene_place near = place;
    put_capture((enum rn_capture_kind)_i, false, utm);
    ck_assert_int_eq(place.lie.kind, near.lie.kind);
    ck_assert_double_eq_tol(place.bounds.radius, near.bounds.radius, 1e-7);
    for (int i = 0; i < 3; i++) {
        ck_assert_double_eq_tol(place.bounds.centre[i] - utm[i], near.bounds.centre[i], 1e-7);
        ck_assert_double_eq_tol(place.lie.up[i], near.lie.up[i], 1e-12);
    }
}
END_TEST

// Degrees of the WGS 84 ellipsoid are so long (NIMA TR8350.2), and none between its last longitude
// and its first.
START_TEST(metres_on_earth) {
    static const struct {
        double from[3], of[3], metres[3];
    } known[] = {{{0, 0, 0}, {0.001, 0.001, 5}, {111.31949, 110.57428, 5}},
                 {{45, 7, 20}, {45.001, 6.999, 0}, {-78.84683, 111.13177, -20}},
                 {{-60, 179.9995, 0}, {-60.001, -179.9995, 0}, {55.80000, -111.41229, 0}},
                 {{90, 0, 0}, {89.999, 90, 0}, {0, -111.69398, 0}}};
    double metres[3];
    rn_located_metres(known[_i].of, known[_i].from, metres);
    for (int i = 0; i < 3; i++)
        ck_assert_double_eq_tol(metres[i], known[_i].metres[i], 1e-5);
}
END_TEST

// A flight straight down over a field, all cameras turned one way: `lanes` beside each other, 40 m
// apart, over a place whose GPS is off by `off_m` at most. In the dataset a unit is 8 m and y is
// up.
static void put_flight(int lanes, double off_m) {
    put_capture(RN_CAPTURE_DRONE, false, origin);
    for (int i = 0; i < CAMERAS; i++) {
        double(*pose)[4] = frames[i].camera.world_from_camera;
        double east = 30 * (i / lanes), north = 40 * (i % lanes), high = draw(3, i);
        const double turned[3][4] = {
            {1, 0, 0, east / 8}, {0, 0, 1, high / 8}, {0, -1, 0, -north / 8}};
        const double to_down[3][3] = {{1, 0, 0}, {0, 0, -1}, {0, 1, 0}}; // along -y, x to the right
        for (int r = 0; r < 3; r++) {
            for (int c = 0; c < 3; c++)
                pose[r][c] = to_down[r][c];
            pose[r][3] = turned[r][3];
        }
        frames[i].located = true;
        frames[i].located_at[0] = -34.5 + (north + off_m * draw(4, i)) / 110924;
        frames[i].located_at[1] = 150.25 + (east + off_m * draw(5, i)) / 91844;
        frames[i].located_at[2] = 120 + high + off_m * draw(6, i);
    }
    frames[7].located_at[0] += 1; // as a receiver has it that just woke up
    for (int i = 0; i < POINTS; i++) {
        const double p[3] = {10 + 10 * draw(0, i), -10, 10 * draw(1, i)};
        memcpy(points[i].position, p, sizeof p);
    }
    ck_assert_int_eq(rn_dataset_find_place(&scene, &place, &err), RN_OK);
}

START_TEST(gps_says_which_way_is_up) {
    put_flight(4, _i ? 2 : 0);
    ck_assert_uint_ge(place.located.count, _i ? CAMERAS / 2 : CAMERAS - 1);
    ck_assert(place.up_located);
    ck_assert_double_gt(place.lie.up[1], cos((_i ? 2 : 0.05) * M_PI / 180));
    ck_assert_double_le(fabs(place.lie.up[1]), 1);
    ck_assert_double_eq_tol(place.located.metres, 8, _i ? 0.1 : 0.01);
    ck_assert_double_lt(place.located.off_m, _i ? 2 : 0.1);
    ck_assert_int_eq(place.lie.kind, RN_CAPTURE_DRONE);
    ck_assert(told("a unit is"));
}
END_TEST

// Off by as much as the cameras are apart, all in one line, or known of few: the cameras say it.
START_TEST(gps_that_says_too_little) {
    put_flight(_i == 1 ? 1 : 4, _i == 0 ? 30 : 1);
    for (int i = 3; i < CAMERAS && _i == 2; i++)
        frames[i].located = false;
    ck_assert_int_eq(rn_dataset_find_place(&scene, &place, &err), RN_OK);
    ck_assert_uint_eq(place.located.count, 0);
    ck_assert(!place.up_located);
    ck_assert_double_lt(fabs(place.lie.up[1]), 0.1);
    ck_assert_int_eq(place.lie.kind, RN_CAPTURE_FORWARD);
    ck_assert(told("by the cameras"));
}
END_TEST

// Where both say it the cameras are the sharper.
START_TEST(up_by_cameras_that_gps_agrees_with) {
    put_capture(RN_CAPTURE_DRONE, false, origin);
    struct rn_scene_place before = place;
    for (int i = 0; i < CAMERAS; i++) {
        frames[i].located = true;
        frames[i].located_at[0] = 10 + frames[i].camera.world_from_camera[1][3] / 1e4;
        frames[i].located_at[1] = 10 + frames[i].camera.world_from_camera[0][3] / 1e4;
        frames[i].located_at[2] = 0.3 * draw(8, i);
    }
    ck_assert_int_eq(rn_dataset_find_place(&scene, &place, &err), RN_OK);
    ck_assert_uint_gt(place.located.count, CAMERAS / 2);
    ck_assert(!place.up_located);
    ck_assert_mem_eq(place.lie.up, before.lie.up, sizeof before.lie.up);
}
END_TEST

START_TEST(given) {
    put_capture(RN_CAPTURE_OUTDOOR, false, origin);
    scene.lie = (struct rn_lie){.up = {0, -1, 0},
                                .up_given = true,
                                .cropped = true,
                                .crop = {{-0.5, -0.5, -0.5}, {0.5, 0.5, 0.5}}};
    ck_assert_int_eq(rn_dataset_find_place(&scene, &place, &err), RN_OK);
    ck_assert_double_eq(place.lie.up[1], -1);
    ck_assert_double_lt(place.bounds.radius, 1);
    ck_assert_double_eq(place.beyond, 0);
}
END_TEST

// Photographs without points: near and far say what is seen.
START_TEST(depths) {
    put_capture(RN_CAPTURE_FORWARD, false, origin);
    scene.points.count = 0;
    for (int i = 0; i < CAMERAS; i++) {
        frames[i].near = 8;
        frames[i].far = 10;
    }
    ck_assert_int_eq(rn_dataset_find_place(&scene, &place, &err), RN_OK);
    ck_assert_uint_eq(place.witnesses, 15 * CAMERAS);
    ck_assert_int_eq(place.bounds.source, RN_BOUNDS_DEPTHS);
    ck_assert(told("places at the poses' depths lie farther"));
    ck_assert_double_eq_tol(place.bounds.centre[1], 9, 0.5);
    for (int i = 0; i < CAMERAS; i++)
        frames[i].near = frames[i].far = 0;
    ck_assert_int_eq(rn_dataset_find_place(&scene, &place, &err), RN_OK);
    ck_assert_int_eq(place.bounds.source, RN_BOUNDS_CAMERAS);
    ck_assert(isnan(place.beyond));
}
END_TEST

// The longest of what is said of a place has room.
START_TEST(told_to_the_end) {
    put_capture(RN_CAPTURE_FORWARD, false, origin);
    place.lie.kind = RN_CAPTURE_OUTDOOR;
    place.by_points = false;
    place.witnesses = 1234567;
    place.beyond = 1;
    for (int i = 0; i < 3; i++)
        place.lie.up[i] = -0.000123;
    ck_assert(told("cameras askew by"));
    ck_assert(told("degrees at most"));
}
END_TEST

// Which way cameras look is said of an angle without a sign.
START_TEST(slopes) {
    static const char *const words[] = {
        "they look 17 degrees up (under the threshold of 25 degrees)",
        "they look 1 degree up (under", "they look straight ahead (under",
        "they look 1 degree down (under",
        "they look 40 degrees down (over the threshold of 25 degrees)"};
    static const double below_deg[] = {-17.2, -0.8, -0.3, 1.2, 40};
    put_capture(RN_CAPTURE_OBJECT, false, origin);
    place.below_deg = below_deg[_i];
    ck_assert(told(words[_i]));
}
END_TEST

// An import keeps the similarity, and it is read back as it was.
START_TEST(kept) {
    put_transforms("train", FRAME("./train/r_0"));
    put_image("train/r_0.png", 16, 16);
    struct rn_read_options how = {
        .up_given = true, .up = {0, 3, 4}, .cropped = true, .crop = {{-1, -2, -3}, {1, 2, 4}}};
    struct rn_import_options options = {.scales = 1, .threads = 1};
    ck_assert_int_eq(rn_dataset_read_as(folder, &how, &problems, &dataset, &err), RN_OK);
    ck_assert_int_eq(dataset->bounds.source, RN_BOUNDS_GIVEN);
    ck_assert_double_eq_tol(dataset->bounds.radius, sqrt(1 + 4 + 12.25), 1e-12);
    ck_assert_int_eq(rn_mkdirs(in_folder("out"), 0755, &err), RN_OK);
    ck_assert_int_eq(
        rn_dataset_import(dataset, "kept", &options, in_folder("out"), &problems, NULL, NULL, &err),
        RN_OK);
    struct rn_lie lie = dataset->lie;
    rn_dataset_destroy(&dataset);
    read_ok(in_folder("out"));
    ck_assert(dataset->lie.known && dataset->lie.up_given && dataset->lie.cropped);
    ck_assert_int_eq(dataset->lie.kind, lie.kind);
    ck_assert_double_eq_tol(dataset->lie.up[2], 0.8, 1e-15);
    ck_assert_double_eq(dataset->lie.crop.low[1], -2);
    ck_assert_double_eq(dataset->lie.crop.high[2], 4);
    ck_assert_double_eq(dataset->bounds.centre[2], 0.5);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("place");
    TCase *tests = tcase_create("place");
    tcase_add_checked_fixture(tests, setup, teardown);
    tcase_add_loop_test(tests, kinds, 0, 2 * RN_CAPTURE_KINDS);
    tcase_add_loop_test(tests, bounds_are_the_objects, 0, 2);
    tcase_add_loop_test(tests, far_from_the_origin, 0, RN_CAPTURE_KINDS);
    tcase_add_loop_test(tests, metres_on_earth, 0, 4);
    tcase_add_loop_test(tests, gps_says_which_way_is_up, 0, 2);
    tcase_add_loop_test(tests, gps_that_says_too_little, 0, 3);
    tcase_add_test(tests, up_by_cameras_that_gps_agrees_with);
    tcase_add_test(tests, given);
    tcase_add_test(tests, depths);
    tcase_add_test(tests, told_to_the_end);
    tcase_add_loop_test(tests, slopes, 0, 5);
    tcase_add_test(tests, kept);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}

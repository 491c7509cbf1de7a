// Camera and path files: what is refused and where, and the cameras between keys.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/dataset/json.h"
#include "common/path/path.h"
#include "tests/support/suite.h"

#define POSE_A "[[1,0,0,0],[0,1,0,0],[0,0,1,-4]]"
#define POSE_B "[[0,0,-1,4],[0,1,0,0],[1,0,0,0]]"  // a quarter turn about y
#define POSE_C "[[-1,0,0,0],[0,1,0,0],[0,0,-1,4]]" // half a turn
#define POSE_D "[[0,0,1,-4],[0,1,0,0],[-1,0,0,0]]"
#define KEY(time, pose, fov)                                                                       \
    "{\"time\":" #time ",\"world_from_camera\":" pose ",\"fov_y_deg\":" #fov "}"
#define PATH(interpolation, loop, fps, keys)                                                       \
    "{\"path\":{\"axes\":\"opencv\",\"fps\":" #fps ",\"interpolation\":\"" interpolation           \
    "\",\"loop\":" loop ",\"width\":64,\"height\":48,\"keys\":[" keys "]}}"

static struct rn_path *parse(const char *json) {
    struct rn_path *path = NULL;
    struct rn_error err;
    enum rn_status status = rn_path_parse(json, strlen(json), "p.json", &path, &err);
    ck_assert_msg(status == RN_OK, "%s: %s", err.where, err.text);
    return path;
}

static void assert_rigid(struct rn_camera *camera) {
    struct rn_error err;
    ck_assert_msg(rn_camera_check(camera, "", &err) == RN_OK, "%s", err.text);
}

static void assert_position(const struct rn_camera *camera, double x, double y, double z) {
    ck_assert_double_eq_tol(camera->world_from_camera[0][3], x, 1e-9);
    ck_assert_double_eq_tol(camera->world_from_camera[1][3], y, 1e-9);
    ck_assert_double_eq_tol(camera->world_from_camera[2][3], z, 1e-9);
}

START_TEST(frame_counts) {
    struct {
        const char *json;
        size_t frames;
    } cases[] = {
        {PATH("spline", "false", 10, KEY(0, POSE_A, 40)), 1},
        {PATH("spline", "true", 10, KEY(5, POSE_A, 40)), 1},
        {PATH("spline", "false", 10, KEY(0, POSE_A, 40) "," KEY(0.7, POSE_B, 40)), 8},
        {PATH("linear", "false", 10, KEY(1, POSE_A, 40) "," KEY(1.75, POSE_B, 40)), 8},
        {PATH("spline", "true", 10, KEY(0, POSE_A, 40) "," KEY(1, POSE_B, 40)), 20},
        {"{\"path\":{\"axes\":\"opencv\",\"width\":64,\"height\":48,\"keys\":[" KEY(
             0, POSE_A, 40) "," KEY(1, POSE_B, 40) "]}}",
         31}, // 30 a second, a spline, not looped
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct rn_path *path = parse(cases[i].json);
        ck_assert_uint_eq(rn_path_frame_count(path), cases[i].frames);
        rn_path_destroy(&path);
        ck_assert_ptr_null(path);
    }
}
END_TEST

START_TEST(keys_are_met_exactly) {
    static const char *const kinds[] = {"spline", "linear"};
    for (int kind = 0; kind < 2; kind++) {
        char json[2048];
        snprintf(json, sizeof json,
                 "{\"path\":{\"axes\":\"opencv\",\"fps\":2,\"interpolation\":\"%s\",\"loop\":false,"
                 "\"width\":64,\"height\":48,\"keys\":[%s,%s,%s]}}",
                 kinds[kind], KEY(0, POSE_A, 30), KEY(1, POSE_B, 40), KEY(3, POSE_C, 60));
        struct rn_path *path = parse(json);
        ck_assert_uint_eq(rn_path_frame_count(path), 7);
        static const size_t frames[] = {0, 2, 6};
        for (int k = 0; k < 3; k++) {
            struct rn_camera camera = rn_path_camera(path, frames[k]);
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 4; j++)
                    ck_assert_double_eq_tol(camera.world_from_camera[i][j],
                                            path->keys[k].world_from_camera[i][j], 1e-9);
            ck_assert_double_eq_tol(rn_camera_fov_from_focal(camera.fy, camera.height),
                                    path->keys[k].fov_y_rad, 1e-9);
            ck_assert_int_eq(camera.width, 64);
            ck_assert_double_eq(camera.cy, 24);
        }
        rn_path_destroy(&path);
    }
}
END_TEST

START_TEST(linear_between_keys) {
    struct rn_path *path =
        parse(PATH("linear", "false", 4, KEY(0, POSE_A, 40) "," KEY(1, POSE_B, 60)));
    struct rn_camera camera = rn_path_camera(path, 1);
    assert_rigid(&camera);
    assert_position(&camera, 1, 0, -3);
    double turned = atan2(camera.world_from_camera[2][0], camera.world_from_camera[0][0]);
    ck_assert_double_eq_tol(turned, M_PI / 8, 1e-9); // a quarter of a quarter turn
    ck_assert_double_eq_tol(rn_camera_fov_from_focal(camera.fy, camera.height), 45 * M_PI / 180,
                            1e-9);
    rn_path_destroy(&path);
}
END_TEST

// Four keys on a circle, looped: the curve stays near it, turns evenly and closes smoothly.
START_TEST(spline_loop_follows_a_circle) {
    struct rn_path *path = parse(PATH(
        "spline", "true", 30,
        KEY(0, POSE_A, 40) "," KEY(1, POSE_B, 40) "," KEY(2, POSE_C, 40) "," KEY(3, POSE_D, 40)));
    size_t count = rn_path_frame_count(path);
    ck_assert_uint_eq(count, 120);
    struct rn_camera previous = rn_path_camera(path, count - 1);
    for (size_t i = 0; i < count; i++) {
        struct rn_camera camera = rn_path_camera(path, i);
        assert_rigid(&camera);
        double x = camera.world_from_camera[0][3], z = camera.world_from_camera[2][3];
        ck_assert_double_eq_tol(hypot(x, z), 4, 0.5);
        double step =
            hypot(x - previous.world_from_camera[0][3], z - previous.world_from_camera[2][3]);
        ck_assert_double_eq_tol(step, 2 * M_PI * 4 / 120, 0.08);
        double cosine = 0;
        for (int k = 0; k < 3; k++)
            cosine += camera.world_from_camera[k][2] * previous.world_from_camera[k][2];
        ck_assert_double_eq_tol(acos(cosine), 2 * M_PI / 120, 0.01);
        previous = camera;
    }
    rn_path_destroy(&path);
}
END_TEST

START_TEST(still_keys_do_not_move) {
    struct rn_path *path = parse(PATH(
        "spline", "false", 4,
        KEY(0, POSE_B, 40) "," KEY(1, POSE_A, 40) "," KEY(2, POSE_A, 50) "," KEY(3, POSE_C, 50)));
    struct rn_camera camera = rn_path_camera(path, 6);
    assert_rigid(&camera);
    assert_position(&camera, 0, 0, -4);
    ck_assert_double_eq_tol(rn_camera_fov_from_focal(camera.fy, camera.height), 45 * M_PI / 180,
                            1e-9);
    rn_path_destroy(&path);
}
END_TEST

START_TEST(opengl_axes) {
    static const char json[] =
        "{\"camera\":{\"world_from_camera\":[[1,0,0,1],[0,1,0,2],[0,0,1,3]],\"axes\":\"opengl\","
        "\"width\":80,\"height\":60,\"fov_y_deg\":90}}";
    struct rn_camera camera;
    struct rn_error err;
    ck_assert_int_eq(rn_camera_parse(json, strlen(json), "c.json", &camera, &err), RN_OK);
    ck_assert_double_eq(camera.world_from_camera[1][1], -1);
    ck_assert_double_eq(camera.world_from_camera[2][2], -1);
    ck_assert_double_eq(camera.world_from_camera[2][3], 3);
    ck_assert_double_eq_tol(camera.fx, 30, 1e-9);
    ck_assert_double_eq(camera.cx, 40);
}
END_TEST

#define CAMERA(pose, rest)                                                                         \
    "{\"camera\":{\"world_from_camera\":" pose ",\"axes\":\"opencv\"," rest "}}"
#define SIZE "\"width\":8,\"height\":6"

#define INTRINSICS "\"fx\":9,\"fy\":9,\"cx\":4,\"cy\":3"

// A lens reads as it was written, its parameters by name; one left out is 0.
START_TEST(camera_with_lens) {
    static const char json[] = CAMERA(
        POSE_A, SIZE "," INTRINSICS ",\"lens\":{\"model\":\"opencv\",\"p2\":0.5,\"k1\":-1e-3}");
    struct rn_camera camera, again;
    struct rn_error err;
    ck_assert_int_eq(rn_camera_parse(json, strlen(json), "c.json", &camera, &err), RN_OK);
    ck_assert_int_eq(camera.lens, RN_LENS_OPENCV);
    for (int i = 0; i < RN_LENS_PARAMETERS; i++)
        ck_assert_double_eq(camera.lens_k[i], i == 0 ? -1e-3 : i == 3 ? 0.5 : 0);
    json_t *document = json_pack("{s:o}", "camera", rn_json_from_camera(&camera));
    char *text = json_dumps(document, 0);
    ck_assert_int_eq(rn_camera_parse(text, strlen(text), "c.json", &again, &err), RN_OK);
    ck_assert_int_eq(again.lens, camera.lens);
    ck_assert_mem_eq(again.lens_k, camera.lens_k, sizeof camera.lens_k);
    free(text);
    json_decref(document);
}
END_TEST

static const struct {
    const char *json, *where, *text;
} bad_cameras[] = {
    {CAMERA(POSE_A, SIZE "," INTRINSICS ",\"lens\":{\"model\":\"square\"}"),
     "c.json#/camera/lens/model", "\"fisheye\""},
    {CAMERA(POSE_A, SIZE "," INTRINSICS ",\"lens\":{\"model\":\"fisheye\",\"p1\":0}"),
     "c.json#/camera/lens/p1", "not a known"},
    {CAMERA(POSE_A, SIZE "," INTRINSICS ",\"lens\":{\"model\":\"fov\",\"omega\":4}"),
     "c.json#/camera/lens/omega", "is 4"},
    {CAMERA(POSE_A, SIZE ",\"fov_y_deg\":50,\"lens\":{\"model\":\"fisheye\"}"),
     "c.json#/camera/fov_y_deg", "pinhole"},
    {"{\"camera\":", "c.json:1", "not valid JSON"},
    {"{}", "c.json#/camera", "missing"},
    {"[]", "c.json#", "object"},
    {"{\"camera\":{},\"camera\":{}}", "c.json:1", "duplicate"},
    {CAMERA(POSE_A, SIZE), "c.json#/camera/fx", "missing"},
    {CAMERA(POSE_A, SIZE ",\"fov_y_deg\":180"), "c.json#/camera/fov_y_deg", "is 180"},
    {CAMERA(POSE_A, SIZE ",\"fov_y_deg\":50,\"cx\":1"), "c.json#/camera/cx", "only one"},
    {CAMERA(POSE_A, SIZE ",\"fov_y_deg\":50,\"zoom\":1"), "c.json#/camera/zoom", "not a known"},
    {CAMERA(POSE_A, "\"width\":0,\"height\":6,\"fov_y_deg\":50"), "c.json#/camera/width", "is 0"},
    {CAMERA(POSE_A, "\"width\":100000,\"height\":6,\"fov_y_deg\":50"), "c.json#/camera/width",
     "100000"},
    {CAMERA("[[1,0,0,NaN],[0,1,0,0],[0,0,1,0]]", SIZE ",\"fov_y_deg\":50"),
     "c.json#/camera/world_from_camera/0/3", "finite"},
    {CAMERA("[[1,0,0,-Infinity],[0,1,0,0],[0,0,1,0]]", SIZE ",\"fov_y_deg\":50"),
     "c.json#/camera/world_from_camera/0/3", "finite"},
    {CAMERA("[[2,0,0,0],[0,2,0,0],[0,0,2,0]]", SIZE ",\"fov_y_deg\":50"),
     "c.json#/camera/world_from_camera", "rotation"},
    {CAMERA("[[1,0,0,0],[0,1,0,0],[0,0,-1,0]]", SIZE ",\"fov_y_deg\":50"),
     "c.json#/camera/world_from_camera", "mirrored"},
    {CAMERA("[[1,0,0,0],[0,1,0,0]]", SIZE ",\"fov_y_deg\":50"), "c.json#/camera/world_from_camera",
     "3 rows"},
    {CAMERA("[[1,0,0],[0,1,0,0],[0,0,1,0]]", SIZE ",\"fov_y_deg\":50"),
     "c.json#/camera/world_from_camera/0", "4 numbers"},
};

START_TEST(bad_camera) {
    const char *json = bad_cameras[_i].json;
    struct rn_camera camera = {.width = 77};
    struct rn_error err;
    ck_assert_int_eq(rn_camera_parse(json, strlen(json), "c.json", &camera, &err),
                     RN_ERROR_INVALID);
    ck_assert_str_eq(err.where, bad_cameras[_i].where);
    ck_assert_msg(strstr(err.text, bad_cameras[_i].text) != NULL, "%s", err.text);
    ck_assert_int_eq(camera.width, 77); // untouched
}
END_TEST

static const struct {
    const char *json, *where, *text;
    enum rn_status status;
} bad_paths[] = {
    {PATH("spline", "false", 10, ""), "p.json#/path/keys", "0 elements", RN_ERROR_INVALID},
    {PATH("cubic", "false", 10, KEY(0, POSE_A, 40)), "p.json#/path/interpolation", "\"linear\"",
     RN_ERROR_INVALID},
    {PATH("spline", "1", 10, KEY(0, POSE_A, 40)), "p.json#/path/loop", "true", RN_ERROR_INVALID},
    {PATH("spline", "false", 0, KEY(0, POSE_A, 40)), "p.json#/path/fps", "is 0", RN_ERROR_INVALID},
    {PATH("spline", "false", 1000, KEY(0, POSE_A, 40) "," KEY(200, POSE_B, 40)),
     "p.json#/path/keys", "frames", RN_ERROR_LIMIT},
    {PATH("spline", "false", 10, KEY(1, POSE_A, 40) "," KEY(1, POSE_B, 40)),
     "p.json#/path/keys/1/time", "later", RN_ERROR_INVALID},
    {PATH("spline", "false", 10, KEY(-1, POSE_A, 40)), "p.json#/path/keys/0/time", "is -1",
     RN_ERROR_INVALID},
    {PATH("spline", "false", 10, KEY(0, POSE_A, NaN)), "p.json#/path/keys/0/fov_y_deg", "number",
     RN_ERROR_INVALID},
    {PATH("spline", "false", 10,
          KEY(0, POSE_A, 40) "," KEY(1, "[[1,0,0,0],[1,1,0,0],[0,0,1,0]]", 40)),
     "p.json#/path/keys/1/world_from_camera", "rotation", RN_ERROR_INVALID},
    {"{\"path\":{\"axes\":\"opencv\",\"speed\":1}}", "p.json#/path/speed", "not a known",
     RN_ERROR_INVALID},
    {"{\"path\":{},\"more\":1}", "p.json#/more", "not a known", RN_ERROR_INVALID},
};

START_TEST(bad_path) {
    const char *json = bad_paths[_i].json;
    struct rn_path *path = NULL;
    struct rn_error err;
    ck_assert_int_eq(rn_path_parse(json, strlen(json), "p.json", &path, &err),
                     bad_paths[_i].status);
    ck_assert_str_eq(err.where, bad_paths[_i].where);
    ck_assert_msg(strstr(err.text, bad_paths[_i].text) != NULL, "%s", err.text);
    ck_assert_ptr_null(path);
}
END_TEST

START_TEST(oversized_document) {
    struct rn_path *path = NULL;
    struct rn_error err;
    ck_assert_int_eq(rn_path_parse("", RN_PATH_MAX_BYTES + 1, "p.json", &path, &err),
                     RN_ERROR_LIMIT);
    ck_assert_str_eq(err.where, "p.json");
}
END_TEST

// Effects go over from key to key; a focus that only one key has is the focus, and a light is
// compared with daylight's. Between frames and around the ends the camera is where it would be.
START_TEST(effects_go_over_from_key_to_key) {
    struct rn_path *path =
        parse("{\"path\":{\"axes\":\"opencv\",\"fps\":4,\"interpolation\":\"linear\",\"width\":64,"
              "\"height\":48,\"keys\":["
              "{\"time\":0,\"world_from_camera\":" POSE_A ",\"fov_y_deg\":40,\"aperture\":0.4,"
              "\"focus\":3,\"exposure\":-1},"
              "{\"time\":1,\"world_from_camera\":" POSE_B ",\"fov_y_deg\":40,\"shutter\":0.5,"
              "\"white_balance\":3252}]}}");
    struct rn_optics half = rn_path_optics(path, 2), end = rn_path_optics(path, 4);
    ck_assert_double_eq_tol(half.aperture, 0.2, 1e-12);
    ck_assert_double_eq_tol(half.focus, 3, 1e-12);
    ck_assert_double_eq_tol(half.shutter, 0.25, 1e-12);
    ck_assert_double_eq_tol(half.exposure, -0.5, 1e-12);
    ck_assert_double_eq_tol(half.white_balance, 0.75 * 6504, 1e-9);
    ck_assert(end.aperture == 0 && end.shutter == 0.5 && half.ortho_height == 0);
    struct rn_camera before = rn_path_camera(path, -0.25), first = rn_path_camera(path, 0),
                     between = rn_path_camera(path, 0.5), second = rn_path_camera(path, 1);
    for (int i = 0; i < 3; i++) {
        double a = first.world_from_camera[i][3], b = second.world_from_camera[i][3];
        ck_assert_double_eq_tol(before.world_from_camera[i][3], a, 1e-12);
        ck_assert_double_eq_tol(between.world_from_camera[i][3], (a + b) / 2, 1e-12);
    }
    rn_path_destroy(&path);
}
END_TEST

// A loop is everywhere in it: before its first frame it is on the way back.
START_TEST(a_loop_has_no_ends) {
    struct rn_path *path =
        parse(PATH("spline", "true", 10, KEY(0, POSE_A, 40) "," KEY(1, POSE_B, 40)));
    struct rn_camera before = rn_path_camera(path, -0.5), last = rn_path_camera(path, 19.5);
    for (int i = 0; i < 12; i++)
        ck_assert_double_eq_tol(before.world_from_camera[i / 4][i % 4],
                                last.world_from_camera[i / 4][i % 4], 1e-9);
    rn_path_destroy(&path);
}
END_TEST

// Equal distances in equal times, however uneven the keys' own times are: 0, 5 and 6 on a line.
START_TEST(constant_speed_is_kept_between_uneven_times) {
#define AT(x) "[[1,0,0," #x "],[0,1,0,0],[0,0,1,-4]]"
    struct rn_path *path =
        parse("{\"path\":{\"axes\":\"opencv\",\"fps\":4,\"interpolation\":\"linear\",\"width\":64,"
              "\"height\":48,\"constant_speed\":true,\"keys\":[" KEY(0, AT(0), 40) "," KEY(
                  0.01, AT(5), 40) "," KEY(10, AT(6), 40) "]}}");
    for (int frame = 0; frame <= 40; frame++) {
        struct rn_camera camera = rn_path_camera(path, frame);
        assert_position(&camera, 6.0 * frame / 40, 0, -4);
    }
    rn_path_destroy(&path);
}
END_TEST

START_TEST(equirectangular_frames_are_the_whole_sphere) {
    struct rn_path *path =
        parse("{\"path\":{\"axes\":\"opencv\",\"lens\":\"equirectangular\",\"width\":64,"
              "\"height\":32,\"keys\":[" KEY(0, POSE_A, 40) "]}}");
    struct rn_camera camera = rn_path_camera(path, 0);
    struct rn_ray left = rn_camera_ray(&camera, 1e-9, 16),
                  right = rn_camera_ray(&camera, 64 - 1e-9, 16);
    ck_assert_double_gt(left.radius, 0);
    for (int i = 0; i < 3; i++)
        ck_assert_double_eq_tol(left.direction[i], right.direction[i], 1e-6); // both look back
    rn_path_destroy(&path);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("path");
    TCase *tests = tcase_create("path");
    tcase_add_test(tests, frame_counts);
    tcase_add_test(tests, keys_are_met_exactly);
    tcase_add_test(tests, linear_between_keys);
    tcase_add_test(tests, spline_loop_follows_a_circle);
    tcase_add_test(tests, still_keys_do_not_move);
    tcase_add_test(tests, opengl_axes);
    tcase_add_test(tests, camera_with_lens);
    tcase_add_test(tests, effects_go_over_from_key_to_key);
    tcase_add_test(tests, a_loop_has_no_ends);
    tcase_add_test(tests, constant_speed_is_kept_between_uneven_times);
    tcase_add_test(tests, equirectangular_frames_are_the_whole_sphere);
    tcase_add_loop_test(tests, bad_camera, 0, sizeof bad_cameras / sizeof *bad_cameras);
    tcase_add_loop_test(tests, bad_path, 0, sizeof bad_paths / sizeof *bad_paths);
    tcase_add_test(tests, oversized_document);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}

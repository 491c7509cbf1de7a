// The codec: every example of the contract survives decoding and encoding; every kind of wrong
// field is refused with its pointer.
#include <jansson.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/camera.h"
#include "proto/dataset.h"
#include "proto/event.h"
#include "proto/incident.h"
#include "proto/job.h"
#include "proto/json_text.h"
#include "proto/ladder.h"
#include "proto/problem.h"
#include "proto/render.h"
#include "proto/scene.h"
#include "tests/support/suite.h"

// ---- examples ------------------------------------------------------------------------------

static const struct {
    const char *file;
    const struct rn_table *table;
} examples[] = {
    {"CameraPathRecord", &rn_camera_path_record_table},
    {"CameraPathRequest", &rn_camera_path_request_table},
    {"Dataset", &rn_dataset_table},
    {"DatasetReport", &rn_dataset_report_table},
    {"DatasetRequest", &rn_dataset_request_table},
    {"Estimate", &rn_estimate_table},
    {"EvalResult", &rn_eval_result_table},
    {"IngestResult", &rn_ingest_result_table},
    {"IncidentEvent", &rn_incident_event_table},
    {"Info", &rn_info_table},
    {"Job", &rn_job_table},
    {"Job.failed", &rn_job_table},
    {"Job.succeeded", &rn_job_table},
    {"JobProgressEvent", &rn_job_progress_event_table},
    {"LadderReport", &rn_ladder_report_table},
    {"MetricEvent", &rn_metric_event_table},
    {"PathResult", &rn_path_result_table},
    {"Problem", &rn_api_problem_table},
    {"RenderRequest", &rn_render_request_table},
    {"RenderRequest.view", &rn_render_request_table},
    {"Scene", &rn_scene_table},
    {"Scene.new", &rn_scene_table},
    {"TrainProgress", &rn_train_progress_table},
    {"TrainResult", &rn_train_result_table},
    {"WorkProgress", &rn_work_progress_table},
};

static char *read_example(const char *name) {
    char path[512];
    snprintf(path, sizeof path, "%s/%s.json", EXAMPLES, name);
    FILE *file = fopen(path, "rb");
    ck_assert_msg(file != NULL, "%s", path);
    char *text = calloc(1, 1 << 16);
    ck_assert_uint_gt(fread(text, 1, (1 << 16) - 1, file), 0);
    fclose(file);
    return text;
}

START_TEST(example_survives) {
    const struct rn_table *table = examples[_i].table;
    char *text = read_example(examples[_i].file), *again;
    void *message = malloc(table->size);
    struct rn_error err = {0};
    enum rn_status status = rn_decode(table, text, strlen(text), message, NULL, &err);
    ck_assert_msg(status == RN_OK, "%s: %s %s", examples[_i].file, err.where, err.text);
    ck_assert_int_eq(rn_encode(table, message, &again, NULL, &err), RN_OK);
    json_t *before = json_loads(text, 0, NULL), *after = json_loads(again, 0, NULL);
    ck_assert_msg(json_equal(before, after), "%s became %s", examples[_i].file, again);
    json_decref(before);
    json_decref(after);
    rn_message_finish(table, message);
    free(message);
    free(text);
    free(again);
}
END_TEST

// ---- refusals ------------------------------------------------------------------------------

static const struct {
    const char *json, *pointer, *detail; // detail: what it must contain
    bool malformed;
} refused[] = {
    {"{\"preset\":\"draft\",\"bogus\":1}", "#/bogus", "not a field of training options", false},
    {"{\"planes\":3,\"seed\":1,\"planes\":3}", "#/planes", "duplicate", true},
    {"{\"planes\":\"3\"}", "#/planes", "must be a whole number", false},
    {"{\"planes\":3.5}", "#/planes", "must be a whole number", false},
    {"{\"planes\":null}", "#/planes", "must be a whole number", false},
    {"{\"planes\":0}", "#/planes", "at least 1", false},
    {"{\"planes\":17}", "#/planes", "at most 16, is 17", false},
    {"{\"planes\":99999999999999999999}", "#/planes", "too big", true},
    {"{\"max_time_s\":0}", "#/max_time_s", "more than 0", false},
    {"{\"max_time_s\":1e999}", "#/max_time_s", "overflow", true},
    {"{\"preset\":\"fast\"}", "#/preset", "one of draft, standard, paper", false},
    {"{\"device\":\"gpu\"}", "#/device", "auto, cpu or cuda:N", false},
    {"{\"kernels\":\"aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa\"}", "#/kernels", "at most 31 bytes",
     false},
    {"{\"device\":\"c\\u0000\"}", "#/device", "", true},
    {"{\"seed\":1", "#/seed", "", true},
    {"[]", "#", "must be an object", true},
    {"", "#", "", true},
    {"{\"seed\":NaN}", "#/seed", "", true},
    {"\xff", "#", "", true},
};

START_TEST(wrong_field_is_refused) {
    struct rn_train_options options;
    struct rn_field_errors errors;
    struct rn_error err = {0};
    const char *json = refused[_i].json;
    ck_assert_int_eq(
        rn_decode(&rn_train_options_table, json, strlen(json), &options, &errors, &err),
        RN_ERROR_INVALID);
    ck_assert_uint_eq(errors.count, 1);
    ck_assert_str_eq(errors.items[0].pointer, refused[_i].pointer);
    ck_assert_msg(strstr(errors.items[0].detail, refused[_i].detail) != NULL, "%s",
                  errors.items[0].detail);
    ck_assert_int_eq(errors.malformed, refused[_i].malformed);
    ck_assert_str_eq(err.where, refused[_i].pointer);
}
END_TEST

static const struct {
    const char *json, *pointer;
} refused_jobs[] = {
    {"{\"dataset\":\"d\",\"scene\":\"s\"}", "#/type"},
    {"{\"type\":\"ingest\"}", "#/type"},
    {"{\"type\":\"train\",\"dataset\":\"d\"}", "#/scene"},
    {"{\"type\":\"train\",\"dataset\":\"d\",\"scene\":\"sc_x\"}", "#/scene"},
    {"{\"type\":\"train\",\"dataset\":\"../d\",\"scene\":\"s\"}", "#/dataset"},
    {"{\"type\":\"train\",\"dataset\":\"d\",\"scene\":\"a b\"}", "#/scene"},
    {"{\"type\":\"train\",\"dataset\":\"d\",\"scene\":\"\xc3\xa4\"}", "#/scene"},
    {"{\"type\":\"train\",\"dataset\":\"d\",\"scene\":\"s\",\"options\":{\"x\":1}}", "#/options/x"},
    {"{\"type\":\"train\",\"dataset\":\"d\",\"scene\":\"s\",\"options\":{\"a~b/c\":1}}",
     "#/options/a~0b~1c"},
    {"{\"type\":\"train\",\"dataset\":\"d\",\"scene\":\"s\",\"options\":{\"seed\":1,\"seed\":2}}",
     "#/options/seed"},
    {"{\"type\":\"train\",\"dataset\":\"d\",\"scene\":\"s\",\"options\":{\"channels\":5}}",
     "#/options/channels"},
    {"{\"type\":\"path\",\"scene\":\"s\"}", "#/path"},
    {"{\"type\":\"path\",\"scene\":\"s\",\"path\":\"p\",\"camera_path\":{\"width\":4,\"height\":3,"
     "\"axes\":\"opencv\",\"keys\":[{\"time\":0,\"fov_y_deg\":60,\"world_from_camera\":"
     "[[1,0,0,0],[0,1,0,0],[0,0,1,0]]}]}}",
     "#/path"},
    {"{\"type\":\"path\",\"scene\":\"s\",\"camera_path\":{}}", "#/camera_path/width"},
    {"{\"type\":\"path\",\"scene\":\"s\",\"camera_path\":[]}", "#/camera_path"},
    {"{\"type\":\"path\",\"scene\":\"s\",\"camera_path\":{\"keys\":[{\"a\":1},{\"a\":1,\"a\":2}]}}",
     "#/camera_path/keys/1/a"},
    {"{\"type\":\"path\",\"scene\":\"s\",\"path\":\"p\",\"options\":{\"width\":8}}",
     "#/options/height"},
    {"{\"type\":\"path\",\"scene\":\"s\",\"path\":\"p\",\"options\":{\"first\":5,\"last\":4}}",
     "#/options/last"},
    {"{\"type\":\"eval\",\"scene\":\"s\",\"options\":{\"split\":\"all\"}}", "#/options/split"},
};

START_TEST(wrong_job_is_refused) {
    struct rn_job_request request;
    struct rn_field_errors errors;
    struct rn_error err = {0};
    const char *json = refused_jobs[_i].json;
    ck_assert_int_eq(rn_job_request_decode(json, strlen(json), &request, &errors, &err),
                     RN_ERROR_INVALID);
    ck_assert_uint_ge(errors.count, 1);
    ck_assert_str_eq(errors.items[0].pointer, refused_jobs[_i].pointer);
}
END_TEST

// ---- the rest ------------------------------------------------------------------------------

START_TEST(all_errors_are_listed) {
    static const char json[] = "{\"planes\":0,\"bogus\":1,\"preset\":7}";
    struct rn_train_options options;
    struct rn_field_errors errors;
    ck_assert_int_eq(
        rn_decode(&rn_train_options_table, json, strlen(json), &options, &errors, NULL),
        RN_ERROR_INVALID);
    ck_assert_uint_eq(errors.count, 3);
    char *problem;
    ck_assert_int_eq(rn_problem_json(RN_PROBLEM_INVALID, "no", &errors, &problem, NULL), RN_OK);
    ck_assert_ptr_nonnull(strstr(problem, "\"status\":422"));
    ck_assert_ptr_nonnull(strstr(problem, "\"pointer\":\"#/planes\""));
    free(problem);
}
END_TEST

START_TEST(more_errors_than_fit_are_dropped) {
    char json[1024] = "{";
    for (int i = 0; i < 40; i++)
        snprintf(json + strlen(json), sizeof json - strlen(json), "%s\"x%d\":1", i ? "," : "", i);
    strcat(json, "}");
    struct rn_eval_options options;
    struct rn_field_errors errors;
    ck_assert_int_eq(rn_decode(&rn_eval_options_table, json, strlen(json), &options, &errors, NULL),
                     RN_ERROR_INVALID);
    ck_assert_uint_eq(errors.count, RN_FIELD_ERRORS_MAX);
}
END_TEST

START_TEST(absent_stays_absent) {
    static const char json[] = "{\"type\":\"train\",\"dataset\":\"d\",\"scene\":\"s\"}";
    struct rn_job_request request;
    struct rn_error err = {0};
    ck_assert_int_eq(rn_job_request_decode(json, strlen(json), &request, NULL, &err), RN_OK);
    ck_assert_int_eq(rn_settings_value(&rn_train_settings, request.train.settings, "planes")->whole,
                     RN_ABSENT);
    ck_assert_int_eq(request.train.preset, -1);
    ck_assert(isnan(
        rn_settings_value(&rn_train_settings, request.train.settings, "max_seconds")->number));
    char *options;
    ck_assert_int_eq(rn_job_request_options(&request, &options, &err), RN_OK);
    ck_assert_str_eq(options, "{}");
    free(options);
    rn_job_request_finish(&request);
}
END_TEST

START_TEST(numbers_read_back_the_same) {
    static const double values[] = {0.1, 1.0 / 3, 1e-300, 123456789.125, 4e15, 0.30000000000000004};
    struct rn_metric_event event = {.step = 1, .train_seconds = values[_i], .psnr = NAN}, again;
    char *json;
    size_t size;
    ck_assert_int_eq(rn_encode(&rn_metric_event_table, &event, &json, &size, NULL), RN_OK);
    ck_assert_int_eq(rn_decode(&rn_metric_event_table, json, size, &again, NULL, NULL), RN_OK);
    ck_assert(again.train_seconds == values[_i]);
    ck_assert(isnan(again.psnr));
    ck_assert_uint_lt(size, 64);
    free(json);
}
END_TEST

START_TEST(zero_has_no_sign) {
    struct rn_buf buf;
    rn_buf_init(&buf, 8);
    rn_json_put_number(&buf, -0.0);
    ck_assert_uint_eq(buf.size, 1);
    ck_assert_int_eq(buf.data[0], '0');
    rn_buf_finish(&buf);
}
END_TEST

START_TEST(missing_value_is_not_encoded) {
    struct rn_metric_event event = {.step = 1, .train_seconds = NAN, .psnr = 1};
    struct rn_error err = {0};
    char *json;
    ck_assert_int_eq(rn_encode(&rn_metric_event_table, &event, &json, NULL, &err),
                     RN_ERROR_INVALID);
    ck_assert_ptr_nonnull(strstr(err.text, "train_seconds"));
}
END_TEST

START_TEST(strings_are_escaped) {
    struct rn_frame_event event = {.index = 0, .url = "a\"b\\c\n\x01\xc3\xa4"};
    char *json;
    ck_assert_int_eq(rn_encode(&rn_frame_event_table, &event, &json, NULL, NULL), RN_OK);
    ck_assert_str_eq(json, "{\"index\":0,\"url\":\"a\\\"b\\\\c\\u000a\\u0001\xc3\xa4\"}");
    struct rn_frame_event again;
    ck_assert_int_eq(rn_decode(&rn_frame_event_table, json, strlen(json), &again, NULL, NULL),
                     RN_OK);
    ck_assert_str_eq(again.url, event.url);
    free(json);
}
END_TEST

START_TEST(lists_have_a_cursor) {
    static const char *const items[] = {"{\"a\":1}", "{}"};
    char *json;
    ck_assert_int_eq(rn_encode_list(items, 2, "x\"", &json, NULL, NULL), RN_OK);
    ck_assert_str_eq(json, "{\"items\":[{\"a\":1},{}],\"next_cursor\":\"x\\\"\"}");
    free(json);
    ck_assert_int_eq(rn_encode_list(NULL, 0, NULL, &json, NULL, NULL), RN_OK);
    ck_assert_str_eq(json, "{\"items\":[],\"next_cursor\":null}");
    free(json);
}
END_TEST

// A scene tells the runner's description among its own fields, and gets it from the same JSON.
START_TEST(description_is_part_of_a_scene) {
    static const char *const keys[] = {"config",   "differences",  "effects", "bounds",
                                       "held_out", "memory_bytes", "kernels"};
    char *text = read_example("Scene"), part[8192], *again;
    struct rn_error err = {0};
    json_t *whole = json_loads(text, 0, NULL), *description = json_object();
    for (size_t i = 0; i < 7; i++)
        json_object_set(description, keys[i], json_object_get(whole, keys[i]));
    size_t size = json_dumpb(description, part, sizeof part, 0);
    ck_assert_uint_lt(size, sizeof part);
    struct rn_scene scene;
    rn_message_init(&rn_scene_table, &scene);
    ck_assert_int_eq(
        rn_decode(&rn_scene_description_table, part, size, &scene.description, NULL, &err), RN_OK);
    ck_assert_str_eq(scene.description.kernels, "avx2");
    struct rn_train_config config = {.preset = ""};
    rn_settings_put(&rn_train_settings, scene.description.config.settings, &config);
    ck_assert_int_eq(config.field.planes, 3);
    ck_assert_int_eq(rn_encode(&rn_scene_table, &scene, &again, NULL, &err), RN_ERROR_INVALID);
    rn_message_finish(&rn_scene_table, &scene);
    ck_assert_int_eq(rn_decode(&rn_scene_table, text, strlen(text), &scene, NULL, &err), RN_OK);
    ck_assert_int_eq(rn_encode(&rn_scene_description_table, &scene.description, &again, NULL, &err),
                     RN_OK);
    json_t *told = json_loads(again, 0, NULL);
    ck_assert_msg(json_equal(description, told), "%s", again);
    json_decref(told);
    free(again);
    rn_message_finish(&rn_scene_table, &scene);
    json_decref(description);
    json_decref(whole);
    free(text);
}
END_TEST

// Axes as OpenGL has them, and a field of view.
#define CAMERA                                                                                     \
    "{\"world_from_camera\":[[1,0,0,0],[0,1,0,0],[0,0,1,0.1]],\"axes\":\"opengl\",\"width\":4,"    \
    "\"height\":3,\"fov_y_deg\":90}"

START_TEST(render_request_is_checked_and_settled) {
    static const char both[] = "{\"view\":\"test:1\",\"camera\":" CAMERA "}", neither[] = "{}";
    static const char wrong[] = "{\"camera\":{\"axes\":\"opencv\"}}";
    static const char depth[] = "{\"view\":\"test:1\",\"output\":\"depth\",\"format\":\"jpeg\"}";
    static const char good[] = "{\"view\":\"val:r_1\"}";
    struct rn_render_request request;
    struct rn_field_errors errors;
    ck_assert_int_ne(rn_render_request_decode(both, strlen(both), &request, &errors, NULL), RN_OK);
    ck_assert_str_eq(errors.items[0].pointer, "#/view");
    ck_assert_int_ne(rn_render_request_decode(wrong, strlen(wrong), &request, &errors, NULL),
                     RN_OK);
    ck_assert_str_eq(errors.items[0].pointer, "#/camera/world_from_camera");
    ck_assert_int_ne(rn_render_request_decode(neither, 2, &request, &errors, NULL), RN_OK);
    ck_assert_int_ne(rn_render_request_decode(depth, strlen(depth), &request, &errors, NULL),
                     RN_OK);
    ck_assert_str_eq(errors.items[0].pointer, "#/format");
    ck_assert_int_eq(rn_render_request_decode(good, strlen(good), &request, &errors, NULL), RN_OK);
    rn_render_request_settle(&request, RN_FORMAT_JPEG);
    char *json;
    ck_assert_int_eq(rn_encode(&rn_render_request_table, &request, &json, NULL, NULL), RN_OK);
    ck_assert_str_eq(json,
                     "{\"view\":\"val:r_1\",\"scale\":0,\"lens\":\"pinhole\",\"colours\":\"even\","
                     "\"output\":\"rgb\",\"format\":\"jpeg\",\"subsample\":1,"
                     "\"tolerance\":0,\"jpeg_quality\":90}");
    free(json);
    rn_message_finish(&rn_render_request_table, &request);
}
END_TEST

START_TEST(time_is_rfc3339) {
    char text[RN_TIME_MAX];
    rn_time_text(1772357400007, text);
    ck_assert_str_eq(text, "2026-03-01T09:30:00.007Z");
}
END_TEST

START_TEST(every_status_has_a_problem) {
    struct rn_error err = {.status = (enum rn_status)_i, .where = "#/scene", .text = "no"};
    char *json;
    ck_assert_int_eq(rn_problem_json_from_error(&err, &json, NULL), RN_OK);
    struct rn_api_problem problem;
    ck_assert_int_eq(rn_decode(&rn_api_problem_table, json, strlen(json), &problem, NULL, NULL),
                     RN_OK);
    ck_assert_int_ge(problem.status, 400);
    ck_assert_str_eq(problem.errors[0].pointer, "#/scene");
    rn_message_finish(&rn_api_problem_table, &problem);
    free(json);
}
END_TEST

#define COUNT(array) (int)(sizeof(array) / sizeof *(array))

static char *encoded(const struct rn_camera *camera) {
    struct rn_dataset_camera item = {.name = "a", .camera = *camera};
    char *json;
    ck_assert_int_eq(rn_encode(&rn_dataset_camera_table, &item, &json, NULL, NULL), RN_OK);
    return json;
}

// The API's camera is the reader's: a lens only where there is one, its parameters by name.
START_TEST(camera_as_json) {
    struct rn_camera camera = {.width = 4, .height = 3, .fx = 5, .fy = 6, .cx = 2, .cy = 1.5};
    for (int i = 0; i < 3; i++)
        camera.world_from_camera[i][i] = 1;
    char *json = encoded(&camera);
    ck_assert_ptr_null(strstr(json, "lens"));
    free(json);
    camera.lens = RN_LENS_FOV;
    camera.lens_k[0] = 0.75;
    json = encoded(&camera);
    ck_assert_ptr_nonnull(strstr(json, "\"lens\":{\"model\":\"fov\",\"omega\":0.75}"));
    free(json);
}
END_TEST

// However a request writes its camera, it is told in one way: equal cameras have equal texts.
START_TEST(camera_of_a_request) {
    static const char text[] = "{\"camera\":" CAMERA "}";
    struct rn_render_request request;
    char *json;
    ck_assert_int_eq(rn_render_request_decode(text, strlen(text), &request, NULL, NULL), RN_OK);
    ck_assert_double_eq_tol(request.camera.fx, 1.5, 1e-15);
    ck_assert_double_eq(request.camera.world_from_camera[2][2], -1);
    ck_assert_double_eq(request.camera.world_from_camera[2][3], 0.1);
    ck_assert_int_eq(rn_encode(&rn_render_request_table, &request, &json, NULL, NULL), RN_OK);
    struct rn_render_request again;
    ck_assert_int_eq(rn_render_request_decode(json, strlen(json), &again, NULL, NULL), RN_OK);
    const double *pose = &request.camera.world_from_camera[0][0];
    for (int i = 0; i < 12; i++)
        ck_assert_double_eq((&again.camera.world_from_camera[0][0])[i], pose[i]);
    ck_assert_double_eq(again.camera.fx, request.camera.fx);
    ck_assert_double_eq(again.camera.cy, request.camera.cy);
    free(json);
}
END_TEST

int main(void) {
    TCase *tests = tcase_create("codec");
    tcase_add_loop_test(tests, example_survives, 0, COUNT(examples));
    tcase_add_loop_test(tests, wrong_field_is_refused, 0, COUNT(refused));
    tcase_add_loop_test(tests, wrong_job_is_refused, 0, COUNT(refused_jobs));
    tcase_add_test(tests, all_errors_are_listed);
    tcase_add_test(tests, more_errors_than_fit_are_dropped);
    tcase_add_test(tests, absent_stays_absent);
    tcase_add_loop_test(tests, numbers_read_back_the_same, 0, 6);
    tcase_add_test(tests, missing_value_is_not_encoded);
    tcase_add_test(tests, strings_are_escaped);
    tcase_add_test(tests, camera_as_json);
    tcase_add_test(tests, camera_of_a_request);
    tcase_add_test(tests, lists_have_a_cursor);
    tcase_add_test(tests, description_is_part_of_a_scene);
    tcase_add_test(tests, render_request_is_checked_and_settled);
    tcase_add_test(tests, time_is_rfc3339);
    tcase_add_test(tests, zero_has_no_sign);
    tcase_add_loop_test(tests, every_status_has_a_problem, 0, RN_STATUS_COUNT);
    Suite *suite = suite_create("proto");
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}

// render, eval.

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

#include "client/commands/submit.h"
#include "client/follow.h"
#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/path/path.h"
#include "proto/dataset.h"
#include "proto/event.h"
#include "proto/render.h"

// Reads a JSON file of at most RN_PATH_MAX_BYTES; the text is the caller's to free.
static enum rn_exit read_document(const char *path, char **ret_text, size_t *ret_size) {
    struct rn_error err = {0};
    uint8_t *bytes = NULL;
    if (rn_file_read(path, RN_PATH_MAX_BYTES, &bytes, ret_size, &err) != RN_OK)
        return rn_client_fail(&err);
    *ret_text = (char *)bytes;
    return RN_EXIT_OK;
}

// ---- render ----

struct render_options {
    const char *view, *camera, *lens, *colours, *output, *file, *format, *crop;
    double at;
    struct rn_option_pair size;
    struct rn_optics_request optics;
    union rn_setting_value settings[RN_RENDER_SETTINGS];
};
#define RENDER(m) .offset = offsetof(struct render_options, m)
#define SIZE_OPTION(place)                                                                         \
    {                                                                                              \
        .name = "size", .kind = RN_OPTION_SIZE, place, .value = "WxH",                             \
        .members = "size|width|height", .min = 1, .max = 16384,                                    \
        .help = "pixels; else as the camera says"                                                  \
    }
#define AT_OPTION(place)                                                                           \
    {                                                                                              \
        .name = "at", .kind = RN_OPTION_SECONDS, place, .value = "T", .min = 0.01,                 \
        .max = 31536000, .help = "as it was after so much training: 15s; `show` lists the marks"   \
    }
#define SETTINGS_OPTION(place)                                                                     \
    { .name = "", .kind = RN_OPTION_SETTINGS, place, .settings = &rn_render_settings }
static const struct rn_option render_table[] = {
    {.name = "view",
     .kind = RN_OPTION_TEXT,
     RENDER(view),
     .value = "SPLIT:N",
     .help = "a view of the dataset: test:12 by index, test:r_12 by name"},
    {.name = "camera",
     .kind = RN_OPTION_TEXT,
     RENDER(camera),
     .value = "FILE",
     .help = "a camera of your own, JSON"},
    {.name = "lens",
     .kind = RN_OPTION_CHOICE,
     RENDER(lens),
     .choices = rn_lens_choice_names,
     .help = "how a view is rendered: without its photograph's lens (the default), or with it"},
    {.name = "colours",
     .kind = RN_OPTION_CHOICE,
     RENDER(colours),
     .choices = rn_colours_choice_names,
     .help =
         "a view in the exposure of all photographs (the default), or in its\nphotograph's own"},
    AT_OPTION(RENDER(at)),
    SIZE_OPTION(RENDER(size)),
    {.name = "output",
     .kind = RN_OPTION_CHOICE,
     RENDER(output),
     .choices = rn_output_kind_names,
     .help = "what the picture shows (rgb)"},
    SETTINGS_OPTION(RENDER(settings)),
    {.name = "", .kind = RN_OPTION_SETTINGS, RENDER(optics), .settings = &rn_optics_settings},
    {.name = "crop",
     .kind = RN_OPTION_TEXT,
     RENDER(crop),
     .value = "BOX",
     .help = "only what lies in the box X0,Y0,Z0,X1,Y1,Z1, dataset units"},
    {.name = "out",
     .letter = 'o',
     .kind = RN_OPTION_TEXT,
     RENDER(file),
     .value = "FILE",
     .members = "format",
     .help = "the picture: .png, .jpg, .jpeg, or .exr: linear colour, alpha, depth,\nnormals; one "
             "that is there is replaced"},
    {.name = "format",
     .kind = RN_OPTION_CHOICE,
     RENDER(format),
     .choices = rn_picture_format_names,
     .members = "",
     .help = "else by FILE's ending; png16: 16 bits a channel"},
    {0}};

static int format_of(const struct render_options *options) {
    const char *dot = strrchr(options->file, '.');
    if (options->format) return rn_name_index(rn_picture_format_names, options->format);
    if (dot && strcasecmp(dot, ".exr") == 0) return RN_FORMAT_EXR;
    if (dot && strcasecmp(dot, ".png") == 0) return RN_FORMAT_PNG;
    if (dot && (strcasecmp(dot, ".jpg") == 0 || strcasecmp(dot, ".jpeg") == 0))
        return RN_FORMAT_JPEG;
    return -1;
}

// The camera of a file {"camera": {...}}.
static enum rn_exit load_camera(const char *file, struct rn_camera *ret_camera) {
    struct rn_error err = {0};
    char *text = NULL;
    size_t size = 0;
    enum rn_exit code = read_document(file, &text, &size);
    if (code != RN_EXIT_OK) return code;
    enum rn_status status = rn_camera_parse(text, size, file, ret_camera, &err);
    free(text);
    return status == RN_OK ? RN_EXIT_OK : rn_client_fail(&err);
}

static enum rn_exit render_body(const struct render_options *options, char **ret_body) {
    struct rn_render_request request;
    rn_message_init(&rn_render_request_table, &request);
    if (options->camera) {
        enum rn_exit code = load_camera(options->camera, &request.camera);
        if (code != RN_EXIT_OK) return code;
    } else if (!rn_take_text("--view", options->view, NULL, request.view, sizeof request.view)) {
        return RN_EXIT_USAGE;
    }
    request.optics = options->optics;
    request.at = options->at;
    request.size.width = options->size.first;
    request.size.height = options->size.second;
    if (!rn_crop_option(options->crop, request.crop)) return RN_EXIT_USAGE;
    request.format = format_of(options);
    request.lens = options->lens ? rn_name_index(rn_lens_choice_names, options->lens) : -1;
    request.colours =
        options->colours ? rn_name_index(rn_colours_choice_names, options->colours) : -1;
    request.output = options->output ? rn_name_index(rn_output_kind_names, options->output) : -1;
    memcpy(request.settings, options->settings, sizeof options->settings);
    *ret_body = rn_api_encode(&rn_render_request_table, &request);
    rn_message_finish(&rn_render_request_table, &request);
    return *ret_body ? RN_EXIT_OK : RN_EXIT_FAILED;
}

// What `render --json` prints.
struct render_summary {
    char *file; // borrowed
    int64_t step;
    double at; // training seconds, of what was looked back at
    double render_ms;
    char scale[48]; // of a heat map's colours: "0 40 samples"
    // Of a budget; absent without one. client_ms: until the answer was here.
    double asked_ms, spent_ms, queue_ms, encode_ms, client_ms, expected_psnr, expected_spread;
    char setting[96], curve[16];
    int late;
};
static const struct rn_field_spec render_summary_fields[] = {
    RN_F_STRING(struct render_summary, file, RN_REQUIRED, 4096),
    RN_F_INT(struct render_summary, step, RN_REQUIRED | RN_NULLABLE, 0, INT64_MAX),
    RN_F_NUMBER(struct render_summary, at, 0, 0, INFINITY),
    RN_F_NUMBER(struct render_summary, render_ms, RN_REQUIRED | RN_NULLABLE, 0, INFINITY),
    RN_F_TEXT(struct render_summary, scale, 0, NULL),
    RN_F_NUMBER(struct render_summary, asked_ms, 0, 0, INFINITY),
    RN_F_NUMBER(struct render_summary, spent_ms, 0, 0, INFINITY),
    RN_F_NUMBER(struct render_summary, queue_ms, 0, 0, INFINITY),
    RN_F_NUMBER(struct render_summary, encode_ms, 0, 0, INFINITY),
    RN_F_NUMBER(struct render_summary, client_ms, 0, 0, INFINITY),
    RN_F_TEXT(struct render_summary, setting, 0, NULL),
    RN_F_TEXT(struct render_summary, curve, 0, NULL),
    RN_F_NUMBER(struct render_summary, expected_psnr, 0, -INFINITY, INFINITY),
    RN_F_NUMBER(struct render_summary, expected_spread, 0, 0, INFINITY),
    {.name = "late", .type = RN_TYPE_TRUTH, .offset = offsetof(struct render_summary, late)}};
static const struct rn_table render_summary_table =
    RN_TABLE(struct render_summary, "summary", render_summary_fields);

static double number_in(const char *header) {
    return *header ? atof(header) : NAN;
}

// A duration of Server-Timing, "queue;dur=1.5, render;dur=20.1", milliseconds; NAN: there is none.
static double timing_in(const char *header, const char *name) {
    char begin[32];
    snprintf(begin, sizeof begin, "%s;dur=", name);
    const char *found = strstr(header, begin);
    return found ? atof(found + strlen(begin)) : NAN;
}

static void print_budget(const struct render_summary *summary) {
    if (!*summary->setting) return;
    if (!isnan(summary->asked_ms)) printf(", asked for %g ms", summary->asked_ms);
    printf(", spent %.1f ms (waited %.1f, encoded in %.1f; here %.1f): %s", summary->spent_ms,
           summary->queue_ms, summary->encode_ms, summary->client_ms, summary->setting);
    if (!isnan(summary->expected_psnr)) printf(", %.1f dB expected", summary->expected_psnr);
    if (!isnan(summary->expected_spread)) printf(" +- %.1f", summary->expected_spread);
    printf(" by the %s curve", strcmp(summary->curve, "preset") == 0  ? "preset's"
                               : strcmp(summary->curve, "stale") == 0 ? "scene's older"
                                                                      : "scene's");
    if (summary->late > 0)
        printf("%s", !isnan(summary->asked_ms)        ? ", late"
                     : !isnan(summary->expected_psnr) ? ", below what was asked for"
                                                      : ", not known to be what was asked for");
}

// "0 40 samples"
static void print_scale(const struct render_summary *summary) {
    const char *high = strchr(summary->scale, ' ');
    if (high) printf(", dark is 0 and bright%s", high);
}

static void print_render(struct rn_client *client, const char *file, double client_ms,
                         const struct rn_http_reply *reply) {
    const char *timing = reply->server_timing;
    bool budget = *reply->budget.setting;
    struct render_summary summary = {.file = (char *)file,
                                     .step = *reply->step ? atoll(reply->step) : RN_ABSENT,
                                     .at = number_in(reply->at),
                                     .render_ms = timing_in(timing, "render"),
                                     .asked_ms = number_in(reply->budget.asked_ms),
                                     .spent_ms = number_in(reply->budget.spent_ms),
                                     .queue_ms = budget ? timing_in(timing, "queue") : NAN,
                                     .encode_ms = budget ? timing_in(timing, "encode") : NAN,
                                     .client_ms = budget ? client_ms : NAN,
                                     .expected_psnr = number_in(reply->budget.expected_psnr),
                                     .expected_spread = number_in(reply->budget.expected_spread),
                                     .late = *reply->budget.late ? atoi(reply->budget.late) : -1};
    snprintf(summary.scale, sizeof summary.scale, "%s", reply->scale);
    snprintf(summary.setting, sizeof summary.setting, "%s", reply->budget.setting);
    snprintf(summary.curve, sizeof summary.curve, "%s", reply->budget.curve);
    if (client->json) {
        char *json = rn_api_encode(&render_summary_table, &summary);
        if (json) puts(json);
        free(json);
        return;
    }
    printf("%s", file);
    if (*reply->step) printf(": step %s", reply->step);
    if (*reply->at) printf(", after %.1f s of training", summary.at);
    if (!isnan(summary.render_ms)) printf(", rendered in %.1f ms", summary.render_ms);
    print_scale(&summary);
    print_budget(&summary);
    putchar('\n');
}

static enum rn_exit check_render(const struct render_options *options) {
    if (!options->view == !options->camera)
        return rn_client_usage("render", "needs one of --view SPLIT:N and --camera FILE");
    if (!options->file) return rn_client_usage("render", "needs -o FILE");
    if (format_of(options) < 0)
        return rn_client_usage(options->file, "must end in .png, .jpg, .jpeg or .exr");
    enum rn_exit code = rn_client_check_target(options->file, true);
    return code == RN_EXIT_OK ? rn_check_budget(options->settings) : code;
}

static enum rn_exit run_render(struct rn_client *client, const void *context, const char **args) {
    const struct render_options *options = context;
    struct rn_error err = {0};
    char *body = NULL;
    enum rn_exit code = check_render(options);
    if (code == RN_EXIT_OK) code = render_body(options, &body);
    if (code != RN_EXIT_OK) return code;
    char *path = rn_api_path("scenes", args[0], "/render");
    struct rn_http_request request = {.method = "POST",
                                      .path = path ? path : "/",
                                      .content_type = "application/json",
                                      .body = body,
                                      .body_size = strlen(body)};
    struct rn_api_reply reply;
    int64_t begin_ns = rn_clock_ns();
    rn_api_exchange(client, &request, &reply); // a large picture may take its time
    double client_ms = (double)(rn_clock_ns() - begin_ns) * 1e-6;
    free(path);
    free(body);
    code = reply.code == RN_EXIT_OK ? RN_EXIT_OK : rn_api_complain(&reply);
    if (code == RN_EXIT_OK && rn_file_write_atomic(options->file, reply.http.body.data,
                                                   reply.http.body.size, &err) != RN_OK)
        code = rn_client_not_written(&err);
    if (code == RN_EXIT_OK) print_render(client, options->file, client_ms, &reply.http);
    rn_api_reply_finish(&reply);
    return code;
}

// ---- eval ----

struct eval_options {
    const char *split;
    int64_t views, scale;
    double at;
    union rn_setting_value settings[RN_RENDER_SETTINGS];
};
#define EVAL(m) .offset = offsetof(struct eval_options, m)
static const struct rn_option eval_table[] = {{.name = "split",
                                               .kind = RN_OPTION_CHOICE,
                                               EVAL(split),
                                               .choices = rn_split_names,
                                               .help = "the photographs to compare with (test)"},
                                              {.name = "views",
                                               .kind = RN_OPTION_INTEGER,
                                               EVAL(views),
                                               .value = "N",
                                               .min = 0,
                                               .max = 1e6,
                                               .help = "that many, evenly spaced; 0 takes all"},
                                              {.name = "scale",
                                               .kind = RN_OPTION_INTEGER,
                                               EVAL(scale),
                                               .value = "J",
                                               .min = 0,
                                               .max = 15,
                                               .help = "only the images 2^J times smaller"},
                                              AT_OPTION(EVAL(at)),
                                              SETTINGS_OPTION(EVAL(settings)),
                                              {0}};

struct eval_request {
    int type;
    char *scene;
    struct rn_eval_options options;
};
static const struct rn_field_spec eval_request_fields[] = {
    RN_F_NAME(struct eval_request, type, RN_REQUIRED, rn_job_type_names),
    RN_F_STRING(struct eval_request, scene, RN_REQUIRED, 4096),
    RN_F_OBJECT(struct eval_request, options, 0, &rn_eval_options_table)};
static const struct rn_table eval_request_table =
    RN_TABLE(struct eval_request, "evaluation request", eval_request_fields);

static char *eval_body(const struct eval_options *options, const char *scene) {
    struct eval_request request;
    rn_message_init(&eval_request_table, &request);
    request.type = RN_JOB_EVAL;
    request.scene = (char *)scene; // only read
    request.options.split = options->split ? rn_name_index(rn_split_names, options->split) : -1;
    request.options.views = options->views;
    request.options.scale = options->scale;
    request.options.at = options->at;
    memcpy(request.options.settings, options->settings, sizeof options->settings);
    return rn_api_encode(&eval_request_table, &request);
}

static void format_psnr(double psnr, char text[24]) {
    snprintf(text, 24, "%s", "identical");
    if (!isnan(psnr)) snprintf(text, 24, "%.2f", psnr);
}

static enum rn_exit print_evaluation(const char *json) {
    struct rn_eval_result result;
    struct rn_text_table table;
    struct rn_error err = {0};
    char psnr[24];
    if (rn_decode(&rn_eval_result_table, json, strlen(json), &result, NULL, &err) != RN_OK)
        return rn_client_fail(&err);
    rn_text_table_init(&table, ">SCALE|>PSNR|>SSIM|>MS");
    for (size_t i = 0; i < result.scale_count; i++) {
        format_psnr(result.scales[i].psnr, psnr);
        rn_text_table_row(&table, "%lld|%s|%.4f|%.1f", (long long)result.scales[i].scale, psnr,
                          result.scales[i].ssim, result.scales[i].render_ms);
    }
    format_psnr(result.psnr, psnr);
    rn_text_table_row(&table, "mean|%s|%.4f|", psnr, result.ssim);
    enum rn_status status = rn_text_table_print(&table, &err);
    rn_text_table_finish(&table);
    printf("\n%lld %s view%s, spread over views %.2f dB and %.4f, %.1f ms a frame (median)\n",
           (long long)result.views, rn_split_names[result.protocol.split],
           result.views == 1 ? "" : "s", result.psnr_spread, result.ssim_spread,
           result.render_ms_median);
    if (*result.setting)
        printf("by what was asked for, all were rendered with: %s\n", result.setting);
    if (isfinite(result.psnr_fitted))
        printf("with what each photograph may have of its own (exposure, pose, light) fitted on "
               "one half "
               "and scored on the other, %.2f dB\n",
               result.psnr_fitted);
    if (isfinite(result.lpips))
        printf("LPIPS (VGG) %.4f\n", result.lpips);
    else
        puts("LPIPS is not told: ripnerfd --lpips FILE names its weights");
    if (isfinite(result.depth_error))
        printf("depths at sparse points are off by %.2g %% of the distance (median)\n",
               100 * result.depth_error);
    printf("protocol: step %lld, background (%g, %g, %g), scales averaged %s, rounding %s, "
           "trained on %s, seed %lld, %s, %s\n",
           (long long)result.protocol.step, result.protocol.background[0],
           result.protocol.background[1], result.protocol.background[2],
           rn_downscale_names[result.protocol.downscale], result.protocol.rounding,
           rn_train_split_names[result.protocol.train_split], (long long)result.protocol.seed,
           result.protocol.device, result.protocol.kernels);
    rn_message_finish(&rn_eval_result_table, &result);
    return status == RN_OK ? RN_EXIT_OK : rn_client_fail(&err);
}

static enum rn_exit run_eval(struct rn_client *client, const void *context, const char **args) {
    const struct eval_options *options = context;
    struct rn_follow follow;
    enum rn_exit code = rn_check_budget(options->settings);
    if (code != RN_EXIT_OK) return code;
    code = rn_submit_and_follow(client, eval_body(options, args[0]), &follow);
    if (code == RN_EXIT_OK && follow.job.result) {
        if (client->json)
            puts(follow.job.result);
        else
            code = print_evaluation(follow.job.result);
    }
    rn_follow_finish(&follow);
    return code;
}

const struct rn_verb rn_verbs_render[] = {
    {.name = "render",
     .arguments = "SCENE -o FILE",
     .summary = "one picture of a scene, also while it trains",
     .details =
         "A camera file is {\"camera\": {\"world_from_camera\": [[4],[4],[4]],\n"
         "\"axes\": \"opencv\" or \"opengl\", \"width\", \"height\", \"fov_y_deg\"}}, or with\n"
         "fx, fy, cx, cy in the field of view's place. A picture of another shape than the "
         "camera's\n"
         "keeps its field of view from top to bottom. Depth is a 16-bit grey PNG whose text chunk\n"
         "ripnerf:depth_scale says how many dataset units 65535 stands for. Normals are colours, "
         "each of\n"
         "the dataset's axes from -1 to 1. Cost (samples a pixel), level (of the ripmap, at the "
         "surface)\n"
         "and footprint (diameter of a pixel's cone there) are heat maps whose scale is printed.\n"
         "FILE is replaced where it is there: a picture is made again in a moment, and over and "
         "over\nwith other settings. No other verb replaces a file without --overwrite.",
     .args_min = 1,
     .args_max = 1,
     .table = render_table,
     .options_size = sizeof(struct render_options),
     .run = run_render},
    {.name = "eval",
     .arguments = "SCENE",
     .summary = "PSNR and SSIM against photographs",
     .args_min = 1,
     .args_max = 1,
     .table = eval_table,
     .options_size = sizeof(struct eval_options),
     .run = run_eval},
    {0}};

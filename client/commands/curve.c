// curve: what accuracy costs in time, of one scene.

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "client/commands/submit.h"
#include "client/table.h"
#include "common/base/buf.h"
#include "common/base/file.h"
#include "proto/job.h"

struct curve_options {
    bool measure, overwrite;
    int64_t views;
    const char *plot;
};
#define CURVE(m) .offset = offsetof(struct curve_options, m)
static const struct rn_option curve_table[] = {
    {.name = "measure",
     .kind = RN_OPTION_FLAG,
     CURVE(measure),
     .help = "measure it now, also where it was measured before"},
    {.name = "views",
     .kind = RN_OPTION_INTEGER,
     CURVE(views),
     .needs = "measure",
     .value = "N",
     .min = 1,
     .max = 64,
     .help = "with --measure, on so many held-out views (16)"},
    {.name = "plot",
     .kind = RN_OPTION_TEXT,
     CURVE(plot),
     .value = "FILE",
     .help = "write the curve as a picture, .svg"},
    {.name = "overwrite",
     .kind = RN_OPTION_FLAG,
     CURVE(overwrite),
     .needs = "plot",
     .help = "replace the picture's file"},
    {0}};

struct curve_request {
    int type;
    char *scene;
    struct rn_curve_options options;
};
static const struct rn_field_spec curve_request_fields[] = {
    RN_F_NAME(struct curve_request, type, RN_REQUIRED, rn_job_type_names),
    RN_F_STRING(struct curve_request, scene, RN_REQUIRED, 4096),
    RN_F_OBJECT(struct curve_request, options, 0, &rn_curve_options_table)};
static const struct rn_table curve_request_table =
    RN_TABLE(struct curve_request, "curve request", curve_request_fields);

// ---- the plot -------------------------------------------------------------------------------

#define WIDTH 720
#define HEIGHT 420
#define LEFT 60
#define RIGHT 20
#define TOP 40
#define BOTTOM 50
#define MOST_TEXT (1u << 20)

struct axes {
    double low_ms, high_ms, low_db, high_db;
};

static double place_x(const struct axes *a, double ms) {
    return LEFT + (WIDTH - LEFT - RIGHT) * log(ms / a->low_ms) / log(a->high_ms / a->low_ms);
}

static double place_y(const struct axes *a, double db) {
    return TOP + (HEIGHT - TOP - BOTTOM) * (a->high_db - db) / (a->high_db - a->low_db);
}

static bool is_shown(const struct rn_curve_point *point) {
    return isfinite(rn_curve_worth(point));
}

static struct axes find_axes(const struct rn_curve_record *curve) {
    struct axes a = {.low_db = INFINITY, .high_db = -INFINITY};
    a.low_ms = fmax(0.8 * curve->points[0].ms_median, 1e-3);
    a.high_ms = fmax(1.25 * curve->points[curve->count - 1].ms_median, 2 * a.low_ms);
    for (size_t i = 0; i < curve->count; i++) {
        if (!is_shown(&curve->points[i])) continue;
        a.low_db = fmin(a.low_db, rn_curve_worth(&curve->points[i]));
        a.high_db = fmax(a.high_db, rn_curve_worth(&curve->points[i]));
    }
    if (!(a.low_db <= a.high_db)) a.low_db = a.high_db = 0;
    a.low_db = floor(a.low_db - 0.5);
    a.high_db = ceil(a.high_db + 0.5);
    return a;
}

static void draw_grid(struct rn_buf *svg, const struct axes *a) {
    static const double steps[] = {1, 2, 5};
    int every = a->high_db - a->low_db > 12 ? 2 : 1;
    for (int exponent = -3; exponent < 6; exponent++)
        for (int i = 0; i < 3; i++) {
            double ms = steps[i] * pow(10, exponent);
            if (ms < a->low_ms || ms > a->high_ms) continue;
            rn_buf_printf(svg,
                          "<path class='g' d='M%.1f %dV%d'/><text x='%.1f' y='%d' "
                          "text-anchor='middle'>%g</text>\n",
                          place_x(a, ms), TOP, HEIGHT - BOTTOM, place_x(a, ms),
                          HEIGHT - BOTTOM + 18, ms);
        }
    for (double db = a->low_db; db <= a->high_db; db += every)
        rn_buf_printf(svg,
                      "<path class='g' d='M%d %.1fH%d'/><text x='%d' y='%.1f' "
                      "text-anchor='end'>%g</text>\n",
                      LEFT, place_y(a, db), WIDTH - RIGHT, LEFT - 6, place_y(a, db) + 4, db);
}

static void draw_points(struct rn_buf *svg, const struct axes *a,
                        const struct rn_curve_record *curve) {
    char text[96];
    rn_buf_printf(svg, "<polyline class='c' points='");
    for (size_t i = 0; i < curve->count; i++)
        if (is_shown(&curve->points[i]))
            rn_buf_printf(svg, "%.1f,%.1f ", place_x(a, curve->points[i].ms_median),
                          place_y(a, rn_curve_worth(&curve->points[i])));
    rn_buf_printf(svg, "'/>\n");
    for (size_t i = 0; i < curve->count; i++) {
        const struct rn_curve_point *p = &curve->points[i];
        if (!is_shown(p)) continue;
        rn_curve_setting_text(&p->setting, text, sizeof text);
        rn_buf_printf(svg,
                      "<circle cx='%.1f' cy='%.1f' r='3.5'><title>%s: %.1f ms, %.2f dB"
                      "</title></circle>\n",
                      place_x(a, p->ms_median), place_y(a, rn_curve_worth(p)), text, p->ms_median,
                      rn_curve_worth(p));
    }
}

static enum rn_exit plot(const char *file, const char *scene, const struct rn_curve_record *curve) {
    struct rn_error err = {0};
    struct rn_buf svg;
    struct axes axes = find_axes(curve);
    rn_buf_init(&svg, MOST_TEXT);
    rn_buf_printf(&svg,
                  "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 %d %d' "
                  "font-family='sans-serif' font-size='12' fill='#333'>\n"
                  "<style>.g{stroke:#ddd;fill:none}.c{stroke:#2368a8;stroke-width:1.5;fill:none}"
                  "circle{fill:#2368a8}</style>\n<rect width='%d' height='%d' fill='#fff'/>\n"
                  "<text x='%d' y='22' font-size='14'>%s: %s, %lldx%lld, %lld views</text>\n",
                  WIDTH, HEIGHT, WIDTH, HEIGHT, LEFT, scene,
                  curve->photographs ? "PSNR on photographs, dB" : "PSNR to the full picture, dB",
                  (long long)curve->width, (long long)curve->height, (long long)curve->views);
    draw_grid(&svg, &axes);
    draw_points(&svg, &axes, curve);
    rn_buf_printf(&svg,
                  "<text x='%d' y='%d' text-anchor='middle'>milliseconds a picture "
                  "(%s, %lld threads, step %lld)</text>\n</svg>\n",
                  WIDTH / 2, HEIGHT - 10, curve->kernels, (long long)curve->threads,
                  (long long)curve->step);
    enum rn_status status = rn_buf_status(&svg, file, &err);
    if (status == RN_OK) status = rn_file_write_atomic(file, svg.data, svg.size, &err);
    rn_buf_finish(&svg);
    return status == RN_OK ? RN_EXIT_OK : rn_client_not_written(&err);
}

// ---- the table ------------------------------------------------------------------------------

static void format_db(double db, char text[24]) {
    snprintf(text, 24, "%s", "same");
    if (!isnan(db)) snprintf(text, 24, "%.2f", db);
}

static enum rn_exit print_curve(const struct rn_curve_record *curve) {
    struct rn_text_table table;
    struct rn_error err = {0};
    char psnr[24], full[24], setting[96];
    rn_text_table_init(&table, ">MS|>P95|>PSNR|>SSIM|>TO FULL|>RAYS|>SAMPLES|SETTING");
    for (size_t i = 0; i < curve->count; i++) {
        const struct rn_curve_point *p = &curve->points[i];
        format_db(p->psnr, psnr);
        format_db(p->psnr_full, full);
        rn_curve_setting_text(&p->setting, setting, sizeof setting);
        rn_text_table_row(&table, "%.1f|%.1f|%s|%.4f|%s|%.0f|%.0f|%s", p->ms_median, p->ms_p95,
                          isnan(p->psnr) ? "" : psnr, p->ssim, full, p->rays, p->samples, setting);
    }
    enum rn_status status = rn_text_table_print(&table, &err);
    rn_text_table_finish(&table);
    printf("\n%lldx%lld, %lld %s, step %lld, measured in %.0f s on %s, %s, %lld threads\n",
           (long long)curve->width, (long long)curve->height, (long long)curve->views,
           curve->photographs ? curve->views == 1 ? "held-out view" : "held-out views"
                              : "views against the full picture",
           (long long)curve->step, curve->seconds, curve->machine, curve->kernels,
           (long long)curve->threads);
    if (curve->stale)
        printf("stale: %s changed since; measure it again with --measure\n", curve->stale_because);
    return status == RN_OK ? RN_EXIT_OK : rn_client_fail(&err);
}

static enum rn_exit measure(struct rn_client *client, const struct curve_options *options,
                            const char *scene) {
    struct curve_request request;
    struct rn_follow follow;
    rn_message_init(&curve_request_table, &request);
    request.type = RN_JOB_CURVE;
    request.scene = (char *)scene; // only read
    request.options.views = options->views;
    enum rn_exit code =
        rn_submit_and_follow(client, rn_api_encode(&curve_request_table, &request), &follow);
    rn_follow_finish(&follow);
    return code;
}

static enum rn_exit check_plot(const struct curve_options *options) {
    const char *dot = options->plot ? strrchr(options->plot, '.') : NULL;
    if (!options->plot) return RN_EXIT_OK;
    if (!dot || strcasecmp(dot, ".svg") != 0)
        return rn_client_usage("--plot", "must end in .svg; it is '%s'", options->plot);
    return rn_client_check_target(options->plot, options->overwrite);
}

static enum rn_exit run_curve(struct rn_client *client, const void *context, const char **args) {
    const struct curve_options *options = context;
    struct rn_curve_record curve;
    struct rn_error err = {0};
    struct rn_api_reply reply;
    enum rn_exit code = check_plot(options);
    if (code == RN_EXIT_OK && options->measure) code = measure(client, options, args[0]);
    if (code != RN_EXIT_OK) return code;
    char *path = rn_api_path("scenes", args[0], "/curve");
    rn_api_send(client, "GET", path ? path : "/", NULL, &reply);
    free(path);
    code = reply.code == RN_EXIT_OK ? RN_EXIT_OK : rn_api_complain(&reply);
    if (code == RN_EXIT_OK && rn_decode(&rn_curve_record_table, (char *)reply.http.body.data,
                                        reply.http.body.size, &curve, NULL, &err) != RN_OK)
        code = rn_client_fail(&err);
    if (code == RN_EXIT_OK) {
        if (client->json)
            puts((char *)reply.http.body.data);
        else
            code = print_curve(&curve);
        if (code == RN_EXIT_OK && options->plot) code = plot(options->plot, args[0], &curve);
        rn_message_finish(&rn_curve_record_table, &curve);
    }
    rn_api_reply_finish(&reply);
    return code;
}

const struct rn_verb rn_verbs_curve[] = {
    {.name = "curve",
     .arguments = "SCENE",
     .summary = "what accuracy costs in time: the ways to render it that no other beats",
     .details = "Each line is a way to render: the median of its milliseconds, what it looks like "
                "beside\nheld-out photographs and beside the full picture, and its settings. "
                "render, path and eval\ngo by it when they are given --within, --render-psnr or "
                "--quality.",
     .args_min = 1,
     .args_max = 1,
     .table = curve_table,
     .options_size = sizeof(struct curve_options),
     .run = run_curve},
    {0}};

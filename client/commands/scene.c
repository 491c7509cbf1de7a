// scenes, show, rm, info.

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "client/commands/export_job.h"
#include "client/follow.h"
#include "client/outcome.h"
#include "common/math/numbers.h"
#include "proto/event.h"
#include "proto/render.h"
#include "proto/scene.h"

static const struct rn_option no_options[] = {{0}};

static const char *format_psnr(double psnr, char text[24]) {
    snprintf(text, 24, "%s", "-");
    if (!isnan(psnr)) snprintf(text, 24, "%.2f", psnr);
    return text;
}

static void add_scene_row(struct rn_text_table *table, const void *message) {
    const struct rn_scene *scene = message;
    char psnr[24], seconds[24];
    rn_format_seconds(scene->train_seconds, seconds, sizeof seconds);
    rn_text_table_row(table, "%s|%s|%s|%lld|%s|%s|%s|%s", scene->name, scene->id,
                      rn_scene_state_names[scene->state], (long long)scene->steps, seconds,
                      format_psnr(scene->psnr, psnr),
                      *scene->dataset_name ? scene->dataset_name : "-", scene->created_at);
}

static enum rn_exit run_scenes(struct rn_client *client, const void *options, const char **args) {
    static const struct rn_api_list list = {
        .kind = RN_KIND_SCENE,
        .table = &rn_scene_table,
        .heading = "NAME|ID|STATE|>STEPS|>TRAINED|>PSNR|DATASET|CREATED",
        .row = add_scene_row};
    return rn_api_print_list(client, &list);
}

// ---- show ----

static void print_field(const char *name, const char *fmt, ...) RN_PRINTF(2, 3);
static void print_field(const char *name, const char *fmt, ...) {
    va_list args;
    printf("%-12s", name);
    va_start(args, fmt);
    vprintf(fmt, args);
    va_end(args);
    putchar('\n');
}

static void print_config(const struct rn_train_config *config) {
    char growth[48] = "";
    if (config->grow_to > config->field.base)
        snprintf(growth, sizeof growth, " (growing to %d)", config->grow_to);
    print_field("field", "%d planes (%s), base %d%s, %d channels, %d levels, footprint %s",
                config->field.planes, rn_orientation_names[config->field.orientation],
                config->field.base, growth, config->field.channels, config->field.levels,
                rn_footprint_names[config->field.footprint]);
    print_field("networks", "width %d, %d + %d hidden layers, shaded per %s", config->field.width,
                config->field.base_layers, config->field.head_layers,
                rn_shading_names[config->field.shading]);
    print_field("preset", "%s, seed %llu, trained on %s", config->preset,
                (unsigned long long)config->seed, rn_train_split_names[config->train_val]);
}

static void print_differences(const void *message) {
    const struct rn_scene_description *description =
        &((const struct rn_scene *)message)->description;
    if (description->difference_count == 0) return;
    puts("\ndiffers from the paper (gain where measured: test PSNR of lego after 15 s)");
    for (size_t i = 0; i < description->difference_count; i++)
        printf("  %s%s%s\n", description->differences[i].what,
               *description->differences[i].measured ? ": " : "",
               description->differences[i].measured);
}

static void count_differences(const void *message) {
    const struct rn_scene *scene = message;
    size_t count = scene->description.difference_count;
    if (count)
        printf("\ndiffers from the paper in %zu point%s: ripnerf show %s --paper\n", count,
               count == 1 ? "" : "s", scene->name);
}

static void print_effects(const struct rn_scene_description *description) {
    if (description->effect_count) puts("\neffects");
    for (size_t i = 0; i < description->effect_count; i++) {
        const struct rn_effect_entry *effect = &description->effects[i];
        printf("  %-16s %-8s  %s", effect->name,
               effect->decided ? effect->on ? "on" : "off" : "not yet", effect->reason);
        if (*effect->threshold_text)
            printf(" (%s %s)",
                   effect->below < 0   ? "threshold"
                   : effect->below > 0 ? "on if at most"
                                       : "on if over",
                   effect->threshold_text);
        putchar('\n');
    }
}

static void print_description(const struct rn_scene_description *description) {
    struct rn_train_config config = {.preset = ""};
    if (isnan(description->bounds.radius)) return; // it has not trained yet
    rn_settings_put(&rn_train_settings, description->config.settings, &config);
    print_config(&config);
    print_field("bounds", "centre (%g, %g, %g), radius %g", description->bounds.centre[0],
                description->bounds.centre[1], description->bounds.centre[2],
                description->bounds.radius);
    print_effects(description);
}

static void print_viewing(const struct rn_viewing_record *viewing) {
    char planes[64];
    if (viewing->bits == RN_ABSENT) return;
    rn_format_planes(viewing->bits, planes, sizeof planes);
    print_field("for viewing", "%s; it is not trained further", planes);
    print_field("", "%.2f dB on %lld %s views, %.3f dB less than the scene that it is of",
                viewing->psnr, (long long)viewing->views, rn_split_names[viewing->split],
                viewing->loss);
    print_field("", "trained on %s, written by ripnerf %s", viewing->dataset, viewing->version);
}

// What a scene on a GPU has the CPU do (tests/ops/device_pictures.c).
static void print_what_a_gpu_leaves(void) {
    print_field("CPU's alone", "cost, surfaces and a crop of a picture; aperture, open shutter and "
                               "parallel rays;");
    print_field("", "while it trains, pictures so coarse that they want levels which it has not");
}

static void print_scene(const void *message) {
    const struct rn_scene *scene = message;
    const struct rn_scene_description *made = &scene->description;
    char psnr[24], seconds[24], bytes[24];
    rn_format_seconds(scene->train_seconds, seconds, sizeof seconds);
    print_field("scene", "%s (%s)", scene->name, scene->id);
    print_field("state", "%s%s", rn_scene_state_names[scene->state],
                scene->loaded ? ", loaded" : "");
    if (*scene->dataset)
        print_field("dataset", "%s (%s)", scene->dataset_name, scene->dataset);
    else
        print_field("dataset", "none here");
    print_viewing(&made->viewing);
    print_field("trained", "%lld steps in %s by %s", (long long)scene->steps, seconds, scene->job);
    if (scene->state == RN_SCENE_FAILED) print_field("why", "ripnerf show %s", scene->job);
    print_field("PSNR", "%s dB%s%s", format_psnr(scene->psnr, psnr), *made->held_out ? " on " : "",
                made->held_out);
    print_field("parameters", "%s",
                *scene->parameters_sha256 ? scene->parameters_sha256 : "no checkpoint yet");
    if (*made->kernels) print_field("kernels", "%s", made->kernels);
    if (strncmp(made->kernels, "sm_", 3) == 0) print_what_a_gpu_leaves();
    if (made->memory_bytes != RN_ABSENT) {
        rn_format_bytes((double)made->memory_bytes, bytes, sizeof bytes);
        print_field("memory", "%s", bytes);
    }
    for (size_t i = 0; i < scene->checkpoint_count; i++) {
        rn_format_bytes((double)scene->checkpoints[i].size_bytes, bytes, sizeof bytes);
        print_field(i ? "" : "checkpoints", "step %lld, %s, %s",
                    (long long)scene->checkpoints[i].step, bytes, scene->checkpoints[i].created_at);
    }
    for (size_t i = 0; i < scene->mark_count; i++) {
        rn_format_bytes((double)scene->marks[i].size_bytes, bytes, sizeof bytes);
        print_field(i ? "" : "marks", "%.1f s, step %lld, %s", scene->marks[i].train_seconds,
                    (long long)scene->marks[i].step, bytes);
    }
    print_description(made);
}

static void print_dataset(const void *message) {
    const struct rn_dataset_record *dataset = message;
    char bytes[24];
    rn_format_bytes((double)dataset->size_bytes, bytes, sizeof bytes);
    print_field("dataset", "%s (%s)", dataset->name, dataset->id);
    print_field("views", "%lld to train, %lld to validate, %lld to test",
                (long long)dataset->views.train, (long long)dataset->views.val,
                (long long)dataset->views.test);
    print_field("images", "%lldx%lld, %lld scale%s, %s alpha, %s on disk",
                (long long)dataset->width, (long long)dataset->height, (long long)dataset->scales,
                dataset->scales == 1 ? "" : "s", dataset->has_alpha ? "with" : "without", bytes);
    print_field("averaged", "%s", dataset->premultiplied ? "premultiplied" : "straight");
    double radius = dataset->bounds.radius, centre[3], up[3];
    for (int i = 0; i < 3; i++) {
        centre[i] = rn_unless_zero(dataset->bounds.centre[i], radius);
        up[i] = rn_unless_zero(dataset->up[i], 1);
    }
    print_field("bounds", "centre (%g, %g, %g), radius %g, %s", centre[0], centre[1], centre[2],
                radius, rn_bounds_source_titles[dataset->bounds.source]);
    if (dataset->capture >= 0)
        print_field("capture", "%s, up is (%.3g, %.3g, %.3g)", rn_capture_titles[dataset->capture],
                    up[0], up[1], up[2]);
    if (isfinite(dataset->crop[0]))
        print_field("crop", "%g, %g, %g to %g, %g, %g", dataset->crop[0], dataset->crop[1],
                    dataset->crop[2], dataset->crop[3], dataset->crop[4], dataset->crop[5]);
    print_field("footprint", "%.3g to %.3g", dataset->footprint.min, dataset->footprint.max);
    print_field("created", "%s", dataset->created_at);
}

static void print_job(const void *message) {
    const struct rn_job *job = message;
    char text[400];
    double fraction;
    if (rn_job_has_ended(job))
        rn_format_outcome(job, text, sizeof text);
    else
        rn_format_progress(job, job->progress, &fraction, text, sizeof text);
    print_field("job", "%s, %s, attempt %lld", job->id, rn_job_type_names[job->type],
                (long long)job->attempt);
    print_field("state", "%s", rn_job_state_names[job->state]);
    if (*job->scene_name) print_field("scene", "%s (%s)", job->scene_name, job->scene);
    if (*job->dataset_name) print_field("dataset", "%s (%s)", job->dataset_name, job->dataset);
    print_field("created", "%s", job->created_at);
    if (*job->started_at) print_field("started", "%s", job->started_at);
    if (*job->finished_at) print_field("finished", "%s", job->finished_at);
    print_field("options", "%s", job->options);
    if (*text)
        print_field(job->problem            ? "problem"
                    : rn_job_has_ended(job) ? "result"
                                            : "progress",
                    "%s", text);
}

static void print_path(const void *message) {
    const struct rn_camera_path_record *path = message;
    print_field("camera path", "%s (%s)", path->name, path->id);
    print_field("created", "%s", path->created_at);
    puts(path->path.json);
}

static const struct {
    enum rn_kind kind;
    const struct rn_table *table;
    void (*print)(const void *message);
} shown[] = {{RN_KIND_SCENE, &rn_scene_table, print_scene},
             {RN_KIND_DATASET, &rn_dataset_table, print_dataset},
             {RN_KIND_JOB, &rn_job_table, print_job},
             {RN_KIND_PATH, &rn_camera_path_record_table, print_path}};

static enum rn_exit print_decoded(const struct rn_api_reply *reply, const struct rn_table *table,
                                  void (*print)(const void *message)) {
    void *message = malloc(table->size);
    enum rn_exit code = message ? rn_api_decode(reply, table, message) : RN_EXIT_FAILED;
    if (code == RN_EXIT_OK) {
        print(message);
        rn_message_finish(table, message);
    }
    free(message);
    return code;
}

struct show_options {
    bool paper;
};
static const struct rn_option show_table[] = {
    {.name = "paper",
     .kind = RN_OPTION_FLAG,
     .offset = offsetof(struct show_options, paper),
     .help = "also where a scene's training differs from the paper's"},
    {0}};

static enum rn_exit run_show(struct rn_client *client, const void *context, const char **args) {
    const struct show_options *options = context;
    struct rn_api_reply reply;
    enum rn_kind kind;
    enum rn_exit code =
        rn_api_find(client, RN_KIND_SCENE | RN_KIND_DATASET | RN_KIND_JOB | RN_KIND_PATH, args[0],
                    &kind, &reply);
    if (code != RN_EXIT_OK) return code;
    if (client->json) puts((char *)reply.http.body.data);
    for (size_t i = 0; !client->json && i < sizeof shown / sizeof *shown; i++)
        if (shown[i].kind == kind) code = print_decoded(&reply, shown[i].table, shown[i].print);
    if (!client->json && kind == RN_KIND_SCENE && code == RN_EXIT_OK)
        code = print_decoded(&reply, &rn_scene_table,
                             options->paper ? print_differences : count_differences);
    rn_api_reply_finish(&reply);
    return code;
}

// ---- rm ----

static enum rn_exit run_rm(struct rn_client *client, const void *options, const char **args) {
    struct rn_api_reply reply;
    enum rn_kind kind;
    if (strncmp(args[0], RN_ID_JOB, strlen(RN_ID_JOB)) == 0)
        return rn_client_usage(args[0], "jobs are not removed; to stop one: ripnerf cancel %s",
                               args[0]);
    enum rn_exit code =
        rn_api_find(client, RN_KIND_SCENE | RN_KIND_DATASET | RN_KIND_PATH, args[0], &kind, &reply);
    if (code != RN_EXIT_OK) return code;
    rn_api_reply_finish(&reply);
    char *path = rn_api_path(rn_api_collection(kind), args[0], "");
    if (!path) return RN_EXIT_FAILED;
    rn_api_send(client, "DELETE", path, NULL, &reply);
    free(path);
    code = reply.code == RN_EXIT_OK ? RN_EXIT_OK : rn_api_complain(&reply);
    if (code == RN_EXIT_OK && !client->json) printf("removed %s\n", args[0]);
    rn_api_reply_finish(&reply);
    return code;
}

// ---- info ----

static void print_info(const void *message) {
    const struct rn_info *info = message;
    char seconds[24], bytes[24];
    rn_format_seconds(info->uptime_s, seconds, sizeof seconds);
    rn_format_bytes((double)info->memory_limit_bytes, bytes, sizeof bytes);
    print_field("version", "%s, up for %s", info->version, seconds);
    if (*info->device)
        print_field("device", "%s, %s, %lld threads", info->device, info->device_name,
                    (long long)info->threads);
    else
        print_field("device", "not known: no runner has answered");
    if (strncmp(info->device, "cuda", 4) == 0) print_what_a_gpu_leaves();
    if (*info->kernels) {
        printf("%-12s%s, of", "kernels", info->kernels);
        for (size_t i = 0; i < info->available_kernel_count; i++)
            printf(" %s", info->available_kernels[i]);
        putchar('\n');
    }
    if (*info->device)
        print_field("films",
                    info->films ? "MP4, WebM, GIF" : "none: ripnerf-film.so is not installed");
    if (*info->executor)
        print_field("executor", "%s: scenes are trained on a cluster", info->executor);
    print_field("memory", "%s for all scenes", info->memory_limit_bytes ? bytes : "no limit");
    print_field("limits", "%lld training at once, %lld jobs waiting, %lld scenes loaded",
                (long long)info->limits.max_training_jobs, (long long)info->limits.max_queued_jobs,
                (long long)info->limits.max_scenes_loaded);
    if (strcmp(info->roots, "[]") == 0)
        print_field("roots", "none: datasets come by upload (ripnerfd --dataset-root)");
    else
        print_field("roots", "%s", info->roots);
}

static void add_place_row(struct rn_text_table *table, const void *message) {
    const struct rn_job *job = message;
    if (*job->runner.machine)
        rn_text_table_row(table, "%s|%s|%s|%s|%s", job->runner.machine, job->runner.slurm_job,
                          job->id, rn_job_type_names[job->type], job->scene_name);
}

static enum rn_exit print_places(struct rn_client *client) {
    static const struct rn_api_list list = {.kind = RN_KIND_JOB,
                                            .table = &rn_job_table,
                                            .heading = "MACHINE|SLURM|JOB|TYPE|FOR",
                                            .query = "&state=running",
                                            .row = add_place_row};
    putchar('\n');
    return rn_api_print_list(client, &list);
}

static bool is_on_a_cluster(const struct rn_api_reply *reply) {
    struct rn_info info;
    if (rn_api_decode(reply, &rn_info_table, &info) != RN_EXIT_OK) return false;
    bool is = *info.executor;
    rn_message_finish(&rn_info_table, &info);
    return is;
}

static enum rn_exit run_info(struct rn_client *client, const void *options, const char **args) {
    struct rn_api_reply reply;
    rn_api_send(client, "GET", "/v1/info", NULL, &reply);
    enum rn_exit code = reply.code;
    if (code != RN_EXIT_OK)
        rn_api_complain(&reply);
    else if (client->json)
        puts((char *)reply.http.body.data);
    else
        code = print_decoded(&reply, &rn_info_table, print_info);
    if (code == RN_EXIT_OK && !client->json && is_on_a_cluster(&reply)) code = print_places(client);
    rn_api_reply_finish(&reply);
    return code;
}

const struct rn_verb rn_verbs_scene[] = {
    {.name = "scenes",
     .arguments = "",
     .summary = "list scenes",
     .table = no_options,
     .run = run_scenes},
    {.name = "show",
     .arguments = "ID",
     .summary = "all about a scene, dataset, job or camera path",
     .args_min = 1,
     .args_max = 1,
     .table = show_table,
     .options_size = sizeof(struct show_options),
     .run = run_show},
    {.name = "rm",
     .arguments = "ID",
     .summary = "remove a scene, dataset or camera path",
     .args_min = 1,
     .args_max = 1,
     .table = no_options,
     .run = run_rm},
    {.name = "info",
     .arguments = "",
     .summary = "the daemon's version, device and limits",
     .table = no_options,
     .run = run_info},
    {0}};

#include "server/runner/scene/describe.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "proto/scene.h"

int64_t rn_resident_bytes(void) {
    FILE *file = fopen("/proc/self/statm", "r");
    long total, resident = 0;
    if (!file) return 0;
    if (fscanf(file, "%ld %ld", &total, &resident) != 2) resident = 0;
    fclose(file);
    return (int64_t)resident * sysconf(_SC_PAGESIZE);
}

// ---- configuration -------------------------------------------------------------------------

enum rn_status rn_configure(const struct rn_train_options *options, bool multi_scale,
                            struct rn_train_config *ret_config, struct rn_error *err) {
    struct rn_train_config config;
    const char *preset = rn_preset_names[rn_name_or(options->preset, 1)];
    enum rn_status status = rn_preset(preset, multi_scale, &config, err);
    if (status) return status;
    rn_train_config_choose(&config, options->settings);
    status = rn_train_config_check(&config, err);
    if (!status) *ret_config = config;
    return status;
}

// ---- scene ---------------------------------------------------------------------------------

enum { MAX_DIFFERENCES = 64 };

// Views that are not of the training's splits are not withheld from it, and not given back.
static size_t fill_differences(const struct rn_train_config *config, const char *held_out,
                               struct rn_difference_record *records) {
    struct rn_difference items[MAX_DIFFERENCES];
    struct rn_train_config told = *config;
    told.train_held_out = told.train_held_out || !strstr(held_out, RN_WITHHELD);
    if (told.train_held_out) told.give_back = 0;
    int count = rn_train_config_differences(&told, items, MAX_DIFFERENCES);
    for (int i = 0; i < count; i++) {
        snprintf(records[i].what, sizeof records[i].what, "%s", items[i].what);
        snprintf(records[i].measured, sizeof records[i].measured, "%s", items[i].measured);
    }
    return (size_t)count;
}

static struct rn_effect_entry effect_entry(enum rn_effect which,
                                           const struct rn_effect_record *effect) {
    struct rn_effect_entry entry = {.on = effect->on,
                                    .decided = effect->decided,
                                    .number = effect->number,
                                    .threshold = effect->threshold,
                                    .below = rn_effect_below(which),
                                    .measurable = rn_effect_is_optional(which, effect->on)};
    snprintf(entry.name, sizeof entry.name, "%s", effect->name);
    snprintf(entry.reason, sizeof entry.reason, "%s", effect->reason);
    rn_effect_text(which, effect->number, entry.number_text, sizeof entry.number_text);
    if (entry.below >= 0)
        rn_effect_text(which, effect->threshold, entry.threshold_text, sizeof entry.threshold_text);
    return entry;
}

// Absent of a scene that was trained here.
static void fill_viewing(const struct rn_viewing *from, struct rn_viewing_record *ret) {
    rn_message_init(&rn_viewing_table, ret);
    if (!from->bits) return;
    int split = rn_name_index(rn_split_names, from->split);
    *ret = (struct rn_viewing_record){.bits = from->bits,
                                      .views = from->views,
                                      .split = split < 0 ? RN_SPLIT_TRAIN : split,
                                      .psnr = from->psnr,
                                      .trained = from->trained,
                                      .loss = from->trained - from->psnr,
                                      .start = ret->start};
    snprintf(ret->dataset, sizeof ret->dataset, "%.*s", RN_NAME_MAX - 1, from->dataset);
    snprintf(ret->parameters_sha256, sizeof ret->parameters_sha256, "%s", from->sha256);
    snprintf(ret->version, sizeof ret->version, "%s", from->version);
    if (!from->has_start) return;
    ret->start.camera = from->start;
    memcpy(ret->start.up, from->up, sizeof from->up);
}

enum rn_status rn_describe_scene(const struct rn_field_info *info, const char *held_out,
                                 char **ret_json, struct rn_error *err) {
    struct rn_difference_record differences[MAX_DIFFERENCES];
    struct rn_effect_entry effects[RN_EFFECT_COUNT];
    struct rn_scene_description scene = {
        .differences = differences,
        .difference_count = fill_differences(&info->config, held_out ? held_out : "", differences),
        .effects = effects,
        .effect_count = RN_EFFECT_COUNT,
        .bounds = rn_describe_bounds(&info->bounds),
        .memory_bytes = rn_resident_bytes(),
    };
    for (int i = 0; i < RN_EFFECT_COUNT; i++)
        effects[i] = effect_entry((enum rn_effect)i, &info->effects[i]);
    fill_viewing(&info->viewing, &scene.viewing);
    rn_settings_get(&rn_train_settings, &info->config, scene.config.settings);
    scene.config.finest_cone = info->finest_cone;
    snprintf(scene.held_out, sizeof scene.held_out, "%s", held_out ? held_out : "");
    snprintf(scene.kernels, sizeof scene.kernels, "%s", info->kernels);
    return rn_encode(&rn_scene_description_table, &scene, ret_json, NULL, err);
}

struct rn_train_progress rn_describe_progress(const struct rn_progress *progress,
                                              const struct rn_train_config *config) {
    struct rn_train_progress message = {
        .step = progress->step,
        .max_steps = config->max_steps,
        .train_seconds = progress->train_seconds,
        .max_seconds = config->max_seconds,
        .load_seconds = progress->load_seconds,
        .evaluate_seconds = progress->evaluate_seconds,
        .loss = progress->loss,
        .rays_per_second = progress->rays_per_second,
        .samples_per_second = progress->samples_per_second,
        .samples = (int64_t)progress->samples,
        .psnr = progress->psnr,
        .psnr_step = isnan(progress->psnr) ? RN_ABSENT : progress->psnr_step,
        .nonfinite = {.rays = (int64_t)progress->nonfinite_rays,
                      .steps_rejected = (int64_t)progress->steps_rejected,
                      .rollbacks = (int64_t)progress->rollbacks},
        .eta_seconds = progress->eta_seconds,
        .fraction = progress->fraction,
    };
    for (size_t i = 0; i < RN_PROGRESS_LEVELS; i++) {
        message.level_samples[i] = (int64_t)progress->level_samples[i];
        if (message.level_samples[i]) message.level_count = i + 1;
    }
    return message;
}

// ---- dataset -------------------------------------------------------------------------------

static struct rn_split_counts split_counts(const int counts[RN_SPLIT_COUNT]) {
    return (struct rn_split_counts){.train = counts[RN_SPLIT_TRAIN],
                                    .val = counts[RN_SPLIT_VAL],
                                    .test = counts[RN_SPLIT_TEST]};
}

void rn_make_relative(char *text, const char *root) {
    size_t length = strlen(root);
    for (char *at = text; length && (at = strstr(at, root)) != NULL;) {
        if (at[length] == '/')
            memmove(at, at + length + 1, strlen(at + length + 1) + 1);
        else
            at += length;
    }
}

static enum rn_status encode_report(struct rn_dataset_report_record *report, const char *root,
                                    char **ret_json, struct rn_error *err) {
    for (size_t i = 0; i < report->problem_count; i++) {
        rn_make_relative(report->problems[i].where, root);
        rn_make_relative(report->problems[i].text, root);
    }
    enum rn_status status = rn_encode(&rn_dataset_report_table, report, ret_json, NULL, err);
    rn_message_finish(&rn_dataset_report_table, report);
    return status;
}

enum rn_status rn_describe_photos_report(const struct rn_dataset *frames, const char *root,
                                         const struct rn_problems *problems,
                                         const struct rn_findings *survey, char **ret_json,
                                         struct rn_error *err) {
    struct rn_dataset_report_record report;
    enum rn_status status = rn_photos_report_fill(frames, problems, survey, &report, err);
    return status ? status : encode_report(&report, root, ret_json, err);
}

enum rn_status rn_describe_report(const struct rn_dataset *source, const char *root,
                                  const struct rn_problems *problems,
                                  const struct rn_findings *survey,
                                  const struct rn_import_options *kept, char **ret_json,
                                  struct rn_error *err) {
    struct rn_dataset_report_record report;
    enum rn_status status = rn_dataset_report_fill(source, problems, survey, kept, &report, err);
    return status ? status : encode_report(&report, root, ret_json, err);
}

enum rn_status rn_describe_dataset(const struct rn_dataset *dataset, int64_t size_bytes,
                                   const struct rn_dataset *source, const char *root,
                                   const struct rn_problems *problems,
                                   const struct rn_findings *survey, char **ret_json,
                                   struct rn_error *err) {
    struct rn_dataset_report report;
    const struct rn_lie *lie = &dataset->lie;
    const double *low = lie->crop.low, *high = lie->crop.high;
    rn_dataset_describe(dataset, &report);
    struct rn_dataset_record record = {
        .views = split_counts(dataset->view_count),
        .scales = dataset->scale_count,
        .frames = (int64_t)dataset->frame_count,
        .width = report.width_max,
        .height = report.height_max,
        .has_alpha = report.with_alpha > 0,
        .bounds = rn_describe_bounds(&dataset->bounds),
        .capture = (int)lie->kind,
        .up = {lie->up[0], lie->up[1], lie->up[2]},
        .crop = {lie->cropped ? low[0] : NAN, low[1], low[2], high[0], high[1], high[2]},
        .footprint = {report.footprint_min, report.footprint_max},
        .size_bytes = size_bytes,
        .premultiplied = dataset->premultiplied_scales,
    };
    enum rn_status status =
        rn_describe_report(source, root, problems, survey, NULL, &record.report, err);
    if (!status) status = rn_encode(&rn_dataset_contents_table, &record, ret_json, NULL, err);
    free(record.report);
    return status;
}

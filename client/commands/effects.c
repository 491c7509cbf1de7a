// effects: what each of a scene's effects brings and costs, measured on its own photographs.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "client/commands/submit.h"
#include "client/table.h"
#include "proto/scene.h"

struct effects_options {
    bool measure;
    double seconds;
    int64_t seeds;
};
#define EFFECTS(m) .offset = offsetof(struct effects_options, m)
static const struct rn_option effects_table[] = {
    {.name = "measure",
     .kind = RN_OPTION_FLAG,
     EFFECTS(measure),
     .help = "measure it now, also where it was measured before"},
    {.name = "seconds",
     .kind = RN_OPTION_SECONDS,
     EFFECTS(seconds),
     .needs = "measure",
     .value = "TIME",
     .min = 1,
     .max = 3600,
     .help = "with --measure, time of each training: 10s, 1m (10s)"},
    {.name = "seeds",
     .kind = RN_OPTION_INTEGER,
     EFFECTS(seeds),
     .needs = "measure",
     .value = "N",
     .min = 1,
     .max = 16,
     .help = "with --measure, pairs of trainings an effect (3)"},
    {0}};

struct effects_request {
    int type;
    char *scene;
    struct rn_effects_options options;
};
static const struct rn_field_spec effects_request_fields[] = {
    RN_F_NAME(struct effects_request, type, RN_REQUIRED, rn_job_type_names),
    RN_F_STRING(struct effects_request, scene, RN_REQUIRED, 4096),
    RN_F_OBJECT(struct effects_request, options, 0, &rn_effects_options_table)};
static const struct rn_table effects_request_table =
    RN_TABLE(struct effects_request, "effects request", effects_request_fields);

static enum rn_exit measure(struct rn_client *client, const struct effects_options *options,
                            const char *scene) {
    struct effects_request request;
    struct rn_follow follow;
    rn_message_init(&effects_request_table, &request);
    request.type = RN_JOB_EFFECTS;
    request.scene = (char *)scene; // only read
    request.options.seconds = options->seconds;
    request.options.seeds = options->seeds;
    enum rn_exit code =
        rn_submit_and_follow(client, rn_api_encode(&effects_request_table, &request), &follow);
    rn_follow_finish(&follow);
    return code;
}

static void format(char text[24], const char *how, double number) {
    snprintf(text, 24, "%s", "");
    if (!isnan(number)) snprintf(text, 24, how, number);
}

static const struct rn_effect_gain *find_gain(const struct rn_effects_record *measured,
                                              const char *name) {
    for (size_t i = 0; measured && i < measured->count; i++)
        if (strcmp(measured->gains[i].name, name) == 0) return &measured->gains[i];
    return NULL;
}

static void add_row(struct rn_text_table *table, const struct rn_effect_entry *effect,
                    const struct rn_effect_gain *gain) {
    char db[24] = "", spread[24] = "", cost[24] = "", picture[24] = "";
    if (gain) {
        format(db, "%+.2f", gain->gain);
        format(spread, "%.2f", gain->gain_spread);
        format(cost, "%+.0f %%", 100 * gain->cost);
        format(picture, "%+.0f %%", 100 * gain->picture_cost);
    }
    rn_text_table_row(table, "%s|%s|%s|%s|%s|%s|%s", effect->name,
                      effect->decided ? effect->on ? "on" : "off" : "not yet", db, spread, cost,
                      picture, effect->reason);
}

// How long it takes to measure them, but for evaluations and what loads: " (3 min of trainings)";
// "" where that is not known.
static void format_duration(const struct rn_scene_description *made, char *ret_text, size_t size) {
    int count = 0;
    for (size_t i = 0; i < made->effect_count; i++)
        count += made->effects[i].measurable == 1;
    snprintf(ret_text, size, "%s", "");
    if (count)
        snprintf(ret_text, size, " (%.0f min of trainings)",
                 2 * count * RN_EFFECTS_SEEDS * RN_EFFECTS_SECONDS / 60);
}

static enum rn_exit print_effects(const struct rn_scene *scene,
                                  const struct rn_effects_record *measured) {
    struct rn_text_table table;
    struct rn_error err = {0};
    char duration[48];
    const struct rn_scene_description *made = &scene->description;
    rn_text_table_init(&table, "EFFECT|STATE|>GAIN, DB|>+-|>TRAINING|>PICTURE|WHY");
    for (size_t i = 0; i < made->effect_count; i++)
        add_row(&table, &made->effects[i], find_gain(measured, made->effects[i].name));
    enum rn_status status = rn_text_table_print(&table, &err);
    rn_text_table_finish(&table);
    if (measured)
        printf("\n%lld trainings of %g s with each and without, in pairs; %s; %s, %s, %lld "
               "threads\n",
               (long long)measured->seeds, measured->seconds, measured->held_out, measured->machine,
               measured->kernels, (long long)measured->threads);
    if (measured && measured->seconds < 0.5 * scene->train_seconds)
        printf("the scene itself trained %.0f s: what gains late does not show in so short ones; "
               "--seconds %.0f tells\n",
               scene->train_seconds, scene->train_seconds);
    format_duration(made, duration, sizeof duration);
    if (!measured && made->viewing.bits == RN_ABSENT)
        printf("\nwhat they bring was not measured: ripnerf effects %s --measure%s\n", scene->name,
               duration);
    return status == RN_OK ? RN_EXIT_OK : rn_client_fail(&err);
}

static enum rn_exit tell(struct rn_client *client, const char *name,
                         const struct rn_effects_record *measured) {
    struct rn_scene scene;
    enum rn_exit code = rn_api_get(client, "scenes", name, "", &rn_scene_table, &scene);
    if (code != RN_EXIT_OK) return code;
    code = print_effects(&scene, measured);
    rn_message_finish(&rn_scene_table, &scene);
    return code;
}

// What was measured; without it a scene is told as it is, but not in JSON.
static enum rn_exit run_effects(struct rn_client *client, const void *context, const char **args) {
    const struct effects_options *options = context;
    struct rn_effects_record measured;
    struct rn_error err = {0};
    struct rn_api_reply reply;
    enum rn_exit code = options->measure ? measure(client, options, args[0]) : RN_EXIT_OK;
    if (code != RN_EXIT_OK) return code;
    char *path = rn_api_path("scenes", args[0], "/effects");
    rn_api_send(client, "GET", path ? path : "/", NULL, &reply);
    free(path);
    bool known = reply.code == RN_EXIT_OK;
    if (!known && (client->json || reply.code != RN_EXIT_NOT_FOUND))
        code = rn_api_complain(&reply);
    else if (client->json)
        puts((char *)reply.http.body.data);
    else if (!known)
        code = tell(client, args[0], NULL);
    else if (rn_decode(&rn_effects_record_table, (char *)reply.http.body.data, reply.http.body.size,
                       &measured, NULL, &err) != RN_OK)
        code = rn_client_fail(&err);
    else {
        code = tell(client, args[0], &measured);
        rn_message_finish(&rn_effects_record_table, &measured);
    }
    rn_api_reply_finish(&reply);
    return code;
}

const struct rn_verb rn_verbs_effects[] = {
    {.name = "effects",
     .arguments = "SCENE",
     .summary = "which effects the photographs call for, why, and what each brings and costs",
     .details =
         "With --measure short trainings of the scene's own photographs are compared, with an "
         "effect\nand without it, in pairs of one seed: the gain in dB on the withheld views "
         "after equal time,\nhalf the range of the pairs' gains, and how much more time a "
         "training ray and a picture\ntake with it. What cannot be switched has no gain.",
     .args_min = 1,
     .args_max = 1,
     .table = effects_table,
     .options_size = sizeof(struct effects_options),
     .run = run_effects},
    {0}};

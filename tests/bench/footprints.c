#include "tests/bench/footprints.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void bench_die(const struct rn_error *err) {
    fprintf(stderr, "%s: %s: %s\n", program_invocation_short_name, err->where, err->text);
    exit(1);
}

bool bench_set_option(struct bench_training *t, const char *name, const char *value) {
    if (strcmp(name, "time") == 0)
        t->seconds = atof(value);
    else if (strcmp(name, "steps") == 0)
        t->steps = atoll(value);
    else if (strcmp(name, "preset") == 0)
        t->preset = value;
    else if (strcmp(name, "seed") == 0)
        t->seed = strtoull(value, NULL, 10);
    else if (strcmp(name, "threads") == 0)
        t->threads = atoi(value);
    else
        return false;
    return true;
}

struct rn_field *bench_train(const struct bench_training *t, enum rn_footprint footprint,
                             bool effects, struct rn_progress *ret_progress) {
    struct rn_error err;
    struct rn_train_config config;
    struct rn_trainer *trainer;
    if (rn_preset(t->preset, t->dataset->scale_count > 1, &config, &err) != RN_OK) bench_die(&err);
    config.field.footprint = footprint;
    config.footprint_given = true;
    config.auto_effects = config.auto_effects && effects;
    config.seed = t->seed;
    config.max_steps = t->steps;
    config.max_seconds = t->steps > 0 ? 0 : t->seconds;
    rn_train_config_suit_time(&config);
    if (rn_trainer_create(t->engine, t->dataset, &config, 0, &trainer, &err) != RN_OK)
        bench_die(&err);
    do {
        if (rn_trainer_advance(trainer, 200, &err) != RN_OK) bench_die(&err);
        rn_trainer_progress(trainer, ret_progress);
    } while (!ret_progress->done);
    return rn_trainer_finish(&trainer);
}

double bench_difference(const struct rn_picture *a, const struct rn_picture *b) {
    double sum = 0;
    size_t n = (size_t)a->width * (size_t)a->height * 3;
    for (size_t i = 0; i < n; i++)
        sum += fabs((double)a->values[i] - (double)b->values[i]);
    return sum / (double)n;
}

void bench_clamp(struct rn_picture *picture) {
    size_t n = (size_t)picture->width * (size_t)picture->height * (size_t)picture->channels;
    for (size_t i = 0; i < n; i++)
        picture->values[i] = fminf(fmaxf(picture->values[i], 0), 1);
}

// Downscaling: photographs of more pixels than the time given has rays for are trained on made
// smaller. A pixel of a smaller photograph is the mean of several, and each ray that goes through
// it learns from them all; what is lost is detail that so few rays would not have shown. Pictures
// that are asked for, and evaluations, keep the photographs' own size.
#include <math.h>
#include <stdio.h>

#include "server/engine/effects/effects.h"

// Of two cores that train a place: how steps are counted as seconds, so that a training by steps
// has the same bytes everywhere.
#define SAMPLES_A_SECOND 3.6e6

struct photographs {
    int count, width, height; // of the largest
    double megapixels;        // of all
};

static struct photographs look_at(const struct rn_dataset *dataset,
                                  const struct rn_train_config *config) {
    struct photographs all = {0};
    for (size_t i = 0; i < dataset->frame_count; i++) {
        const struct rn_frame *frame = &dataset->frames[i];
        int width = frame->camera.width, height = frame->camera.height;
        if (frame->split != RN_SPLIT_TRAIN && !(config->train_val && frame->split == RN_SPLIT_VAL))
            continue;
        all.count++;
        all.megapixels += 1e-6 * width * height;
        if ((int64_t)width * height <= (int64_t)all.width * all.height) continue;
        all.width = width;
        all.height = height;
    }
    return all;
}

// Seconds of training; 0: without a limit.
static double time_of(const struct rn_train_config *config) {
    double steps = (double)config->max_steps * config->target_samples / SAMPLES_A_SECOND;
    if (config->max_seconds > 0 && steps > 0) return fmin(config->max_seconds, steps);
    return config->max_seconds > 0 ? config->max_seconds : steps;
}

static int suit(const struct photographs *p, double seconds) {
    int side = p->width > p->height ? p->width : p->height;
    return rn_train_scale_by_time(p->megapixels, side, seconds);
}

int rn_effect_scale(const struct rn_dataset *dataset, const struct rn_train_config *config) {
    struct photographs photographs = look_at(dataset, config);
    enum rn_effect_choice choice = config->effect[RN_EFFECT_DOWNSCALING];
    if (choice == RN_EFFECT_UNWANTED) return 1;
    if (config->train_scale > 0) return config->train_scale;
    bool measured = config->auto_effects && dataset->scale_count == 1;
    int scale = measured ? suit(&photographs, time_of(config)) : 1;
    return choice == RN_EFFECT_WANTED && scale == 1 ? 2 : scale;
}

static void prepare(const struct rn_dataset *dataset, struct rn_train_config *config,
                    struct rn_bounds *bounds, struct rn_effect_record *r) {
    struct photographs p = look_at(dataset, config);
    double seconds = time_of(config);
    bool asked = config->train_scale > 0;
    char time[32] = "no limit of time";
    (void)bounds;
    config->train_scale = rn_effect_scale(dataset, config);
    r->number = seconds > 0 ? p.megapixels / seconds : NAN;
    r->threshold = RN_TRAIN_MEGAPIXELS;
    r->on = config->train_scale > 1;
    if (seconds > 0) snprintf(time, sizeof time, "%.3g s", seconds);
    int length =
        snprintf(r->reason, sizeof r->reason, "%d photographs, %dx%d, are %.3g megapixels for %s",
                 p.count, p.width, p.height, p.megapixels, time);
    if (r->on)
        snprintf(r->reason + length, sizeof r->reason - (size_t)length,
                 ": trained on at 1/%d of their size%s", config->train_scale,
                 asked ? ", as asked" : "");
}

const struct rn_effect_row rn_effect_downscaling = {
    .unit = {" megapixels a second", 1},
    .prepare = prepare,
};

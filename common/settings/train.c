#include "common/settings/train.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static const struct rn_train_config paper = {
    .preset = "paper",
    .field = {.planes = 10,
              .orientation = RN_ORIENTATION_PLATONIC,
              .base = 512,
              .channels = 16,
              .levels = 8,
              .footprint = RN_FOOTPRINT_RIP,
              .shading = RN_SHADING_SAMPLE,
              .width = 128,
              .base_layers = 2,
              .head_layers = 4,
              .view_dependence = true,
              .occupancy = 128},
    .step = 2 * 1.7320508075688772 / 1024,
    .target_samples = 262144,
    .initial_rays = 8192,
    .learning_rate = 2e-3,
    .plane_rate = 10,
    .weight_decay = 1e-5,
    .beta2 = 0.999,
    .adam_eps = 1e-15,
    .max_steps = 120000,
    .multi_step_rate = true,
    .stop = 1e-4,
    .background = {1, 1, 1},
};

static const struct rn_train_config standard = {
    .preset = "standard",
    .field = {.planes = 3,
              .orientation = RN_ORIENTATION_PLATONIC,
              .base = 64,
              .channels = 16,
              .levels = 8,
              .footprint = RN_FOOTPRINT_RIP,
              .shading = RN_SHADING_RAY,
              .width = 64,
              .base_layers = 1,
              .head_layers = 2,
              .view_dependence = true,
              .occupancy = 128},
    .step = 0.005,
    .target_samples = 32768,
    .initial_rays = 4096,
    .learning_rate = 8e-3,
    .plane_rate = 10,
    .weight_decay = 0,
    .beta2 = 0.99,
    .adam_eps = 1e-15,
    .grow_to = 512,
    .max_seconds = 60,
    .carve = true,
    .roulette = 1,
    .sparse = true,
    .favour_finest = true,
    .cone_step = true,
    .auto_effects = true,
    .stop = 2e-3,
    .refine_at_rest = true,
    .supersample = true,
    .background = {1, 1, 1},
    .random_background = 0.2,
    .smoothing = 0.1,
};

// On two cores, lego: a second hidden layer of the colour network is 0.1 dB behind after 15 s (two
// seeds) and 0.25 dB ahead after 60; networks twice as wide are level after 60 s and 0.4 dB ahead
// after 300. In 10,000 steps of these, half the smoothing is 0.15 dB ahead, the networks' decay
// 0.1, and splitting pixels 0.6; frames then take three times as long or more.
#define SHORT_RUN 40 // seconds
#define LONG_RUN 120

enum rn_status rn_preset(const char *name, bool multi_scale, struct rn_train_config *ret_config,
                         struct rn_error *err) {
    if (strcmp(name, "paper") == 0) {
        *ret_config = paper;
        return RN_OK;
    }
    if (strcmp(name, "standard") != 0 && strcmp(name, "draft") != 0)
        return rn_error_set(err, RN_ERROR_INVALID, "preset",
                            "'%s' is no preset; use draft, standard or paper", name);
    *ret_config = standard;
    // Few rays need levels then, and those of the isotropic pyramid cost half the fetches.
    if (multi_scale) ret_config->field.footprint = RN_FOOTPRINT_MIP;
    if (strcmp(name, "draft") == 0) {
        snprintf(ret_config->preset, sizeof ret_config->preset, "draft");
        ret_config->field.base = 64;
        ret_config->grow_to = 256;
        ret_config->target_samples = 16384;
        ret_config->step = 0.0068;
        ret_config->stop = 4e-3;
        ret_config->max_seconds = 15;
        ret_config->field.head_layers = 1;
        ret_config->draw_by_error = true;
    }
    return RN_OK;
}

void rn_train_config_suit_time(struct rn_train_config *config) {
    double seconds = config->max_seconds;
    if (strcmp(config->preset, "standard") != 0) return;
    bool is_short = seconds > 0 && seconds < SHORT_RUN;
    config->field.head_layers = is_short ? 1 : 2;
    config->draw_by_error = is_short;
    bool is_long = seconds >= LONG_RUN;
    config->field.width = is_long ? 128 : 64;
    config->smoothing = is_long ? 0.05 : 0.1;
    config->weight_decay = is_long ? 0.05 : 0;
    config->split_pixels = is_long ? 0.4 : 0;
}

void rn_train_config_set_base(struct rn_train_config *config, int base) {
    bool grows = config->grow_to > 0 && base % 8 == 0 && base >= 128;
    config->field.base = grows ? base / 8 : base;
    config->grow_to = grows ? base : 0;
}

enum rn_status rn_planes_check(int planes, enum rn_orientation orientation, struct rn_error *err) {
    bool platonic = planes == 3 || planes == 4 || planes == 6 || planes == 10;
    if (orientation == RN_ORIENTATION_PLATONIC && !platonic)
        return rn_error_set(err, RN_ERROR_INVALID, "planes",
                            "%d planes belong to no Platonic solid; use 3, 4, 6 or 10", planes);
    if (planes < 1 || planes > RN_MAX_PLANES)
        return rn_error_set(err, RN_ERROR_INVALID, "planes", "%d planes; use 1 to %d", planes,
                            RN_MAX_PLANES);
    return RN_OK;
}

static bool power_of_two(int n) {
    return n > 0 && (n & (n - 1)) == 0;
}

enum rn_status rn_train_config_check(const struct rn_train_config *c, struct rn_error *err) {
    const struct rn_field_config *f = &c->field;
#define REQUIRE(condition, name, text)                                                             \
    if (!(condition)) return rn_error_set(err, RN_ERROR_INVALID, name, text)
    enum rn_status status = rn_planes_check(f->planes, f->orientation, err);
    if (status != RN_OK) return status;
    REQUIRE(f->base >= 2 && f->base <= 4096, "base", "must be 2 to 4096 texels");
    REQUIRE(f->channels == 4 || f->channels == 8 || f->channels == 16, "channels",
            "must be 4, 8 or 16");
    REQUIRE(f->levels >= 1 && f->levels <= RN_MAX_LEVELS, "levels", "must be 1 to 10");
    REQUIRE(f->footprint >= RN_FOOTPRINT_RIP && f->footprint <= RN_FOOTPRINT_POINT, "footprint",
            "must be rip, mip or point");
    REQUIRE(f->shading == RN_SHADING_SAMPLE || f->shading == RN_SHADING_RAY, "shading",
            "must be sample or ray");
    REQUIRE(f->width >= 16 && f->width <= 256 && f->width % 16 == 0, "width",
            "must be a multiple of 16, 16 to 256");
    REQUIRE(f->base_layers >= 1 && f->base_layers <= 5, "base_layers", "must be 1 to 5");
    REQUIRE(f->head_layers >= 1 && f->head_layers <= 5, "head_layers", "must be 1 to 5");
    REQUIRE(power_of_two(f->occupancy) && f->occupancy >= 16 && f->occupancy <= 256, "occupancy",
            "must be a power of two, 16 to 256");
    REQUIRE(f->footprint_base >= 0 && f->footprint_base <= 4096, "footprint_base",
            "must be 0 to 4096 texels");
    REQUIRE(c->grow_to >= 0 && c->grow_to <= 4096, "grow_to", "must be 0 to 4096 texels");
    REQUIRE(c->step >= 1e-3 && c->step <= 1, "step", "must be 0.001 to 1 scene radii");
    REQUIRE(c->target_samples >= 1024 && c->target_samples <= 1 << 22, "target_samples",
            "must be 1024 to 4194304");
    REQUIRE(c->initial_rays >= 1 && c->initial_rays <= 1 << 17, "initial_rays",
            "must be 1 to 131072");
    REQUIRE(c->learning_rate > 0 && c->learning_rate <= 10, "learning_rate", "must be in (0, 10]");
    REQUIRE(c->plane_rate > 0 && c->plane_rate <= 1000, "plane_rate", "must be in (0, 1000]");
    REQUIRE(c->weight_decay >= 0 && c->weight_decay < 1, "weight_decay", "must be in [0, 1)");
    REQUIRE(c->beta2 > 0 && c->beta2 < 1, "beta2", "must be in (0, 1)");
    REQUIRE(c->adam_eps > 0 && c->adam_eps < 1, "adam_eps", "must be in (0, 1)");
    REQUIRE(c->max_steps >= 0, "max_steps", "must not be negative");
    REQUIRE(c->max_seconds >= 0 && c->max_seconds < 1e9, "max_time", "must not be negative");
    REQUIRE(c->until_psnr >= 0 && c->until_psnr < 100, "until_psnr", "must be 0 to 100 dB");
    REQUIRE(c->roulette >= 0 && c->roulette <= 64, "roulette", "must be in [0, 64]");
    REQUIRE(c->stop > 0 && c->stop < 1, "stop", "must be in (0, 1)");
    for (int i = 0; i < 3; i++)
        REQUIRE(c->background[i] >= 0 && c->background[i] <= 1, "background", "must be in [0, 1]");
    REQUIRE(c->random_background >= 0 && c->random_background <= 1, "random_background",
            "must be in [0, 1]");
    REQUIRE(c->split_pixels >= 0 && c->split_pixels <= 1, "split_pixels", "must be in [0, 1]");
    REQUIRE(c->smoothing >= 0 && c->smoothing <= 0.25, "smoothing", "must be in [0, 1/4]");
    return RN_OK;
#undef REQUIRE
}

int rn_train_config_differences(const struct rn_train_config *c, struct rn_difference *items,
                                int capacity) {
    const struct rn_field_config *f = &c->field;
    int n = 0;
#define DIFFERS(condition, text, gain)                                                             \
    if (condition) {                                                                               \
        if (n < capacity) items[n] = (struct rn_difference){text, gain};                           \
        n++;                                                                                       \
    }
    DIFFERS(f->planes != paper.field.planes, "fewer planes than the paper's 10", "3: +4.3 dB")
    DIFFERS(f->orientation != paper.field.orientation, "planes not along a Platonic solid", "")
    DIFFERS((c->grow_to > 0 ? c->grow_to : f->base) != paper.field.base,
            "another base grid in the end than the paper's 512 x 512",
            "256: level on validation views after 15 s, in a third more steps")
    DIFFERS(c->grow_to > 0, "planes grow from a coarse grid while they are trained", "+3.9 dB")
    DIFFERS(f->channels != paper.field.channels, "fewer channels than the paper's 16",
            "8: -0.5 dB on validation views after 60 CPU seconds")
    DIFFERS(f->footprint != paper.field.footprint, "another footprint than the paper's ripmap",
            "mip: +0.7 dB over four scales after 30 s")
    DIFFERS(f->shading != paper.field.shading,
            "view-dependent colour once a ray instead of once a sample", "+0.7 dB")
    DIFFERS(f->width != paper.field.width, "narrower networks than the paper's 128", "64: +0.4 dB")
    DIFFERS(f->base_layers != paper.field.base_layers || f->head_layers != paper.field.head_layers,
            "fewer hidden layers", "1 and 1: +1.0 dB")
    DIFFERS(fabs(c->step - paper.step) > 1e-9, "another marching step than diagonal / 1024",
            "0.005 radii: +0.1 dB")
    DIFFERS(c->cone_step, "samples of wide cones span several marching steps",
            "+0.1 dB over four scales after 30 s")
    DIFFERS(c->target_samples != paper.target_samples, "smaller batch than 262,144 samples",
            "32,768: +3.1 dB")
    DIFFERS(c->carve, "occupancy carved from alpha before the first step", "+1.3 dB")
    DIFFERS(c->random_background > 0, "the loss is at first the mean over all backgrounds",
            "+0.3 dB after 2,000 steps")
    DIFFERS(c->split_pixels > 0, "pixels are in the end trained and rendered as 2 x 2 cones",
            "+0.6 dB after 10,000 steps")
    DIFFERS(c->smoothing > 0, "planes are smoothed, ever less, while they are trained",
            "+0.4 dB after 1,500 and 3,000 steps")
    DIFFERS(c->roulette > 0, "roulette on samples of small gradient (unbiased)",
            "a quarter of them goes back: +0.7 dB after 60 CPU seconds")
    DIFFERS(c->sparse, "optimiser visits touched texels only", "+1.0 dB")
    DIFFERS(c->learning_rate != paper.learning_rate || c->plane_rate != paper.plane_rate,
            "other learning rates", "four times: +1.7 dB")
    DIFFERS(c->beta2 != paper.beta2, "another decay of AdamW's second moment than 0.999",
            "0.99: +0.4 dB")
    DIFFERS(c->weight_decay != paper.weight_decay, "another weight decay than 1e-5",
            c->weight_decay > 0 ? "0.05 of the networks: +0.1 dB after 10,000 steps"
                                : "none: level on validation views after 60 CPU seconds")
    DIFFERS(c->favour_finest, "most rays from the finest scale, pixels nearly without replacement",
            "the first: +0.9 dB over four scales after 20 s; the second: +0.3 dB")
    DIFFERS(c->draw_by_error, "rays drawn more often where errors are large (unbiased)",
            "+0.3 dB after 1,500 steps")
    DIFFERS(!c->multi_step_rate, "rate schedule made for the time given",
            "+0.2 dB on validation views after 60 CPU seconds")
    DIFFERS(fabs(c->stop - paper.stop) > 1e-12, "rays end at another transmittance than 1e-4",
            "0.002: +0.2 dB")
    DIFFERS(c->refine_at_rest,
            "the finished scene's occupancy is measured anew in cells half as wide",
            "frames in 0.8 of the time, -0.01 dB")
    DIFFERS(c->supersample, "wide pixels are rendered as several of the finest trained on",
            "+4.4 dB over four scales after 20 s")
    return n;
#undef DIFFERS
}

static const char *const footprints[] = {"rip", "mip", "point"};
static const char *const orientations[] = {"platonic", "golden", "blue", "white"};

const char *rn_footprint_name(enum rn_footprint footprint) {
    return (unsigned)footprint < 3 ? footprints[footprint] : "?";
}
const char *rn_orientation_name(enum rn_orientation orientation) {
    return (unsigned)orientation < 4 ? orientations[orientation] : "?";
}
enum rn_status rn_footprint_parse(const char *name, enum rn_footprint *ret) {
    for (int i = 0; i < 3; i++)
        if (strcmp(name, footprints[i]) == 0) {
            *ret = (enum rn_footprint)i;
            return RN_OK;
        }
    return RN_ERROR_INVALID;
}
enum rn_status rn_orientation_parse(const char *name, enum rn_orientation *ret) {
    for (int i = 0; i < 4; i++)
        if (strcmp(name, orientations[i]) == 0) {
            *ret = (enum rn_orientation)i;
            return RN_OK;
        }
    return RN_ERROR_INVALID;
}

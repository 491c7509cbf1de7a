#include "common/settings/train.h"

#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>

const char *const rn_preset_names[] = {"draft", "standard", "paper", NULL};
const char *const rn_train_split_names[] = {"train", "trainval", NULL};
const char *const rn_orientation_names[] = {"platonic", "golden", "blue", "white", NULL};
const char *const rn_footprint_names[] = {"rip", "mip", "point", NULL};
const char *const rn_space_names[] = {"ball", "unbounded", NULL};
const char *const rn_shading_names[] = {"sample", "ray", NULL};
const char *const rn_effect_choice_names[] = {"auto", "on", "off", NULL};

#define PLACE(member) .offset = offsetof(struct rn_train_config, member)
#define PRESETS(of_paper, of_standard, of_draft)                                                   \
    .paper = (of_paper), .standard = (of_standard), .draft = (of_draft)
static const struct rn_setting rows[] = {
    {.name = "preset",
     .type = RN_SETTING_TEXT,
     .flags = RN_SETTING_OF_DATA,
     PLACE(preset),
     .unit = "",
     .meaning = "where the settings started from",
     PRESETS(0, 0, 0)},
    {.name = "planes",
     .type = RN_SETTING_INT,
     PLACE(field.planes),
     .min = 1,
     .max = RN_MAX_PLANES,
     .unit = "",
     .meaning = "planes that features lie on; of a Platonic solid 3, 4, 6 or 10",
     .option = "planes",
     .flag = "planes",
     PRESETS(10, 3, 3),
     .unlike = "another number of planes than the paper's 10",
     .gain = "+4.3 dB with 3"},
    {.name = "orientation",
     .type = RN_SETTING_CHOICE,
     PLACE(field.orientation),
     .unit = "",
     .choices = rn_orientation_names,
     .meaning = "where the planes' normals come from",
     .option = "orientation",
     .flag = "orientation",
     PRESETS(0, 0, 0),
     .unlike = "planes not along a Platonic solid"},
    {.name = "base",
     .type = RN_SETTING_INT,
     PLACE(field.base),
     .min = 2,
     .max = 4096,
     .unit = "texels",
     .meaning = "side of each plane's base grid; as an option, of the grid in the end",
     .option = "base",
     .flag = "base",
     PRESETS(512, 64, 64),
     .unlike = "another base grid in the end than the paper's 512 x 512",
     .gain = "level with 256 on validation views after 15 s, in a third more steps"},
    {.name = "grow_to",
     .type = RN_SETTING_INT,
     PLACE(grow_to),
     .min = 0,
     .max = 4096,
     .unit = "texels",
     .meaning = "base side that the planes grow to by doubling; 0: they do not grow",
     PRESETS(0, 512, 256),
     .unlike = "planes grow from a coarse grid while they are trained",
     .gain = "+3.9 dB"},
    {.name = "channels",
     .type = RN_SETTING_INT,
     .flags = RN_SETTING_POWER_OF_TWO,
     PLACE(field.channels),
     .min = 4,
     .max = 16,
     .unit = "",
     .meaning = "features of a texel",
     .option = "channels",
     .flag = "channels",
     PRESETS(16, 16, 16),
     .unlike = "fewer channels than the paper's 16",
     .gain = "-0.5 dB with 8 on validation views after 60 CPU seconds"},
    {.name = "levels",
     .type = RN_SETTING_INT,
     PLACE(field.levels),
     .min = 1,
     .max = RN_MAX_LEVELS,
     .unit = "",
     .meaning = "levels of the ripmap along each axis",
     PRESETS(8, 8, 8),
     .unlike = "another number of levels along each axis than the paper's 8"},
    {.name = "footprint",
     .type = RN_SETTING_CHOICE,
     PLACE(field.footprint),
     .unit = "",
     .choices = rn_footprint_names,
     .meaning = "how a sample's size is looked up",
     .option = "footprint",
     .flag = "footprint",
     PRESETS(0, 0, 0),
     .unlike = "another footprint than the paper's ripmap",
     .gain = "+0.7 dB with mip over four scales after 30 s"},
    {.name = "footprint_given",
     .type = RN_SETTING_BOOL,
     .flags = RN_SETTING_LATER | RN_SETTING_OF_DATA,
     PLACE(footprint_given),
     .unit = "",
     .meaning = "the footprint was asked for: it stays though the data calls for less",
     PRESETS(0, 0, 0)},
    {.name = "cut_out",
     .type = RN_SETTING_BOOL,
     .flags = RN_SETTING_LATER | RN_SETTING_OF_DATA,
     PLACE(cut_out),
     .unit = "",
     .meaning = "masks cut an object out: what they leave out is empty",
     PRESETS(0, 0, 0)},
    {.name = "footprint_base",
     .type = RN_SETTING_INT,
     .flags = RN_SETTING_OR_ZERO,
     PLACE(field.footprint_base),
     .min = 1,
     .max = 4096,
     .unit = "texels",
     .meaning = "side of the grid in whose texels footprints are measured; 0: the base grid",
     PRESETS(0, 0, 0),
     .unlike = "footprints are measured in texels of another grid than the base grid"},
    {.name = "mean_level",
     .type = RN_SETTING_BOOL,
     .flags = RN_SETTING_LATER,
     PLACE(field.mean_level),
     .unit = "",
     .meaning = "with footprint mip: a plane's level is the mean of the two that rip would ask for",
     PRESETS(0, 0, 0),
     .unlike = "mip's level is the mean of rip's two"},
    {.name = "shading",
     .type = RN_SETTING_CHOICE,
     PLACE(field.shading),
     .unit = "",
     .choices = rn_shading_names,
     .meaning = "where the colour network runs: for each sample, or once a ray",
     PRESETS(0, 1, 1),
     .unlike = "view-dependent colour once a ray instead of once a sample",
     .gain = "+0.7 dB"},
    {.name = "width",
     .type = RN_SETTING_INT,
     .flags = RN_SETTING_SIXTEENS,
     PLACE(field.width),
     .min = 16,
     .max = 256,
     .unit = "",
     .meaning = "width of every hidden layer",
     PRESETS(128, 64, 64),
     .unlike = "networks of another width than the paper's 128",
     .gain = "+0.4 dB with 64"},
    {.name = "base_layers",
     .type = RN_SETTING_INT,
     PLACE(field.base_layers),
     .min = 1,
     .max = 5,
     .unit = "",
     .meaning = "hidden layers of the density network",
     PRESETS(2, 1, 1),
     .unlike = "another number of hidden layers",
     .gain = "+1.0 dB with 1 and 1"},
    {.name = "head_layers",
     .type = RN_SETTING_INT,
     PLACE(field.head_layers),
     .min = 1,
     .max = 5,
     .unit = "",
     .meaning = "hidden layers of the colour network",
     PRESETS(4, 2, 1),
     .unlike = "another number of hidden layers",
     .gain = "+1.0 dB with 1 and 1"},
    {.name = "view_dependence",
     .type = RN_SETTING_BOOL,
     PLACE(field.view_dependence),
     .unit = "",
     .meaning = "the colour network sees the direction",
     PRESETS(1, 1, 1),
     .unlike = "colour does not depend on the direction"},
    {.name = "occupancy",
     .type = RN_SETTING_INT,
     .flags = RN_SETTING_POWER_OF_TWO,
     PLACE(field.occupancy),
     .min = 16,
     .max = 256,
     .unit = "cells",
     .meaning = "cells a side of the occupancy grid",
     PRESETS(128, 128, 128),
     .unlike = "another occupancy grid than the paper's 128 cells a side"},
    {.name = "step",
     .type = RN_SETTING_NUMBER,
     PLACE(step),
     .min = 0.001,
     .max = 1,
     .unit = "scene radii",
     .meaning = "marching step",
     PRESETS(2 * 1.7320508075688772 / 1024, 0.005, 0.0068),
     .unlike = "another marching step than diagonal / 1024",
     .gain = "+0.1 dB with 0.005 radii"},
    {.name = "cone_step",
     .type = RN_SETTING_BOOL,
     PLACE(cone_step),
     .unit = "",
     .meaning = "a sample spans as many marching steps as its cone is wide, at most 8",
     PRESETS(0, 1, 1),
     .unlike = "samples of wide cones span several marching steps",
     .gain = "+0.1 dB over four scales after 30 s"},
    {.name = "target_samples",
     .type = RN_SETTING_INT,
     PLACE(target_samples),
     .min = 1024,
     .max = 1 << 22,
     .unit = "samples",
     .meaning = "samples a training step that the batch of rays aims at",
     PRESETS(262144, 32768, 16384),
     .unlike = "another batch than 262,144 samples",
     .gain = "+3.1 dB with 32,768"},
    {.name = "initial_rays",
     .type = RN_SETTING_INT,
     PLACE(initial_rays),
     .min = 1,
     .max = 1 << 17,
     .unit = "rays",
     .meaning = "rays of the first training step",
     PRESETS(8192, 4096, 4096),
     .unlike = "another number of rays at the first step than the paper's 8,192",
     .gain = "level with 8,192 after 700 steps"},
    {.name = "carve",
     .type = RN_SETTING_BOOL,
     PLACE(carve),
     .unit = "",
     .meaning = "the occupancy begins with the images' alpha",
     PRESETS(0, 1, 1),
     .unlike = "occupancy carved from alpha before the first step",
     .gain = "+1.3 dB"},
    {.name = "random_background",
     .type = RN_SETTING_NUMBER,
     .flags = RN_SETTING_LATER,
     PLACE(random_background),
     .min = 0,
     .max = 1,
     .unit = "",
     .meaning = "share of the schedule at whose beginning the loss is the mean over all "
                "backgrounds whose channels are 0 or 1; 0: never",
     PRESETS(0, 0.2, 0.2),
     .unlike = "the loss is at first the mean over all backgrounds",
     .gain = "+0.3 dB after 2,000 steps"},
    {.name = "split_pixels",
     .type = RN_SETTING_NUMBER,
     .flags = RN_SETTING_LATER,
     PLACE(split_pixels),
     .min = 0,
     .max = 1,
     .unit = "",
     .meaning = "share of the schedule at whose end a pixel is trained and rendered as the mean of "
                "2 x 2 cones; 0: never",
     PRESETS(0, 0, 0),
     .unlike = "pixels are in the end trained and rendered as 2 x 2 cones",
     .gain = "+0.6 dB after 10,000 steps"},
    {.name = "smoothing",
     .type = RN_SETTING_NUMBER,
     .flags = RN_SETTING_LATER,
     PLACE(smoothing),
     .min = 0,
     .max = 0.25,
     .unit = "",
     .meaning = "share of the way to each of its neighbours that a texel goes every 32 steps, "
                "times the square of the rate's factor; 0: none",
     PRESETS(0, 0.1, 0.1),
     .unlike = "planes are smoothed, ever less, while they are trained",
     .gain = "+0.4 dB after 1,500 and 3,000 steps"},
    {.name = "roulette",
     .type = RN_SETTING_NUMBER,
     PLACE(roulette),
     .min = 0,
     .max = 64,
     .unit = "",
     .meaning = "samples whose gradient is below this many times the mean are backpropagated by "
                "Russian roulette; 0: all are",
     PRESETS(0, 1, 1),
     .unlike = "roulette on samples of small gradient (unbiased)",
     .gain = "+0.7 dB after 60 CPU seconds, a quarter of them backpropagated"},
    {.name = "sparse",
     .type = RN_SETTING_BOOL,
     PLACE(sparse),
     .unit = "",
     .meaning = "the optimiser visits only touched texels",
     PRESETS(0, 1, 1),
     .unlike = "optimiser visits touched texels only",
     .gain = "+1.0 dB"},
    {.name = "learning_rate",
     .type = RN_SETTING_NUMBER,
     .flags = RN_SETTING_OVER_MIN,
     PLACE(learning_rate),
     .min = 0,
     .max = 10,
     .unit = "",
     .meaning = "learning rate of the networks",
     PRESETS(0.002, 0.008, 0.008),
     .unlike = "other learning rates",
     .gain = "+1.7 dB with four times the rate"},
    {.name = "plane_rate",
     .type = RN_SETTING_NUMBER,
     .flags = RN_SETTING_OVER_MIN,
     PLACE(plane_rate),
     .min = 0,
     .max = 1000,
     .unit = "",
     .meaning = "factor on the learning rate for the planes",
     PRESETS(10, 10, 10),
     .unlike = "other learning rates",
     .gain = "+1.7 dB with four times the rate"},
    {.name = "beta2",
     .type = RN_SETTING_NUMBER,
     .flags = RN_SETTING_OVER_MIN | RN_SETTING_UNDER_MAX,
     PLACE(beta2),
     .min = 0,
     .max = 1,
     .unit = "",
     .meaning = "decay of AdamW's second moment",
     PRESETS(0.999, 0.99, 0.99),
     .unlike = "another decay of AdamW's second moment than 0.999",
     .gain = "+0.4 dB with 0.99"},
    {.name = "weight_decay",
     .type = RN_SETTING_NUMBER,
     .flags = RN_SETTING_UNDER_MAX,
     PLACE(weight_decay),
     .min = 0,
     .max = 1,
     .unit = "",
     .meaning = "decoupled weight decay; where the optimiser is sparse, of the networks alone",
     PRESETS(1e-05, 0, 0),
     .unlike = "another weight decay than 1e-5",
     .gain = "+0.1 dB with 0.05 of the networks, after 10,000 steps",
     .gain_of_none = "level with none on validation views after 60 CPU seconds"},
    {.name = "adam_eps",
     .type = RN_SETTING_NUMBER,
     .flags = RN_SETTING_OVER_MIN | RN_SETTING_UNDER_MAX,
     PLACE(adam_eps),
     .min = 0,
     .max = 1,
     .unit = "",
     .meaning = "AdamW's epsilon",
     PRESETS(1e-15, 1e-15, 1e-15),
     .unlike = "another epsilon of AdamW than 1e-15"},
    {.name = "favour_finest",
     .type = RN_SETTING_BOOL,
     PLACE(favour_finest),
     .unit = "",
     .meaning = "most rays are drawn from the finest scale; else evenly over all pixels, with area "
                "weights",
     PRESETS(0, 1, 1),
     .unlike = "most rays from the finest scale, pixels nearly without replacement",
     .gain = "+0.9 dB by the first over four scales after 20 s, +0.3 dB by the second"},
    {.name = "draw_by_error",
     .type = RN_SETTING_BOOL,
     PLACE(draw_by_error),
     .unit = "",
     .meaning = "of these, more where errors are large, with weights that keep the loss the mean "
                "over all pixels",
     PRESETS(0, 0, 1),
     .unlike = "rays drawn more often where errors are large (unbiased)",
     .gain = "+0.3 dB after 1,500 steps"},
    {.name = "multi_step_rate",
     .type = RN_SETTING_BOOL,
     PLACE(multi_step_rate),
     .unit = "",
     .meaning = "the paper's rate schedule; else a decay made for the time given",
     PRESETS(1, 0, 0),
     .unlike = "rate schedule made for the time given",
     .gain = "+0.2 dB on validation views after 60 CPU seconds"},
    {.name = "stop",
     .type = RN_SETTING_NUMBER,
     .flags = RN_SETTING_OVER_MIN | RN_SETTING_UNDER_MAX,
     PLACE(stop),
     .min = 0,
     .max = 1,
     .unit = "",
     .meaning = "transmittance at which a ray ends",
     PRESETS(0.0001, 0.002, 0.004),
     .unlike = "rays end at another transmittance than 1e-4",
     .gain = "+0.2 dB with 0.002"},
    {.name = "space",
     .type = RN_SETTING_CHOICE,
     .flags = RN_SETTING_LATER | RN_SETTING_OF_DATA,
     PLACE(field.space),
     .unit = "",
     .choices = rn_space_names,
     .meaning = "what the field's ball stands for: the scene's ball, or all of space",
     PRESETS(0, 0, 0),
     .unlike = "all of space instead of a ball"},
    {.name = "occupancy_limit",
     .type = RN_SETTING_NUMBER,
     .flags = RN_SETTING_LATER,
     PLACE(occupancy_limit),
     .min = 0,
     .max = 1,
     .unit = "",
     .meaning = "optical depth of a step above which a cell is occupied; 0: 0.005",
     PRESETS(0, 0, 0),
     .unlike = "a cell is occupied from another optical depth on than the paper's 0.005"},
    {.name = "distortion_loss",
     .type = RN_SETTING_NUMBER,
     .flags = RN_SETTING_LATER,
     PLACE(distortion_loss),
     .min = 0,
     .max = 1,
     .unit = "",
     .meaning = "weight of the loss that draws together what a ray sees; 0: none",
     PRESETS(0, 0, 0),
     .unlike = "what a ray sees is drawn together (the distortion loss)"},
    {.name = "sample_cells",
     .type = RN_SETTING_BOOL,
     .flags = RN_SETTING_LATER,
     PLACE(sample_cells),
     .unit = "",
     .meaning = "cells of the occupancy grid are drawn to be measured, a quarter of all and of the "
                "occupied ones; else each has its turn",
     PRESETS(1, 0, 0),
     .unlike = "every cell of the occupancy grid is measured in turn, none by lot",
     .gain = "level by the other after 30 CPU seconds"},
    {.name = "refine_at_rest",
     .type = RN_SETTING_BOOL,
     .flags = RN_SETTING_LATER | RN_SETTING_SAME_BYTES,
     PLACE(refine_at_rest),
     .unit = "",
     .meaning = "the finished scene's occupancy is measured anew in cells half as wide",
     PRESETS(0, 1, 1),
     .unlike = "the finished scene's occupancy is measured anew in cells half as wide",
     .gain = "frames in 0.8 of the time, -0.01 dB"},
    {.name = "supersample",
     .type = RN_SETTING_BOOL,
     .flags = RN_SETTING_SAME_BYTES,
     PLACE(supersample),
     .unit = "",
     .meaning = "pixels wider than the finest trained on are rendered as several of these",
     PRESETS(0, 1, 1),
     .unlike = "wide pixels are rendered as several of the finest trained on",
     .gain = "+4.4 dB over four scales after 20 s"},
    {.name = "auto_effects",
     .type = RN_SETTING_BOOL,
     PLACE(auto_effects),
     .unit = "",
     .meaning = "what the data does not call for may be switched off",
     PRESETS(0, 1, 1)},
#define EFFECT_ROW(CONSTANT, ROW, NAME)                                                            \
    {.name = "effect_" #ROW,                                                                       \
     .type = RN_SETTING_CHOICE,                                                                    \
     .flags = RN_SETTING_LATER,                                                                    \
     PLACE(effect[RN_EFFECT_##CONSTANT]),                                                          \
     .unit = "",                                                                                   \
     .choices = rn_effect_choice_names,                                                            \
     .meaning = "an effect as the data calls for it, or as you say where it can be",               \
     .option = "effect_" #ROW,                                                                     \
     .flag = "effect",                                                                             \
     .key = NAME,                                                                                  \
     PRESETS(0, 0, 0)},
    RN_EFFECTS(EFFECT_ROW)
#undef EFFECT_ROW
        {.name = "background",
         .type = RN_SETTING_COLOUR,
         .flags = RN_SETTING_OF_DATA,
         PLACE(background),
         .min = 0,
         .max = 1,
         .unit = "",
         .meaning = "what lies behind the scene",
         PRESETS(1, 1, 1)},
    {.name = "train_scale",
     .type = RN_SETTING_INT,
     .flags = RN_SETTING_LATER | RN_SETTING_OR_ZERO | RN_SETTING_POWER_OF_TWO,
     PLACE(train_scale),
     .min = 1,
     .max = 16,
     .unit = "",
     .meaning = "photographs are trained on so many times smaller, 1: as they are; 0: by the time "
                "given",
     .option = "train_scale",
     .flag = "train-scale",
     PRESETS(1, 0, 0)},
    {.name = "pixel_memory",
     .type = RN_SETTING_INT,
     .flags = RN_SETTING_LATER | RN_SETTING_OR_ZERO | RN_SETTING_SAME_BYTES,
     PLACE(pixel_memory),
     .min = 1,
     .max = 1048576,
     .unit = "MiB",
     .meaning = "photographs that take more than this lie on disk while they are trained on; 0: "
                "never",
     PRESETS(1024, 1024, 1024)},
    {.name = "train_val",
     .type = RN_SETTING_BOOL,
     PLACE(train_val),
     .unit = "",
     .choices = rn_train_split_names,
     .meaning = "which views are learned from (train)",
     .option = "train_split",
     .flag = "train-split",
     .told = "train_split",
     PRESETS(0, 0, 0)},
    {.name = "train_held_out",
     .type = RN_SETTING_BOOL,
     .flags = RN_SETTING_LATER,
     PLACE(train_held_out),
     .unit = "",
     .meaning = "the views by which progress is measured are trained on too",
     PRESETS(1, 0, 0),
     .unlike = "the views by which progress is measured are withheld",
     .gain = "level with all 200 views trained on, after 30 CPU seconds"},
    {.name = "seed",
     .type = RN_SETTING_UINT64,
     PLACE(seed),
     .min = 0,
     .max = 9007199254740991,
     .unit = "",
     .meaning = "of all random numbers",
     .option = "seed",
     .flag = "seed",
     PRESETS(0, 0, 0)},
    {.name = "max_steps",
     .type = RN_SETTING_INT64,
     .flags = RN_SETTING_OR_ZERO,
     PLACE(max_steps),
     .min = 1,
     .max = 1000000000,
     .unit = "steps",
     .meaning = "stop after so many steps; 0: no limit",
     .option = "max_steps",
     .flag = "max-steps",
     PRESETS(120000, 0, 0)},
    {.name = "max_seconds",
     .type = RN_SETTING_NUMBER,
     .flags = RN_SETTING_OVER_MIN | RN_SETTING_OR_ZERO,
     PLACE(max_seconds),
     .min = 0,
     .max = 31536000,
     .unit = "s",
     .meaning = "stop after so much training: 60s, 10m, 1h; 0: no limit",
     .option = "max_time_s",
     .flag = "max-time",
     PRESETS(0, 60, 15)},
    {.name = "until_psnr",
     .type = RN_SETTING_NUMBER,
     .flags = RN_SETTING_OVER_MIN | RN_SETTING_OR_ZERO | RN_SETTING_SAME_BYTES,
     PLACE(until_psnr),
     .min = 0,
     .max = 100,
     .unit = "dB",
     .meaning = "stop at this PSNR of the held-out views; 0: no limit",
     .option = "until_psnr",
     .flag = "until-psnr",
     PRESETS(0, 0, 0)},
    {.name = "until_plateau",
     .type = RN_SETTING_BOOL,
     .flags = RN_SETTING_LATER,
     PLACE(until_plateau),
     .unit = "",
     .meaning = "stop where half as much time again gains less than 0.1 dB; the rate then decays "
                "within a third of the time so far",
     .option = "until_plateau",
     .flag = "until-plateau",
     PRESETS(0, 0, 0)},
};
_Static_assert(sizeof rows / sizeof *rows == RN_TRAIN_SETTINGS, "a row for every setting");
const struct rn_settings rn_train_settings = {rows, RN_TRAIN_SETTINGS};

// ---- presets --------------------------------------------------------------------------------

static double preset_value(const struct rn_setting *row, int preset) {
    return preset == RN_PRESET_PAPER   ? row->paper
           : preset == RN_PRESET_DRAFT ? row->draft
                                       : row->standard;
}

enum rn_status rn_preset(const char *name, bool multi_scale, struct rn_train_config *ret_config,
                         struct rn_error *err) {
    int preset = rn_choice_index(rn_preset_names, name);
    if (preset < 0)
        return rn_error_set(err, RN_ERROR_INVALID, "preset",
                            "'%s' is no preset; use draft, standard or paper", name);
    struct rn_train_config config = {.preset = ""};
    for (size_t i = 0; i < RN_TRAIN_SETTINGS; i++)
        rn_setting_put_number(&rows[i], preset_value(&rows[i], preset), &config);
    snprintf(config.preset, sizeof config.preset, "%s", name);
    // Few rays need levels then, and those of the isotropic pyramid cost half the fetches.
    if (multi_scale && preset != RN_PRESET_PAPER) config.field.footprint = RN_FOOTPRINT_MIP;
    *ret_config = config;
    return RN_OK;
}

// What `standard` makes of the time it has. On two cores, lego: a second hidden layer of the colour
// network is 0.1 dB behind after 15 s (two seeds) and 0.25 dB ahead after 60; networks twice as
// wide are level after 60 s and 0.4 dB ahead after 300. In 10,000 steps of these, half the
// smoothing is 0.15 dB ahead, the networks' decay 0.1, and splitting pixels 0.6; frames then take
// three times as long or more.
#define PLATEAU_TIMES 10 // the preset's time, for a training that ends at its plateau
#define SHORT_RUN 40     // seconds
#define LONG_RUN 120
static const struct {
    const char *name;
    double in_short, between, in_long; // no limit counts as between
} by_time[] = {{"head_layers", 1, 2, 2},     {"draw_by_error", 1, 0, 0},
               {"width", 64, 64, 128},       {"smoothing", 0.1, 0.1, 0.05},
               {"weight_decay", 0, 0, 0.05}, {"split_pixels", 0, 0, 0.4}};

void rn_train_config_suit_time(struct rn_train_config *config) {
    double seconds = config->max_seconds;
    if (strcmp(config->preset, "standard") != 0) return;
    for (size_t i = 0; i < sizeof by_time / sizeof *by_time; i++)
        rn_setting_put_number(rn_settings_find(&rn_train_settings, by_time[i].name),
                              seconds >= LONG_RUN                  ? by_time[i].in_long
                              : seconds > 0 && seconds < SHORT_RUN ? by_time[i].in_short
                                                                   : by_time[i].between,
                              config);
}

void rn_train_config_set_base(struct rn_train_config *config, int base) {
    bool grows = config->grow_to > 0 && base % 8 == 0 && base >= 128;
    config->field.base = grows ? base / 8 : base;
    config->grow_to = grows ? base : 0;
}

static bool asks(const union rn_setting_value *values, size_t offset) {
    size_t i = 0;
    while (rows[i].offset != offset)
        i++;
    return !rn_setting_is_absent(&rows[i], &values[i]);
}
#define ASKS(member) asks(values, offsetof(struct rn_train_config, member))

void rn_train_config_choose(struct rn_train_config *config,
                            const union rn_setting_value values[RN_TRAIN_SETTINGS]) {
    bool limited = ASKS(max_steps) || ASKS(max_seconds);
    if (limited) config->max_seconds = 0, config->max_steps = 0;
    rn_settings_put(&rn_train_settings, values, config);
    bool longer = config->until_plateau && !limited;
    if (longer) config->max_seconds *= PLATEAU_TIMES;
    if (limited || longer) rn_train_config_suit_time(config);
    rn_settings_put(&rn_train_settings, values, config); // what the time suits gives way
    if (ASKS(field.base) && !ASKS(grow_to)) rn_train_config_set_base(config, config->field.base);
    if (ASKS(field.footprint)) config->footprint_given = true;
}

// ---- checks ---------------------------------------------------------------------------------

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

enum rn_status rn_train_config_check(const struct rn_train_config *c, struct rn_error *err) {
    enum rn_status status = rn_planes_check(c->field.planes, c->field.orientation, err);
    return status != RN_OK ? status : rn_settings_check(&rn_train_settings, c, err);
}

enum rn_status rn_train_choice_check(const union rn_setting_value values[RN_TRAIN_SETTINGS],
                                     struct rn_error *err) {
    struct rn_train_config config;
    enum rn_status status = rn_preset("standard", false, &config, err);
    if (status != RN_OK) return status;
    rn_train_config_choose(&config, values);
    return rn_train_config_check(&config, err);
}

// ---- the paper ------------------------------------------------------------------------------

// Of the base grid the one in the end counts.
static double told_value(const struct rn_setting *row, const struct rn_train_config *config) {
    bool is_base = row->offset == offsetof(struct rn_train_config, field.base);
    return is_base && config->grow_to > 0 ? config->grow_to : rn_setting_number(row, config);
}

static bool differs(const struct rn_setting *row, const struct rn_train_config *config) {
    return row->unlike && fabs(told_value(row, config) - row->paper) > 1e-9 * fabs(row->paper);
}

int rn_train_config_differences(const struct rn_train_config *config, struct rn_difference *items,
                                int capacity) {
    int n = 0;
    const char *last = "";
    for (size_t i = 0; i < RN_TRAIN_SETTINGS; i++) {
        const struct rn_setting *row = &rows[i];
        if (!differs(row, config) || strcmp(row->unlike, last) == 0) continue;
        bool none = row->gain_of_none && rn_setting_number(row, config) == 0;
        const char *gain = none ? row->gain_of_none : row->gain;
        last = row->unlike;
        if (n < capacity) items[n] = (struct rn_difference){last, gain ? gain : ""};
        n++;
    }
    return n;
}

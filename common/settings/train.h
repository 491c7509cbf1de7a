// What is trained and how: plain values, fixed by a preset, overridden by flags, recorded in every
// checkpoint.
#ifndef RN_COMMON_SETTINGS_TRAIN_H
#define RN_COMMON_SETTINGS_TRAIN_H

#include <stdbool.h>
#include <stdint.h>

#include "common/base/status.h"
#include "common/settings/effects.h"
#include "common/settings/setting.h"

#define RN_MAX_PLANES 16
#define RN_MAX_LEVELS 10
#define RN_APPEARANCE 7 // numbers of a photograph's code

enum rn_orientation {        // where the planes' normals come from
    RN_ORIENTATION_PLATONIC, // 3, 4, 6, 10: vertices of the dual solid, antipodes merged
    RN_ORIENTATION_GOLDEN,   // golden spiral
    RN_ORIENTATION_BLUE,     // blue noise on the sphere
    RN_ORIENTATION_WHITE,    // white noise, the control
};

enum rn_footprint {
    RN_FOOTPRINT_RIP,   // anisotropic: one level per axis (paper, section 3.3)
    RN_FOOTPRINT_MIP,   // isotropic: one level from the ball that the cone's cross-section spans
    RN_FOOTPRINT_POINT, // no levels
};

enum rn_shading {
    RN_SHADING_SAMPLE, // the paper: a colour network for every sample
    RN_SHADING_RAY,    // diffuse colour a sample, one view-dependent network a ray
};

enum rn_space {         // that the field's unit ball stands for (server/engine/field/space.h)
    RN_SPACE_BALL,      // the scene's ball
    RN_SPACE_UNBOUNDED, // all of space
};

struct rn_field_config {
    enum rn_space space;
    int planes; // 3, 4, 6, 10 (platonic), 1..RN_MAX_PLANES otherwise
    enum rn_orientation orientation;
    int base;     // side of each plane's base grid, texels, 2..4096
    int channels; // per texel: 4, 8 or 16
    int levels;   // per axis, 1..RN_MAX_LEVELS
    enum rn_footprint footprint;
    int footprint_base; // side of the grid whose texels footprints are measured in; 0: base
    bool voxels;        // a dense grid of voxels beside the planes (server/engine/field/voxels.h)
    bool mean_level;    // MIP: the level on a plane is the mean of the two that RIP would ask for
    enum rn_shading shading;
    int width;            // of every hidden layer, a multiple of 16
    int base_layers;      // hidden layers of the density network
    int head_layers;      // hidden layers of the colour network
    bool view_dependence; // false: the colour network does not see the direction
    int appearances;      // photographs that have a code of their own for the colour network
                          // (server/engine/field/mlp.h); 0: none has
    int occupancy;        // cells a side, a power of two, 16..256
};

struct rn_train_config {
    char preset[16];
    struct rn_field_config field;
    double step;        // marching step, in scene radii (the paper: 2 sqrt(3)/1024)
    int target_samples; // samples a step that the dynamic ray batch aims at
    int initial_rays;
    double learning_rate; // networks
    double plane_rate;    // factor on the learning rate for the planes
    double weight_decay;  // decoupled; where `sparse` the networks' alone
    double beta2;         // of AdamW's second moment; the first's is 0.9
    double adam_eps;
    int64_t max_steps;    // 0: no limit
    int grow_to;          // base side that the planes grow to by doubling; 0: they do not grow
    double max_seconds;   // 0: no limit
    double until_psnr;    // 0: no limit
    bool until_plateau;   // ends where no more is gained (train/schedule.h)
    bool carve;           // occupancy from the images' alpha before the first step
    bool sparse;          // the optimiser visits only texels that the step touched
    bool multi_step_rate; // the paper's rate schedule; else one decay made for the time given
    bool favour_finest;   // most rays from the finest scale, all of weight 1 (kernels/draw.h); else
                          // evenly over all pixels, weighted by area
    bool draw_by_error;   // of these, more where errors are large (train/importance.h)
    bool auto_effects;    // effects that the data does not call for may be switched off
    enum rn_effect_choice effect[RN_EFFECT_COUNT]; // before what is measured
    double roulette; // times the mean gradient below which a sample is backpropagated by roulette;
                     // 0 = off
    bool cut_out;    // masks cut an object out: what they leave out is empty; measured
    bool footprint_given;   // asked for by name: not switched off though the data calls for less
    bool cone_step;         // a sample spans as many steps as its cone is wide, at most 8
    double stop;            // early stop: transmittance below which a ray ends
    double occupancy_limit; // optical depth of a step above which a cell is occupied; the mean over
                            // all cells where that is less. 0: as the space calls for; in a ball
                            // RN_OCCUPANCY_LIMIT
    double distortion_loss; // weight of the loss that draws what a ray sees together; 0: as the
                            // space calls for; in a ball there is none. Grows in
    bool sample_cells;   // occupancy: after the first 256 steps cells are drawn, a quarter of all
                         // and of those that are occupied; else each has its turn
    bool refine_at_rest; // occupancy is measured anew when training is over (occupancy.h)
    bool supersample;    // pixels wider than those trained on are rendered as several of these
    uint64_t seed;
    int train_scale;  // times that photographs are made smaller to be trained on, a power of two;
                      // 0: by the time given (rn_train_scale_by_time)
    int pixel_memory; // MiB: photographs that take more lie on disk, where the engine has a place
    bool train_val;   // train on train+val
    bool train_held_out;      // also on the views by which progress is measured
    double give_back;         // share of the schedule at whose end these are trained on too; 0:
                              // never. At the plateau where the training ends there
    float background[3];      // white unless the scene says otherwise
    double random_background; // share of the schedule at whose beginning the loss is the mean over
                              // all backgrounds whose channels are 0 or 1; 0: never
    double split_pixels;      // share of the schedule at whose end a pixel is trained as 2 x 2
                              // cones, whose mean is its colour, and rendered so; 0: never.
                              // Switched off for photographs of several scales
    double smoothing;         // share of the way to each of its neighbours that a texel goes every
                      // RN_SMOOTH_EVERY steps, times the square of the rate's factor; 0 to 1/4
};

// The one table: a row for every member of struct rn_train_config. What follows from it and the
// presets is in preset.c.
#define RN_TRAIN_SETTINGS (57 + RN_EFFECT_COUNT)
extern const struct rn_settings rn_train_settings;

enum rn_preset_name { RN_PRESET_DRAFT, RN_PRESET_STANDARD, RN_PRESET_PAPER };
extern const char *const rn_preset_names[];      // "draft", "standard", "paper"
extern const char *const rn_train_split_names[]; // "train", "trainval": of train_val
extern const char *const rn_orientation_names[]; // "platonic", "golden", "blue", "white"
extern const char *const rn_footprint_names[];   // "rip", "mip", "point"
extern const char *const rn_space_names[];       // "ball", "unbounded"
extern const char *const rn_shading_names[];     // "sample", "ray"
extern const char *const rn_switch_names[];      // "off", "on": of voxels

// Platonic: 3, 4, 6 or 10 planes; other orientations: 1 to RN_MAX_PLANES. RN_ERROR_INVALID else.
enum rn_status rn_planes_check(int planes, enum rn_orientation orientation,
                               struct rn_error *err) RN_MUST_CHECK;

// "draft", "standard", "paper". `multi_scale` says whether the dataset has several scales (the
// defaults were measured apart). RN_ERROR_INVALID for an unknown name.
enum rn_status rn_preset(const char *name, bool multi_scale, struct rn_train_config *ret_config,
                         struct rn_error *err) RN_MUST_CHECK;
#define RN_TRAIN_LONG_RUN 120 // seconds: larger networks, larger batches of places

// After a change of max_seconds: what the preset makes of the time.
void rn_train_config_suit_time(struct rn_train_config *config);
// What the data calls for in place of the preset's value of the setting `name`; another than the
// preset's was asked for, and stays.
void rn_train_config_suit_data(struct rn_train_config *config, const char *name, double value);
// Times, a power of two, that photographs of so many megapixels in all, the largest of so many
// pixels a side, are made smaller for a training of so many seconds (effects/downscaling.c). 1
// without a limit, of 0 seconds.
int rn_train_scale_by_time(double megapixels, int longest_side, double seconds);
// Training megapixels for each second, at most: chosen by hand, scales were not compared.
#define RN_TRAIN_MEGAPIXELS 0.5
// What a request asks for, onto a preset: a limit of its own takes the place of the preset's, and
// what follows from the time or from a base grid that grows is settled. Until its plateau, and
// without a limit of its own, a training may take ten times as long as the preset's.
void rn_train_config_choose(struct rn_train_config *config,
                            const union rn_setting_value values[RN_TRAIN_SETTINGS]);
// Whether what a request asks for can be trained at all. As rn_train_config_check.
enum rn_status rn_train_choice_check(const union rn_setting_value values[RN_TRAIN_SETTINGS],
                                     struct rn_error *err) RN_MUST_CHECK;
// Every value in its range and consistent with the others; errors name the option.
enum rn_status rn_train_config_check(const struct rn_train_config *config,
                                     struct rn_error *err) RN_MUST_CHECK;

// One line for each thing in which `config` differs from the paper, for `show`.
struct rn_difference {
    const char *what; // "3 planes instead of 10"
    // The gain in test PSNR: `standard` with it against `standard` without, one scale of lego at
    // 400x400 after 15 s on two threads, where nothing else is said (README, Figures). "": not
    // measured by itself.
    const char *measured;
};
// Fills at most `capacity` items and returns how many there are.
int rn_train_config_differences(const struct rn_train_config *config, struct rn_difference *items,
                                int capacity);

// Texels a side of the grid whose texel a footprint of level 0 is as wide as.
static inline int rn_footprint_base(const struct rn_field_config *config) {
    return config->footprint_base > 0 ? config->footprint_base : config->base;
}

// Whether levels follow from a footprint's extent along each axis of a plane, or from a ball's.
static inline bool rn_levels_by_axis(const struct rn_field_config *config) {
    return config->footprint == RN_FOOTPRINT_RIP ||
           (config->footprint == RN_FOOTPRINT_MIP && config->mean_level);
}

#endif

// What a scene's effects bring, measured: GET /v1/scenes/{id}/effects, the result of an `effects`
// job, and the file effects.json in the scene's folder.
#ifndef RN_PROTO_EFFECTS_H
#define RN_PROTO_EFFECTS_H

#include "proto/codec.h"

#define RN_EFFECTS_MEASURED 32 // at most

// One effect: trainings with it beside trainings without, pair by pair of one seed. All that is
// compared is with less without: a positive gain, or cost, is the effect's.
struct rn_effect_gain {
    char name[32];
    bool on;                   // in the scene as it was trained
    double psnr, psnr_without; // dB on the withheld views, means over the seeds
    double gain, gain_spread;  // dB; half the range of the pairs' gains, NAN of one pair
    double cost;               // of a training ray's time, as a share of that without
    double picture_cost;       // likewise of a withheld view's picture
};
struct rn_effects_record {
    char machine[128], device[16], kernels[32];
    int64_t threads;
    char version[32];
    char measured_at[RN_TIME_MAX];
    double seconds;               // of training, each
    int64_t seeds;                // pairs of trainings an effect
    char held_out[256];           // which views are compared
    struct rn_effect_gain *gains; // owned
    size_t count;
};
extern const struct rn_table rn_effects_record_table;

// effects.json of a scene's folder. RN_ERROR_NOT_FOUND: nothing was measured; RN_ERROR_INVALID.
enum rn_status rn_effects_read(const char *scene_folder, struct rn_effects_record *ret_record,
                               struct rn_error *err) RN_MUST_CHECK;

// POST /v1/scenes/{id}/effects, and the options of an `effects` job.
#define RN_EFFECTS_SECONDS 10.0
#define RN_EFFECTS_SEEDS 3
struct rn_effects_options {
    double seconds; // of each training; absent = RN_EFFECTS_SECONDS
    int64_t seeds;  // pairs of trainings an effect; absent = RN_EFFECTS_SEEDS
};
extern const struct rn_table rn_effects_options_table;

#endif

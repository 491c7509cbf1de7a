// Scenes: the record, and the part of it that the runner knows.
#ifndef RN_PROTO_SCENE_H
#define RN_PROTO_SCENE_H

#include "common/settings/train.h"
#include "proto/codec.h"
#include "proto/dataset.h"
#include "proto/names.h"

struct rn_field_config_record {
    union rn_setting_value settings[RN_TRAIN_SETTINGS];
    double finest_cone; // measured on the photographs
};
extern const struct rn_table rn_field_config_table;

struct rn_difference_record {
    char what[256], measured[256];
};
struct rn_effect_entry {
    char name[32];
    bool on, decided;
    double number, threshold;
    char reason[160];
};

// What the runner knows of a scene. The daemon keeps it as the JSON text it came in.
struct rn_scene_description {
    struct rn_field_config_record config;
    struct rn_difference_record *differences; // owned
    size_t difference_count;
    struct rn_effect_entry *effects; // owned
    size_t effect_count;
    struct rn_bounds_record bounds;
    char held_out[256]; // "" = null
    int64_t memory_bytes;
    char kernels[32];
};
extern const struct rn_table rn_scene_description_table;

struct rn_checkpoint_record {
    int64_t step, size_bytes;
    char created_at[RN_TIME_MAX];
};

// The resource.
struct rn_scene {
    char id[RN_ID_MAX], name[RN_NAME_MAX];
    char dataset[RN_ID_MAX], dataset_name[RN_NAME_MAX];
    char created_at[RN_TIME_MAX];
    int state; // enum rn_scene_state
    char job[RN_ID_MAX];
    int64_t steps;
    double train_seconds, psnr;
    char parameters_sha256[65];
    struct rn_scene_description description;  // absent before it has trained
    struct rn_checkpoint_record *checkpoints; // owned, newest first
    size_t checkpoint_count;
    bool loaded;
};
extern const struct rn_table rn_scene_table;

#endif

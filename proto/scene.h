// Scenes: the record, and the part of it that the runner knows.
#ifndef RN_PROTO_SCENE_H
#define RN_PROTO_SCENE_H

#include "common/settings/train.h"
#include "proto/camera.h"
#include "proto/codec.h"
#include "proto/dataset.h"
#include "proto/marks.h"
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
    char number_text[48], threshold_text[48]; // with their unit; "" = absent
    int below; // 1: called for by numbers at the threshold and below it; -1: by none, or not known
    char reason[160];
    int measurable; // 1: an effects job measures it; -1: not known, of an older build
};

// What a scene that came as a file for viewing is; bits absent: it was trained here.
struct rn_viewing_record {
    int64_t bits, views;         // of a value of its planes; that the figures are means over
    int split;                   // rn_split_names, of these views
    double psnr, trained, loss;  // dB: its own, the original's, the difference
    char dataset[RN_NAME_MAX];   // that it was trained on, there
    char parameters_sha256[65];  // of the original
    char version[32];            // of the program that wrote the file
    struct rn_scene_start start; // absent of files that older builds wrote
};

extern const struct rn_table rn_viewing_table;

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
    struct rn_viewing_record viewing;
};
extern const struct rn_table rn_scene_description_table;

// Options of the job that takes a file for viewing in: POST /v1/scenes.
struct rn_scene_import_options {
    char dataset[RN_ID_MAX]; // whose photographs it may be compared with; "" = absent
};
extern const struct rn_table rn_scene_import_options_table;

#define RN_CHECKPOINTS_KEPT 2 // of a scene, the newest ones
struct rn_checkpoint_record {
    int64_t step, size_bytes;
    char created_at[RN_TIME_MAX];
};

// The resource.
struct rn_scene {
    char id[RN_ID_MAX], name[RN_NAME_MAX];
    char dataset[RN_ID_MAX], dataset_name[RN_NAME_MAX]; // "" = null: its photographs are not here
    char created_at[RN_TIME_MAX];
    int state; // enum rn_scene_state
    char job[RN_ID_MAX];
    int64_t steps;
    double train_seconds, psnr;
    char parameters_sha256[65];
    struct rn_scene_description description;  // absent before it has trained
    struct rn_checkpoint_record *checkpoints; // owned, newest first
    size_t checkpoint_count;
    struct rn_mark *marks; // owned, by time: what there is to look back at
    size_t mark_count;
    bool loaded;
};
extern const struct rn_table rn_scene_table;

#endif

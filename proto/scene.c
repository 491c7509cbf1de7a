#include "proto/scene.h"

#include "proto/checks.h"
#include "proto/job.h"

#define MOST_DIFFERENCES 64
#define MOST_EFFECTS 32

#define S struct rn_field_config_record
static const struct rn_field_spec config[] = {
    RN_F_NUMBER(S, finest_cone, RN_REQUIRED, 0, INFINITY),
};
const struct rn_table rn_field_config_table = RN_TABLE_OF_SETTINGS(
    S, "a field's configuration", config, &rn_train_settings, settings, 0, false);
#undef S

#define S struct rn_difference_record
static const struct rn_field_spec difference[] = {
    RN_F_TEXT(S, what, RN_REQUIRED, NULL),
    RN_F_TEXT(S, measured, RN_REQUIRED, NULL),
};
static const struct rn_table difference_table = RN_TABLE(S, "a difference", difference);
#undef S

#define S struct rn_effect_entry
static const struct rn_field_spec effect[] = {
    RN_F_TEXT(S, name, RN_REQUIRED, NULL),
    RN_F_BOOL(S, on, RN_REQUIRED),
    RN_F_BOOL(S, decided, RN_REQUIRED),
    RN_F_NUMBER(S, number, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_NUMBER(S, threshold, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_TEXT(S, number_text, 0, NULL),
    RN_F_TEXT(S, threshold_text, 0, NULL),
    {.name = "below", .type = RN_TYPE_TRUTH, .offset = offsetof(S, below)},
    RN_F_TEXT(S, reason, RN_REQUIRED, NULL),
    {.name = "measurable", .type = RN_TYPE_TRUTH, .offset = offsetof(S, measurable)},
};
static const struct rn_table effect_table = RN_TABLE(S, "an effect", effect);
#undef S

#define S struct rn_viewing_record
static const struct rn_field_spec viewing[] = {
    RN_F_INT(S, bits, RN_REQUIRED, 1, 32),
    RN_F_INT(S, views, RN_REQUIRED, 0, INFINITY),
    RN_F_NAME(S, split, RN_REQUIRED, rn_split_names),
    RN_F_NUMBER(S, psnr, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_NUMBER(S, trained, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_NUMBER(S, loss, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_TEXT(S, dataset, RN_REQUIRED, NULL),
    RN_F_TEXT(S, parameters_sha256, RN_REQUIRED, NULL),
    RN_F_TEXT(S, version, RN_REQUIRED, NULL),
    RN_F_OBJECT(S, start, 0, &rn_scene_start_table),
};
const struct rn_table rn_viewing_table = RN_TABLE(S, "a scene for viewing", viewing);
#undef S

#define S struct rn_scene_description
static const struct rn_field_spec description[] = {
    RN_F_OBJECT(S, config, RN_REQUIRED, &rn_field_config_table),
    RN_F_OBJECTS(S, differences, difference_count, RN_REQUIRED, &difference_table,
                 MOST_DIFFERENCES),
    RN_F_OBJECTS(S, effects, effect_count, RN_REQUIRED, &effect_table, MOST_EFFECTS),
    RN_F_OBJECT(S, bounds, RN_REQUIRED, &rn_bounds_record_table),
    RN_F_TEXT(S, held_out, RN_REQUIRED | RN_NULLABLE, NULL),
    RN_F_INT(S, memory_bytes, RN_REQUIRED, 0, INFINITY),
    RN_F_TEXT(S, kernels, RN_REQUIRED, NULL),
    RN_F_OBJECT(S, viewing, 0, &rn_viewing_table),
};
const struct rn_table rn_scene_description_table =
    RN_TABLE(S, "a scene's description", description);
#undef S

#define S struct rn_scene_import_options
static const struct rn_field_spec scene_import[] = {
    RN_F_TEXT(S, dataset, 0, rn_check_reference),
};
const struct rn_table rn_scene_import_options_table =
    RN_TABLE(S, "scene import options", scene_import);
#undef S

#define S struct rn_checkpoint_record
static const struct rn_field_spec checkpoint[] = {
    RN_F_INT(S, step, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, size_bytes, RN_REQUIRED, 0, INFINITY),
    RN_F_TEXT(S, created_at, RN_REQUIRED, NULL),
};
static const struct rn_table checkpoint_table = RN_TABLE(S, "a checkpoint", checkpoint);
#undef S

#define S struct rn_scene
// A member of the description, which stands among the scene's own.
#define PART(m, kind, f, ...)                                                                      \
    {                                                                                              \
        .name = #m, .type = RN_TYPE_##kind, .flags = (f), .offset = offsetof(S, description.m),    \
        __VA_ARGS__                                                                                \
    }
#define PART_COUNT(m) .count_offset = offsetof(S, description.m)
static const struct rn_field_spec scene[] = {
    RN_F_TEXT(S, id, RN_REQUIRED, NULL),
    RN_F_TEXT(S, name, RN_REQUIRED, NULL),
    RN_F_TEXT(S, dataset, RN_REQUIRED | RN_NULLABLE, NULL),
    RN_F_TEXT(S, dataset_name, RN_REQUIRED | RN_NULLABLE, NULL),
    RN_F_TEXT(S, created_at, RN_REQUIRED, NULL),
    RN_F_NAME(S, state, RN_REQUIRED, rn_scene_state_names),
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
    RN_F_INT(S, steps, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, train_seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, psnr, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_TEXT(S, parameters_sha256, RN_REQUIRED | RN_NULLABLE, NULL),
    PART(config, OBJECT, RN_REQUIRED | RN_NULLABLE, .table = &rn_field_config_table),
    PART(differences, OBJECTS, RN_REQUIRED, PART_COUNT(difference_count), .max = MOST_DIFFERENCES,
         .table = &difference_table),
    PART(effects, OBJECTS, RN_REQUIRED, PART_COUNT(effect_count), .max = MOST_EFFECTS,
         .table = &effect_table),
    PART(bounds, OBJECT, RN_REQUIRED | RN_NULLABLE, .table = &rn_bounds_record_table),
    PART(held_out, TEXT, RN_REQUIRED | RN_NULLABLE, .size = sizeof((S *)0)->description.held_out),
    RN_F_OBJECTS(S, checkpoints, checkpoint_count, RN_REQUIRED, &checkpoint_table, 16),
    RN_F_OBJECTS(S, marks, mark_count, RN_REQUIRED, &rn_mark_table, RN_MARKS_KEPT),
    PART(memory_bytes, INT, RN_REQUIRED | RN_NULLABLE, .max = INFINITY),
    PART(kernels, TEXT, RN_REQUIRED | RN_NULLABLE, .size = sizeof((S *)0)->description.kernels),
    RN_F_BOOL(S, loaded, RN_REQUIRED),
    PART(viewing, OBJECT, 0, .table = &rn_viewing_table),
};
const struct rn_table rn_scene_table = RN_TABLE(S, "a scene", scene);
#undef S

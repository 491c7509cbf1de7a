#include "proto/scene.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/job.h"

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
    RN_F_TEXT(S, reason, RN_REQUIRED, NULL),
};
static const struct rn_table effect_table = RN_TABLE(S, "an effect", effect);
#undef S

#define S struct rn_scene_description
static const struct rn_field_spec description[] = {
    RN_F_OBJECT(S, config, RN_REQUIRED, &rn_field_config_table),
    RN_F_OBJECTS(S, differences, difference_count, RN_REQUIRED, &difference_table, 64),
    RN_F_OBJECTS(S, effects, effect_count, RN_REQUIRED, &effect_table, 16),
    RN_F_OBJECT(S, bounds, RN_REQUIRED, &rn_bounds_record_table),
    RN_F_TEXT(S, held_out, RN_REQUIRED | RN_NULLABLE, NULL),
    RN_F_INT(S, memory_bytes, RN_REQUIRED, 0, INFINITY),
    RN_F_TEXT(S, kernels, RN_REQUIRED, NULL),
};
const struct rn_table rn_scene_description_table =
    RN_TABLE(S, "a scene's description", description);
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
static const struct rn_field_spec scene[] = {
    RN_F_TEXT(S, id, RN_REQUIRED, NULL),
    RN_F_TEXT(S, name, RN_REQUIRED, NULL),
    RN_F_TEXT(S, dataset, RN_REQUIRED, NULL),
    RN_F_TEXT(S, dataset_name, RN_REQUIRED, NULL),
    RN_F_TEXT(S, created_at, RN_REQUIRED, NULL),
    RN_F_NAME(S, state, RN_REQUIRED, rn_scene_state_names),
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
    RN_F_INT(S, steps, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, train_seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, psnr, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_TEXT(S, parameters_sha256, RN_REQUIRED | RN_NULLABLE, NULL),
    RN_F_JSON(S, config, RN_REQUIRED | RN_NULLABLE | RN_IS_OBJECT),
    RN_F_JSON(S, differences, RN_REQUIRED),
    RN_F_JSON(S, effects, RN_REQUIRED),
    RN_F_JSON(S, bounds, RN_REQUIRED | RN_NULLABLE | RN_IS_OBJECT),
    RN_F_TEXT(S, held_out, RN_REQUIRED | RN_NULLABLE, NULL),
    RN_F_OBJECTS(S, checkpoints, checkpoint_count, RN_REQUIRED, &checkpoint_table, 16),
    RN_F_INT(S, memory_bytes, RN_REQUIRED | RN_NULLABLE, 0, INFINITY),
    RN_F_TEXT(S, kernels, RN_REQUIRED | RN_NULLABLE, NULL),
    RN_F_BOOL(S, loaded, RN_REQUIRED),
};
const struct rn_table rn_scene_table = RN_TABLE(S, "a scene", scene);

// The description, taken apart into the scene's own members.
static const struct rn_field_spec scene_part[] = {
    RN_F_JSON(S, config, RN_REQUIRED | RN_IS_OBJECT),
    RN_F_JSON(S, differences, RN_REQUIRED),
    RN_F_JSON(S, effects, RN_REQUIRED),
    RN_F_JSON(S, bounds, RN_REQUIRED | RN_IS_OBJECT),
    RN_F_TEXT(S, held_out, RN_REQUIRED | RN_NULLABLE, NULL),
    RN_F_INT(S, memory_bytes, RN_REQUIRED, 0, INFINITY),
    RN_F_TEXT(S, kernels, RN_REQUIRED, NULL),
};
static const struct rn_table scene_part_table = RN_TABLE(S, "a scene's description", scene_part);
#undef S

enum rn_status rn_scene_describe(struct rn_scene *ret_scene, const char *text, size_t size,
                                 struct rn_error *err) {
    struct rn_scene part;
    rn_message_init(&scene_part_table, &part);
    if (text) {
        enum rn_status status = rn_decode(&scene_part_table, text, size, &part, NULL, err);
        if (status) return status;
    } else {
        part.differences = strdup("[]");
        part.effects = strdup("[]");
    }
    if (!part.differences || !part.effects) {
        rn_message_finish(&scene_part_table, &part);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "scene", "out of memory");
    }
    rn_message_finish(&scene_part_table, ret_scene);
    ret_scene->config = part.config;
    ret_scene->differences = part.differences;
    ret_scene->effects = part.effects;
    ret_scene->bounds = part.bounds;
    ret_scene->memory_bytes = part.memory_bytes;
    memcpy(ret_scene->held_out, part.held_out, sizeof part.held_out);
    memcpy(ret_scene->kernels, part.kernels, sizeof part.kernels);
    return RN_OK;
}

#include "proto/effects.h"

#include "proto/checks.h"
#include "proto/folder.h"

#define S struct rn_effect_gain
static const struct rn_field_spec gain[] = {
    RN_F_TEXT(S, name, RN_REQUIRED, NULL),
    RN_F_BOOL(S, on, RN_REQUIRED),
    RN_F_NUMBER(S, psnr, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_NUMBER(S, psnr_without, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_NUMBER(S, gain, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_NUMBER(S, gain_spread, RN_REQUIRED | RN_NULLABLE, 0, INFINITY),
    RN_F_NUMBER(S, cost, RN_REQUIRED | RN_NULLABLE, -1, INFINITY),
    RN_F_NUMBER(S, picture_cost, RN_REQUIRED | RN_NULLABLE, -1, INFINITY),
};
static const struct rn_table gain_table = RN_TABLE(S, "an effect's gain", gain);
#undef S

#define S struct rn_effects_record
static const struct rn_field_spec record[] = {
    RN_F_TEXT(S, machine, RN_REQUIRED, NULL),
    RN_F_TEXT(S, device, RN_REQUIRED, NULL),
    RN_F_TEXT(S, kernels, RN_REQUIRED, NULL),
    RN_F_INT(S, threads, RN_REQUIRED, 1, 1024),
    RN_F_TEXT(S, version, RN_REQUIRED, NULL),
    RN_F_TEXT(S, measured_at, RN_REQUIRED, NULL),
    RN_F_NUMBER(S, seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, seeds, RN_REQUIRED, 1, 64),
    RN_F_TEXT(S, held_out, RN_REQUIRED, NULL),
    RN_F_OBJECTS(S, gains, count, RN_REQUIRED, &gain_table, RN_EFFECTS_MEASURED),
};
const struct rn_table rn_effects_record_table = RN_TABLE(S, "measured effects", record);
#undef S

#define S struct rn_effects_options
static const struct rn_field_spec options[] = {
    RN_F_NUMBER(S, seconds, 0, 1, 3600),
    RN_F_INT(S, seeds, 0, 1, 16),
};
const struct rn_table rn_effects_options_table = RN_TABLE(S, "effects options", options);
#undef S

enum rn_status rn_effects_read(const char *scene_folder, struct rn_effects_record *ret_record,
                               struct rn_error *err) {
    return rn_folder_read(scene_folder, "effects.json", &rn_effects_record_table, ret_record, err);
}

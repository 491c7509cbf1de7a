#include "proto/export.h"

#include "proto/job.h"

const char *const rn_export_format_names[] = {"ply", "obj", NULL};
const char *const rn_export_kind_names[] = {"mesh", "scene", NULL};

#define S struct rn_export_options
static const struct rn_field_spec options[] = {
    RN_F_NAME(S, as, 0, rn_export_kind_names),
    RN_F_NAME(S, format, 0, rn_export_format_names),
    RN_F_INT(S, cells, 0, 8, 1024),
    RN_F_NUMBER(S, level, 0, 0.01, 0.99),
    RN_F_NUMBERS(S, crop, 0, -INFINITY, INFINITY),
    RN_F_INT(S, max_bytes, 0, 1, INFINITY),
    RN_F_NUMBER(S, max_loss, 0, 0, 100),
};
const struct rn_table rn_export_options_table = RN_TABLE(S, "export options", options);
#undef S

const char *rn_export_check(const struct rn_export_options *o, const char **ret_pointer) {
    if (o->as == RN_EXPORT_SCENE) {
        *ret_pointer = o->format >= 0          ? "#/options/format"
                       : o->cells != RN_ABSENT ? "#/options/cells"
                       : !isnan(o->level)      ? "#/options/level"
                       : isfinite(o->crop[0])  ? "#/options/crop"
                                               : NULL;
        return *ret_pointer ? "is of a mesh, not of a scene" : NULL;
    }
    *ret_pointer = o->max_bytes != RN_ABSENT ? "#/options/max_bytes"
                   : !isnan(o->max_loss)     ? "#/options/max_loss"
                                             : NULL;
    return *ret_pointer ? "is of a scene, not of a mesh; as says which" : NULL;
}

#define S struct rn_export_result
static const struct rn_field_spec result[] = {
    RN_F_TEXT(S, file, RN_REQUIRED, NULL),
    RN_F_INT(S, bytes, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, vertices, 0, 0, INFINITY),
    RN_F_INT(S, triangles, 0, 0, INFINITY),
    RN_F_INT(S, bits, 0, 1, 32),
    RN_F_INT(S, views, 0, 1, INFINITY),
    RN_F_NUMBER(S, psnr, 0, -INFINITY, INFINITY),
    RN_F_NUMBER(S, trained, 0, -INFINITY, INFINITY),
    RN_F_NUMBER(S, loss, 0, -INFINITY, INFINITY),
    RN_F_NAME(S, split, 0, rn_split_names),
};
const struct rn_table rn_export_result_table = RN_TABLE(S, "export result", result);
#undef S

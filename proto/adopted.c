#include "proto/adopted.h"

#define S struct rn_adopted_record
static const struct rn_field_spec fields[] = {
    RN_F_INT(S, datasets, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, scenes, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, camera_paths, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, jobs, RN_REQUIRED, 0, INFINITY),
};
const struct rn_table rn_adopted_table = RN_TABLE(S, "a backup that was taken in", fields);
#undef S

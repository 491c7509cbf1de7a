// Between the reader of paths and what moves along them. Within common/path only.
#ifndef RN_COMMON_PATH_MOTION_H
#define RN_COMMON_PATH_MOTION_H

#include "common/path/path.h"

// Fills centre and travelled, once keys and the rest stand. RN_ERROR_NO_MEMORY.
enum rn_status rn_path_prepare(struct rn_path *path) RN_MUST_CHECK;

#endif

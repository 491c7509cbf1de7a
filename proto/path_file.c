#include "proto/path_file.h"

#define S struct rn_path_file_request
static const struct rn_field_spec request[] = {
    RN_F_STRING(S, file, 0, RN_PATH_FILE_MAX),
    RN_F_STRING(S, beside, 0, RN_PATH_FILE_MAX),
    RN_F_TEXT(S, from, 0, NULL),
    RN_F_PATH(S, path, 0),
    RN_F_TEXT(S, to, 0, NULL),
    RN_F_STRING(S, space, 0, RN_PATH_FILE_MAX),
    RN_F_STRING(S, dataset, 0, RN_PATH_FILE_MAX),
};
const struct rn_table rn_path_file_request_table =
    RN_TABLE(S, "a camera path of another program", request);
#undef S

#define S struct rn_path_file
static const struct rn_field_spec answer[] = {
    RN_F_TEXT(S, format, RN_REQUIRED, NULL),   RN_F_PATH(S, path, 0),
    RN_F_STRING(S, file, 0, RN_PATH_FILE_MAX), RN_F_STRING(S, beside, 0, RN_PATH_FILE_MAX),
    RN_F_TEXT(S, beside_name, 0, NULL),
};
const struct rn_table rn_path_file_table = RN_TABLE(S, "a converted camera path", answer);
#undef S

#include "proto/audit.h"

#define S struct rn_audit_line
static const struct rn_field_spec line[] = {
    RN_F_TEXT(S, time, RN_REQUIRED, NULL),
    RN_F_TEXT(S, request, RN_REQUIRED, NULL),
    RN_F_TEXT(S, token, 0, NULL),
    RN_F_TEXT(S, token_id, 0, NULL),
    RN_F_TEXT(S, address, RN_REQUIRED, NULL),
    RN_F_TEXT(S, verb, RN_REQUIRED, NULL),
    RN_F_STRING(S, path, RN_REQUIRED, 65536),
    RN_F_INT(S, status, RN_REQUIRED, 0, 999),
};
const struct rn_table rn_audit_line_table = RN_TABLE(S, "a line of the audit", line);
#undef S

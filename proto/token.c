#include "proto/token.h"

#include "proto/checks.h"

#define MOST_SECONDS (10 * 365.25 * 86400)

#define S struct rn_token_request
static const struct rn_field_spec request[] = {
    RN_F_TEXT(S, name, RN_REQUIRED, rn_check_name),
    RN_F_NAME(S, scope, 0, rn_scope_names),
    RN_F_TEXT(S, scene, 0, rn_check_reference),
    RN_F_TEXT(S, job, 0, rn_check_reference),
    RN_F_INT(S, expires_s, 0, 1, MOST_SECONDS),
    RN_F_INT(S, max_jobs, 0, 0, 10000),
    RN_F_INT(S, max_bytes, 0, 0, 1e15),
};
const struct rn_table rn_token_request_table = RN_TABLE(S, "a token's request", request);
#undef S

#define S struct rn_token_record
static const struct rn_field_spec token[] = {
    RN_F_TEXT(S, id, RN_REQUIRED | RN_NULLABLE, NULL),
    RN_F_TEXT(S, name, RN_REQUIRED | RN_NULLABLE, NULL),
    RN_F_NAME(S, scope, RN_REQUIRED, rn_scope_names),
    RN_F_TEXT(S, scene, RN_REQUIRED | RN_NULLABLE, NULL),
    RN_F_TEXT(S, job, RN_REQUIRED | RN_NULLABLE, NULL),
    RN_F_TEXT(S, created_at, RN_REQUIRED | RN_NULLABLE, NULL),
    RN_F_TEXT(S, expires_at, RN_REQUIRED | RN_NULLABLE, NULL),
    RN_F_INT(S, max_jobs, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, max_bytes, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, open_jobs, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, bytes, RN_REQUIRED, 0, INFINITY),
    RN_F_TEXT(S, token, 0, NULL),
};
const struct rn_table rn_token_table = RN_TABLE(S, "a token", token);
#undef S

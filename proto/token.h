// Tokens: who may do what. The secret itself is told once, in the answer that makes it.
#ifndef RN_PROTO_TOKEN_H
#define RN_PROTO_TOKEN_H

#include "proto/codec.h"

// POST /v1/tokens. With a scene or a job it is a link: it shows that one thing and nothing else.
struct rn_token_request {
    char name[RN_NAME_MAX];
    int scope;                   // rn_scope_names; absent: read
    char scene[RN_NAME_MAX];     // id or name
    char job[RN_ID_MAX];         // of a path
    int64_t expires_s;           // from now; absent: never
    int64_t max_jobs, max_bytes; // quotas; absent: the daemon's
};
extern const struct rn_table rn_token_request_table;

// The resource.
struct rn_token_record {
    char id[RN_ID_MAX], name[RN_NAME_MAX];
    int scope;
    char scene[RN_ID_MAX], job[RN_ID_MAX]; // "" = null
    char created_at[RN_TIME_MAX], expires_at[RN_TIME_MAX];
    int64_t max_jobs, max_bytes; // 0: no quota
    int64_t open_jobs, bytes;    // what counts against them
    char token[64];              // the secret; "" = left out
};
extern const struct rn_table rn_token_table;

#endif

// A line of the audit: one write that was asked for, and what came of it.
#ifndef RN_PROTO_AUDIT_H
#define RN_PROTO_AUDIT_H

#include "proto/codec.h"
#include "proto/names.h"

struct rn_audit_line {
    char time[RN_TIME_MAX];
    char request[33];                             // its id, as the answer and the log have it
    char token[RN_NAME_MAX], token_id[RN_ID_MAX]; // "" = absent: the daemon's own, or none
    char address[46];
    char verb[8];
    char *path;     // owned
    int64_t status; // 0: the client left before there was one
};
extern const struct rn_table rn_audit_line_table;

#endif

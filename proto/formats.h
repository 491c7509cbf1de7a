// The tables of dataset formats and of formats of camera paths, and what kinds of captures and
// sources of bounds are called, as GET /v1/formats gives them.
#ifndef RN_PROTO_FORMATS_H
#define RN_PROTO_FORMATS_H

#include "common/base/status.h"

// {"items": [{name, title, signs, documents, photo_folders}] in the order of precedence,
// "paths": [{name, title, file}], "captures" and "bounds": [{name, title}]}; malloc'd.
// RN_ERROR_NO_MEMORY.
enum rn_status rn_formats_to_json(char **ret_json, struct rn_error *err) RN_MUST_CHECK;

#endif

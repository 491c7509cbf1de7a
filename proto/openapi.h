// openapi.yaml as JSON, embedded at build time.
#ifndef RN_PROTO_OPENAPI_H
#define RN_PROTO_OPENAPI_H

#include <stddef.h>

extern const char rn_openapi_json[]; // NUL-terminated
extern const size_t rn_openapi_json_size;

#endif

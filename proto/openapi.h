// openapi.yaml as JSON, embedded at build time.
#ifndef RN_PROTO_OPENAPI_H
#define RN_PROTO_OPENAPI_H

extern const char rn_openapi_json[]; // NUL-terminated

#endif

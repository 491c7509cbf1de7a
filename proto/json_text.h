// Inside proto/: writing JSON text, and finding a place in it.
#ifndef RN_PROTO_JSON_TEXT_H
#define RN_PROTO_JSON_TEXT_H

#include <jansson.h>
#include <stddef.h>

#include "common/base/buf.h"
#include "common/math/camera.h"

#define RN_JSON_TEXT_MAX ((size_t)64 << 20) // bytes of one encoded message

void rn_json_put_string(struct rn_buf *buf, const char *text);
// The shortest decimal that reads back as the same double. `value` is finite.
void rn_json_put_number(struct rn_buf *buf, double value);
void rn_json_put_value(struct rn_buf *buf, const json_t *value);
// In OpenCV axes with fx, fy, cx, cy and the lens. camera.c
void rn_json_put_camera(struct rn_buf *buf, const struct rn_camera *camera);

// The pointer ("#/options/planes") of what stands at byte `position` of a JSON text, well formed up
// to there; right behind a key it is the key's. Long pointers are cut.
void rn_json_pointer_at(const char *json, size_t position, char *ret_pointer, size_t size);
// Appends "/token" with RFC 6901 escapes; the result is cut to `size`.
void rn_json_pointer_push(char *pointer, size_t size, const char *token, size_t token_size);

#endif

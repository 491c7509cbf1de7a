#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/camera.h"
#include "proto/codec.h"
#include "proto/event.h"
#include "proto/json_text.h"

static const void *member(const struct rn_field_spec *field, const void *message) {
    return (const char *)message + field->offset;
}

static size_t member_count(const struct rn_field_spec *field, const void *message) {
    return *(const size_t *)((const char *)message + field->count_offset);
}

static bool message_is_absent(const struct rn_table *table, const void *message);

static bool is_absent(const struct rn_field_spec *field, const void *message) {
    const void *at = member(field, message);
    switch (field->type) {
    case RN_TYPE_BOOL:
        return false;
    case RN_TYPE_INT:
        return *(const int64_t *)at == RN_ABSENT;
    case RN_TYPE_NUMBER:
    case RN_TYPE_NUMBERS:
        return !isfinite(*(const double *)at);
    case RN_TYPE_NAME:
    case RN_TYPE_TRUTH:
        return *(const int *)at < 0;
    case RN_TYPE_TEXT:
        return *(const char *)at == '\0';
    case RN_TYPE_STRING:
    case RN_TYPE_JSON:
        return *(char *const *)at == NULL;
    case RN_TYPE_CAMERA:
        return ((const struct rn_camera *)at)->width == 0;
    case RN_TYPE_PATH:
        return ((const struct rn_path_document *)at)->json == NULL;
    case RN_TYPE_INTS:
    case RN_TYPE_TEXTS:
    case RN_TYPE_OBJECTS:
        return member_count(field, message) == 0;
    case RN_TYPE_OBJECT:
        return message_is_absent(field->table, at);
    }
    return true;
}

static bool message_is_absent(const struct rn_table *table, const void *message) {
    for (size_t i = 0; i < rn_table_rows(table); i++) {
        struct rn_field_spec row = rn_table_row(table, i);
        const struct rn_field_spec *field = &row;
        if (!field->name) continue;
        if (field->type == RN_TYPE_BOOL && !*(const bool *)member(field, message)) continue;
        if (!is_absent(field, message)) return false;
    }
    return true;
}

// An encoding under way; `wrong` is the first field that should not be absent.
struct encoder {
    struct rn_buf buf;
    const char *wrong;
};

static void put(struct encoder *encoder, const char *text) {
    rn_buf_append(&encoder->buf, text, strlen(text));
}

static void put_message(struct encoder *encoder, const struct rn_table *table, const void *message);

static void put_values(struct encoder *encoder, const struct rn_field_spec *field,
                       const void *message) {
    const char *at = member(field, message);
    size_t count = field->type == RN_TYPE_NUMBERS ? field->capacity : member_count(field, message);
    put(encoder, "[");
    for (size_t i = 0; i < count; i++) {
        if (i) put(encoder, ",");
        if (field->type == RN_TYPE_INTS)
            rn_buf_printf(&encoder->buf, "%" PRId64, ((const int64_t *)at)[i]);
        else if (field->type == RN_TYPE_TEXTS)
            rn_json_put_string(&encoder->buf, at + i * field->size);
        else if (isfinite(((const double *)at)[i]))
            rn_json_put_number(&encoder->buf, ((const double *)at)[i]);
        else
            encoder->wrong = field->name;
    }
    put(encoder, "]");
}

static void put_objects(struct encoder *encoder, const struct rn_field_spec *field,
                        const void *message) {
    const char *items = *(char *const *)member(field, message);
    put(encoder, "[");
    for (size_t i = 0; i < member_count(field, message); i++) {
        if (i) put(encoder, ",");
        put_message(encoder, field->table, items + i * field->table->size);
    }
    put(encoder, "]");
}

static void put_field(struct encoder *encoder, const struct rn_field_spec *field,
                      const void *message) {
    const void *at = member(field, message);
    switch (field->type) {
    case RN_TYPE_BOOL:
        put(encoder, *(const bool *)at ? "true" : "false");
        break;
    case RN_TYPE_TRUTH:
        put(encoder, *(const int *)at ? "true" : "false");
        break;
    case RN_TYPE_INT:
        rn_buf_printf(&encoder->buf, "%" PRId64, *(const int64_t *)at);
        break;
    case RN_TYPE_NUMBER:
        rn_json_put_number(&encoder->buf, *(const double *)at);
        break;
    case RN_TYPE_NAME:
        rn_json_put_string(&encoder->buf, field->names[*(const int *)at]);
        break;
    case RN_TYPE_TEXT:
        rn_json_put_string(&encoder->buf, at);
        break;
    case RN_TYPE_STRING:
        rn_json_put_string(&encoder->buf, *(char *const *)at);
        break;
    case RN_TYPE_JSON:
        put(encoder, *(char *const *)at);
        break;
    case RN_TYPE_CAMERA:
        rn_json_put_camera(&encoder->buf, at);
        break;
    case RN_TYPE_PATH:
        put(encoder, ((const struct rn_path_document *)at)->json);
        break;
    case RN_TYPE_INTS:
    case RN_TYPE_NUMBERS:
    case RN_TYPE_TEXTS:
        put_values(encoder, field, message);
        break;
    case RN_TYPE_OBJECT:
        put_message(encoder, field->table, at);
        break;
    case RN_TYPE_OBJECTS:
        put_objects(encoder, field, message);
        break;
    }
}

// Fields for which "empty" is a value, so that a required one may be so.
static bool may_be_empty(enum rn_type type) {
    return type == RN_TYPE_TEXT || type == RN_TYPE_INTS || type == RN_TYPE_TEXTS ||
           type == RN_TYPE_OBJECTS || type == RN_TYPE_OBJECT;
}

static void put_message(struct encoder *encoder, const struct rn_table *table,
                        const void *message) {
    const char *separator = "{";
    for (size_t i = 0; i < rn_table_rows(table); i++) {
        struct rn_field_spec row = rn_table_row(table, i);
        const struct rn_field_spec *field = &row;
        if (!field->name) continue;
        bool absent = is_absent(field, message), as_null = absent && field->flags & RN_NULLABLE;
        if (absent && !as_null && !(field->flags & RN_REQUIRED)) continue;
        put(encoder, separator);
        rn_json_put_string(&encoder->buf, field->name);
        put(encoder, ":");
        separator = ",";
        if (as_null)
            put(encoder, "null");
        else if (absent && !may_be_empty(field->type))
            encoder->wrong = field->name;
        else
            put_field(encoder, field, message);
    }
    put(encoder, *separator == '{' ? "{}" : "}");
}

static enum rn_status take(struct encoder *encoder, const char *what, char **ret_json,
                           size_t *ret_size, struct rn_error *err) {
    size_t size;
    char *json = (char *)rn_buf_take(&encoder->buf, &size);
    if (!json) return rn_error_set(err, RN_ERROR_NO_MEMORY, what, "out of memory");
    if (encoder->wrong) {
        free(json);
        return rn_error_set(err, RN_ERROR_INVALID, what, "the field %s has no value",
                            encoder->wrong);
    }
    *ret_json = json;
    if (ret_size) *ret_size = size;
    return RN_OK;
}

enum rn_status rn_encode(const struct rn_table *table, const void *message, char **ret_json,
                         size_t *ret_size, struct rn_error *err) {
    struct encoder encoder = {.wrong = NULL};
    rn_buf_init(&encoder.buf, RN_JSON_TEXT_MAX);
    put_message(&encoder, table, message);
    return take(&encoder, table->title, ret_json, ret_size, err);
}

enum rn_status rn_encode_list(const char *const *items, size_t count, const char *next_cursor,
                              char **ret_json, size_t *ret_size, struct rn_error *err) {
    struct encoder encoder = {.wrong = NULL};
    rn_buf_init(&encoder.buf, RN_JSON_TEXT_MAX);
    put(&encoder, "{\"items\":[");
    for (size_t i = 0; i < count; i++) {
        if (i) put(&encoder, ",");
        put(&encoder, items[i]);
    }
    put(&encoder, "],\"next_cursor\":");
    if (next_cursor)
        rn_json_put_string(&encoder.buf, next_cursor);
    else
        put(&encoder, "null");
    put(&encoder, "}");
    return take(&encoder, "list", ret_json, ret_size, err);
}

enum rn_status rn_encode_strings(const char *const *strings, size_t count, char **ret_json,
                                 struct rn_error *err) {
    struct encoder encoder = {.wrong = NULL};
    rn_buf_init(&encoder.buf, RN_JSON_TEXT_MAX);
    put(&encoder, "[");
    for (size_t i = 0; i < count; i++) {
        if (i) put(&encoder, ",");
        rn_json_put_string(&encoder.buf, strings[i]);
    }
    put(&encoder, "]");
    return take(&encoder, "strings", ret_json, NULL, err);
}

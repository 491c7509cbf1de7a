#include "proto/codec.h"

#include <inttypes.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "common/dataset/json.h"
#include "common/dataset/json_memory.h"
#include "common/path/path.h"
#include "proto/json_text.h"

// ---- tables --------------------------------------------------------------------------------

// A row of settings as a field, its value that of a union rn_setting_value.
static struct rn_field_spec spec_of(const struct rn_setting *row, bool as_option, bool by_name) {
    static const enum rn_type types[] = {
        [RN_SETTING_BOOL] = RN_TYPE_TRUTH,     [RN_SETTING_INT] = RN_TYPE_INT,
        [RN_SETTING_INT64] = RN_TYPE_INT,      [RN_SETTING_UINT64] = RN_TYPE_INT,
        [RN_SETTING_NUMBER] = RN_TYPE_NUMBER,  [RN_SETTING_CHOICE] = RN_TYPE_NAME,
        [RN_SETTING_COLOUR] = RN_TYPE_NUMBERS, [RN_SETTING_TEXT] = RN_TYPE_TEXT};
    struct rn_field_spec spec = {.name = as_option   ? row->option
                                         : row->told ? row->told
                                                     : row->name,
                                 .type = row->choices ? RN_TYPE_NAME : types[row->type],
                                 .size = RN_SETTING_TEXT_MAX,
                                 .min = row->min,
                                 .max = row->max,
                                 .capacity = 3,
                                 .names = row->choices};
    if (row->flags & RN_SETTING_OVER_MIN) spec.flags |= RN_OVER_MIN;
    if (row->flags & RN_SETTING_UNDER_MAX) spec.flags |= RN_UNDER_MAX;
    if (row->flags & RN_SETTING_POWER_OF_TWO) spec.flags |= RN_POWER_OF_TWO;
    if (as_option) return spec;
    if (by_name && !rn_setting_is_by_name(row)) spec.name = NULL;
    if (!by_name && !(row->flags & RN_SETTING_LATER)) spec.flags |= RN_REQUIRED;
    if (row->flags & RN_SETTING_OR_ZERO) {
        spec.min = 0;
        spec.flags &= ~(unsigned)RN_OVER_MIN;
    }
    return spec;
}

size_t rn_table_rows(const struct rn_table *table) {
    return table->field_count + (table->settings ? table->settings->count : 0);
}

struct rn_field_spec rn_table_row(const struct rn_table *table, size_t i) {
    size_t count = table->settings ? table->settings->count : 0, first = table->settings_at;
    if (!count || i < first) return table->fields[i];
    if (i >= first + count) return table->fields[i - count];
    struct rn_field_spec spec =
        spec_of(&table->settings->rows[i - first], table->as_options, table->by_name);
    spec.offset = table->settings_offset + (i - first) * sizeof(union rn_setting_value);
    return spec;
}

// ---- members -------------------------------------------------------------------------------

static void *member(const struct rn_field_spec *field, void *message) {
    return (char *)message + field->offset;
}

static size_t *member_count(const struct rn_field_spec *field, void *message) {
    return (size_t *)((char *)message + field->count_offset);
}

static void init_field(const struct rn_field_spec *field, void *message) {
    void *at = member(field, message);
    switch (field->type) {
    case RN_TYPE_BOOL:
        *(bool *)at = false;
        break;
    case RN_TYPE_INT:
        *(int64_t *)at = RN_ABSENT;
        break;
    case RN_TYPE_NUMBER:
        *(double *)at = NAN;
        break;
    case RN_TYPE_NAME:
    case RN_TYPE_TRUTH:
        *(int *)at = -1;
        break;
    case RN_TYPE_TEXT:
        memset(at, 0, field->size);
        break;
    case RN_TYPE_NUMBERS:
        for (size_t i = 0; i < field->capacity; i++)
            ((double *)at)[i] = NAN;
        break;
    case RN_TYPE_INTS:
    case RN_TYPE_TEXTS:
        memset(at, 0, field->capacity * (field->size ? field->size : sizeof(int64_t)));
        *member_count(field, message) = 0;
        break;
    case RN_TYPE_OBJECT:
        rn_message_init(field->table, at);
        break;
    case RN_TYPE_OBJECTS:
        *member_count(field, message) = 0;
        *(void **)at = NULL;
        break;
    case RN_TYPE_STRING:
    case RN_TYPE_JSON:
        *(char **)at = NULL;
        break;
    case RN_TYPE_CAMERA:
        *(struct rn_camera *)at = (struct rn_camera){0};
        break;
    case RN_TYPE_PATH:
        *(struct rn_path_document *)at = (struct rn_path_document){0};
        break;
    }
}

void rn_message_init(const struct rn_table *table, void *message) {
    memset(message, 0, table->size);
    for (size_t i = 0; i < rn_table_rows(table); i++) {
        struct rn_field_spec field = rn_table_row(table, i);
        init_field(&field, message); // rows that are no field too
    }
}

static void free_objects(const struct rn_field_spec *field, void *message) {
    char *items = *(char **)member(field, message);
    for (size_t i = 0; items && i < *member_count(field, message); i++)
        rn_message_finish(field->table, items + i * field->table->size);
    free(items);
}

static void free_path(struct rn_path_document *document) {
    free(document->json);
    rn_path_destroy(&document->path);
}

void rn_message_finish(const struct rn_table *table, void *message) {
    for (size_t i = 0; i < rn_table_rows(table); i++) {
        struct rn_field_spec row = rn_table_row(table, i);
        const struct rn_field_spec *field = &row;
        if (!field->name) continue;
        void *at = member(field, message);
        if (field->type == RN_TYPE_STRING || field->type == RN_TYPE_JSON) free(*(char **)at);
        if (field->type == RN_TYPE_PATH) free_path(at);
        if (field->type == RN_TYPE_OBJECT) rn_message_finish(field->table, at);
        if (field->type == RN_TYPE_OBJECTS) free_objects(field, message);
        init_field(field, message);
    }
}

// ---- errors --------------------------------------------------------------------------------

void rn_field_errors_add(struct rn_field_errors *errors, const char *pointer, const char *fmt,
                         ...) {
    if (!errors || errors->count == RN_FIELD_ERRORS_MAX) return;
    struct rn_field_error *item = &errors->items[errors->count++];
    snprintf(item->pointer, sizeof item->pointer, "%s", pointer);
    va_list args;
    va_start(args, fmt);
    vsnprintf(item->detail, sizeof item->detail, fmt, args);
    va_end(args);
}

// One decoding under way. `failed` is sticky; a lack of memory ends the decoding.
struct decoder {
    struct rn_field_errors *errors;
    bool no_memory;
    char pointer[256]; // of the value at hand
};

RN_PRINTF(2, 3) static void refuse(struct decoder *decoder, const char *fmt, ...) {
    char text[256];
    va_list args;
    va_start(args, fmt);
    vsnprintf(text, sizeof text, fmt, args);
    va_end(args);
    rn_field_errors_add(decoder->errors, decoder->pointer, "%s", text);
}

// Appends to the pointer; returns the length to go back to with leave().
static size_t enter(struct decoder *decoder, const char *token) {
    size_t length = strlen(decoder->pointer);
    rn_json_pointer_push(decoder->pointer, sizeof decoder->pointer, token, strlen(token));
    return length;
}

static size_t enter_index(struct decoder *decoder, size_t index) {
    char text[24];
    snprintf(text, sizeof text, "%zu", index);
    return enter(decoder, text);
}

static void leave(struct decoder *decoder, size_t length) {
    decoder->pointer[length] = '\0';
}

// ---- decoding ------------------------------------------------------------------------------

static void decode_object(struct decoder *decoder, const struct rn_table *table, json_t *object,
                          void *message);

// 0 is in the range of what may have none.
static bool in_range(struct decoder *decoder, const struct rn_field_spec *field, double value) {
    bool low = field->flags & RN_OVER_MIN ? value <= field->min : value < field->min;
    bool high = field->flags & RN_UNDER_MAX ? value >= field->max : value > field->max;
    int exponent;
    bool other = field->flags & RN_POWER_OF_TWO && value != 0 && frexp(value, &exponent) != 0.5;
    if (other && !low && !high)
        refuse(decoder, "must be a power of two from %.15g to %.15g", field->min, field->max);
    if (low)
        refuse(decoder, "must be %s %.15g, is %.15g",
               field->flags & RN_OVER_MIN ? "more than" : "at least", field->min, value);
    if (high)
        refuse(decoder, "must be %s %.15g, is %.15g",
               field->flags & RN_UNDER_MAX ? "less than" : "at most", field->max, value);
    return !low && !high && !other;
}

static void decode_int(struct decoder *decoder, const struct rn_field_spec *field,
                       const json_t *value, int64_t *ret_value) {
    double real = json_number_value(value);
    bool whole = json_is_integer(value) ||
                 (json_is_real(value) && fabs(real) <= 0x1p53 && real == floor(real));
    if (!whole)
        refuse(decoder, "must be a whole number");
    else if (in_range(decoder, field, real))
        *ret_value = json_is_integer(value) ? (int64_t)json_integer_value(value) : (int64_t)real;
}

static void decode_number(struct decoder *decoder, const struct rn_field_spec *field,
                          const json_t *value, double *ret_value) {
    if (!json_is_number(value))
        refuse(decoder, "must be a number");
    else if (in_range(decoder, field, json_number_value(value)))
        *ret_value = json_number_value(value);
}

static void decode_name(struct decoder *decoder, const struct rn_field_spec *field,
                        const json_t *value, int *ret_value) {
    int index = json_is_string(value) ? rn_name_index(field->names, json_string_value(value)) : -1;
    if (index >= 0) {
        *ret_value = index;
        return;
    }
    char list[200] = "";
    for (size_t i = 0; field->names[i]; i++) {
        size_t length = strlen(list);
        snprintf(list + length, sizeof list - length, "%s%s", i ? ", " : "", field->names[i]);
    }
    refuse(decoder, "must be one of %s", list);
}

static void decode_text(struct decoder *decoder, const struct rn_field_spec *field,
                        const json_t *value, char *ret_text) {
    const char *text = json_string_value(value);
    if (!text) {
        refuse(decoder, "must be a string");
    } else if (json_string_length(value) >= field->size) {
        refuse(decoder, "must have at most %zu bytes, has %zu", field->size - 1,
               json_string_length(value));
    } else {
        const char *wrong = field->check ? field->check(text) : NULL;
        if (wrong) refuse(decoder, "%s", wrong);
        memcpy(ret_text, text, json_string_length(value) + 1);
    }
}

static void decode_string(struct decoder *decoder, const struct rn_field_spec *field,
                          const json_t *value, char **ret_text) {
    if (!json_is_string(value))
        refuse(decoder, "must be a string");
    else if ((double)json_string_length(value) > field->max)
        refuse(decoder, "must have at most %.0f bytes, has %zu", field->max,
               json_string_length(value));
    else if (field->check && field->check(json_string_value(value)))
        refuse(decoder, "%s", field->check(json_string_value(value)));
    else if (!(*ret_text = strdup(json_string_value(value))))
        decoder->no_memory = true;
}

static void decode_json(struct decoder *decoder, const struct rn_field_spec *field,
                        const json_t *value, char **ret_text) {
    if (field->flags & RN_IS_OBJECT && !json_is_object(value)) {
        refuse(decoder, "must be an object");
        return;
    }
    struct rn_buf buf;
    rn_buf_init(&buf, RN_JSON_TEXT_MAX);
    rn_json_put_value(&buf, value);
    size_t size;
    *ret_text = (char *)rn_buf_take(&buf, &size);
    if (!*ret_text) decoder->no_memory = true;
}

// A reader's error: its place is within the value at hand.
static void refuse_inside(struct decoder *decoder, const struct rn_error *err) {
    size_t length = strlen(decoder->pointer), room = sizeof decoder->pointer - length;
    if (err->status == RN_ERROR_NO_MEMORY) decoder->no_memory = true;
    snprintf(decoder->pointer + length, room, "%s", err->where[0] ? err->where + 1 : "");
    refuse(decoder, "%s", err->text);
    leave(decoder, length);
}

static void decode_camera(struct decoder *decoder, const json_t *value,
                          struct rn_camera *ret_camera) {
    struct rn_json object = rn_json_root(value, "");
    struct rn_error err;
    if (rn_json_camera(&object, ret_camera, &err)) refuse_inside(decoder, &err);
}

static void decode_path(struct decoder *decoder, const struct rn_field_spec *field,
                        const json_t *value, struct rn_path_document *ret_document) {
    struct rn_json object = rn_json_root(value, "");
    struct rn_error err;
    if (rn_path_read(&object, &ret_document->path, &err))
        refuse_inside(decoder, &err);
    else
        decode_json(decoder, field, value, &ret_document->json);
}

// Whether `value` is an array of a length in [least, most].
static bool is_array(struct decoder *decoder, const json_t *value, size_t least, size_t most) {
    if (!json_is_array(value)) {
        refuse(decoder, "must be an array");
        return false;
    }
    size_t size = json_array_size(value);
    if (size >= least && size <= most) return true;
    if (least == most)
        refuse(decoder, "must have %zu items, has %zu", most, size);
    else
        refuse(decoder, "must have at most %zu items, has %zu", most, size);
    return false;
}

static void decode_values(struct decoder *decoder, const struct rn_field_spec *field,
                          const json_t *value, void *message) {
    bool fixed = field->type == RN_TYPE_NUMBERS;
    if (!is_array(decoder, value, fixed ? field->capacity : 0, field->capacity)) return;
    char *at = member(field, message);
    for (size_t i = 0; i < json_array_size(value); i++) {
        const json_t *item = json_array_get(value, i);
        size_t length = enter_index(decoder, i);
        if (field->type == RN_TYPE_INTS) decode_int(decoder, field, item, (int64_t *)at + i);
        if (field->type == RN_TYPE_NUMBERS) decode_number(decoder, field, item, (double *)at + i);
        if (field->type == RN_TYPE_TEXTS) decode_text(decoder, field, item, at + i * field->size);
        leave(decoder, length);
    }
    if (!fixed) *member_count(field, message) = json_array_size(value);
}

static void decode_objects(struct decoder *decoder, const struct rn_field_spec *field,
                           const json_t *value, void *message) {
    if (!is_array(decoder, value, 0, (size_t)field->max)) return;
    size_t count = json_array_size(value);
    char *items = count ? calloc(count, field->table->size) : NULL;
    if (count && !items) {
        decoder->no_memory = true;
        return;
    }
    *(void **)member(field, message) = items;
    for (size_t i = 0; i < count; i++) {
        rn_message_init(field->table, items + i * field->table->size);
        *member_count(field, message) = i + 1;
        size_t length = enter_index(decoder, i);
        decode_object(decoder, field->table, json_array_get(value, i),
                      items + i * field->table->size);
        leave(decoder, length);
    }
}

static void decode_field(struct decoder *decoder, const struct rn_field_spec *field, json_t *value,
                         void *message) {
    void *at = member(field, message);
    if (json_is_null(value) && field->flags & RN_NULLABLE) return;
    switch (field->type) {
    case RN_TYPE_BOOL:
        if (!json_is_boolean(value)) refuse(decoder, "must be true or false");
        *(bool *)at = json_is_true(value);
        break;
    case RN_TYPE_TRUTH:
        if (!json_is_boolean(value)) refuse(decoder, "must be true or false");
        *(int *)at = json_is_true(value);
        break;
    case RN_TYPE_INT:
        decode_int(decoder, field, value, at);
        break;
    case RN_TYPE_NUMBER:
        decode_number(decoder, field, value, at);
        break;
    case RN_TYPE_NAME:
        decode_name(decoder, field, value, at);
        break;
    case RN_TYPE_TEXT:
        decode_text(decoder, field, value, at);
        break;
    case RN_TYPE_STRING:
        decode_string(decoder, field, value, at);
        break;
    case RN_TYPE_INTS:
    case RN_TYPE_NUMBERS:
    case RN_TYPE_TEXTS:
        decode_values(decoder, field, value, message);
        break;
    case RN_TYPE_OBJECT:
        decode_object(decoder, field->table, value, at);
        break;
    case RN_TYPE_OBJECTS:
        decode_objects(decoder, field, value, message);
        break;
    case RN_TYPE_JSON:
        decode_json(decoder, field, value, at);
        break;
    case RN_TYPE_CAMERA:
        decode_camera(decoder, value, at);
        break;
    case RN_TYPE_PATH:
        decode_path(decoder, field, value, at);
        break;
    }
}

static bool is_field(const struct rn_table *table, const char *key) {
    for (size_t i = 0; i < rn_table_rows(table); i++) {
        const char *name = rn_table_row(table, i).name;
        if (name && strcmp(name, key) == 0) return true;
    }
    return false;
}

static void refuse_unknown(struct decoder *decoder, const struct rn_table *table, json_t *object) {
    const char *key;
    json_t *value;
    json_object_foreach(object, key, value) {
        if (is_field(table, key)) continue;
        size_t length = enter(decoder, key);
        refuse(decoder, "is not a field of %s", table->title);
        leave(decoder, length);
    }
}

static void decode_object(struct decoder *decoder, const struct rn_table *table, json_t *object,
                          void *message) {
    if (!json_is_object(object)) {
        refuse(decoder, "must be an object (%s)", table->title);
        return;
    }
    refuse_unknown(decoder, table, object);
    for (size_t i = 0; i < rn_table_rows(table) && !decoder->no_memory; i++) {
        struct rn_field_spec row = rn_table_row(table, i);
        const struct rn_field_spec *field = &row;
        if (!field->name) continue;
        json_t *value = json_object_get(object, field->name);
        size_t length = enter(decoder, field->name);
        if (value)
            decode_field(decoder, field, value, message);
        else if (field->flags & RN_REQUIRED)
            refuse(decoder, "is missing");
        leave(decoder, length);
    }
}

static enum rn_status first_error(const struct rn_field_errors *errors, struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_INVALID, errors->items[0].pointer, "%s",
                        errors->items[0].detail);
}

// Parses the text as an object; the caller json_decref's it. Errors go to `errors` (not NULL).
static enum rn_status parse(const char *json, size_t size, json_t **ret_root,
                            struct rn_field_errors *errors, struct rn_error *err) {
    json_error_t error;
    json_t *root = rn_json_load(json, size, &error);
    if (root && json_is_object(root)) {
        *ret_root = root;
        return RN_OK;
    }
    if (!root && json_error_code(&error) == json_error_out_of_memory)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "#", "out of memory while reading JSON");
    char pointer[256] = "#";
    if (!root) {
        size_t position = error.position > 0 ? (size_t)error.position : 0;
        rn_json_pointer_at(json, position < size ? position : size, pointer, sizeof pointer);
    }
    errors->malformed = true;
    if (root)
        rn_field_errors_add(errors, pointer, "must be an object");
    else
        rn_field_errors_add(errors, pointer, "%s (line %d, column %d)", error.text, error.line,
                            error.column);
    json_decref(root);
    return first_error(errors, err);
}

enum rn_status rn_decode(const struct rn_table *table, const char *json, size_t size,
                         void *ret_message, struct rn_field_errors *errors, struct rn_error *err) {
    struct rn_field_errors own;
    struct decoder decoder = {.errors = errors ? errors : &own, .pointer = "#"};
    decoder.errors->count = 0;
    decoder.errors->malformed = false;
    json_t *root;
    enum rn_status status = parse(json, size, &root, decoder.errors, err);
    if (status) return status;
    rn_message_init(table, ret_message);
    decode_object(&decoder, table, root, ret_message);
    json_decref(root);
    if (decoder.no_memory)
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, table->title, "out of memory");
    else if (decoder.errors->count)
        status = first_error(decoder.errors, err);
    if (status) rn_message_finish(table, ret_message);
    return status;
}

enum rn_status rn_decode_peek(const char *json, size_t json_size, const char *key, size_t size,
                              char *ret_text, struct rn_field_errors *errors,
                              struct rn_error *err) {
    struct rn_field_errors own;
    struct decoder decoder = {.errors = errors ? errors : &own, .pointer = "#"};
    decoder.errors->count = 0;
    decoder.errors->malformed = false;
    json_t *root;
    enum rn_status status = parse(json, json_size, &root, decoder.errors, err);
    if (status) return status;
    struct rn_field_spec field = {.name = key, .type = RN_TYPE_TEXT, .size = size};
    const json_t *value = json_object_get(root, key);
    enter(&decoder, key);
    if (value)
        decode_text(&decoder, &field, value, ret_text);
    else
        refuse(&decoder, "is missing");
    json_decref(root);
    return decoder.errors->count ? first_error(decoder.errors, err) : RN_OK;
}

void rn_time_text(int64_t wall_ms, char ret_text[RN_TIME_MAX]) {
    time_t seconds = (time_t)(wall_ms / 1000);
    struct tm utc = {0};
    gmtime_r(&seconds, &utc);
    char day[24] = "";
    strftime(day, sizeof day, "%Y-%m-%dT%H:%M:%S", &utc);
    snprintf(ret_text, RN_TIME_MAX, "%s.%03dZ", day, (int)(wall_ms % 1000));
}

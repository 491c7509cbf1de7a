#include "common/dataset/json.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/file.h"
#include "common/base/names.h"
#include "common/dataset/json_memory.h"

// Turns the bare words NaN and Infinity into strings of the same length.
static void quote_nonfinite(char *json, size_t size_bytes) {
    bool in_string = false;
    for (size_t i = 0; i < size_bytes; i++) {
        char c = json[i];
        if (in_string && c == '\\') {
            i++;
        } else if (c == '"') {
            in_string = !in_string;
        } else if (!in_string && (c == 'N' || c == 'I' || c == '-')) {
            static const char *const words[] = {"NaN", "-Infinity", "Infinity"};
            for (size_t w = 0; w < 3; w++) {
                size_t length = strlen(words[w]);
                if (size_bytes - i < length || memcmp(json + i, words[w], length) != 0) continue;
                json[i] = json[i + length - 1] = '"';
                i += length - 1;
                break;
            }
        }
    }
}

// Blanks comments, so that lines keep their numbers. One that is never closed stays.
static void blank_comments(char *json, size_t size_bytes) {
    bool in_string = false;
    for (size_t i = 0; i + 1 < size_bytes; i++) {
        const char *end;
        if (in_string && json[i] == '\\') {
            i++;
            continue;
        }
        if (json[i] == '"') in_string = !in_string;
        if (in_string || json[i] != '/') continue;
        char *rest = json + i;
        if (rest[1] == '/')
            end = memchr(rest, '\n', size_bytes - i);
        else if (rest[1] == '*' && (end = memmem(rest + 2, size_bytes - i - 2, "*/", 2)) != NULL)
            end += 2;
        else
            continue;
        if (!end) end = json + size_bytes;
        for (; rest < end; rest++)
            if (*rest != '\n') *rest = ' ';
        i = (size_t)(end - json) - 1;
    }
}

// Windows' editors begin a text with a mark that says how it is encoded.
static enum rn_status drop_mark(char *text, size_t size_bytes, const char *where,
                                struct rn_error *err) {
    if (size_bytes >= 3 && memcmp(text, "\xef\xbb\xbf", 3) == 0) memset(text, ' ', 3);
    bool wide =
        size_bytes >= 2 && (memcmp(text, "\xff\xfe", 2) == 0 || memcmp(text, "\xfe\xff", 2) == 0);
    return wide ? rn_error_set(err, RN_ERROR_INVALID, where, "is UTF-16; save it as UTF-8") : RN_OK;
}

static enum rn_status parse_in_place(char *json, size_t size_bytes, const char *where,
                                     json_t **ret_root, struct rn_error *err) {
    enum rn_status status = drop_mark(json, size_bytes, where, err);
    if (status) return status;
    quote_nonfinite(json, size_bytes);
    json_error_t error;
    json_t *root = rn_json_load(json, size_bytes, &error);
    // The library leaves the text empty when it cannot even begin.
    if (!root && (!error.text[0] || json_error_code(&error) == json_error_out_of_memory))
        return rn_error_set(err, RN_ERROR_NO_MEMORY, where, "out of memory while reading JSON");
    if (!root) {
        char place[256];
        snprintf(place, sizeof place, "%.230s:%d", where, error.line);
        return rn_error_set(err, RN_ERROR_INVALID, place, "not valid JSON: %s (column %d)",
                            error.text, error.column);
    }
    *ret_root = root;
    return RN_OK;
}

enum rn_status rn_json_parse(const char *json, size_t size_bytes, const char *where,
                             json_t **ret_root, struct rn_error *err) {
    if (size_bytes > RN_JSON_MAX_BYTES)
        return rn_error_set(err, RN_ERROR_LIMIT, where, "%zu bytes of JSON; the limit is %zu",
                            size_bytes, RN_JSON_MAX_BYTES);
    char *copy = malloc(size_bytes + 1);
    if (!copy) return rn_error_set(err, RN_ERROR_NO_MEMORY, where, "out of memory");
    memcpy(copy, json, size_bytes);
    enum rn_status status = parse_in_place(copy, size_bytes, where, ret_root, err);
    free(copy);
    return status;
}

enum rn_status rn_json_parse_file(const char *path, bool comments, json_t **ret_root,
                                  struct rn_error *err) {
    uint8_t *bytes;
    size_t size_bytes;
    enum rn_status status = rn_file_read(path, RN_JSON_MAX_BYTES, &bytes, &size_bytes, err);
    if (status) return status;
    if (comments) blank_comments((char *)bytes, size_bytes);
    status = parse_in_place((char *)bytes, size_bytes, path, ret_root, err);
    free(bytes);
    return status;
}

struct rn_json rn_json_root(const json_t *root, const char *file) {
    return (struct rn_json){.value = root, .file = file};
}

struct rn_json rn_json_element(const struct rn_json *array, size_t index) {
    return (struct rn_json){json_array_get(array->value, index), array->file, array, NULL, index};
}

// Appends "/a/b/3" to `pointer` (bounded).
static void append_pointer(const struct rn_json *at, char *pointer, size_t capacity) {
    if (!at->parent) return;
    append_pointer(at->parent, pointer, capacity);
    size_t used = strlen(pointer);
    if (!at->key) {
        snprintf(pointer + used, capacity - used, "/%zu", at->index);
        return;
    }
    if (used + 1 < capacity) pointer[used++] = '/';
    for (const char *c = at->key; *c && used + 2 < capacity; c++) { // RFC 6901: ~ and / escaped
        if (*c == '~' || *c == '/') pointer[used++] = '~';
        pointer[used++] = *c == '~' ? '0' : *c == '/' ? '1' : *c;
    }
    pointer[used] = 0;
}

void rn_json_where(const struct rn_json *at, char where[256]) {
    char pointer[160] = "";
    append_pointer(at, pointer, sizeof pointer);
    size_t room = 256 - strlen(pointer) - 2, length = strlen(at->file);
    if (length <= room)
        snprintf(where, 256, "%.*s#%s", (int)room, at->file, pointer);
    else
        snprintf(where, 256, "...%.*s#%s", (int)room - 3, at->file + length - room + 3, pointer);
}

enum rn_status rn_json_error(const struct rn_json *at, enum rn_status status, struct rn_error *err,
                             const char *fmt, ...) {
    if (!err) return status;
    char where[256], text[sizeof err->text];
    rn_json_where(at, where);
    va_list args;
    va_start(args, fmt);
    vsnprintf(text, sizeof text, fmt, args);
    va_end(args);
    return rn_error_set(err, status, where, "%s", text);
}

bool rn_json_find(const struct rn_json *object, const char *key, struct rn_json *ret_member) {
    const json_t *value = json_object_get(object->value, key);
    if (!value) return false;
    *ret_member = (struct rn_json){value, object->file, object, key, 0};
    return true;
}

enum rn_status rn_json_member(const struct rn_json *object, const char *key,
                              struct rn_json *ret_member, struct rn_error *err) {
    if (!key) {
        *ret_member = *object;
        return RN_OK;
    }
    if (!json_is_object(object->value))
        return rn_json_error(object, RN_ERROR_INVALID, err, "must be an object");
    if (rn_json_find(object, key, ret_member)) return RN_OK;
    struct rn_json missing = {NULL, object->file, object, key, 0};
    return rn_json_error(&missing, RN_ERROR_INVALID, err, "is missing");
}

enum rn_status rn_json_array(const struct rn_json *object, const char *key, size_t min, size_t max,
                             struct rn_json *ret_array, struct rn_error *err) {
    struct rn_json at;
    enum rn_status status = rn_json_member(object, key, &at, err);
    if (status) return status;
    size_t count = json_array_size(at.value);
    if (!json_is_array(at.value))
        return rn_json_error(&at, RN_ERROR_INVALID, err, "must be an array");
    if (count < min || count > max)
        return rn_json_error(&at, count > max ? RN_ERROR_LIMIT : RN_ERROR_INVALID, err,
                             "has %zu elements; %zu to %zu are possible", count, min, max);
    *ret_array = at;
    return RN_OK;
}

static enum rn_status get_number(const struct rn_json *at, double *ret_value,
                                 struct rn_error *err) {
    double value = json_number_value(at->value);
    if (!json_is_number(at->value) || !isfinite(value))
        return rn_json_error(at, RN_ERROR_INVALID, err, "must be a finite number");
    *ret_value = value;
    return RN_OK;
}

enum rn_status rn_json_number(const struct rn_json *object, const char *key, double min, double max,
                              double *ret_value, struct rn_error *err) {
    struct rn_json at;
    double value = 0;
    enum rn_status status = rn_json_member(object, key, &at, err);
    if (status || (status = get_number(&at, &value, err))) return status;
    if (value < min || value > max)
        return rn_json_error(&at, RN_ERROR_INVALID, err, "is %g; must lie within %g and %g", value,
                             min, max);
    *ret_value = value;
    return RN_OK;
}

enum rn_status rn_json_integer(const struct rn_json *object, const char *key, int min, int max,
                               int *ret_value, struct rn_error *err) {
    struct rn_json at;
    enum rn_status status = rn_json_member(object, key, &at, err);
    if (status) return status;
    json_int_t value = json_integer_value(at.value);
    if (!json_is_integer(at.value))
        return rn_json_error(&at, RN_ERROR_INVALID, err, "must be an integer");
    if (value < min || value > max)
        return rn_json_error(&at, RN_ERROR_INVALID, err,
                             "is %" JSON_INTEGER_FORMAT "; must lie within %d and %d", value, min,
                             max);
    *ret_value = (int)value;
    return RN_OK;
}

enum rn_status rn_json_boolean(const struct rn_json *object, const char *key, bool *ret_value,
                               struct rn_error *err) {
    struct rn_json at;
    enum rn_status status = rn_json_member(object, key, &at, err);
    if (status) return status;
    if (!json_is_boolean(at.value))
        return rn_json_error(&at, RN_ERROR_INVALID, err, "must be true or false");
    *ret_value = json_is_true(at.value);
    return RN_OK;
}

enum rn_status rn_json_text(const struct rn_json *object, const char *key, size_t max_bytes,
                            const char **ret_text, struct rn_error *err) {
    struct rn_json at;
    enum rn_status status = rn_json_member(object, key, &at, err);
    if (status) return status;
    if (!json_is_string(at.value))
        return rn_json_error(&at, RN_ERROR_INVALID, err, "must be a string");
    size_t length = json_string_length(at.value);
    if (!length || length > max_bytes)
        return rn_json_error(&at, RN_ERROR_INVALID, err, "has %zu bytes; 1 to %zu are possible",
                             length, max_bytes);
    *ret_text = json_string_value(at.value);
    return RN_OK;
}

enum rn_status rn_json_choice(const struct rn_json *object, const char *key,
                              const char *const *names, int count, int *ret_index,
                              struct rn_error *err) {
    struct rn_json at;
    enum rn_status status = rn_json_member(object, key, &at, err);
    if (status) return status;
    const char *text = json_string_value(at.value);
    char all[128] = "";
    for (int i = 0; i < count; i++) {
        if (text && strcmp(text, names[i]) == 0) {
            *ret_index = i;
            return RN_OK;
        }
        size_t used = strlen(all);
        snprintf(all + used, sizeof all - used, "%s\"%s\"", i ? ", " : "", names[i]);
    }
    return rn_json_error(&at, RN_ERROR_INVALID, err, "must be one of %s", all);
}

static enum rn_status get_row(const struct rn_json *row, size_t columns, double *values,
                              struct rn_error *err) {
    if (!json_is_array(row->value) || json_array_size(row->value) != columns)
        return rn_json_error(row, RN_ERROR_INVALID, err, "must be an array of %zu numbers",
                             columns);
    for (size_t i = 0; i < columns; i++) {
        struct rn_json at = rn_json_element(row, i);
        enum rn_status status = get_number(&at, &values[i], err);
        if (status) return status;
    }
    return RN_OK;
}

enum rn_status rn_json_matrix(const struct rn_json *object, const char *key, size_t rows,
                              size_t columns, double *ret_values, struct rn_error *err) {
    struct rn_json at;
    enum rn_status status = rn_json_member(object, key, &at, err);
    if (status) return status;
    if (rows == 0) return get_row(&at, columns, ret_values, err);
    if (!json_is_array(at.value) || json_array_size(at.value) != rows)
        return rn_json_error(&at, RN_ERROR_INVALID, err, "must be an array of %zu rows of %zu",
                             rows, columns);
    for (size_t i = 0; i < rows; i++) {
        struct rn_json row = rn_json_element(&at, i);
        if ((status = get_row(&row, columns, ret_values + i * columns, err))) return status;
    }
    return RN_OK;
}

enum rn_status rn_json_refuse_unknown(const struct rn_json *object, const char *const *known,
                                      struct rn_error *err) {
    if (!json_is_object(object->value))
        return rn_json_error(object, RN_ERROR_INVALID, err, "must be an object");
    const char *key;
    json_t *value;
    json_object_foreach((json_t *)object->value, key, value) {
        if (rn_name_index(known, key) >= 0) continue;
        struct rn_json at = {value, object->file, object, key, 0};
        return rn_json_error(&at, RN_ERROR_INVALID, err, "is not a known field");
    }
    return RN_OK;
}

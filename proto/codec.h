// JSON <-> C structs by tables: the one place where messages are taken apart and put together.
//
// A message is a plain struct and a table that names its fields. Decoding refuses unknown,
// duplicate, missing, mistyped and out-of-range fields and points at each; encoding writes the
// fields in the table's order. A field that may be absent (not RN_REQUIRED) or null
// (RN_NULLABLE) holds its type's absent value: RN_ABSENT, NAN, -1 for a name, "" or NULL. It is
// left out when encoded, or written as null when RN_NULLABLE; an infinite number counts as absent.
#ifndef RN_PROTO_CODEC_H
#define RN_PROTO_CODEC_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#include "common/base/status.h"
#include "common/settings/setting.h"
#include "proto/names.h"

#define RN_ABSENT INT64_MIN // of an integer; a number's is NAN

enum rn_type {
    RN_TYPE_BOOL,    // bool; false when absent
    RN_TYPE_TRUTH,   // int: 0, 1, or -1 when absent
    RN_TYPE_INT,     // int64_t
    RN_TYPE_NUMBER,  // double
    RN_TYPE_NAME,    // int: index in `names`
    RN_TYPE_TEXT,    // char[size]
    RN_TYPE_STRING,  // char *, owned
    RN_TYPE_INTS,    // int64_t[capacity] with a size_t count: an array of variable length
    RN_TYPE_NUMBERS, // double[capacity], all of them
    RN_TYPE_TEXTS,   // char[capacity][size] with a size_t count
    RN_TYPE_OBJECT,  // a nested struct with its `table`
    RN_TYPE_OBJECTS, // struct *, owned, with a size_t count; at most max items
    RN_TYPE_JSON,    // char *, owned: any value, kept as compact JSON text
    RN_TYPE_CAMERA,  // struct rn_camera, as rn_json_camera reads it; of width 0 when absent
    RN_TYPE_PATH,    // struct rn_path_document, owned
};

enum {
    RN_REQUIRED = 1,     // must be there (null is there, with RN_NULLABLE)
    RN_NULLABLE = 2,     // null is a value: it means absent
    RN_OVER_MIN = 4,     // min itself is not allowed
    RN_UNDER_MAX = 8,    // max itself is not allowed
    RN_IS_OBJECT = 16,   // JSON: only an object will do
    RN_POWER_OF_TWO = 32 // INT
};

struct rn_field_spec {
    const char *name;
    enum rn_type type;
    unsigned flags;
    size_t offset;       // of the member
    size_t size;         // of a text with its NUL
    size_t count_offset; // INTS, TEXTS, OBJECTS: of the size_t count
    double min,
        max; // INT, NUMBER and their arrays: each value; TEXT, STRING: bytes; OBJECTS: items
    size_t capacity; // INTS, NUMBERS, TEXTS
    const char *const *names;
    const struct rn_table *table;
    const char *(*check)(const char *text); // TEXT, STRING: NULL, or what is wrong ("must be ...")
};

// Thread-safety: constant.
struct rn_table {
    const char *title; // for errors: "training options"
    size_t size;       // of the struct
    const struct rn_field_spec *fields;
    size_t field_count;
    // Or, with `settings`: in front of field `settings_at` there is one for every row of a table of
    // settings, in the struct a union rn_setting_value[settings->count] at settings_offset. As
    // options: the rows that may be asked for, none of them required; by name: those that may be
    // asked for and have no option; else a record of all.
    const struct rn_settings *settings;
    size_t settings_offset, settings_at;
    bool as_options, by_name;
};

// A camera path and the text that it was read from, which is what is kept and passed on. Absent:
// NULL both; encoded is the text.
struct rn_path_document {
    char *json;
    struct rn_path *path;
};

// How many rows to visit, and one of them: some have no name and are no field.
size_t rn_table_rows(const struct rn_table *table);
struct rn_field_spec rn_table_row(const struct rn_table *table, size_t i);

#define RN_TABLE(struct_type, text, specs)                                                         \
    {                                                                                              \
        .title = (text), .size = sizeof(struct_type), .fields = (specs),                           \
        .field_count = sizeof(specs) / sizeof(specs)[0]                                            \
    }

#define RN_TABLE_OF_SETTINGS(struct_type, text, specs, settings_, member, at, options)             \
    {                                                                                              \
        .title = (text), .size = sizeof(struct_type), .fields = (specs),                           \
        .field_count = sizeof(specs) / sizeof(specs)[0], .settings = (settings_),                  \
        .settings_offset = offsetof(struct_type, member), .settings_at = (at),                     \
        .as_options = (options)                                                                    \
    }

// Fields by shape; `s` is the struct type, `m` the member, which has the JSON key's name.
#define RN_F_BOOL(s, m, f)                                                                         \
    { .name = #m, .type = RN_TYPE_BOOL, .flags = (f), .offset = offsetof(s, m) }
#define RN_F_INT(s, m, f, lo, hi)                                                                  \
    {                                                                                              \
        .name = #m, .type = RN_TYPE_INT, .flags = (f), .offset = offsetof(s, m), .min = (lo),      \
        .max = (hi)                                                                                \
    }
#define RN_F_NUMBER(s, m, f, lo, hi)                                                               \
    {                                                                                              \
        .name = #m, .type = RN_TYPE_NUMBER, .flags = (f), .offset = offsetof(s, m), .min = (lo),   \
        .max = (hi)                                                                                \
    }
#define RN_F_NAME(s, m, f, table_of_names)                                                         \
    {                                                                                              \
        .name = #m, .type = RN_TYPE_NAME, .flags = (f), .offset = offsetof(s, m),                  \
        .names = (table_of_names)                                                                  \
    }
#define RN_F_TEXT(s, m, f, checker)                                                                \
    {                                                                                              \
        .name = #m, .type = RN_TYPE_TEXT, .flags = (f), .offset = offsetof(s, m),                  \
        .size = sizeof((s *)0)->m, .check = (checker)                                              \
    }
#define RN_F_STRING(s, m, f, bytes)                                                                \
    { .name = #m, .type = RN_TYPE_STRING, .flags = (f), .offset = offsetof(s, m), .max = (bytes) }
#define RN_F_INTS(s, m, n, f, lo, hi)                                                              \
    {                                                                                              \
        .name = #m, .type = RN_TYPE_INTS, .flags = (f), .offset = offsetof(s, m),                  \
        .count_offset = offsetof(s, n), .min = (lo), .max = (hi),                                  \
        .capacity = sizeof((s *)0)->m / sizeof(int64_t)                                            \
    }
#define RN_F_NUMBERS(s, m, f, lo, hi)                                                              \
    {                                                                                              \
        .name = #m, .type = RN_TYPE_NUMBERS, .flags = (f), .offset = offsetof(s, m), .min = (lo),  \
        .max = (hi), .capacity = sizeof((s *)0)->m / sizeof(double)                                \
    }
#define RN_F_TEXTS(s, m, n, f)                                                                     \
    {                                                                                              \
        .name = #m, .type = RN_TYPE_TEXTS, .flags = (f), .offset = offsetof(s, m),                 \
        .count_offset = offsetof(s, n), .size = sizeof((s *)0)->m[0],                              \
        .capacity = sizeof((s *)0)->m / sizeof((s *)0)->m[0]                                       \
    }
#define RN_F_OBJECT(s, m, f, t)                                                                    \
    { .name = #m, .type = RN_TYPE_OBJECT, .flags = (f), .offset = offsetof(s, m), .table = (t) }
#define RN_F_OBJECTS(s, m, n, f, t, most)                                                          \
    {                                                                                              \
        .name = #m, .type = RN_TYPE_OBJECTS, .flags = (f), .offset = offsetof(s, m),               \
        .count_offset = offsetof(s, n), .table = (t), .max = (most)                                \
    }
#define RN_F_JSON(s, m, f)                                                                         \
    { .name = #m, .type = RN_TYPE_JSON, .flags = (f), .offset = offsetof(s, m) }

#define RN_F_CAMERA(s, m, f)                                                                       \
    { .name = #m, .type = RN_TYPE_CAMERA, .flags = (f), .offset = offsetof(s, m) }
#define RN_F_PATH(s, m, f)                                                                         \
    { .name = #m, .type = RN_TYPE_PATH, .flags = (f), .offset = offsetof(s, m) }

// What is wrong with a JSON text, field by field.
#define RN_FIELD_ERRORS_MAX 16
struct rn_field_error {
    char pointer[256]; // "#/options/planes"
    char detail[256];  // "must be at most 16, is 17"
};
struct rn_field_errors {
    bool malformed; // not JSON at all, or duplicate keys: HTTP 400 rather than 422
    size_t count;   // listed; further ones are dropped
    struct rn_field_error items[RN_FIELD_ERRORS_MAX];
};

// Sets every field of *message to its absent value. An optional nested object is absent when all
// its fields are; it is then left out when encoded.
void rn_message_init(const struct rn_table *table, void *message);
// Frees what the fields own and sets them absent again.
void rn_message_finish(const struct rn_table *table, void *message);

// Decodes `size` bytes of UTF-8 into *ret_message, which the caller finishes with
// rn_message_finish. RN_ERROR_INVALID (*err has the first error, *errors, which may be NULL, all
// of them; nothing to finish), RN_ERROR_NO_MEMORY.
enum rn_status rn_decode(const struct rn_table *table, const char *json, size_t size,
                         void *ret_message, struct rn_field_errors *errors,
                         struct rn_error *err) RN_MUST_CHECK;
// Encodes as compact JSON, NUL-terminated, malloc'd and owned by the caller; ret_size (may be
// NULL) is without the NUL. RN_ERROR_NO_MEMORY; RN_ERROR_INVALID when a required field is absent
// or a number is not finite (an error of the program's).
enum rn_status rn_encode(const struct rn_table *table, const void *message, char **ret_json,
                         size_t *ret_size, struct rn_error *err) RN_MUST_CHECK;
// {"items":[...],"next_cursor":...}: `items` are JSON texts; next_cursor may be NULL. As rn_encode.
enum rn_status rn_encode_list(const char *const *items, size_t count, const char *next_cursor,
                              char **ret_json, size_t *ret_size,
                              struct rn_error *err) RN_MUST_CHECK;
// The string at a top-level key ("type"), before the right table is known. RN_ERROR_INVALID as
// rn_decode, also when it is missing, no string or longer than `size` allows.
enum rn_status rn_decode_peek(const char *json, size_t json_size, const char *key, size_t size,
                              char *ret_text, struct rn_field_errors *errors,
                              struct rn_error *err) RN_MUST_CHECK;

// Adds one error; the list may be NULL or full.
void rn_field_errors_add(struct rn_field_errors *errors, const char *pointer, const char *fmt, ...)
    RN_PRINTF(3, 4);

// `value`, or `fallback` when it is absent.
static inline int64_t rn_int_or(int64_t value, int64_t fallback) {
    return value == RN_ABSENT ? fallback : value;
}
static inline double rn_number_or(double value, double fallback) {
    return isnan(value) ? fallback : value;
}
static inline int rn_name_or(int value, int fallback) {
    return value < 0 ? fallback : value;
}

// "2026-03-01T09:30:00.000Z" from milliseconds since 1970.
#define RN_TIME_MAX 32
void rn_time_text(int64_t wall_ms, char ret_text[RN_TIME_MAX]);

#endif

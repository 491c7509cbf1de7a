#include "proto/json_text.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void rn_json_put_string(struct rn_buf *buf, const char *text) {
    rn_buf_append(buf, "\"", 1);
    const char *run = text, *at = text;
    for (; *at; at++) {
        unsigned char c = (unsigned char)*at;
        if (c >= 0x20 && c != '"' && c != '\\') continue;
        rn_buf_append(buf, run, (size_t)(at - run));
        if (c == '"' || c == '\\')
            rn_buf_printf(buf, "\\%c", c);
        else
            rn_buf_printf(buf, "\\u%04x", c);
        run = at + 1;
    }
    rn_buf_append(buf, run, (size_t)(at - run));
    rn_buf_append(buf, "\"", 1);
}

void rn_json_put_number(struct rn_buf *buf, double value) {
    char text[32];
    if (value == 0) value = 0; // "-0" would be read as a whole number, which has no sign
    for (int digits = 15; digits <= 17; digits++) {
        snprintf(text, sizeof text, "%.*g", digits, value);
        if (strtod(text, NULL) == value) break;
    }
    rn_buf_append(buf, text, strlen(text));
}

static void put_object(struct rn_buf *buf, json_t *object) {
    const char *key, *separator = "";
    json_t *member;
    rn_buf_append(buf, "{", 1);
    json_object_foreach(object, key, member) {
        rn_buf_append(buf, separator, strlen(separator));
        rn_json_put_string(buf, key);
        rn_buf_append(buf, ":", 1);
        rn_json_put_value(buf, member);
        separator = ",";
    }
    rn_buf_append(buf, "}", 1);
}

void rn_json_put_value(struct rn_buf *buf, const json_t *value) {
    switch (json_typeof(value)) {
    case JSON_OBJECT:
        put_object(buf, (json_t *)value);
        break;
    case JSON_ARRAY:
        rn_buf_append(buf, "[", 1);
        for (size_t i = 0; i < json_array_size(value); i++) {
            if (i) rn_buf_append(buf, ",", 1);
            rn_json_put_value(buf, json_array_get(value, i));
        }
        rn_buf_append(buf, "]", 1);
        break;
    case JSON_STRING:
        rn_json_put_string(buf, json_string_value(value));
        break;
    case JSON_INTEGER:
        rn_buf_printf(buf, "%" PRId64, (int64_t)json_integer_value(value));
        break;
    case JSON_REAL:
        rn_json_put_number(buf, json_real_value(value));
        break;
    case JSON_TRUE:
        rn_buf_append(buf, "true", 4);
        break;
    case JSON_FALSE:
        rn_buf_append(buf, "false", 5);
        break;
    case JSON_NULL:
        rn_buf_append(buf, "null", 4);
        break;
    }
}

void rn_json_pointer_push(char *pointer, size_t size, const char *token, size_t token_size) {
    size_t length = strlen(pointer);
    if (length + 1 < size) pointer[length++] = '/';
    for (size_t i = 0; i < token_size && length + 2 < size; i++) {
        char c = token[i];
        if (c == '~' || c == '/') pointer[length++] = '~';
        pointer[length++] = c == '~' ? '0' : c == '/' ? '1' : c;
    }
    pointer[length] = '\0';
}

// ---- where a byte stands ----

#define MAX_DEPTH 64 // deeper levels are left out of the pointer

struct level {
    bool is_object;
    size_t index;    // of an array's element
    const char *key; // of an object's member, without quotes; NULL before the first
    size_t key_size;
    bool expects_key;
};

struct scan {
    struct level levels[MAX_DEPTH];
    size_t depth;
};

static struct level *top(struct scan *scan) {
    return scan->depth && scan->depth <= MAX_DEPTH ? &scan->levels[scan->depth - 1] : NULL;
}

static void open_level(struct scan *scan, bool is_object) {
    scan->depth++;
    struct level *level = top(scan);
    if (level) *level = (struct level){.is_object = is_object, .expects_key = is_object};
}

// `at` is the opening quote; returns the closing one or `end`.
static const char *scan_string(struct scan *scan, const char *at, const char *end) {
    const char *start = at + 1, *close = start;
    while (close < end && *close != '"')
        close += *close == '\\' && close + 1 < end ? 2 : 1;
    struct level *level = top(scan);
    if (level && level->expects_key) {
        level->key = start;
        level->key_size = (size_t)(close - start);
        level->expects_key = false;
    }
    return close;
}

static void scan_comma(struct scan *scan) {
    struct level *level = top(scan);
    if (!level) return;
    level->index++;
    level->expects_key = level->is_object;
}

void rn_json_pointer_at(const char *json, size_t position, char *ret_pointer, size_t size) {
    struct scan scan = {.depth = 0};
    const char *end = json + position;
    for (const char *at = json; at < end; at++) {
        if (*at == '{' || *at == '[') open_level(&scan, *at == '{');
        if ((*at == '}' || *at == ']') && scan.depth) scan.depth--;
        if (*at == ',') scan_comma(&scan);
        if (*at == '"') at = scan_string(&scan, at, end);
    }
    snprintf(ret_pointer, size, "#");
    for (size_t i = 0; i < scan.depth && i < MAX_DEPTH; i++) {
        const struct level *level = &scan.levels[i];
        char index[24];
        int length = snprintf(index, sizeof index, "%zu", level->index);
        if (!level->is_object)
            rn_json_pointer_push(ret_pointer, size, index, (size_t)length);
        else if (level->key)
            rn_json_pointer_push(ret_pointer, size, level->key, level->key_size);
    }
}

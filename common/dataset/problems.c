#include "common/dataset/dataset.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/utf8.h"

#define RN_PROBLEMS_MAX 500

static bool grow(struct rn_problems *problems) {
    if (problems->count < problems->capacity) return true;
    if (problems->capacity >= RN_PROBLEMS_MAX) return false;
    size_t capacity = problems->capacity ? 2 * problems->capacity : 16;
    if (capacity > RN_PROBLEMS_MAX) capacity = RN_PROBLEMS_MAX;
    struct rn_problem *items = realloc(problems->items, capacity * sizeof *items);
    if (!items) return false;
    problems->items = items;
    problems->capacity = capacity;
    return true;
}

// What has no room ends with dots, and not within a character; names may be no UTF-8.
static void shorten(char *text, size_t size, int length) {
    static const char dots[] = "...";
    size_t at = size - sizeof dots;
    while (at > 0 && (unsigned char)text[at] >> 6 == 2)
        at--;
    if (length >= (int)size) memcpy(text + at, dots, sizeof dots);
    rn_utf8_clean(text);
}

void rn_problems_add(struct rn_problems *problems, enum rn_severity severity, const char *where,
                     const char *fmt, ...) {
    if (!problems) return;
    if (severity == RN_SEVERITY_ERROR) problems->errors++;
    if (severity == RN_SEVERITY_WARNING) problems->warnings++;
    if (!grow(problems)) {
        problems->dropped++;
        return;
    }
    struct rn_problem *problem = &problems->items[problems->count++];
    problem->severity = severity;
    int length = snprintf(problem->where, sizeof problem->where, "%s", where);
    shorten(problem->where, sizeof problem->where, length);
    va_list args;
    va_start(args, fmt);
    length = vsnprintf(problem->text, sizeof problem->text, fmt, args);
    va_end(args);
    shorten(problem->text, sizeof problem->text, length);
}

void rn_problems_finish(struct rn_problems *problems) {
    free(problems->items);
    *problems = (struct rn_problems){0};
}

const char *const rn_split_names[] = {"train", "val", "test", NULL};

const char *rn_split_name(enum rn_split split) {
    return (unsigned)split < RN_SPLIT_COUNT ? rn_split_names[split] : "?";
}

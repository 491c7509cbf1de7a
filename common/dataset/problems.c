#include "common/dataset/dataset.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

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
    snprintf(problem->where, sizeof problem->where, "%s", where);
    va_list args;
    va_start(args, fmt);
    vsnprintf(problem->text, sizeof problem->text, fmt, args);
    va_end(args);
}

void rn_problems_finish(struct rn_problems *problems) {
    free(problems->items);
    *problems = (struct rn_problems){0};
}

const char *const rn_split_names[] = {"train", "val", "test", NULL};

const char *rn_split_name(enum rn_split split) {
    return (unsigned)split < RN_SPLIT_COUNT ? rn_split_names[split] : "?";
}

// Tables of names: arrays of strings that end with NULL; an enum's value is its index.
#ifndef RN_BASE_NAMES_H
#define RN_BASE_NAMES_H

#include <string.h>

// The index of `name` in such a table, or -1.
static inline int rn_name_index(const char *const *names, const char *name) {
    for (int i = 0; names[i]; i++)
        if (strcmp(names[i], name) == 0) return i;
    return -1;
}

#endif

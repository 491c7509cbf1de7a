// What was meant by a word that there is not.
#ifndef RN_CLIENT_NEAREST_H
#define RN_CLIENT_NEAREST_H

#include <stddef.h>

// Thread-safety: a plain value. Begin with the word and its size; `name` is the nearest so far.
struct rn_nearest {
    const char *word;
    size_t size;
    const char *name; // NULL: none is near
    size_t distance;
};

// Takes a name that is nearer: at most 2 slips (letters missing, too much, wrong or exchanged) and
// under half of the word.
void rn_nearest_try(struct rn_nearest *nearest, const char *name);

#endif

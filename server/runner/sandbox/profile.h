// What each mode of the runner may do: the one table. A mode that is new, or an existing one that
// needs another program or folder, is a row or a word here.
#ifndef RN_SERVER_RUNNER_SANDBOX_PROFILE_H
#define RN_SERVER_RUNNER_SANDBOX_PROFILE_H

#include <stdbool.h>

// Folders and files that an order names.
enum rn_place {
    RN_PLACE_SOURCE,  // of an import: a folder, or a spooled archive
    RN_PLACE_TARGET,  // the dataset that it makes
    RN_PLACE_WORK,    // where it unpacks
    RN_PLACE_DATASET, // that a scene is trained on
    RN_PLACE_SCENE,   // with the frames of its jobs
    RN_PLACE_COUNT
};

// Bits of places are 1 << enum rn_place.
struct rn_profile {
    const char *mode;
    const char *programs[4]; // that it may start, by name, from the system's folders
    bool listed_calls;       // system calls: only those listed in calls.c, else all but the refused
    unsigned read;           // places it reads
    unsigned write;          // places it writes, and reads
    unsigned tidy;           // places beside which it may remove what has become empty
};

// NULL: no such mode.
const struct rn_profile *rn_profile_of(const char *mode);

#endif

#include "server/runner/sandbox/profile.h"

#include <stddef.h>
#include <string.h>

#define SOURCE (1u << RN_PLACE_SOURCE)
#define TARGET (1u << RN_PLACE_TARGET)
#define WORK (1u << RN_PLACE_WORK)
#define DATASET (1u << RN_PLACE_DATASET)
#define SCENE (1u << RN_PLACE_SCENE)

// No mode opens a network connection. A program that is started runs under the same confinement.
static const struct rn_profile profiles[] = {
    // mode    programs               listed reads    writes         tidies
    {"ingest", {NULL}, false, SOURCE, TARGET | WORK, TARGET | WORK},
    {"poses", {"colmap", "ffmpeg"}, false, SOURCE, TARGET | WORK, TARGET | WORK},
    {"field", {NULL}, true, DATASET, SCENE, 0},
    {"remote", {NULL}, true, DATASET, SCENE, 0},   // field, once it has joined its daemon
    {"rank", {NULL}, true, DATASET | SCENE, 0, 0}, // beside the first, once it has joined that
    {"probe", {NULL}, true, 0, 0, 0},
    {"needs", {NULL}, true, DATASET | SCENE, 0, 0},
};

const struct rn_profile *rn_profile_of(const char *mode) {
    for (size_t i = 0; i < sizeof profiles / sizeof profiles[0]; i++)
        if (strcmp(profiles[i].mode, mode) == 0) return &profiles[i];
    return NULL;
}

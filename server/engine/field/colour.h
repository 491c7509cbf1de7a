// The colour of a ray: from what was composited along it to what is seen of it, and back. Here
// stands what effects and the options of a picture do to it.
#ifndef RN_ENGINE_FIELD_COLOUR_H
#define RN_ENGINE_FIELD_COLOUR_H

#include "server/engine/field/real.h"

// What acts on it: of every ray of a step or of a picture. Plain values.
struct rn_colouring {
    float background[3];       // what a ray shows that meets nothing
    float background_variance; // training: a channel's, of random backgrounds with that mean
};

// One pair of functions a type of number. SEEN: of a ray of that opacity, the composited colour
// `rgb` becomes the one over the background, which is put behind it last. BACK, its adjoint: `grad`
// holds dL/d(colour seen) and what of dL/d(opacity) does not come through it; afterwards
// dL/d(composited colour) and dL/d(opacity).
#define RN_COLOUR_FUNCTIONS(SEEN, BACK, NUMBER)                                                    \
    RN_HD void SEEN(const struct rn_colouring *colouring, NUMBER opacity, NUMBER rgb[3]) {         \
        for (int c = 0; c < 3; c++)                                                                \
            rgb[c] += (1 - opacity) * (NUMBER)colouring->background[c];                            \
    }                                                                                              \
    RN_HD void BACK(const struct rn_colouring *colouring, NUMBER grad[4]) {                        \
        for (int c = 0; c < 3; c++)                                                                \
            grad[3] -= grad[c] * (NUMBER)colouring->background[c];                                 \
    }
RN_COLOUR_FUNCTIONS(rn_colour_seen, rn_colour_back, rn_real)

#endif

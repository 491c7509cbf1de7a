// What is told of effects outside of training: of all that are in the table.
#ifndef RN_ENGINE_EFFECTS_ABOUT_H
#define RN_ENGINE_EFFECTS_ABOUT_H

#include <stdbool.h>
#include <stddef.h>

#include "server/engine/scene/effect.h"

// A number of the effect's record, or its threshold, in the unit in which people read it: "1.5
// times as long as wide". Empty where it is NAN.
void rn_effect_text(enum rn_effect effect, double number, char *text, size_t capacity);
// 1: its number calls for it at its threshold and below, 0: above, -1: no number decides.
int rn_effect_below(enum rn_effect effect);
// Whether a scene in which it is on, or off, can be compared with one that differs in it alone.
bool rn_effect_is_optional(enum rn_effect effect, bool on);
// What scores of photographs that a scene was not trained on leave open (RN_FIT_*).
unsigned rn_effects_fit(const struct rn_effect_record records[RN_EFFECT_COUNT]);

#endif

// The background: photographs that alpha opens to it are carved by their alpha, composited over
// it, and for a while over random ones, so that what is empty becomes so. Photographs that were cut
// from the colour they stood on are composited over that alone: whether it shows through where the
// outline is closed, or what stands before it is of that colour, they do not say.
#include <stdio.h>
#include <string.h>

#include "server/engine/effects/effects.h"

static const struct rn_backdrop *backdrop_of(const struct rn_evidence *e) {
    return &e->photographs->frames[0].frame->backdrop;
}

static void detect(const struct rn_evidence *e, struct rn_effect_record *r) {
    const struct rn_pixels *p = e->photographs;
    size_t open = 0;
    for (int f = 0; f < p->frame_count; f++) {
        const struct rn_camera *camera = &p->frames[f].camera;
        const uint8_t *rgba = p->rgba + 4 * p->frames[f].offset;
        for (size_t i = 0; i < (size_t)camera->width * (size_t)camera->height; i++)
            open += rgba[4 * i + 3] < 255;
        rn_pixels_let_go(p);
    }
    r->number = (double)open / (double)p->pixel_count;
    r->on =
        rn_effect_choose(&e->field->config, RN_EFFECT_BACKGROUND, true, r->number > r->threshold);
    const struct rn_backdrop *backdrop = backdrop_of(e);
    const uint8_t *c = backdrop->colour;
    char cut[64] = "";
    if (backdrop->known)
        snprintf(cut, sizeof cut, ", cut from the colour %d,%d,%d they stood on", c[0], c[1], c[2]);
    snprintf(r->reason, sizeof r->reason, "%.1f %% of the training pixels have alpha below 255%s",
             100 * r->number, cut);
}

static void settle(const struct rn_evidence *e) {
    struct rn_train_config *config = &e->field->config;
    const struct rn_backdrop *backdrop = backdrop_of(e);
    bool on = e->field->effects[RN_EFFECT_BACKGROUND].on;
    if (on && !backdrop->known) return;
    config->carve = config->carve && on;
    config->random_background = 0;
    for (int c = 0; c < 3; c++)
        config->background[c] = on ? (float)backdrop->colour[c] / 255 : 0;
}

// Over random backgrounds the loss is the mean over all whose channels are 0 or 1.
static void colour(const struct rn_field *field, struct rn_colouring *colouring) {
    memcpy(colouring->background, field->config.background, sizeof colouring->background);
}

static void march(const struct rn_train_config *config, double done, struct rn_march_options *m) {
    if (!(done < config->random_background)) return;
    for (int c = 0; c < 3; c++)
        m->colour.background[c] = 0.5f;
    m->colour.background_variance = 0.25f; // of a number that is 0 or 1, as often
}

const struct rn_effect_row rn_effect_background = {
    .unit = {" %", 100},
    .detect = detect,
    .settle = settle,
    .colour = colour,
    .march = march,
};

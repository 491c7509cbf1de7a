// The best picture by a deadline. The way to render that should fit is begun at once: its first
// pass is a whole picture, which is refined while there is time (rn_render with a deadline). Where
// that is not there soon, or it is not known how slow pictures are here, a quick one is made, so
// that there is a picture in any case. One that was expected well before the deadline is rendered
// as if there were none; where it is not there by half of the time, that was wrong: it is given up.
#ifndef RN_ENGINE_RENDER_WITHIN_H
#define RN_ENGINE_RENDER_WITHIN_H

#include "server/engine/render/render.h"

// A way to render this picture, the milliseconds that it is expected to take, and its samples.
struct rn_render_choice {
    struct rn_render_settings settings;
    double ms, samples;
};

// From the quickest to the full picture; `count` >= 1. The array is the caller's and lives for the
// call.
struct rn_render_budget {
    const struct rn_render_choice *choices;
    size_t count;
    int64_t deadline_ns; // rn_clock_ns: when the pictures must be there
    // How many times as long as expected pictures take here and now; 0 when nothing is known. Kept
    // up to date, for the next picture to begin with.
    double slowness;
    // Of a scene whose rays take many times the samples that the choices say, as one that has
    // hardly been trained, whose fog every ray goes through: milliseconds a ray, whatever the
    // choices say. 0: it is not so, or not known. Kept up to date likewise.
    double ray_ms;
};
struct rn_render_spent {
    size_t choice;                      // that the picture was made with,
    struct rn_render_settings settings; // and the same with the tolerance there was time for
    double ms;                          // all that was rendered, what was thrown away included
};
// As rn_render; of the options, settings and deadline are not looked at. Where there is time
// for nothing, the quickest choice is rendered. `ret_result->stats` are of the picture that is
// returned.
enum rn_status rn_render_within(struct rn_engine *engine, struct rn_field *field,
                                const struct rn_render_options *options,
                                struct rn_render_budget *budget, bool (*keep_going)(void *context),
                                void *context, struct rn_render_result *ret_result,
                                struct rn_render_spent *ret_spent,
                                struct rn_error *err) RN_MUST_CHECK;

#endif

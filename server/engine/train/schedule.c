#include "server/engine/train/schedule.h"

#include <math.h>

#include "server/engine/effects/effects.h"
#include "server/engine/field/occupancy.h"

#define LAST_GROWTH 0.35 // fraction of the run at which the planes reach their final size
#define EARLIER 0.3      // each doubling before that comes at this share of the next one's fraction
#define PLATEAU_DB 0.1   // what is worth going on for,
#define PLATEAU_PATIENCE 1.5 // times as long a training
#define PLATEAU_DONE 0.75    // of the schedule, when no more is gained
#define STEP_POWER 0.8       // of a texel's size: how steps shrink as planes grow
#define PICTURE_STEPS 0.85   // of the run, from when a disparity box is marched as its pictures are

double rn_schedule_done(const struct rn_train_config *config, const struct rn_progress *progress) {
    double done = NAN;
    if (config->max_steps > 0) done = (double)progress->step / (double)config->max_steps;
    if (config->max_seconds > 0)
        done = fmax(isnan(done) ? 0 : done, progress->train_seconds / config->max_seconds);
    return done;
}

double rn_schedule_rays(const struct rn_train_config *config, const struct rn_progress *progress) {
    return (double)progress->rays / rn_schedule_done(config, progress);
}

// The limits, so that this share of the schedule is done now.
static void bring_to(struct rn_train_config *config, const struct rn_progress *progress,
                     double done) {
    if (config->max_steps > 0) config->max_steps = (int64_t)ceil((double)progress->step / done);
    if (config->max_seconds > 0) config->max_seconds = progress->train_seconds / done;
}

void rn_schedule_note_figure(struct rn_train_config *config, struct rn_progress *progress) {
    double done = rn_schedule_done(config, progress);
    if (!config->until_plateau || progress->plateau || done >= 1) return;
    bool first = progress->gained_seconds <= 0;
    if (first || progress->psnr >= progress->gained_psnr + PLATEAU_DB) {
        progress->gained_psnr = fmax(progress->psnr, progress->gained_psnr);
        if (done >= LAST_GROWTH) progress->gained_seconds = progress->train_seconds;
        return;
    }
    progress->plateau = progress->train_seconds >= PLATEAU_PATIENCE * progress->gained_seconds;
    if (progress->plateau) bring_to(config, progress, done < PLATEAU_DONE ? PLATEAU_DONE : 1);
}

bool rn_schedule_gives_back(const struct rn_train_config *config,
                            const struct rn_progress *progress) {
    if (config->give_back <= 0) return false;
    if (config->until_plateau) return progress->plateau;
    return rn_schedule_done(config, progress) >= config->give_back;
}

// The paper: x 0.6 at 1/2, 3/4, 5/6, 9/10 of the run. Ours: constant, then an exponential decay to
// 1/20, made for the time given; without a limit the rate stays.
static double rate_factor(const struct rn_train_config *config,
                          const struct rn_progress *progress) {
    double done = rn_schedule_done(config, progress);
    if (isnan(done)) return 1;
    if (config->multi_step_rate)
        return pow(0.6, (done >= 0.5) + (done >= 0.75) + (done >= 5.0 / 6) + (done >= 0.9));
    double decay = done < 0.2 ? 0 : fmin(1, (done - 0.2) / 0.8);
    return exp(-3.0 * decay);
}

double rn_schedule_rate(const struct rn_train_config *config, const struct rn_progress *progress) {
    return ldexp(config->learning_rate * rate_factor(config, progress), -(int)progress->rollbacks);
}

float rn_schedule_smoothing(const struct rn_train_config *config,
                            const struct rn_progress *progress) {
    double factor = rn_schedule_rate(config, progress) / config->learning_rate;
    if ((progress->step + 1) % RN_SMOOTH_EVERY != 0) return 0;
    return (float)(config->smoothing * factor * factor);
}

struct rn_occupancy_turn rn_schedule_occupancy(const struct rn_train_config *config, int64_t step) {
    bool all = step < (config->carve ? 1 : RN_OCCUPANCY_WARM_UP);
    struct rn_occupancy_turn turn = {.due = step % RN_OCCUPANCY_EVERY == 0,
                                     .sampled = config->sample_cells && !all,
                                     .first = all ? 0 : (uint32_t)(step / RN_OCCUPANCY_EVERY % 4),
                                     .stride = all ? 1 : 4};
    turn.decay = (float)pow(RN_OCCUPANCY_DECAY, turn.stride);
    return turn;
}

struct rn_march_options rn_schedule_march(const struct rn_field *field,
                                          const struct rn_progress *progress) {
    const struct rn_train_config *config = &field->config;
    double texels =
        config->grow_to > config->field.base ? (double)config->grow_to / config->field.base : 1;
    struct rn_march_options march = rn_effects_march_trained(field);
    bool as_pictures =
        field->cpu.disparity.on && rn_schedule_done(config, progress) >= PICTURE_STEPS;
    march.step =
        (float)((as_pictures ? rn_picture_step(field) : config->step) * pow(texels, STEP_POWER));
    march.roulette = (float)config->roulette;
    march.seed = config->seed;
    march.counter = (uint64_t)progress->step;
    rn_effects_march(config, rn_schedule_done(config, progress), &march);
    return march;
}

int rn_schedule_base(const struct rn_train_config *config, const struct rn_progress *progress) {
    double done = rn_schedule_done(config, progress);
    int base = config->grow_to;
    if (isnan(done)) return base;
    for (double at = LAST_GROWTH; base / 2 >= config->field.base && done < at; at *= EARLIER)
        base /= 2;
    return base;
}

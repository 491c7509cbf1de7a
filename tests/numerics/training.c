// Cases 9 and 10: training that would diverge, and long runs. Non-finite numbers planted where they
// hurt are found within a step; hostile data and rates leave nothing behind, in memory, in a
// picture or in a checkpoint, that is not a number; training that cannot be saved says so.
#include "tests/numerics/trainer.h"

// ---- planted numbers ------------------------------------------------------------------------

// Planted after step 10: gone after step 11, with one rollback, and training goes on to the end.
static int check_planted(struct rn_engine *engine, const struct rn_dataset *dataset,
                         struct numerics_random *random) {
    char names[2][80];
    snprintf(names[0], sizeof names[0], "9 non-finite number found, %s", engine->kernels->name);
    snprintf(names[1], sizeof names[1], "9 non-finite numbers left by planted ones, %s",
             engine->kernels->name);
    struct numerics_case found = {names[0], "planted in seven places", "steps", 1, 0, ""};
    struct numerics_case left = {names[1], "parameters, picture, checkpoint", "numbers", 0.5, 0,
                                 ""};
    for (int what = 0; what < PLANTS; what++) {
        struct rn_trainer *t = make_trainer(engine, dataset, 1);
        while (t->progress.step < 10)
            advance(t);
        plant(t, what, random);
        int steps = 0;
        while (t->progress.rollbacks == 0 && advance(t))
            steps++;
        steps += t->progress.rollbacks > 0 && t->progress.step >= STEPS;
        numerics_see(&found, t->progress.rollbacks == 1 ? steps : INFINITY, "%s",
                     plant_names[what]);
        while (advance(t))
            continue;
        bool finished = t->progress.step == STEPS && isfinite(t->progress.loss);
        numerics_see(&left, finished ? count_left(engine, t) : INFINITY, "%s", plant_names[what]);
        rn_trainer_destroy(&t);
    }
    return numerics_close(&found) + numerics_close(&left);
}

// Saved at once, without a step in between.
static int check_saved(struct rn_engine *engine, const struct rn_dataset *dataset,
                       struct numerics_random *random) {
    struct numerics_case c = {"9 non-finite numbers saved right after planting",
                              "parameters, moments",
                              "numbers",
                              0.5,
                              0,
                              ""};
    static const int at_once[] = {0, 2, 4, 5, 6};
    for (int i = 0; i < 5; i++) {
        struct rn_trainer *t = make_trainer(engine, dataset, 1);
        while (t->progress.step < 3)
            advance(t);
        plant(t, at_once[i], random);
        struct rn_error err = {0};
        char path[64];
        snprintf(path, sizeof path, "%s/checkpoint", folder);
        must(rn_trainer_save(t, path, &err), &err);
        numerics_see(&c, count_left(engine, t), "%s", plant_names[at_once[i]]);
        rn_trainer_destroy(&t);
        must(rn_trainer_restore(engine, dataset, path, 0, &t, &err), &err);
        numerics_see(&c, count_wild(t->optimiser.m, t->field->parameters.count),
                     "restored moments");
        rn_trainer_destroy(&t);
    }
    return numerics_close(&c);
}

// A number that comes back after every step: after three rollbacks training fails and says so; the
// parameters stay good.
static int check_hopeless(struct rn_engine *engine, const struct rn_dataset *dataset,
                          struct numerics_random *random) {
    struct numerics_case c = {"9 rollbacks before hopeless training fails",
                              "NaN before every step",
                              "off four",
                              0.5,
                              0,
                              ""};
    struct rn_trainer *t = make_trainer(engine, dataset, 1);
    do
        plant(t, 1, random);
    while (advance(t));
    struct rn_error err = {0};
    bool said = rn_trainer_advance(t, 0, &err) == RN_ERROR_NUMERIC && strstr(err.text, "diverged");
    double wild = count_left(engine, t);
    numerics_see(&c, said && wild == 0 ? fabs((double)t->progress.rollbacks - 4) : INFINITY,
                 "%d rollbacks, %g numbers: %s", (int)t->progress.rollbacks, wild, err.text);
    rn_trainer_destroy(&t);
    return numerics_close(&c);
}

// ---- hostile data ---------------------------------------------------------------------------

#define HOSTILE 8
static const char *const hostile_names[HOSTILE] = {
    "rate x 100", "all black",     "all white",           "all transparent",
    "one view",   "equal cameras", "contradictory views", "random pixels, rate x 100"};

static void spoil_pixels(struct rn_trainer *t, int what, uint64_t seed) {
    size_t n = 4 * t->train.pixel_count;
    uint8_t *rgba = t->train.rgba;
    if (what >= 1 && what <= 3) memset(rgba, what == 2 ? 255 : 0, n);
    for (size_t i = 0; i < n; i++) {
        if (what == 1 && i % 4 == 3) rgba[i] = 255;
        if (what == 6 && i / 400 % 2) rgba[i] = (uint8_t)(255 - rgba[i]);
        if (what == 7) rgba[i] = (uint8_t)rn_rng_draw(seed, 5, i).v[0];
    }
}

static int check_hostile(struct rn_engine *engine, uint64_t seed) {
    char name[80];
    snprintf(name, sizeof name, "9 non-finite numbers left by hostile data, %s",
             engine->kernels->name);
    struct numerics_case c = {name, "eight kinds, 60 steps", "numbers", 0.5, 0, ""};
    for (int what = 0; what < HOSTILE; what++) {
        struct rn_dataset *dataset = read_views(what == 4 ? 1 : 6);
        for (size_t f = 1; f < dataset->frame_count && what == 5; f++)
            dataset->frames[f].camera = dataset->frames[0].camera;
        struct rn_trainer *t = make_trainer(engine, dataset, what == 0 || what == 7 ? 100 : 1);
        spoil_pixels(t, what, seed);
        while (advance(t))
            continue;
        numerics_see(&c, isfinite(t->progress.loss) ? count_left(engine, t) : INFINITY, "%s",
                     hostile_names[what]);
        rn_trainer_destroy(&t);
        rn_dataset_destroy(&dataset);
    }
    return numerics_close(&c);
}

// ---- long runs ------------------------------------------------------------------------------

// A field that is dense where y * side > 0 and empty elsewhere: plane 0 (u = y) holds the sign, the
// density network passes its first channel on, positive and negative part apart.
static void set_halves(struct rn_trainer *t, float side) {
    const struct rn_field_config *c = &t->field->config.field;
    const struct rn_mlp_shape *shape = &t->field->cpu.base_shape;
    float *planes = t->field->parameters.values;
    float *base = planes + t->field->parameters.plane_count;
    memset(planes, 0, t->field->parameters.count * sizeof *planes);
    for (int i = 0; i < c->base * c->base; i++)
        planes[(size_t)i * (size_t)c->channels] = i % c->base >= c->base / 2 ? side : -side;
    base[0] = 1;
    base[1] = -1;
    for (int l = 1; l < shape->layers; l++) {
        float *w = base + shape->offset[l];
        bool last = l + 1 == shape->layers;
        w[0] = last ? 10 : 1;
        w[shape->out[l] + !last] = last ? -10 : 1;
    }
    rn_field_refresh(t->field, t->engine);
}

// Cells wholly in the ball, more than a few from the border, whose bit is not what the field says.
static double count_stuck(const struct rn_trainer *t, float side) {
    int cells = t->field->cpu.occupancy.cells;
    double stuck = 0;
    for (int i = 0; i < cells * cells * cells; i++) {
        int x = i / cells / cells, y = i / cells % cells, z = i % cells;
        double at[3], far = 0, height = (2 * y + 1.0) / cells - 1;
        for (int k = 0; k < 3; k++) {
            at[k] = fabs((2.0 * (k == 0 ? x : k == 1 ? y : z) + 1) / cells - 1) + 1.0 / cells;
            far += at[k] * at[k];
        }
        if (!t->field->hull[i] || far > 1 || fabs(height) < 4.0 / cells) continue;
        bool set =
            t->field->cpu.occupancy.words[rn_brick_word(x, y, z, cells)] & rn_brick_bit(x, y);
        stuck += set != (height * (double)side > 0);
    }
    return stuck;
}

// A trainer with the smallest grid and field there are.
static struct rn_trainer *make_small(struct rn_engine *engine, const struct rn_dataset *dataset) {
    struct rn_error err = {0};
    struct rn_train_config config;
    struct rn_trainer *t;
    must(rn_preset("standard", false, &config, &err), &err);
    config.field.base = config.field.occupancy = config.field.width = 16;
    config.grow_to = 0;
    config.max_seconds = 0;
    config.max_steps = 1;
    must(rn_trainer_create(engine, dataset, &config, 0, &t, &err), &err);
    return t;
}

// Matter that moves to the other half and back, `refreshes` each time: no cell stays set, none
// stays empty, and the decayed maxima of empty cells end at nothing.
static void move_matter(struct numerics_case cases[2], struct rn_trainer *t, int moves,
                        int refreshes) {
    size_t side = (size_t)t->field->config.field.occupancy;
    for (int move = 0; move < moves; move++) {
        float dense = move % 2 ? -1 : 1;
        double largest = 0;
        set_halves(t, dense);
        for (int i = 0; i < refreshes; i++) {
            rn_trainer_update_occupancy(t);
            t->progress.step += RN_OCCUPANCY_EVERY;
        }
        numerics_see(&cases[0], count_stuck(t, dense), "move %d", move);
        for (size_t i = 0; i < side * side * side; i++)
            largest = fmax(largest, (double)t->field->occupancy[i]);
        double most = exp(15) * t->field->config.step * 1.5; // the densest there is
        numerics_see(&cases[1], largest / most, "move %d", move);
    }
}

// At 11 ms a step (preset standard) a day is 7.8 million steps: 490,000 refreshes.
static int check_occupancy(struct rn_engine *engine, const struct rn_dataset *dataset) {
    struct numerics_case many[2] = {
        {"10 occupancy cells stuck or dead", "128,000 steps, 8 moves, 32^3 cells", "cells", 0.5, 0,
         ""},
        {"10 occupancy EMA against its largest value", "the same", "of it", 1.0001, 0, ""}};
    struct numerics_case day[2] = {
        {"10 occupancy cells stuck or dead after a day", "7.8 million steps, 4 moves, 16^3 cells",
         "cells", 0.5, 0, ""},
        {"10 occupancy EMA against its largest value, a day", "the same", "of it", 1.0001, 0, ""}};
    struct rn_trainer *t = make_trainer(engine, dataset, 1);
    move_matter(many, t, 8, 1000);
    rn_trainer_destroy(&t);
    t = make_small(engine, dataset);
    move_matter(day, t, 4, 122000);
    rn_trainer_destroy(&t);
    return numerics_close(&many[0]) + numerics_close(&many[1]) + numerics_close(&day[0]) +
           numerics_close(&day[1]);
}

// ---- weight decay -----------------------------------------------------------------------------

// Where the optimiser visits touched texels only a decay is the networks' alone.
static int check_sparse_decay(struct rn_engine *engine, const struct rn_dataset *dataset) {
    struct numerics_case c = {"8 texels that a weight decay moves in sparse updates",
                              "decay 0.9, one step",
                              "texels",
                              0.5,
                              0,
                              ""};
    struct rn_trainer *plain = make_trainer(engine, dataset, 1);
    struct rn_trainer *decayed = make_trainer(engine, dataset, 1);
    const struct rn_parameters *p = &plain->field->parameters;
    const float *values = decayed->field->parameters.values;
    decayed->field->config.weight_decay = 0.9;
    double moved = 0, networks = 0;
    advance(plain);
    advance(decayed);
    for (size_t i = 0; i < p->count; i++)
        *(i < p->plane_count ? &moved : &networks) += values[i] != p->values[i];
    numerics_see(&c, plain->field->config.sparse && networks > 0 ? moved : INFINITY,
                 "%g weights moved", networks);
    rn_trainer_destroy(&plain);
    rn_trainer_destroy(&decayed);
    return numerics_close(&c);
}

int main(void) {
    struct numerics_random random = numerics_random();
    struct rn_engine_options options = {.device = "cpu", .threads = 1};
    const struct rn_kernels *kernels;
    struct rn_engine *engine;
    struct rn_error err = {0};
    if (!mkdtemp(folder)) return 1;
    must(rn_engine_create(&options, &engine, &err), &err);
    struct rn_dataset *dataset = read_views(6);
    int failed = check_saved(engine, dataset, &random) + check_hopeless(engine, dataset, &random);
    rn_engine_destroy(&engine);
    for (int i = 0; (kernels = rn_kernels_available(i)); i++) {
        options.kernels = kernels->name;
        must(rn_engine_create(&options, &engine, &err), &err);
        failed += check_planted(engine, dataset, &random) + check_hostile(engine, random.seed);
        rn_engine_destroy(&engine);
    }
    must(rn_engine_create(&options, &engine, &err), &err);
    failed += check_occupancy(engine, dataset) + check_sparse_decay(engine, dataset);
    rn_engine_destroy(&engine);
    rn_dataset_destroy(&dataset);
    must(rn_remove_tree(folder, &err), &err);
    return failed > 0;
}

// The preset `paper`: each rule of the released code that is not a formula of the field, stated
// here anew and plainly, and compared with what is trained; and the preset as a whole, on small
// data.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/field/occupancy.h"
#include "server/engine/scene/occupancy.h"
#include "tests/ops/train_scene.h"

#define STEPS 274 // past the first 256, in which all cells are measured

static struct rn_train_config preset_for(const struct rn_dataset *d) {
    struct rn_error err;
    struct rn_train_config config;
    ck_assert(rn_preset("paper", d->scale_count > 1, &config, &err) == RN_OK);
    return config;
}

// The same made small.
static struct rn_train_config small_paper(const struct rn_dataset *d) {
    struct rn_train_config config = preset_for(d);
    config.field.base = 32;
    config.field.occupancy = 32;
    config.step *= 4; // its number is held above; here a quarter of the samples do
    config.target_samples = 1024;
    config.initial_rays = 128;
    config.max_steps = STEPS;
    config.seed = 3;
    return config;
}

// ---- rules ----------------------------------------------------------------------------------

START_TEST(preset_has_the_released_numbers) {
    const struct rn_dataset *sets[2] = {dataset, scaled};
    struct rn_difference item;
    for (int s = 0; s < 2; s++) {
        struct rn_train_config c = preset_for(sets[s]);
        ck_assert_int_eq(rn_train_config_differences(&c, &item, 1), 0);
        ck_assert(c.field.planes == 10 && c.field.orientation == RN_ORIENTATION_PLATONIC);
        ck_assert(c.field.base == 512 && c.field.channels == 16 && c.field.levels == 8);
        ck_assert(c.field.footprint == RN_FOOTPRINT_RIP && c.field.width == 128);
        ck_assert(c.field.base_layers == 2 && c.field.head_layers == 4);
        ck_assert(c.field.shading == RN_SHADING_SAMPLE && c.field.occupancy == 128);
        ck_assert_double_eq_tol(c.step, 2 * sqrt(3) / 1024, 1e-15); // 3 sqrt(3) / 1024 over 1.5
        ck_assert(c.target_samples == 262144 && c.initial_rays == 8192 && c.max_steps == 120000);
        ck_assert_double_eq(c.learning_rate, 2e-3);
        ck_assert_double_eq(c.learning_rate * c.plane_rate, 2e-2);
        ck_assert(c.beta2 == 0.999 && c.weight_decay == 1e-5 && c.adam_eps == 1e-15);
        ck_assert(c.stop == 1e-4 && c.random_background == 0 && c.smoothing == 0);
        ck_assert(!c.sparse && !c.carve && c.roulette == 0 && c.distortion_loss == 0);
        for (int i = 0; i < 3; i++)
            ck_assert_float_eq(c.background[i], 1);
    }
}
END_TEST

// Limits, what the user gives or the data decide, where photographs lie, and what is told as an
// effect: no rule of the released code.
static bool is_no_rule(const struct rn_setting *row) {
    static const char *const names[] = {
        "preset",       "footprint_given", "cut_out",   "background",  "train_val",  "train_scale",
        "seed",         "pixel_memory",    "max_steps", "max_seconds", "until_psnr", "auto_effects",
        "until_plateau"};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        if (strcmp(row->name, names[i]) == 0) return true;
    return strncmp(row->name, "effect_", 7) == 0;
}

// Every other setting, changed, is a difference that is told: no list is empty for what it leaves
// out.
START_TEST(whatever_differs_is_told) {
    for (size_t i = 0; i < RN_TRAIN_SETTINGS; i++) {
        const struct rn_setting *row = &rn_train_settings.rows[i];
        bool is_name = row->type == RN_SETTING_BOOL || row->type == RN_SETTING_CHOICE;
        double most = is_name ? 1 : row->max;
        struct rn_train_config config = preset_for(dataset);
        rn_setting_put_number(row, row->paper < most ? most : row->min, &config);
        int told = rn_train_config_differences(&config, NULL, 0);
        ck_assert_msg((told > 0) == !is_no_rule(row), "%s: %d told", row->name, told);
    }
}
END_TEST

// MultiStepLR: x 0.6 from steps 60,000, 90,000, 100,000 and 108,000 of 120,000 on.
START_TEST(rates_fall_at_the_released_steps) {
    struct rn_train_config config = preset_for(dataset);
    static const int64_t after[] = {60000, 90000, 100000, 108000};
    for (int64_t step = 0; step < 120000; step += 250) {
        struct rn_progress progress = {.step = step};
        double rate = 2e-3;
        for (int i = 0; i < 4; i++)
            if (step >= after[i]) rate *= 0.6;
        ck_assert_double_eq_tol(rn_schedule_rate(&config, &progress), rate, 1e-15);
    }
}
END_TEST

// The next batch has as many rays as make 262,144 samples by this one's samples a ray, and one.
START_TEST(batches_follow_the_samples) {
    struct rn_error err;
    struct rn_train_config config = small_paper(scaled);
    config.target_samples = 65536; // the batch stays over its least, 64 rays
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *t = trainer_for(engine, scaled, &config);
    ck_assert_int_eq(t->next_rays, config.initial_rays);
    for (int i = 0; i < 8; i++) {
        int rays = t->next_rays;
        uint64_t samples = t->progress.samples;
        int64_t step = t->progress.step;
        while (t->progress.step == step)
            ck_assert(rn_trainer_advance(t, 1, &err) == RN_OK);
        samples = t->progress.samples - samples;
        ck_assert_uint_gt(samples, 0);
        ck_assert_int_eq(t->next_rays,
                         rays * (int64_t)config.target_samples / (int64_t)samples + 1);
    }
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

// Of both splits nothing is withheld.
START_TEST(train_and_validation_views_are_all_trained_on) {
    for (int both = 0; both < 2; both++) {
        struct rn_train_config config = small_paper(dataset);
        config.train_val = both;
        struct rn_engine *engine = engine_with(1);
        struct rn_trainer *t = trainer_for(engine, dataset, &config);
        int views = dataset->view_count[RN_SPLIT_TRAIN];
        ck_assert_int_gt(dataset->view_count[RN_SPLIT_VAL], 0);
        if (both) views += dataset->view_count[RN_SPLIT_VAL];
        ck_assert_int_eq(t->train.frame_count, views);
        ck_assert_int_gt(t->held.frame_count, 0);
        ck_assert(!strstr(rn_trainer_held_out(t), "trained on too") == !both);
        rn_trainer_destroy(&t);
        rn_engine_destroy(&engine);
    }
}
END_TEST

// ---- the occupancy --------------------------------------------------------------------------

// A marker that no density of a new field reaches stands in each cell, once the grid has taken
// those that `is_full` names for occupied: it shows whether a cell was looked at, as only then it
// decays.
#define MARK 100.0f

static void mark_cells(struct rn_field *field, bool (*is_full)(int x)) {
    int n = field->config.field.occupancy, index[3];
    for (size_t i = 0; i < (size_t)n * n * n; i++) {
        rn_cell_at(i, n, index);
        field->occupancy[i] = is_full(index[0]) && field->hull[i] ? MARK : 0;
    }
    rn_field_refresh_occupancy(field);
    for (size_t i = 0; i < (size_t)n * n * n; i++)
        if (field->hull[i]) field->occupancy[i] = MARK;
}

static bool in_a_slab(int x) {
    return x >= 14 && x < 18;
}
static bool everywhere(int x) {
    return x >= 0;
}

// Shares of empty and of occupied cells that the round before step 256 looks at.
static void looked_at(struct rn_trainer *t, bool (*is_full)(int x), double share[2]) {
    struct rn_field *field = t->field;
    int n = field->config.field.occupancy, index[3];
    size_t count[2] = {0, 0}, looked[2] = {0, 0};
    mark_cells(field, is_full);
    t->progress.step = 256;
    ck_assert(rn_trainer_update_occupancy(t));
    for (size_t i = 0; i < (size_t)n * n * n; i++) {
        if (!field->hull[i]) continue;
        rn_cell_at(i, n, index);
        bool full = is_full(index[0]), decayed = field->occupancy[i] != MARK;
        if (decayed) ck_assert_float_eq(field->occupancy[i], MARK * 0.95f);
        count[full]++;
        looked[full] += decayed;
    }
    for (int i = 0; i < 2; i++)
        share[i] = count[i] ? (double)looked[i] / (double)count[i] : NAN;
}

// Of n cells n / 4 draws with replacement reach 1 - exp(-1/4) = 22.1 %; with them all that are
// occupied, or n / 4 draws of these where they are more. What is not looked at does not decay.
START_TEST(cells_are_drawn_as_released) {
    struct rn_train_config config = small_paper(dataset);
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *t = trainer_for(engine, dataset, &config);
    double cells = pow(32, 3), uniform = 1 - exp(-0.25), share[2];
    looked_at(t, in_a_slab, share);
    printf("empty %.4f of %.4f, occupied %.4f\n", share[0], uniform, share[1]);
    ck_assert_double_eq_tol(share[0], uniform, 0.015); // 4 sigma of 14,000 cells
    ck_assert_double_eq(share[1], 1);
    looked_at(t, everywhere, share);
    double own = 1 - exp(-cells / 4 / (double)t->hull.count);
    double expected = 1 - (1 - uniform) * (1 - own);
    printf("occupied, more than a quarter of all: %.4f of %.4f\n", share[1], expected);
    ck_assert_double_eq_tol(share[1], expected, 0.016);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

// Every 16 steps; of the first 256 steps all cells.
START_TEST(all_cells_are_measured_at_first) {
    struct rn_train_config config = preset_for(dataset);
    for (int64_t step = 0; step < 600; step++) {
        struct rn_occupancy_turn turn = rn_schedule_occupancy(&config, step);
        ck_assert(turn.due == (step % 16 == 0));
        ck_assert(turn.sampled == (step >= 256));
        if (step < 256) ck_assert(turn.stride == 1 && turn.first == 0 && turn.decay == 0.95f);
    }
}
END_TEST

// ---- as a whole -----------------------------------------------------------------------------

// A run on `threads`; where `pieces`, cut short as soon as may be, now and then saved, and a while
// later lost and resumed from the file.
static void hash_of_run(const struct rn_dataset *d, int threads, bool pieces, char hex[65]) {
    struct rn_error err;
    struct rn_train_config config = small_paper(d);
    struct rn_engine *engine = engine_with(threads);
    struct rn_trainer *t = trainer_for(engine, d, &config);
    char path[128];
    snprintf(path, sizeof path, "%s/paper.safetensors", folder);
    if (pieces) rn_engine_yield_to(engine, always, NULL);
    for (int i = 1; !done(t); i++) {
        ck_assert(rn_trainer_advance(t, pieces ? 1000 : 1, &err) == RN_OK);
        if (pieces && i % 300 == 270)
            ck_assert_msg(rn_trainer_save(t, path, &err) == RN_OK, "%s", err.text);
        if (!pieces || i % 300 != 0) continue;
        rn_trainer_destroy(&t);
        ck_assert_msg(rn_trainer_restore(engine, d, path, 0, &t, &err) == RN_OK, "%s", err.text);
    }
    ck_assert_int_eq(t->progress.step, STEPS);
    rn_field_sha256(rn_trainer_field(t), hex);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}

START_TEST(paper_has_the_same_bytes_however_it_runs) {
    char one[65], other[65];
    hash_of_run(scaled, 1, false, one);
    for (int threads = 2; threads <= 3; threads++) {
        hash_of_run(scaled, threads, false, other);
        ck_assert_str_eq(one, other);
    }
    hash_of_run(scaled, 2, true, other);
    ck_assert_str_eq(one, other);
}
END_TEST

static uint64_t mix(uint64_t hash, const float *numbers, size_t count) {
    for (size_t i = 0; i < count; i++) {
        uint32_t bits;
        memcpy(&bits, numbers + i, sizeof bits);
        hash = (hash ^ bits) * 0x100000001b3u; // FNV-1a, by words
    }
    return hash;
}

// Of all that a picture is made of: parameters, maps, networks as the kernels read them.
static uint64_t mark_of_picture(const struct rn_field *field, int levels) {
    const struct rn_field_config *c = &field->config.field;
    uint64_t hash = mix(0xcbf29ce484222325u, field->parameters.values, field->parameters.count);
    for (int p = 0; p < c->planes; p++)
        for (int y = 0; y < levels; y++)
            for (int x = 0; x < levels; x++) {
                const struct rn_map *map = &field->cpu.maps[p][y][x];
                hash = mix(hash, map->texels,
                           (size_t)map->width * (size_t)map->height * (size_t)c->channels);
            }
    return mix(hash, field->packed, rn_mlp_packed_count(&field->cpu.base_shape));
}

// Whatever is cut short, an update too: a picture shows one step, and a step one picture. One that
// needs more maps than training has changes nothing.
START_TEST(pictures_in_between_show_one_step) {
    struct rn_error err;
    struct rn_train_config config = small_paper(dataset);
    struct rn_engine *engine = engine_with(1);
    uint64_t last = 0;
    char now[65], alone[65];
    int64_t step = -1;
    int within_updates = 0, more = 0;
    config.max_steps = 70; // past the first copy of good parameters
    struct rn_trainer *t = trainer_for(engine, dataset, &config);
    run_to_end(t);
    rn_field_sha256(t->field, alone);
    rn_trainer_destroy(&t);
    t = trainer_for(engine, dataset, &config);
    rn_engine_yield_to(engine, always, NULL);
    for (int i = 0; !done(t); i++) {
        ck_assert(rn_trainer_advance(t, 1000, &err) == RN_OK);
        bool within = t->optimiser.update.under_way && t->optimiser.update.next > 0;
        within_updates += within;
        if (within && t->field->steps == 40 && more++ == 0)
            ck_assert(rn_field_make_ready(t->field, engine, config.field.levels, &err) == RN_OK);
        if (i % 11 != 0 && step == t->field->steps) continue;
        uint64_t mark = mark_of_picture(t->field, t->optimiser.levels);
        ck_assert((step == t->field->steps) == (last == mark));
        step = t->field->steps;
        last = mark;
    }
    ck_assert_int_gt(within_updates, 100 * config.max_steps);
    ck_assert_int_gt(more, 0);
    rn_field_sha256(t->field, now);
    ck_assert_str_eq(now, alone);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

static int rays_done(const struct rn_trainer *t) {
    int done = 0;
    for (int g = 0; g < RN_GROUPS; g++)
        done += t->step.groups[g].cursor - rn_step_first_ray(t, g);
    return done;
}

// What a picture waits for is one packet of rays, not a group of them.
START_TEST(waves_are_cut_short_after_a_packet) {
    struct rn_error err;
    struct rn_train_config config = small_paper(dataset);
    config.initial_rays = 4 * RN_GROUPS * RN_PACKET_RAYS;
    config.target_samples = 4194304;
    struct rn_engine *engine = engine_with(1);
    struct rn_trainer *t = trainer_for(engine, dataset, &config);
    rn_engine_yield_to(engine, always, NULL);
    while (!t->step.under_way)
        ck_assert(rn_trainer_advance(t, 1000, &err) == RN_OK);
    int before = rays_done(t), packet = t->step.groups[0].packet;
    ck_assert_int_eq(before, 0); // the step's beginning is a piece of its own
    ck_assert_int_lt(packet, config.initial_rays / RN_GROUPS);
    while (t->step.under_way && t->step.stage == RN_STEP_WAVES) {
        ck_assert(rn_trainer_advance(t, 1000, &err) == RN_OK);
        ck_assert_int_le(rays_done(t) - before, packet);
        before = rays_done(t);
    }
    ck_assert_int_eq(before, config.initial_rays);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

// And of a validation a few pixels, in the fog of the first steps: networks so wide take as long
// for eight as others for a packet.
START_TEST(validation_is_cut_short_after_a_few_pixels) {
    struct rn_error err;
    struct rn_train_config config = small_paper(dataset);
    config.train_val = false;
    struct rn_engine *engine = engine_with(1);
    struct rn_trainer *t = trainer_for(engine, dataset, &config);
    const struct rn_camera *camera = &t->held.frames[0].camera;
    size_t pixels = (size_t)camera->width * (size_t)camera->height * (size_t)t->held.frame_count;
    size_t calls = 0;
    bool over = false;
    rn_engine_yield_to(engine, always, NULL);
    for (; !over; calls++)
        ck_assert(rn_trainer_validate(t, 1000, &over, &err) == RN_OK);
    ck_assert(t->progress.psnr > 0);
    ck_assert_uint_ge(calls, pixels / 8);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

// Parameters that are not finite: back to the last sound ones at half the rate, and on to the end.
START_TEST(paper_goes_back_when_it_diverges) {
    struct rn_error err;
    struct rn_train_config config = small_paper(dataset);
    config.max_steps = 60;
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *t = trainer_for(engine, dataset, &config);
    while (t->progress.step < 20)
        ck_assert(rn_trainer_advance(t, 1, &err) == RN_OK);
    for (size_t i = 0; i < 64; i++)
        t->field->parameters.values[i] = NAN;
    run_to_end(t);
    ck_assert_uint_gt(t->progress.rollbacks, 0);
    double rate = 2e-3 * pow(0.6, 4); // at the end
    ck_assert_double_eq_tol(rn_schedule_rate(&t->field->config, &t->progress),
                            ldexp(rate, -(int)t->progress.rollbacks), 1e-12);
    for (size_t i = 0; i < t->field->parameters.count; i++)
        ck_assert(isfinite(t->field->parameters.values[i]));
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

static void add_tests(TCase *tests) {
    tcase_add_test(tests, preset_has_the_released_numbers);
    tcase_add_test(tests, whatever_differs_is_told);
    tcase_add_test(tests, rates_fall_at_the_released_steps);
    tcase_add_test(tests, batches_follow_the_samples);
    tcase_add_test(tests, train_and_validation_views_are_all_trained_on);
    tcase_add_test(tests, cells_are_drawn_as_released);
    tcase_add_test(tests, all_cells_are_measured_at_first);
    tcase_add_test(tests, paper_has_the_same_bytes_however_it_runs);
    tcase_add_test(tests, pictures_in_between_show_one_step);
    tcase_add_test(tests, waves_are_cut_short_after_a_packet);
    tcase_add_test(tests, validation_is_cut_short_after_a_few_pixels);
    tcase_add_test(tests, paper_goes_back_when_it_diverges);
}

int main(void) {
    return run_on_scene("paper", add_tests);
}

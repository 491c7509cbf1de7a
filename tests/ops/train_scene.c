#include "tests/ops/train_scene.h"

#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include "common/base/file.h"
#include "tests/support/suite.h"

char folder[64];
struct rn_dataset *dataset, *scaled;

static void make_dataset(void) {
    struct rn_error err = {0};
    char plain[128], pyramid[128];
    snprintf(folder, sizeof folder, "/tmp/ripnerf-train-XXXXXX");
    ck_assert_ptr_nonnull(mkdtemp(folder));
    snprintf(plain, sizeof plain, "%s/plain", folder);
    snprintf(pyramid, sizeof pyramid, "%s/pyramid", folder);
    struct rn_synth_options synth = {.size = 48, .views = 12, .threads = 2, .samples = 4};
    struct rn_import_options import = {.scales = 3, .threads = 2};
    ck_assert(rn_mkdirs(plain, 0755, &err) == RN_OK && rn_mkdirs(pyramid, 0755, &err) == RN_OK);
    ck_assert_msg(rn_synthesise("sphere", &synth, plain, NULL, NULL, &err) == RN_OK, "%s",
                  err.text);
    ck_assert_msg(rn_dataset_read(plain, NULL, &dataset, &err) == RN_OK, "%s", err.text);
    ck_assert_msg(rn_dataset_import(dataset, "pyramid", &import, pyramid, NULL, NULL, NULL, &err) ==
                      RN_OK,
                  "%s", err.text);
    ck_assert_msg(rn_dataset_read(pyramid, NULL, &scaled, &err) == RN_OK, "%s", err.text);
}

static void remove_dataset(void) {
    struct rn_error err;
    rn_dataset_destroy(&dataset);
    rn_dataset_destroy(&scaled);
    ck_assert(rn_remove_tree(folder, &err) == RN_OK);
}

struct rn_train_config config_for(const struct rn_dataset *d) {
    struct rn_error err;
    struct rn_train_config config;
    ck_assert(rn_preset("standard", d->scale_count > 1, &config, &err) == RN_OK);
    config.field.base = 32;
    config.grow_to = 64; // at 35 % of the steps
    config.field.occupancy = 32;
    config.target_samples = 8192;
    config.initial_rays = 1024;
    config.max_seconds = 0;
    config.max_steps = 50;
    config.split_pixels = 0.3;
    config.seed = 3;
    return config;
}

struct rn_engine *engine_with(int threads) {
    static struct rn_device_info first;
    struct rn_error err;
    struct rn_engine *engine;
    struct rn_engine_options options = {.threads = threads,
                                        .kernels = *first.kernels ? first.kernels : NULL};
    ck_assert(rn_engine_create(&options, &engine, &err) == RN_OK);
    if (!*first.kernels) rn_engine_describe(engine, &first);
    return engine;
}

struct rn_trainer *trainer_for(struct rn_engine *engine, const struct rn_dataset *d,
                               const struct rn_train_config *config) {
    struct rn_error err;
    struct rn_trainer *trainer;
    ck_assert_msg(rn_trainer_create(engine, d, config, 0, &trainer, &err) == RN_OK, "%s", err.text);
    return trainer;
}

bool always(void *context) {
    (void)context;
    return true;
}

bool done(const struct rn_trainer *trainer) {
    struct rn_progress p;
    rn_trainer_progress(trainer, &p);
    return p.done;
}

void run_to_end(struct rn_trainer *trainer) {
    struct rn_error err;
    while (!done(trainer))
        ck_assert(rn_trainer_advance(trainer, 1, &err) == RN_OK);
}

void check_goes_on(const struct rn_dataset *d, const struct rn_train_config *config,
                   void (*look)(const struct rn_trainer *trainer, bool restored)) {
    char path[128], hash[3][65];
    struct rn_error err;
    snprintf(path, sizeof path, "%s/half", folder);
    for (int run = 0; run < 2; run++) {
        struct rn_engine *engine = engine_with(1 + run);
        struct rn_trainer *t = trainer_for(engine, d, config);
        if (run == 1) rn_engine_yield_to(engine, always, NULL);
        while (!done(t)) {
            ck_assert(rn_trainer_advance(t, 0, &err) == RN_OK);
            struct rn_progress p;
            rn_trainer_progress(t, &p);
            if (run == 0 && p.step == config->max_steps / 2)
                ck_assert(rn_trainer_save(t, path, &err) == RN_OK);
        }
        rn_field_sha256(t->field, hash[run]);
        look(t, false);
        rn_trainer_destroy(&t);
        rn_engine_destroy(&engine);
    }
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *t;
    ck_assert_msg(rn_trainer_restore(engine, d, path, 0, &t, &err) == RN_OK, "%s", err.text);
    look(t, true);
    run_to_end(t);
    rn_field_sha256(t->field, hash[2]);
    ck_assert_str_eq(hash[0], hash[1]);
    ck_assert_str_eq(hash[0], hash[2]);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}

double held_out_psnr(struct rn_trainer *trainer) {
    struct rn_error err;
    struct rn_progress p;
    bool finished = false;
    while (!finished)
        ck_assert(rn_trainer_validate(trainer, 100, &finished, &err) == RN_OK);
    rn_trainer_progress(trainer, &p);
    return p.psnr;
}

int run_on_scene(const char *name, void (*add)(TCase *tests)) {
    Suite *suite = suite_create(name);
    TCase *tests = tcase_create("whole runs");
    tcase_add_unchecked_fixture(tests, make_dataset, remove_dataset);
    tcase_set_timeout(tests, 300);
    add(tests);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}

bool is_live(const struct rn_trainer *t, int frame, int x, int y) {
    for (size_t i = 0; i < t->sampler.live_count; i++) {
        struct rn_live_block b = rn_trainer_live(t, i);
        if (b.frame == frame && x >= b.x && x < b.x + RN_LIVE_BLOCK && y >= b.y &&
            y < b.y + RN_LIVE_BLOCK)
            return true;
    }
    return false;
}

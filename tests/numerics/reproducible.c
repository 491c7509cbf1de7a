// Case 11: the same seed and number of steps give the same parameters, byte for byte, for any
// number of threads, with pauses, renders, evaluations, checkpoints, resumes and a crash.
#include <signal.h>
#include <sys/wait.h>

#include "tests/numerics/trainer.h"

// Steps: the occupancy is refreshed, view dependence decided and the planes doubled twice on the
// way.
#define LONG_ENOUGH 24

static uint64_t seed; // of every training

enum { PLAIN, PAUSED, SAVED, RESUMED, CRASHED, WAYS };
static const char *const ways[WAYS] = {
    "undisturbed", "paused, rendered and evaluated between steps", "a checkpoint after every step",
    "resumed from a checkpoint after every step", "killed and resumed from the last checkpoint"};

static struct rn_dataset *read_scaled(struct rn_dataset *plain) {
    struct rn_error err = {0};
    struct rn_import_options import = {.scales = 3, .threads = 1};
    struct rn_dataset *dataset;
    char path[64];
    snprintf(path, sizeof path, "%s/scaled", folder);
    must(rn_dataset_import(plain, "scaled", &import, path, NULL, NULL, NULL, &err), &err);
    must(rn_dataset_read(path, NULL, &dataset, &err), &err);
    return dataset;
}

static struct rn_engine *engine_with(const char *kernels, int threads) {
    struct rn_error err = {0};
    struct rn_engine_options options = {.device = "cpu", .threads = threads, .kernels = kernels};
    struct rn_engine *engine;
    must(rn_engine_create(&options, &engine, &err), &err);
    return engine;
}

static struct rn_trainer *trainer_for(struct rn_engine *engine, const struct rn_dataset *dataset) {
    struct rn_error err = {0};
    struct rn_train_config config;
    struct rn_trainer *t;
    must(rn_preset("standard", dataset->scale_count > 1, &config, &err), &err);
    config.field.base = 16;
    config.field.occupancy = 32;
    config.grow_to = 64; // 32 from step 3 on, 64 from step 9 on
    config.target_samples = 4096;
    config.initial_rays = 512;
    config.max_seconds = 0;
    config.max_steps = LONG_ENOUGH;
    config.seed = seed;
    must(rn_trainer_create(engine, dataset, &config, 0, &t, &err), &err);
    return t;
}

static void disturb(struct rn_engine *engine, struct rn_trainer *t) {
    struct rn_error err = {0};
    struct rn_camera camera = t->dataset->frames[0].camera;
    bool done;
    camera.world_from_camera[2][3] *= 30; // far away: needs more ripmap levels
    count_rendered(engine, t, &camera);
    must(rn_trainer_validate(t, 0.1, &done, &err), &err);
}

static void checkpoint_path(char path[64]) {
    snprintf(path, 64, "%s/reproducible", folder);
}

static bool over(const struct rn_trainer *t) {
    struct rn_progress progress;
    rn_trainer_progress(t, &progress);
    return progress.done;
}

// To the end, which the planes have grown by, in one of the ways; returns the trainer, which a
// resume replaces.
static struct rn_trainer *train(struct rn_engine *engine, struct rn_trainer *t, int way) {
    struct rn_error err = {0};
    const struct rn_dataset *dataset = t->dataset;
    char path[64];
    checkpoint_path(path);
    while (!over(t)) {
        must(rn_trainer_advance(t, 0, &err), &err);
        if (way == PAUSED) disturb(engine, t);
        if (way == SAVED || way == RESUMED) must(rn_trainer_save(t, path, &err), &err);
        if (way != RESUMED) continue;
        rn_trainer_destroy(&t);
        must(rn_trainer_restore(engine, dataset, path, 0, &t, &err), &err);
    }
    if (t->field->config.field.base != t->field->config.grow_to) {
        fprintf(stderr, "the planes have not grown\n");
        exit(1);
    }
    return t;
}

// A child trains with a checkpoint after every step until it is killed, at some step; the rest is
// trained here. Whether the child had come anywhere is in *ret_steps.
static struct rn_trainer *crash(struct rn_engine *engine, const char *kernels,
                                const struct rn_dataset *dataset, int threads, int64_t *ret_steps) {
    struct rn_error err = {0};
    struct rn_trainer *t;
    char path[64];
    checkpoint_path(path);
    remove(path);
    pid_t child = fork();
    if (child < 0) exit(1);
    if (child == 0) {
        struct rn_engine *own = engine_with(kernels, threads);
        train(own, trainer_for(own, dataset), SAVED);
        pause();
    }
    while (access(path, R_OK) != 0)
        usleep(1000);
    usleep(5000);
    kill(child, SIGKILL);
    waitpid(child, NULL, 0);
    must(rn_trainer_restore(engine, dataset, path, 0, &t, &err), &err);
    *ret_steps = t->progress.step;
    return train(engine, t, PLAIN);
}

// Parameters after a run: planes and networks.
static float *parameters_of(const char *kernels, const struct rn_dataset *dataset, int threads,
                            int way, size_t *ret_bytes, int64_t *ret_steps) {
    struct rn_engine *engine = engine_with(kernels, threads);
    struct rn_trainer *t =
        way == CRASHED ? crash(engine, kernels, dataset, threads == 8 ? 1 : threads + 1, ret_steps)
                       : train(engine, trainer_for(engine, dataset), way);
    *ret_bytes = t->field->parameters.count * sizeof(float);
    float *copy = malloc(*ret_bytes);
    if (!copy) exit(1);
    memcpy(copy, t->field->parameters.values, *ret_bytes);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
    return copy;
}

static double differing(const float *a, const float *b, size_t bytes) {
    double count = 0;
    for (size_t i = 0; i < bytes; i++)
        count += ((const unsigned char *)a)[i] != ((const unsigned char *)b)[i];
    return count;
}

static int check_ways(const char *kernels, const struct rn_dataset *sets[2], bool all) {
    static const int threads[] = {1, 2, 3, 8};
    int failed = 0;
    float *truth[2];
    size_t bytes, same;
    int64_t steps = 0;
    for (int s = 0; s < 2; s++)
        truth[s] = parameters_of(kernels, sets[s], 1, PLAIN, &bytes, &steps);
    for (int way = 0; way < (all ? WAYS : PLAIN + 1); way++) {
        char name[120];
        snprintf(name, sizeof name, "11 %s, %s", ways[way], kernels);
        struct numerics_case c = {
            name,
            "1, 2, 3, 8 threads, 24 steps, planes doubled twice, one scale and three",
            "bytes differ",
            0,
            0,
            ""};
        for (int i = 0; i < 8; i++) {
            if (way == PLAIN && i / 2 == 0) continue; // the truth itself
            float *got = parameters_of(kernels, sets[i % 2], threads[i / 2], way, &same, &steps);
            numerics_see(&c, differing(truth[i % 2], got, same), "%d threads, %d scales%s",
                         threads[i / 2], sets[i % 2]->scale_count,
                         way == CRASHED ? ", killed with other threads" : "");
            if (way == CRASHED && steps >= LONG_ENOUGH)
                fprintf(stderr, "the child had finished before it was killed\n");
            free(got);
        }
        failed += numerics_close(&c);
    }
    free(truth[0]);
    free(truth[1]);
    return failed;
}

int main(void) {
    struct numerics_random random = numerics_random();
    struct rn_error err = {0};
    const struct rn_kernels *k;
    int failed = 0, count = 0;
    if (!mkdtemp(folder)) return 1;
    seed = random.seed % 1000000;
    struct rn_dataset *plain = read_views(6), *scaled = read_scaled(plain);
    const struct rn_dataset *sets[2] = {plain, scaled};
    while (rn_kernels_available(count))
        count++;
    for (int i = 0; (k = rn_kernels_available(i)); i++)
        failed += check_ways(k->name, sets, i == 0 || i + 1 == count);
    rn_dataset_destroy(&plain);
    rn_dataset_destroy(&scaled);
    must(rn_remove_tree(folder, &err), &err);
    return failed > 0;
}

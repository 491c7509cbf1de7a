// A training and its pictures on a device, for the tests of the engine with one.
#ifndef RN_TESTS_OPS_DEVICE_RUN_H
#define RN_TESTS_OPS_DEVICE_RUN_H

#include "server/engine/engine.h"
#include "server/engine/train/photographs.h"
#include "server/engine/train/trainer.h"
#include "tests/support/suite.h"

// One engine and trainer at a time, of one dataset.
struct device_run {
    struct rn_engine *engine;
    struct rn_trainer *trainer;
    struct rn_progress progress;
    struct rn_dataset *dataset;
    char folder[64], path[128];                  // the dataset's; the checkpoint's
    bool deterministic;                          // of engines
    const char *kernels;                         // likewise, the CPU's; NULL: the fastest
    void (*prepare)(struct rn_trainer *trainer); // NULL, or before take_step's step
};
extern struct device_run run;

// Of a test's beginning and its end: tests share a process where it may not be forked, and leave
// nothing to the next one.
void make_dataset(void); // of a sphere
void make_dataset_of(const char *scene);
void make_dataset_sized(const char *scene, int size); // pixels a side
void remove_dataset(void);
void put_back(void);    // what the two below have changed
void hide_module(void); // there is none where one is looked for

// What an emulated device does from now on (cuda_emulator/knobs.h); false where the device is real.
struct emulation {
    int error;         // of every call; 0: none
    int order;         // of threads
    const char *skips; // kernels that do nothing; NULL: none
};
bool emulate(struct emulation how);

// A preset, so small that an emulator trains it in seconds; rays drawn from all blocks alike.
struct rn_train_config small_config(const char *preset, int64_t steps);
enum rn_status try_engine(const char *device, size_t memory, struct rn_engine **ret_engine,
                          struct rn_error *err);
struct rn_engine *engine_on(const char *device);

// `config` NULL restores from the checkpoint.
void run_begin(const char *device, const struct rn_train_config *config);
void run_to(int64_t step);
void run_validate(void);
void run_end(void);
// In the deterministic mode a run that is interrupted again and again ends as one that is not.
void compare_interrupted(const struct rn_train_config *config, int64_t steps);

// What one step leaves of the planes' and networks' gradients, of what the cells of a place showed,
// and of the errors of blocks that are drawn by them.
struct one_step {
    float *m, *seen, *errors;
    size_t counts[3], cells, blocks; // planes, density network, colour network
    double loss;
    uint64_t samples;
};
struct one_step take_step(const char *device, const struct rn_train_config *config);
// Prints and bounds how far they are apart (root mean square over that of the CPU's).
void compare_steps(const struct one_step *here, const struct one_step *there, double bound);
void step_finish(struct one_step *step);
// Takes the same step here and there: losses within a thousandth, samples within that share.
void compare_one_step(const struct rn_train_config *config, const char *what, double samples_apart);

// Of the checkpoint, by the first camera so many times as far away.
void picture(const char *device, double away, int supersample, struct rn_render_result *ret);
double difference(const struct rn_picture *a, const struct rn_picture *b); // the largest
// Largest difference of two devices' pictures of the checkpoint.
double compare_pictures(const char *one, const char *other, double away);

// Adds a test of the suite, with a dataset of its own (device_test.c); device_pictures.c.
void device_add(Suite *suite, const char *name, const TTest *test);
void device_add_with(Suite *suite, const char *name, const TTest *test, void (*make)(void));
void device_add_pictures(Suite *suite);
void device_add_places(Suite *suite);   // device_places.c
void device_add_captures(Suite *suite); // device_captures.c

#endif

// Small photographs, and engines and trainers for them.
#ifndef RN_TESTS_OPS_TRAIN_SCENE_H
#define RN_TESTS_OPS_TRAIN_SCENE_H

#include <check.h>

#include "server/engine/engine.h"
#include "server/engine/train/schedule.h"
#include "server/engine/train/photographs.h"
#include "server/engine/train/trainer.h"

extern char folder[64];                     // for what a test writes
extern struct rn_dataset *dataset, *scaled; // a sphere, and the same at three scales

// Makes them, runs the tests that `add` adds, and removes them; returns what main does.
int run_on_scene(const char *name, void (*add)(TCase *tests));

// `standard` made small: 50 steps, and planes that grow from 32 to 64 texels.
struct rn_train_config config_for(const struct rn_dataset *d);
// All with the kernel set that was the quickest for the first: on a busy machine another timing may
// choose another set, whose bytes differ.
struct rn_engine *engine_with(int threads);
struct rn_trainer *trainer_for(struct rn_engine *engine, const struct rn_dataset *d,
                               const struct rn_train_config *config);
bool always(void *context); // a render that waits
bool done(const struct rn_trainer *trainer);
void run_to_end(struct rn_trainer *trainer);
// The same bytes by one thread, by two over a render that waits all the time, and by two from the
// checkpoint of half of the steps on. `look` sees each training, `restored` before it goes on, else
// at its end.
void check_goes_on(const struct rn_dataset *d, const struct rn_train_config *config,
                   void (*look)(const struct rn_trainer *trainer, bool restored));
double held_out_psnr(struct rn_trainer *trainer);
// Whether a frame's pixel is in a live block.
bool is_live(const struct rn_trainer *t, int frame, int x, int y);

#endif

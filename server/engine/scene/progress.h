// How far a training is.
#ifndef RN_ENGINE_SCENE_PROGRESS_H
#define RN_ENGINE_SCENE_PROGRESS_H

#include <stdbool.h>
#include <stdint.h>

#define RN_PROGRESS_LEVELS 16
struct rn_progress {
    int64_t step;
    double train_seconds;                       // the --max-time clock
    double turn_seconds;                        // of these, what came between steps; not saved
    double load_seconds;                        // all before the first step, not on the clock
    double evaluate_seconds;                    // held-out evaluation, not on the clock
    double loss;                                // of the last step
    double rays_per_second, samples_per_second; // over the last second or so
    uint64_t samples;                           // field evaluations that entered the loss, total
    uint64_t rays;
    uint64_t level_samples[RN_PROGRESS_LEVELS]; // per ripmap level (the larger of the two axes)
    double psnr;                                // latest held-out figure, dB; NAN before the first
    int64_t psnr_step;
    int64_t given_back; // step from which withheld photographs are trained on; 0: they are not
    uint64_t nonfinite_rays, steps_rejected, rollbacks;
    double eta_seconds; // on the clock, NAN when unknown
    double fraction;    // 0..1 of the binding limit, NAN when there is no limit
    bool done;          // a limit is reached: nothing left to train
    // Of a training that ends where no more is gained: the last figure that was clearly better than
    // the one noted before it, and when; 0 before there is one. Whether the plateau is reached.
    double gained_psnr, gained_seconds;
    bool plateau;
};

#endif

#include "server/jobs/forecast.h"

#include <math.h>

// Fitted to trainings of lego and fern (tests/bench/figures.md, "Estimates").
#define SHRINKS 0.72    // gain of a doubling of the time, of that of the doubling before,
#define EARLY_STEPS 350 // but not before so many steps: there each gains as much as the last
#define LEAST_GAIN 0.1  // dB, of the doubling that was measured
#define MOST_GAIN 4.0
#define LEAST_STEPS 50 // of the second run, for its end to tell something
// A training on its way, beside one that ends then: its planes are coarser and its rate has not
// decayed. Most at the share MOST_BEHIND_AT of its schedule, by this share of the measured gain.
#define BEHIND 0.3
#define BEHIND_FROM 0.1
#define MOST_BEHIND_AT 0.28
#define BEHIND_TO 0.7

double rn_forecast_seconds(const struct rn_calibration *c) {
    double by_steps = c->max_steps > 0 ? (double)c->max_steps * c->step_seconds : INFINITY;
    double seconds = fmin(by_steps, c->max_seconds > 0 ? c->max_seconds : INFINITY);
    return isfinite(seconds) ? seconds : NAN;
}

static double measured_gain(const struct rn_calibration *c) {
    double doublings = log2(c->seconds[1] / c->seconds[0]);
    return fmin(fmax((c->psnr[1] - c->psnr[0]) / doublings, LEAST_GAIN), MOST_GAIN);
}

double rn_forecast_psnr(const struct rn_calibration *c, double seconds) {
    if (c->seconds[1] < LEAST_STEPS * c->step_seconds || !(c->seconds[0] > 0)) return NAN;
    double doublings = log2(seconds / c->seconds[1]);
    double early = fmax(log2(EARLY_STEPS * c->step_seconds / c->seconds[1]), 0);
    early = fmin(early, fmax(doublings, 0));
    double late = SHRINKS * (1 - pow(SHRINKS, doublings - early)) / (1 - SHRINKS);
    return c->psnr[1] + measured_gain(c) * (early + late);
}

// On the way to its end.
static double psnr_at(const struct rn_calibration *c, double limit, double seconds) {
    double done = seconds / limit;
    double rise = (done - BEHIND_FROM) / (MOST_BEHIND_AT - BEHIND_FROM);
    double fall = (BEHIND_TO - done) / (BEHIND_TO - MOST_BEHIND_AT);
    double behind = BEHIND * measured_gain(c) * fmax(fmin(rise, fall), 0);
    return rn_forecast_psnr(c, seconds) - behind;
}

double rn_forecast_passing(const struct rn_calibration *c, double limit, double psnr) {
    double low = 1e-3 * limit, high = limit;
    if (!(psnr_at(c, limit, limit) >= psnr)) return NAN;
    for (int i = 0; i < 60; i++) {
        double middle = sqrt(low * high);
        if (psnr_at(c, limit, middle) >= psnr)
            high = middle;
        else
            low = middle;
    }
    return high;
}

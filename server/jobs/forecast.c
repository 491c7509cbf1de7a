#include "server/jobs/forecast.h"

#include <math.h>

// Fitted to seventeen trainings of twelve datasets (tests/bench/figures.md, "Estimates").
// From the second look to the end of a training as long as the one begun: dB, times the square root
// of what was gained between the looks.
#define RISE 2.08
#define LONGER 0.3     // of that rise, what twice the time gains,
#define SHRINKS 0.72   // and of that the next doubling
#define LATER 1.43     // times as long takes a step of the whole as one before the second look
#define LEAST_STEPS 50 // until the second look, for it to tell something
#define BENT 3.0       // power by which what is left to rise falls, after the second look

double rn_forecast_seconds(const struct rn_calibration *c) {
    double by_steps = c->max_steps > 0 ? (double)c->max_steps * LATER * c->step_seconds : INFINITY;
    double seconds = fmin(by_steps, c->max_seconds > 0 ? c->max_seconds : INFINITY);
    return isfinite(seconds) ? seconds : NAN;
}

static double gained(const struct rn_calibration *c) {
    return fmax(c->psnr[1] - c->psnr[0], 0);
}

static double rise(const struct rn_calibration *c) {
    return RISE * sqrt(gained(c));
}

double rn_forecast_psnr(const struct rn_calibration *c, double seconds) {
    if (!(c->seconds[1] >= LEAST_STEPS * c->step_seconds) || isnan(c->psnr[0])) return NAN;
    double doublings = log2(seconds * RN_CALIBRATION_LOOKED / c->seconds[1]);
    double longer = LONGER * (1 - pow(SHRINKS, doublings)) / (1 - SHRINKS);
    return c->psnr[1] + rise(c) * (1 + longer);
}

// On the way to its end.
static double psnr_at(const struct rn_calibration *c, double limit, double seconds) {
    double end = rn_forecast_psnr(c, limit), done = seconds / limit;
    if (done < RN_CALIBRATION_LOOKED)
        return end - rise(c) - gained(c) * log2(RN_CALIBRATION_LOOKED / done);
    return end - rise(c) * pow((1 - done) / (1 - RN_CALIBRATION_LOOKED), BENT);
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

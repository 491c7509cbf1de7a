#include "server/jobs/forecast.h"

#include <math.h>

// Fitted to sixteen trainings of eleven datasets (tests/bench/figures.md, "Estimates").
#define RISE 0.45    // from the last look to the end, of what was gained since the first
#define LONGER 0.3   // of what is gained after the look before the last, what twice the time gains,
#define SHRINKS 0.72 // and of that the next doubling
#define LATER 1.22   // times as long takes a step of the whole as one before the last look
#define LEAST_STEPS 75 // until the last look, for it to tell something
#define BENT 2.2       // power by which what is left to rise falls, after the last look

enum { LAST = RN_CALIBRATION_LOOKS - 1 };

double rn_forecast_seconds(const struct rn_calibration *c) {
    double by_steps = c->max_steps > 0 ? (double)c->max_steps * LATER * c->step_seconds : INFINITY;
    double seconds = fmin(by_steps, c->max_seconds > 0 ? c->max_seconds : INFINITY);
    return isfinite(seconds) ? seconds : NAN;
}

static double gained(const struct rn_calibration *c, int since, int until) {
    return fmax(c->psnr[until] - c->psnr[since], 0);
}

static double rise(const struct rn_calibration *c) {
    return RISE * gained(c, 0, LAST);
}

double rn_forecast_psnr(const struct rn_calibration *c, double seconds) {
    if (!(c->seconds[LAST] >= LEAST_STEPS * c->step_seconds) || isnan(c->psnr[0])) return NAN;
    double doublings = log2(seconds * RN_CALIBRATION_LOOKED / c->seconds[LAST]);
    double longer = LONGER * (1 - pow(SHRINKS, doublings)) / (1 - SHRINKS);
    return c->psnr[LAST] + rise(c) + longer * (rise(c) + gained(c, LAST - 1, LAST));
}

// On the way to its end; before the last look as it was seen, in the logarithm of time.
static double psnr_at(const struct rn_calibration *c, double limit, double seconds) {
    double end = rn_forecast_psnr(c, limit), done = seconds / limit;
    if (done >= RN_CALIBRATION_LOOKED)
        return end - rise(c) * pow((1 - done) / (1 - RN_CALIBRATION_LOOKED), BENT);
    double look = done / RN_CALIBRATION_LOOKED * RN_CALIBRATION_LOOKS; // 1, 2 ...: the first ...
    int next = look < 2 ? 1 : LAST;                                    // of the two about it
    double left = log2((next + 1) / look) / log2((next + 1.0) / next);
    return end - rise(c) - gained(c, next, LAST) - gained(c, next - 1, next) * left;
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

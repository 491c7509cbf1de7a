#include "server/jobs/forecast.h"

#include <math.h>

// Fitted to sixteen trainings of eleven datasets (tests/bench/figures.md, "Estimates").
#define RISE 0.45    // from 15/32 to the end, of what was gained since 5/32
#define LONGER 0.3   // of what is gained after the look before the last, what twice the time gains,
#define SHRINKS 0.72 // and of that the next doubling
#define LATER 1.22   // times as long takes a step of the whole as one before the last look
#define LEAST_STEPS 75 // until the last look, for it to tell something
#define BENT 2.2       // power by which what is left to rise falls, after the last look

enum { LAST = RN_CALIBRATION_LOOKS - 1 };

double rn_forecast_seconds(const struct rn_calibration *c) {
    double steps = (double)c->max_steps * LATER * c->step_seconds;
    double by_steps = c->max_steps > 0 ? c->turn_seconds + steps : INFINITY;
    double seconds = fmin(by_steps, c->max_seconds > 0 ? c->max_seconds : INFINITY);
    return isfinite(seconds) ? seconds : NAN;
}

static double gained(const struct rn_calibration *c, int since, int until) {
    return fmax(c->psnr[until] - c->psnr[since], 0);
}

// From the last look to the end. A look after 15/32 has seen a part of what rises after that.
static double rise(const struct rn_calibration *c) {
    double left = fmax(1 - c->seconds[LAST] / c->whole_seconds, 0);
    double share = pow(left / (1 - RN_CALIBRATION_LOOKED), BENT);
    return gained(c, 0, LAST) * RISE * share / (1 + RISE * (1 - share));
}

double rn_forecast_psnr(const struct rn_calibration *c, double seconds) {
    bool told = c->seconds[LAST] - c->turn_seconds >= LEAST_STEPS * c->step_seconds;
    if (!told || isnan(c->psnr[0])) return NAN;
    double doublings = log2(seconds / c->whole_seconds);
    double longer = LONGER * (1 - pow(SHRINKS, doublings)) / (1 - SHRINKS);
    return c->psnr[LAST] + rise(c) + longer * (rise(c) + gained(c, LAST - 1, LAST));
}

// On the way to its end; before the last look as it was seen, in the logarithm of time.
static double psnr_at(const struct rn_calibration *c, double limit, double seconds) {
    const double *looked = c->seconds;
    double end = rn_forecast_psnr(c, limit), done = seconds / limit * c->whole_seconds;
    if (done > looked[LAST])
        return end -
               rise(c) * pow((c->whole_seconds - done) / (c->whole_seconds - looked[LAST]), BENT);
    int next = done < looked[1] ? 1 : LAST;
    double left = log(looked[next] / done) / log(looked[next] / looked[next - 1]);
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

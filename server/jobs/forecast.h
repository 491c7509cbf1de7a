// How a training will do, by two short ones of the same dataset: what an estimate is made of.
#ifndef RN_SERVER_JOBS_FORECAST_H
#define RN_SERVER_JOBS_FORECAST_H

#include "proto/estimate.h"

// Seconds of training until the limits asked for; NAN without any.
double rn_forecast_seconds(const struct rn_calibration *calibration);
// PSNR at the end of a training of so many seconds, its schedule complete. What each doubling of
// the time gains shrinks by the same factor, from some hundred steps on. NAN where nothing was held
// out, or the second run had no more than a few steps.
double rn_forecast_psnr(const struct rn_calibration *calibration, double seconds);
// When a training of `limit` seconds passes a PSNR: on the way it is behind one that ends then, as
// its rate has not decayed yet. NAN: not within its limit.
double rn_forecast_passing(const struct rn_calibration *calibration, double limit, double psnr);

#endif

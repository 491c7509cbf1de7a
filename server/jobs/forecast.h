// How a training will do, by its beginning: what an estimate is made of.
#ifndef RN_SERVER_JOBS_FORECAST_H
#define RN_SERVER_JOBS_FORECAST_H

#include "proto/estimate.h"

// Seconds of training until the limits asked for; NAN without any.
double rn_forecast_seconds(const struct rn_calibration *calibration);
// PSNR at the end of a training of so many seconds: what is gained after the last look goes by what
// was gained since the first. NAN where nothing was held out, or only a few steps were made.
double rn_forecast_psnr(const struct rn_calibration *calibration, double seconds);
// When a training of `limit` seconds passes a PSNR. NAN: not within its limit.
double rn_forecast_passing(const struct rn_calibration *calibration, double limit, double psnr);

#endif

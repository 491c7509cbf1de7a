// How bright photographs are against each other, by what they show of the same sparse points.
#ifndef RN_COMMON_DATASET_EXPOSURE_H
#define RN_COMMON_DATASET_EXPOSURE_H

#include "common/dataset/dataset.h"

// Photographs with fewer usable sightings are not measured.
#define RN_EXPOSURE_SIGHTINGS 30
// The unrest (below) above which training makes photographs even. A phone's film of a fox on its
// stand, whose exposures follow the camera around, stands at 0.068: made even it ends where it did
// with each test photograph's exposure fitted (30.1 dB beside 30.0) and 3.8 dB lower as the
// photographs are, since view dependence had taken them up. A cup whose photographs were each made
// lighter or darker by up to half a stop stands at 0.263 and gains 5.8 dB.
#define RN_EXPOSURE_UNREST 0.1

// The unrest of light (below) above which each photograph has an appearance of its own in training.
// Captures of one place by one camera stand at 0.018 to 0.044 (a cup, a drone's tractor, a fox, a
// dinosaur's horns); 135 photographs of a statue, by as many people, at 0.14.
#define RN_LIGHT_UNREST 0.08

// The colours of all sightings, photograph by photograph. Owner: the caller;
// rn_exposures_destroy.
struct rn_exposures;

// For the photographs of a dataset, which must outlive it. *ret_exposures is NULL where there are
// no sightings. RN_ERROR_NO_MEMORY.
enum rn_status rn_exposures_create(const struct rn_dataset *dataset,
                                   struct rn_exposures **ret_exposures,
                                   struct rn_error *err) RN_MUST_CHECK;
void rn_exposures_destroy(struct rn_exposures **exposures);

// Looks at one decoded photograph of full size. Thread-safe for different photographs. NULL-safe.
void rn_exposures_look(struct rn_exposures *exposures, const struct rn_frame *frame,
                       const struct rn_image *image);

// After all were looked at: log colour = log gain of the photograph + log colour of the point, by
// channel, solved for least absolute differences by reweighting; gains near 1 are favoured where
// sightings are few, and their logarithms' mean is 0. Fills the frames' `gain` and, beside the one
// of the eight that look most nearly the same way that shares enough points, `light`. NULL-safe.
void rn_exposures_solve(struct rn_exposures *exposures, struct rn_frame *frames,
                        size_t frame_count);

// By how much gains differ: 90 % of the photographs' (mean over channels) lie within this factor,
// less 1, of the mean; 0.05 is 5 %. NAN where fewer than two photographs were measured.
double rn_exposure_spread(const struct rn_frame *frames, size_t frame_count);
// By how much a photograph's brightness (mean of the channels' gains) differs from that of the one
// whose camera looks most nearly the same way: 90 % of the photographs by no more than this factor,
// less 1. What view dependence can take up is not in it, such as a camera's own metering of a scene
// that it turns around. NAN where fewer than two photographs were measured.
double rn_exposure_unrest(const struct rn_frame *frames, size_t frame_count);
// By how much the light on the same points differs, whatever the exposures: the median of the
// photographs' `light`, as a factor less 1. NAN where fewer than two were measured.
double rn_light_unrest(const struct rn_frame *frames, size_t frame_count);

#endif

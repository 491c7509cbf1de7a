// Learned perceptual image patch similarity, the published VGG variant (Zhang et al. 2018, "The
// Unreasonable Effectiveness of Deep Features as a Perceptual Metric"). Its weights come with no
// program of ours: a file of them is named by who has one.
//
// The file is in the safetensors format, float32, and names tensors as the published package's
// state does: of the 13 convolutions net.slice1.0 .. net.slice5.28 `.weight` [out, in, 3, 3] and
// `.bias` [out], and of the five layers that are compared lin0 .. lin4 `.model.1.weight`
// [1, channels, 1, 1]. Others are not read; how colours are scaled before is part of the metric.
#ifndef RN_COMMON_IMAGE_LPIPS_H
#define RN_COMMON_IMAGE_LPIPS_H

#include "common/image/image.h"

// The environment variable by which ripnerfd names the file to its runners.
#define RN_LPIPS_VARIABLE "RIPNERF_LPIPS"

// The network's weights, mapped. Thread-safety: constant once it is open.
struct rn_lpips;

// Maps a file of weights; it is not opened again. RN_ERROR_NOT_FOUND, RN_ERROR_CORRUPT or
// RN_ERROR_INVALID name the file and the tensor.
enum rn_status rn_lpips_open(const char *path, struct rn_lpips **ret_lpips,
                             struct rn_error *err) RN_MUST_CHECK;
void rn_lpips_close(struct rn_lpips **lpips);

// The distance of two pictures of one size and three channels, sRGB in [0, 1]: 0 for the same. NAN
// where a side is under 16 pixels, which the network's last layer would not see. Needs up to 770
// bytes a pixel (RN_ERROR_NO_MEMORY). `keep_going` (may be NULL) is asked between layers; false
// stops with RN_ERROR_CANCELLED. The same digits on every machine and for any number of threads;
// against float64 within 1e-5 of the distance.
enum rn_status rn_lpips_compare(const struct rn_lpips *lpips, const struct rn_picture *a,
                                const struct rn_picture *b, int threads,
                                bool (*keep_going)(void *context), void *context,
                                double *ret_distance, struct rn_error *err) RN_MUST_CHECK;

#endif

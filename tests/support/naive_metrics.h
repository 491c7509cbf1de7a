// PSNR and SSIM by their definitions, in long double and without any shortcut: the reference that
// tests hold common/image/metrics.h against.
#ifndef RN_TESTS_SUPPORT_NAIVE_METRICS_H
#define RN_TESTS_SUPPORT_NAIVE_METRICS_H

#include <math.h>

#include "common/image/image.h"

static inline long double naive_value(const struct rn_picture *p, int x, int y, int channel) {
    return (long double)p->values[((size_t)y * (size_t)p->width + (size_t)x) * (size_t)p->channels +
                                  (size_t)channel];
}

static inline double naive_psnr(const struct rn_picture *a, const struct rn_picture *b) {
    long double sum = 0;
    for (int y = 0; y < a->height; y++)
        for (int x = 0; x < a->width; x++)
            for (int c = 0; c < a->channels; c++) {
                long double d = naive_value(a, x, y, c) - naive_value(b, x, y, c);
                sum += d * d;
            }
    long double count = (long double)a->width * a->height * a->channels;
    return (double)(10 * log10l(count / sum));
}

// The index of the window whose first pixel is (x0, y0): weighted means, then weighted central
// moments, over an explicit two-dimensional Gaussian.
static inline long double naive_ssim_at(const struct rn_picture *a, const struct rn_picture *b,
                                        int window, int x0, int y0, int channel) {
    long double weights = 0, ma = 0, mb = 0, va = 0, vb = 0, cov = 0;
    for (int pass = 0; pass < 2; pass++)
        for (int i = 0; i < window * window; i++) {
            int dx = i % window - window / 2, dy = i / window - window / 2;
            long double weight = expl(-(long double)(dx * dx + dy * dy) / 4.5L); // 2 * 1.5^2
            long double x = naive_value(a, x0 + i % window, y0 + i / window, channel);
            long double y = naive_value(b, x0 + i % window, y0 + i / window, channel);
            if (pass == 0) {
                weights += weight;
                ma += weight * x;
                mb += weight * y;
            } else {
                long double da = x - ma / weights, db = y - mb / weights;
                va += weight * da * da;
                vb += weight * db * db;
                cov += weight * da * db;
            }
        }
    ma /= weights;
    mb /= weights;
    return (2 * ma * mb + 1e-4L) * (2 * cov / weights + 9e-4L) /
           ((ma * ma + mb * mb + 1e-4L) * ((va + vb) / weights + 9e-4L));
}

static inline double naive_ssim(const struct rn_picture *a, const struct rn_picture *b) {
    int window = 11;
    while (window > a->width || window > a->height)
        window -= 2;
    long double sum = 0;
    long count = 0;
    for (int c = 0; c < a->channels; c++)
        for (int y = 0; y + window <= a->height; y++)
            for (int x = 0; x + window <= a->width; x++, count++)
                sum += naive_ssim_at(a, b, window, x, y, c);
    return (double)(sum / count);
}

#endif

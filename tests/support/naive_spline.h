// What an interpolated pixel is in a picture with a tolerance, the plain way.
#ifndef RN_TESTS_SUPPORT_NAIVE_SPLINE_H
#define RN_TESTS_SUPPORT_NAIVE_SPLINE_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>

// Sixteen pixels around the one at `at`, on axes that are turned by 45 degrees, by the weights of a
// cubic spline halfway between its middle points, and between the nearest four. `right`, `down`:
// how many numbers the neighbours are away.
static inline double naive_spline(const float *at, ptrdiff_t right, ptrdiff_t down) {
    static const double weights[4] = {-1 / 16.0, 9 / 16.0, 9 / 16.0, -1 / 16.0};
    double sum = 0, low = INFINITY, high = -INFINITY;
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++) {
            double value = (double)at[(i + j - 3) * down + (i - j) * right];
            bool nearest = (i == 1 || i == 2) && (j == 1 || j == 2);
            sum += weights[i] * weights[j] * value;
            low = nearest ? fmin(low, value) : low;
            high = nearest ? fmax(high, value) : high;
        }
    return fmin(fmax(sum, low), high);
}

#endif

#include "common/math/symmetric.h"

#include <math.h>

#define SWEEPS 16 // over all pairs of axes; the off-diagonal vanishes quadratically

// Makes a[p][q] 0.
static void rotate(int size, double *a, double *axes, int p, int q) {
    if (a[p * size + q] == 0) return;
    double tau = (a[q * size + q] - a[p * size + p]) / (2 * a[p * size + q]);
    double t = copysign(1, tau) / (fabs(tau) + sqrt(1 + tau * tau));
    double c = 1 / sqrt(1 + t * t), s = t * c;
    for (int k = 0; k < size; k++) {
        double before = a[k * size + p], axis = axes[k * size + p];
        a[k * size + p] = c * before - s * a[k * size + q];
        a[k * size + q] = s * before + c * a[k * size + q];
        axes[k * size + p] = c * axis - s * axes[k * size + q];
        axes[k * size + q] = s * axis + c * axes[k * size + q];
    }
    for (int k = 0; k < size; k++) {
        double before = a[p * size + k];
        a[p * size + k] = c * before - s * a[q * size + k];
        a[q * size + k] = s * before + c * a[q * size + k];
    }
}

static void find_axes(int size, double *a, double *axes) {
    for (int i = 0; i < size * size; i++)
        axes[i] = i % (size + 1) == 0;
    for (int sweep = 0; sweep < SWEEPS; sweep++)
        for (int p = 0; p < size; p++)
            for (int q = p + 1; q < size; q++)
                rotate(size, a, axes, p, q);
}

void rn_symmetric_axes3(double a[3][3], double axes[3][3]) {
    find_axes(3, &a[0][0], &axes[0][0]);
}

void rn_symmetric_axes4(double a[4][4], double axes[4][4]) {
    find_axes(4, &a[0][0], &axes[0][0]);
}

#include "common/math/around.h"

#include <math.h>

#include "common/math/numbers.h"
#include "common/math/vector.h"

void rn_around_axes(const double up[3], double a[3], double b[3]) {
    const double seed[3] = {fabs(up[0]) < 0.9, fabs(up[0]) >= 0.9, 0};
    double along = rn_dot(seed, up);
    for (int i = 0; i < 3; i++)
        a[i] = seed[i] - along * up[i];
    rn_make_unit(a);
    rn_cross(up, a, b);
}

double rn_around_arc(double *angles, size_t count, double *ret_first) {
    double gap = 0;
    *ret_first = 0;
    rn_numbers_sort(angles, count);
    for (size_t k = 0; k < count; k++) {
        double next = k + 1 < count ? angles[k + 1] : angles[0] + 2 * M_PI;
        if (next - angles[k] <= gap) continue;
        gap = next - angles[k];
        *ret_first = next;
    }
    return 2 * M_PI - gap;
}

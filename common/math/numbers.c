#include "common/math/numbers.h"

#include <math.h>
#include <stdlib.h>

static int compare(const void *a, const void *b) {
    double left = *(const double *)a, right = *(const double *)b;
    return (left > right) - (left < right);
}

void rn_numbers_sort(double *numbers, size_t count) {
    if (count) qsort(numbers, count, sizeof *numbers, compare);
}

double rn_numbers_quantile(double *numbers, size_t count, double share) {
    if (!count) return NAN;
    rn_numbers_sort(numbers, count);
    size_t at = (size_t)(share * (double)count);
    return numbers[at < count ? at : count - 1];
}

double rn_numbers_median(double *numbers, size_t count) {
    if (!count) return NAN;
    rn_numbers_sort(numbers, count);
    return 0.5 * (numbers[(count - 1) / 2] + numbers[count / 2]);
}

double rn_unless_zero(double value, double scale) {
    return fabs(value) <= 1e-9 * scale ? 0 : value;
}

// Order statistics of a handful of numbers.
#ifndef RN_COMMON_MATH_NUMBERS_H
#define RN_COMMON_MATH_NUMBERS_H

#include <stddef.h>

// In place, ascending; none is NAN.
void rn_numbers_sort(double *numbers, size_t count);

// The value below which `share` 0 .. 1 of the numbers lie, which are sorted by it; NAN of none.
double rn_numbers_quantile(double *numbers, size_t count, double share);

// Of an even count the mean of the two in the middle; sorts them; NAN of none.
double rn_numbers_median(double *numbers, size_t count);
// A value to be told: 0 in place of what differs from it by rounding alone, beside lengths of
// `scale`, as (-2e-17, 0, 1) does from (0, 0, 1).
double rn_unless_zero(double value, double scale);

#endif

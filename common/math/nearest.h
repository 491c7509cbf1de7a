// The few nearest of many, offered one by one.
#ifndef RN_COMMON_MATH_NEAREST_H
#define RN_COMMON_MATH_NEAREST_H

#include <math.h>
#include <stddef.h>

#define RN_NEAREST_MOST 16

struct rn_nearest {
    int most, count;               // 1..RN_NEAREST_MOST that are kept, and how many there are
    double apart[RN_NEAREST_MOST]; // in any measure, nearest first
    size_t which[RN_NEAREST_MOST];
};

// Of equally near ones the first offered stays; NaN is none.
static inline void rn_nearest_offer(struct rn_nearest *nearest, double apart, size_t which) {
    int at = nearest->count;
    if (!(apart < (at == nearest->most ? nearest->apart[at - 1] : HUGE_VAL))) return;
    if (at == nearest->most)
        at--;
    else
        nearest->count++;
    for (; at > 0 && nearest->apart[at - 1] > apart; at--) {
        nearest->apart[at] = nearest->apart[at - 1];
        nearest->which[at] = nearest->which[at - 1];
    }
    nearest->apart[at] = apart;
    nearest->which[at] = which;
}

#endif

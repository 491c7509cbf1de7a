#include "server/runner/field/pace.h"

#include <math.h>

#define LEAST_MS 0.4 // what a file takes from here to a socket
#define FIRST_MS 1.5 // until it is known better:
#define KNOWN 16     // by so many pictures
#define MOST 0.3     // of the time asked for

void rn_pace_note(struct rn_pace_end *end, double needed_ms) {
    end->needed_ms[end->count++ % RN_PACE_MEMORY] = needed_ms;
}

double rn_pace_keep_ms(const struct rn_pace_end *end, double asked_ms) {
    int count = end->count < RN_PACE_MEMORY ? end->count : RN_PACE_MEMORY;
    double most = count < KNOWN ? FIRST_MS : LEAST_MS;
    for (int i = 0; i < count; i++)
        most = fmax(most, end->needed_ms[i]);
    return fmin(most + RN_PACE_AWAY_MS, MOST * asked_ms);
}

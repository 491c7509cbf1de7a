// What is kept free of a deadline for all that comes when its picture's file is made: that the
// picture ended late, that the file took longer than files before it, that it went to the daemon
// and from there to the socket. Learnt from the pictures before.
#ifndef RN_SERVER_RUNNER_FIELD_PACE_H
#define RN_SERVER_RUNNER_FIELD_PACE_H

#define RN_PACE_MEMORY 128  // pictures
#define RN_PACE_AWAY_MS 0.3 // of whoever asks from this machine: to here, and from the socket

// Zero at the start: nothing is known. Plain.
struct rn_pace_end {
    double needed_ms[RN_PACE_MEMORY]; // by the last pictures, in a ring
    int count;                        // of all there were
};

// What one picture needed.
void rn_pace_note(struct rn_pace_end *end, double needed_ms);
// What to keep free of `asked_ms`: the way, and what the neediest of the last 128 pictures needed,
// so that one of 129 is late where all are alike; some more before that is known, and never most of
// the time.
double rn_pace_keep_ms(const struct rn_pace_end *end, double asked_ms);

#endif

// Whose turn the cores are, where somebody looks at one picture after another and something else
// works beside: pictures go first, and what works stands still for the next one where that is
// likely to come soon, so that it finds the cores free; a share is the work's in any case.
#ifndef RN_COMMON_BASE_TURNS_H
#define RN_COMMON_BASE_TURNS_H

#include <stdint.h>

#define RN_TURNS_NEAR_NS 50000000 // a picture that begins so soon after another one follows it
#define RN_TURNS_SHARE 0.1        // of the time from one picture to the next, that the work has

// Times of rn_clock_ns, zero at the start. Plain.
struct rn_turns {
    int64_t ended_ns; // when the last picture was there; 0: there was none
    int64_t own_until_ns, free_until_ns, wait_until_ns;
    int64_t rest_until_ns; // of work that is not cut short
};
enum rn_turn {
    RN_TURN_FREE,  // the work goes on, and lets a picture that comes go first
    RN_TURN_OWN,   // it goes on, and a picture that comes waits
    RN_TURN_WAITS, // it stands still
};

// A picture began and ended. One that follows another gives the work its share at once, `most_ns`
// at most, and then half of the time that it was itself late by; after that the work stands still
// until the next picture, or until that is not near any more.
void rn_turns_end(struct rn_turns *turns, int64_t began_ns, int64_t ended_ns, int64_t most_ns);
enum rn_turn rn_turns_at(const struct rn_turns *turns, int64_t now_ns);
// When the turn after `now_ns` begins, if no picture comes; INT64_MAX: none does.
int64_t rn_turns_next_ns(const struct rn_turns *turns, int64_t now_ns);
// Work in pieces that lets pictures go first but cannot be cut short: one took so long. Where
// pictures follow one another the next piece waits until that was its share.
void rn_turns_worked(struct rn_turns *turns, int64_t took_ns, int64_t now_ns);
// How long the next piece is to wait, if no picture comes; 0: it may begin.
int64_t rn_turns_rest_ns(const struct rn_turns *turns, int64_t now_ns);

#endif

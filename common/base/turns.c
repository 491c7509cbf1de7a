#include "common/base/turns.h"

#include <stdbool.h>

static int64_t later(int64_t a, int64_t b) {
    return a > b ? a : b;
}

void rn_turns_end(struct rn_turns *turns, int64_t began_ns, int64_t ended_ns, int64_t most_ns) {
    int64_t gap_ns = later(began_ns - turns->ended_ns, 0);
    int64_t share_ns = (int64_t)(RN_TURNS_SHARE * (double)(ended_ns - turns->ended_ns));
    bool follows = turns->ended_ns > 0 && gap_ns <= RN_TURNS_NEAR_NS;
    if (share_ns > most_ns) share_ns = most_ns;
    turns->ended_ns = ended_ns;
    turns->own_until_ns = follows ? ended_ns + share_ns : ended_ns;
    turns->free_until_ns = follows ? later(turns->own_until_ns, ended_ns + gap_ns / 2) : ended_ns;
    turns->wait_until_ns = follows ? ended_ns + RN_TURNS_NEAR_NS : ended_ns;
}

enum rn_turn rn_turns_at(const struct rn_turns *turns, int64_t now_ns) {
    if (now_ns < turns->ended_ns) return RN_TURN_WAITS;
    if (now_ns < turns->own_until_ns) return RN_TURN_OWN;
    if (now_ns < turns->free_until_ns) return RN_TURN_FREE;
    return now_ns < turns->wait_until_ns ? RN_TURN_WAITS : RN_TURN_FREE;
}

int64_t rn_turns_next_ns(const struct rn_turns *turns, int64_t now_ns) {
    const int64_t ends[] = {turns->ended_ns, turns->own_until_ns, turns->free_until_ns,
                            turns->wait_until_ns};
    for (int i = 0; i < 4; i++)
        if (now_ns < ends[i]) return ends[i];
    return INT64_MAX;
}

void rn_turns_worked(struct rn_turns *turns, int64_t took_ns, int64_t now_ns) {
    turns->rest_until_ns = now_ns + (int64_t)((1 / RN_TURNS_SHARE - 1) * (double)took_ns);
}

int64_t rn_turns_rest_ns(const struct rn_turns *turns, int64_t now_ns) {
    int64_t until_ns = turns->rest_until_ns;
    if (until_ns > turns->wait_until_ns) until_ns = turns->wait_until_ns; // pictures are not near
    return until_ns > now_ns ? until_ns - now_ns : 0;
}

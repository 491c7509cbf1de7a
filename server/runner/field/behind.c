#include "server/runner/field/behind.h"

#include <string.h>

#define MOST_PIXELS (1 << 23) // of the pictures together

size_t rn_behind_most(bool on_device, int threads, int width, int height) {
    size_t fit = MOST_PIXELS / ((size_t)width * (size_t)height), wanted = (size_t)threads;
    return !on_device ? 0 : fit < wanted ? fit : wanted;
}

static void *run(void *context) {
    struct rn_piece *piece = context;
    piece->status = piece->run(piece, &piece->err);
    return NULL;
}

static struct rn_piece *take_oldest(struct rn_behind *behind) {
    struct rn_piece *oldest = behind->pieces[0];
    behind->count--;
    memmove(behind->pieces, behind->pieces + 1, behind->count * sizeof behind->pieces[0]);
    if (oldest->on_thread) pthread_join(oldest->thread, NULL);
    return oldest;
}

enum rn_status rn_behind_add(struct rn_behind *behind, struct rn_piece *piece, size_t most,
                             struct rn_error *err) {
    if (most >= RN_BEHIND_MOST) most = RN_BEHIND_MOST - 1;
    piece->on_thread = most > 0 && pthread_create(&piece->thread, NULL, run, piece) == 0;
    if (!piece->on_thread) run(piece);
    behind->pieces[behind->count++] = piece;
    return rn_behind_settle(behind, most, err);
}

enum rn_status rn_behind_settle(struct rn_behind *behind, size_t most, struct rn_error *err) {
    enum rn_status status = RN_OK;
    while (behind->count > most && status == RN_OK) {
        struct rn_piece *oldest = take_oldest(behind);
        status = oldest->status;
        if (status == RN_OK) status = oldest->settle(oldest, &oldest->err);
        if (status != RN_OK && err) *err = oldest->err;
        oldest->release(oldest);
    }
    return status;
}

void rn_behind_drop(struct rn_behind *behind) {
    while (behind->count > 0) {
        struct rn_piece *oldest = take_oldest(behind);
        oldest->release(oldest);
    }
}

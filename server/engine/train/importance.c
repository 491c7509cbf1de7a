#include "server/engine/train/importance.h"

#include <math.h>

#include "server/engine/scene/scene.h"

#define AHEAD 16 // turns for which memory is asked ahead

enum rn_status rn_importance_init(size_t count, struct rn_importance *ret, struct rn_error *err) {
    *ret = (struct rn_importance){.count = count,
                                  .error = rn_block_create((count + 1) * sizeof *ret->error),
                                  .share = rn_block_create((count + 1) * sizeof *ret->share),
                                  .begin = rn_block_create((count + 1) * sizeof *ret->begin),
                                  .guide = rn_block_create((count + 1) * sizeof *ret->guide)};
    if (!ret->error || !ret->share || !ret->begin || !ret->guide) {
        rn_importance_finish(ret);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "pixels", "out of memory");
    }
    for (size_t i = 0; i < count; i++) {
        ret->error[i] = -1;
        ret->share[i] = 1;
    }
    return RN_OK;
}

void rn_importance_finish(struct rn_importance *im) {
    rn_block_destroy(im->error);
    rn_block_destroy(im->share);
    rn_block_destroy(im->begin);
    rn_block_destroy(im->guide);
    *im = (struct rn_importance){0};
}

void rn_importance_note(struct rn_importance *im, size_t block, double loss) {
    im->error[block] = rn_block_error(im->error[block], (float)loss);
}

void rn_importance_weigh(struct rn_importance *im, size_t first, size_t count) {
    double sum = 0;
    size_t seen = 0;
    for (size_t i = first; i < first + count; i++) {
        if (im->error[i] < 0) continue;
        sum += sqrt((double)im->error[i]);
        seen++;
    }
    double scale = sum > 0 ? (double)seen / sum : 0;
    for (size_t i = first; i < first + count; i++) {
        double importance = im->error[i] < 0 || scale == 0 ? 1 : scale * sqrt((double)im->error[i]);
        im->share[i] = (float)(RN_IMPORTANCE_EVEN + (1 - RN_IMPORTANCE_EVEN) * importance);
    }
}

void rn_importance_lay_out(struct rn_importance *im, size_t first, size_t count) {
    double total = 0, at = 0;
    for (size_t i = first; i < first + count; i++)
        total += (double)im->share[i];
    size_t next = 0; // of the guide
    for (size_t i = 0; i < count; i++) {
        im->begin[first + i] = at / total;
        at += (double)im->share[first + i];
        for (; next < count && (double)next / (double)count < at / total; next++)
            im->guide[first + next] = (uint32_t)i;
    }
    for (; next < count; next++)
        im->guide[first + next] = (uint32_t)(count - 1);
}

// The block at `at` or one before it.
static const uint32_t *guide_to(const struct rn_importance *im, size_t first, size_t count,
                                double at) {
    return &im->guide[first + (size_t)(at * (double)count)];
}

struct rn_shares rn_importance_shares(const struct rn_importance *im) {
    return (struct rn_shares){im->share, im->begin, im->guide};
}

struct rn_live_pixel rn_importance_pixel(const struct rn_importance *im, size_t first, size_t count,
                                         uint64_t seed, uint64_t turn, float *ret_weight) {
    // Turns follow each other, and their blocks lie anywhere.
    __builtin_prefetch(guide_to(im, first, count, rn_golden_place(seed, turn + 2 * AHEAD)));
    size_t later = first + *guide_to(im, first, count, rn_golden_place(seed, turn + AHEAD));
    __builtin_prefetch(&im->begin[later]);
    __builtin_prefetch(&im->share[later]);
    struct rn_shares shares = rn_importance_shares(im);
    return rn_shared_pixel(&shares, first, count, seed, turn, ret_weight);
}

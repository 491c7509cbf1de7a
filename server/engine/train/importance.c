#include "server/engine/train/importance.h"

#include <math.h>

#include "server/engine/scene/scene.h"

#define AHEAD 16 // turns for which memory is asked ahead

size_t rn_importance_bytes(size_t count, int lists) {
    size_t places = rn_share_place(lists, count) + 1;
    return count * 2 * sizeof(float) + places * (sizeof(double) + sizeof(uint32_t));
}

enum rn_status rn_importance_init(size_t count, int lists, struct rn_importance *ret,
                                  struct rn_error *err) {
    size_t places = rn_share_place(lists, count) + 1;
    *ret = (struct rn_importance){.count = count,
                                  .error = rn_block_create((count + 1) * sizeof *ret->error),
                                  .share = rn_block_create((count + 1) * sizeof *ret->share),
                                  .sum = rn_block_create(places * sizeof *ret->sum),
                                  .guide = rn_block_create(places * sizeof *ret->guide)};
    if (!ret->error || !ret->share || !ret->sum || !ret->guide) {
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
    rn_block_destroy(im->sum);
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

void rn_importance_lay_out(struct rn_importance *im, int list, size_t first, size_t count) {
    size_t place = rn_share_place(list, first), runs = rn_share_runs(count);
    double *sum = im->sum + place, total = 0;
    for (size_t i = 0; i < count; i++) {
        if (i % RN_SHARE_RUN == 0) sum[i / RN_SHARE_RUN] = total;
        total += (double)im->share[first + i];
    }
    sum[runs] = total;
    size_t next = 0; // of the guide
    for (size_t run = 0; run < runs; run++)
        for (; next < runs && (double)next / (double)runs < sum[run + 1] / total; next++)
            im->guide[place + next] = (uint32_t)run;
    for (; next < runs; next++)
        im->guide[place + next] = (uint32_t)(runs - 1);
}

// The run at `at` or one before it.
static const uint32_t *guide_to(const struct rn_importance *im, size_t place, size_t runs,
                                double at) {
    return &im->guide[place + (size_t)(at * (double)runs)];
}

struct rn_shares rn_importance_shares(const struct rn_importance *im) {
    return (struct rn_shares){im->share, im->sum, im->guide};
}

struct rn_live_pixel rn_importance_pixel(const struct rn_importance *im, int list, size_t first,
                                         size_t count, uint64_t seed, uint64_t turn,
                                         float *ret_weight) {
    // Turns follow each other, and their blocks lie anywhere.
    size_t place = rn_share_place(list, first), runs = rn_share_runs(count);
    __builtin_prefetch(guide_to(im, place, runs, rn_golden_place(seed, turn + 2 * AHEAD)));
    size_t later = *guide_to(im, place, runs, rn_golden_place(seed, turn + AHEAD));
    __builtin_prefetch(&im->sum[place + later]);
    __builtin_prefetch(&im->share[first + later * RN_SHARE_RUN]);
    struct rn_shares shares = rn_importance_shares(im);
    return rn_shared_pixel(&shares, list, first, count, seed, turn, ret_weight);
}

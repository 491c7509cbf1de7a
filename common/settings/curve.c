#include "common/settings/curve.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/nearest.h"
#include "common/math/vector.h"

#define NEAREST 4 // views that a place is judged by

// Of what is expected, fitted to lego: 150 views, each unknown in turn; two of three are within.
#define FEW 1.5          // times the variance of NEAREST views, as they are few
#define LOSS_SPREAD 0.55 // dB, of what a picture lost to the full one
#define LEAST_SPREAD 0.1 // dB

double rn_curve_pixels(const struct rn_curve *curve) {
    return (double)curve->width * (double)curve->height;
}

double rn_curve_worth(const struct rn_curve_point *point) {
    if (!isnan(point->psnr)) return point->psnr;
    return isnan(point->psnr_full) ? INFINITY : point->psnr_full;
}

static int quicker(const void *a, const void *b) {
    double x = ((const struct rn_curve_point *)a)->ms_median;
    double y = ((const struct rn_curve_point *)b)->ms_median;
    return (x > y) - (x < y);
}

void rn_curve_reduce(struct rn_curve_point *points, size_t *count) {
    const struct rn_curve_point full = points[0];
    size_t kept = 0;
    double best = -INFINITY;
    qsort(points + 1, *count - 1, sizeof *points, quicker);
    for (size_t i = 1; i < *count && points[i].ms_median < full.ms_median; i++)
        if (rn_curve_worth(&points[i]) > best) {
            best = rn_curve_worth(&points[i]);
            points[kept++] = points[i];
        }
    points[kept++] = full;
    *count = kept;
}

// ---- finalists ------------------------------------------------------------------------------

#define NEAR_FACTOR 1.1  // of time, and
#define NEAR_DB 0.2      // of worth, that a finalist may be away from the best ones
#define LEAST_APART 1.04 // one finalist of those that take so much longer, or a power of it

struct ranked {
    struct rn_curve_trial trial;
    size_t place; // in the list
};

static int quicker_trial(const void *a, const void *b) {
    const struct ranked *x = a, *y = b;
    if (x->trial.ms != y->trial.ms) return x->trial.ms < y->trial.ms ? -1 : 1;
    return (x->place > y->place) - (x->place < y->place);
}

// Better than all quicker ones, or but little worse than those that are clearly quicker.
static bool is_near_front(const struct ranked *sorted, size_t i) {
    double best = -INFINITY, reach = -INFINITY, worth = sorted[i].trial.worth;
    for (size_t j = 0; j < i; j++) {
        best = fmax(best, sorted[j].trial.worth);
        if (sorted[j].trial.ms * NEAR_FACTOR < sorted[i].trial.ms)
            reach = fmax(reach, sorted[j].trial.worth);
    }
    return worth > best || worth > reach + NEAR_DB;
}

// The best of each group that takes at most `apart` times as long as its first one; 0 where there
// are more groups than there is room for.
static size_t choose_apart(const struct ranked *sorted, size_t count, double apart, size_t most,
                           const struct rn_curve_trial *trials, size_t *ret_finalists) {
    double group_ms = -INFINITY;
    size_t chosen = 0;
    ret_finalists[chosen++] = 0;
    for (size_t i = 0; i < count; i++) {
        const struct ranked *way = &sorted[i];
        if (way->place == 0 || !is_near_front(sorted, i)) continue;
        if (way->trial.ms <= group_ms * apart) {
            size_t *last = &ret_finalists[chosen - 1];
            if (way->trial.worth > trials[*last].worth) *last = way->place;
            continue;
        }
        if (chosen == most) return 0;
        group_ms = way->trial.ms;
        ret_finalists[chosen++] = way->place;
    }
    return chosen;
}

size_t rn_curve_finalists(const struct rn_curve_trial *trials, size_t count, size_t most,
                          size_t *ret_finalists) {
    struct ranked sorted[RN_CURVE_TRIALS];
    double apart = LEAST_APART;
    size_t chosen;
    for (size_t i = 0; i < count; i++)
        sorted[i] = (struct ranked){trials[i], i};
    qsort(sorted, count, sizeof *sorted, quicker_trial);
    while (!(chosen = choose_apart(sorted, count, apart, most, trials, ret_finalists)))
        apart *= LEAST_APART;
    return chosen;
}

// ---- budgets --------------------------------------------------------------------------------

enum rn_budget_kind rn_budget_of(const union rn_setting_value values[RN_RENDER_SETTINGS],
                                 double *ret_number) {
    for (size_t i = RN_RENDER_BUDGET; i < RN_RENDER_SETTINGS; i++)
        if (!rn_setting_is_absent(&rn_render_settings.rows[i], &values[i])) {
            *ret_number = values[i].number;
            return (enum rn_budget_kind)(RN_BUDGET_TIME + (int)(i - RN_RENDER_BUDGET));
        }
    return RN_BUDGET_NONE;
}

const char *rn_budget_check(const union rn_setting_value values[RN_RENDER_SETTINGS],
                            enum rn_budget_kind *ret_kind) {
    bool budget = false, setting = false;
    for (size_t i = 0; i < RN_RENDER_SETTINGS; i++) {
        const struct rn_setting *row = &rn_render_settings.rows[i];
        if (rn_setting_is_absent(row, &values[i])) continue;
        if (i < RN_RENDER_BUDGET) {
            setting = true;
            continue;
        }
        *ret_kind = (enum rn_budget_kind)(RN_BUDGET_TIME + (int)(i - RN_RENDER_BUDGET));
        if (budget) return "goes alone: one of within_ms, render_psnr and quality";
        if (setting) return "goes without settings, which are chosen by it";
        budget = true;
    }
    return NULL;
}

// A promise: nineteen of twenty pictures keep it.
static size_t best_within(const struct rn_curve *curve, double ms, double scale, bool *ret_missed) {
    size_t best = 0;
    *ret_missed = true;
    for (size_t i = 0; i < curve->count; i++)
        if (curve->points[i].ms_p95 * scale <= ms) {
            best = i;
            *ret_missed = false;
        }
    return best;
}

static size_t best_of_median(const struct rn_curve *curve, double ms) {
    size_t best = 0;
    for (size_t i = 1; i < curve->count; i++)
        if (curve->points[i].ms_median <= ms) best = i;
    return best;
}

static size_t quickest_of(const struct rn_curve *curve, double psnr, double full,
                          bool *ret_missed) {
    size_t best = curve->count - 1;
    for (size_t i = 0; i < curve->count; i++) {
        *ret_missed = !(rn_curve_expected(curve, i, full) >= psnr);
        if (!*ret_missed) return i;
        if (rn_curve_expected(curve, i, full) > rn_curve_expected(curve, best, full)) best = i;
    }
    return best;
}

size_t rn_curve_choose(const struct rn_curve *curve, enum rn_budget_kind kind, double number,
                       double pixels, double psnr, bool *ret_missed) {
    double scale = pixels / rn_curve_pixels(curve);
    double low = curve->points[0].ms_median, high = curve->points[curve->count - 1].ms_median;
    *ret_missed = false;
    if (kind == RN_BUDGET_TIME) return best_within(curve, number, scale, ret_missed);
    if (kind == RN_BUDGET_PSNR) return quickest_of(curve, number, psnr, ret_missed);
    if (kind == RN_BUDGET_NONE || number >= 100) return curve->count - 1;
    return best_of_median(curve, low * pow(high / low, number / 100) * (1 + 1e-9));
}

// Errors add up: what a point differs from the full picture by comes on top of what that differs
// from the photographs by.
static double with_loss(double psnr_of_full, double psnr_full) {
    if (isnan(psnr_full)) return psnr_of_full;
    if (isnan(psnr_of_full)) return NAN;
    return -10 * log10(pow(10, -psnr_of_full / 10) + pow(10, -psnr_full / 10));
}

double rn_curve_expected(const struct rn_curve *curve, size_t point, double psnr) {
    const struct rn_curve_point *p = &curve->points[point];
    return isnan(p->psnr) ? with_loss(psnr, p->psnr_full) : p->psnr;
}

struct rn_curve_here rn_curve_here(const struct rn_curve *curve, const double position[3]) {
    struct rn_nearest nearest = {.most = NEAREST};
    const struct rn_curve_point *full = &curve->points[curve->count - 1];
    double weights = 0, psnr = 0, squares = 0;
    for (size_t i = 0; i < curve->around_count; i++)
        rn_nearest_offer(&nearest, rn_square_apart(curve->around[i].position, position), i);
    for (int k = 0; k < nearest.count; k++) {
        double weight = 1 / (nearest.apart[k] + 1e-12);
        const struct rn_curve_view *view = &curve->around[nearest.which[k]];
        weights += weight;
        psnr += weight * view->psnr;
        squares += weight * view->psnr * view->psnr;
    }
    if (!(weights > 0) || isnan(full->psnr))
        return (struct rn_curve_here){.better = 0, .spread = full->psnr_spread};
    psnr /= weights;
    return (struct rn_curve_here){.better = psnr - full->psnr,
                                  .spread = sqrt(FEW * fmax(squares / weights - psnr * psnr, 0))};
}

static double error_of(double psnr) {
    return pow(10, -psnr / 10);
}

static double full_error(const struct rn_curve *curve) {
    return error_of(curve->points[curve->count - 1].psnr);
}

// What interpolation loses, mean square; fitted to photographs of lego, 150 views at 2 to 8 pixels
// apart with tolerances of 0, 0.1 and 0.3. Only ratios matter where a curve was measured.
static double lost(int64_t subsample, double interpolation, double roughness) {
    if (subsample <= 1) return interpolation;
    double apart = (double)subsample;
    return (1 + 0.25 * apart) * interpolation + 0.18 * apart * roughness;
}

static int64_t subsample_of(const struct rn_curve_point *point) {
    struct rn_render_settings settings = {.subsample = 1}; // where the point says nothing
    rn_settings_put(&rn_render_settings, point->setting.values, &settings);
    return settings.subsample;
}

// Of what interpolation is likely to lose, how much it does beside the photographs: the least that
// points with at least half as much to lose have lost in all, as the others have coarser steps and
// rays that end early too; no more than what is likely.
static double share_lost(const struct rn_curve *curve, size_t point, double full, double psnr) {
    double share = 1, most = curve->points[point].interpolation;
    for (size_t i = 0; i < curve->count; i++) {
        double likely = curve->points[i].interpolation;
        if (!(2 * likely >= most) || subsample_of(&curve->points[i]) > 1) continue;
        share = fmin(share, (error_of(rn_curve_expected(curve, i, psnr)) - full) / likely);
    }
    return fmax(share, 0);
}

double rn_curve_expected_here(const struct rn_curve *curve, size_t point,
                              const struct rn_curve_made *made, double psnr, double better) {
    const struct rn_curve_point *p = &curve->points[point];
    int64_t subsample = subsample_of(p);
    double full = error_of(rn_curve_expected(curve, curve->count - 1, psnr));
    double loss = error_of(rn_curve_expected(curve, point, psnr)) - full;
    double now = lost(subsample, made->interpolation, made->roughness);
    double then = lost(subsample, p->interpolation, p->roughness);
    // A picture that is better than the full one, as it is smoother, is so wherever it is taken.
    if (loss < 0)
        loss *= error_of(better);
    else if (isnan(then))
        loss = now > 0 ? now : loss;
    else if (subsample > 1 && then > 0)
        loss *= now / then;
    else // what remains is of steps and of rays that end
        loss += (then > 0 ? share_lost(curve, point, full, psnr) : 1) * (now - then);
    return -10 * log10(full * error_of(better) + loss);
}

double rn_curve_spread_here(const struct rn_curve *curve, double expected, double psnr,
                            const struct rn_curve_here *here) {
    double full = rn_curve_expected(curve, curve->count - 1, psnr) + here->better;
    double share = fmin(error_of(full) / error_of(expected), 1);
    double of_full = share * here->spread, of_loss = (1 - share) * LOSS_SPREAD;
    return sqrt(of_full * of_full + of_loss * of_loss + LEAST_SPREAD * LEAST_SPREAD);
}

// Mean square errors add up, not decibels; a picture that is better than the full one, as it is
// smoother, is so by a factor.
double rn_curve_from_here(const struct rn_curve *curve, double psnr, double better) {
    double error = error_of(psnr), full = full_error(curve), times = error_of(better);
    if (better == 0) return psnr;
    return -10 * log10(error > full * times ? error - full * (times - 1) : error / times);
}

void rn_curve_setting_text(const struct rn_curve_setting *setting, char *ret_text, size_t size) {
    size_t length = 0;
    *ret_text = '\0';
    for (size_t i = 0; i < RN_RENDER_BUDGET; i++) {
        const struct rn_setting *row = &rn_render_settings.rows[i];
        const union rn_setting_value *value = &setting->values[i];
        double number = row->type == RN_SETTING_NUMBER ? value->number : (double)value->whole;
        bool plain = number == (row->type == RN_SETTING_INT) && !isnan(row->settled);
        if (rn_setting_is_absent(row, value) || plain || length >= size) continue;
        length += (size_t)snprintf(ret_text + length, size - length, "%s%s=%.4g", length ? "," : "",
                                   row->option, number);
    }
    if (length == 0) snprintf(ret_text, size, "full");
}

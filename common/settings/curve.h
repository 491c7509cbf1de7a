// What accuracy costs in time: the curve of a scene, and what a budget becomes by it.
//
// A curve is a list of ways to render, from the quickest to the full picture, each with what it was
// measured to take and to look like, and none that another one beats in both. Of a scene that was
// not measured there is its preset's, from other scenes.
#ifndef RN_COMMON_SETTINGS_CURVE_H
#define RN_COMMON_SETTINGS_CURVE_H

#include <stdint.h>

#include "common/settings/render.h"

#define RN_CURVE_POINTS 64

// The settings of a point, in the order of rn_render_settings; absent: as the scene calls for.
struct rn_curve_setting {
    union rn_setting_value values[RN_RENDER_SETTINGS];
};
struct rn_curve_point {
    struct rn_curve_setting setting;
    double ms_median, ms_p95;        // of rendering one of the curve's pictures
    double psnr, ssim;               // against photographs; NAN without any
    double psnr_full;                // against the full picture; NAN: the same picture
    double psnr_spread;              // standard deviation over the views, of psnr or else psnr_full
    double rays, samples;            // of a picture, mean
    double interpolation, roughness; // rn_curve_made of a picture, mean; NAN: of an older version
};
// What the full picture of one held-out view is worth, and where that was taken from: a picture
// from near there will be about as good.
struct rn_curve_view {
    double position[3]; // dataset coordinates
    double psnr;        // against its photograph
};
#define RN_CURVE_VIEWS 512
// Plain but for `points` and `around`, which whoever made it owns.
struct rn_curve {
    struct rn_curve_point *points; // by ms_median, the last one the full picture
    size_t count;
    const struct rn_curve_view *around;
    size_t around_count;
    int64_t width, height; // of the pictures it was measured with; 0 x 0: it was not
};

// What a way to render took and was worth on the first view that it was tried on.
struct rn_curve_trial {
    double ms, worth;
};
#define RN_CURVE_TRIALS 160
// Which of these ways are worth measuring on all views, at most `most` >= 2: the full picture,
// `trials[0]`, then, from the quickest on, those that on this view lie on the front or near it, the
// best of each group that takes about as long; the groups are as close to each other as there is
// room for. `count` is 1 to RN_CURVE_TRIALS. How many there are.
size_t rn_curve_finalists(const struct rn_curve_trial *trials, size_t count, size_t most,
                          size_t *ret_finalists);

// Pixels of a picture whose times the curve tells.
double rn_curve_pixels(const struct rn_curve *curve);
// What makes a point good: its PSNR against photographs, else against the full picture, of which
// the full picture itself has more than any other.
double rn_curve_worth(const struct rn_curve_point *point);
// Sorts the points by time and drops those that are beaten: no better than a quicker one. The full
// picture stays, as the last one; it is `points[0]` when called.
void rn_curve_reduce(struct rn_curve_point *points, size_t *count);

// ---- budgets --------------------------------------------------------------------------------

enum rn_budget_kind { RN_BUDGET_NONE, RN_BUDGET_TIME, RN_BUDGET_PSNR, RN_BUDGET_QUALITY };
// What a request's settings ask for; *ret_number: of milliseconds, dB or quality.
enum rn_budget_kind rn_budget_of(const union rn_setting_value values[RN_RENDER_SETTINGS],
                                 double *ret_number);
// More than one budget, or one beside settings: what is wrong, and the kind of the one that is too
// much. NULL: nothing is.
const char *rn_budget_check(const union rn_setting_value values[RN_RENDER_SETTINGS],
                            enum rn_budget_kind *ret_kind);
// The curve's point for a picture of so many pixels: the best one that keeps within the time in 95
// of 100 pictures; the quickest one of at least that PSNR, else the best one; the best one whose
// median is within the time that lies, on a logarithmic scale, that far between the quickest and
// the full picture. Of a curve without photographs, `psnr` stands for the scene's own, by which all
// points are worth that much more or less. *ret_missed: no point is so quick, or so good.
size_t rn_curve_choose(const struct rn_curve *curve, enum rn_budget_kind kind, double number,
                       double pixels, double psnr, bool *ret_missed);
// The PSNR to expect of a point against photographs; `psnr` of the full picture, for a curve that
// does not know it. NAN: nothing is known.
double rn_curve_expected(const struct rn_curve *curve, size_t point, double psnr);

// What is known of a full picture from a place, dB.
struct rn_curve_here {
    double better; // than the mean of the curve's views, is to be expected
    double spread; // of that: two of three pictures are within
};
// By the full pictures of the nearest four views, each counted by its nearness: at the place of one
// of them that one alone. Where none is known: 0, and the spread of the curve's views.
struct rn_curve_here rn_curve_here(const struct rn_curve *curve, const double position[3]);

// What a picture was interpolated from, which tells what it lost by that (rn_render_stats).
struct rn_curve_made {
    double interpolation; // of points between others, likely loss, mean square
    double roughness;     // of what was rendered smaller, mean square
};
// The PSNR to expect of this picture, made with a point's settings but for the tolerance, where the
// full pictures are better by so much (rn_curve_here.better): the full one's error here, and what
// the point loses to it, by as much more as there was more to interpolate than in the curve's
// pictures.
double rn_curve_expected_here(const struct rn_curve *curve, size_t point,
                              const struct rn_curve_made *made, double psnr, double better);
// How far off `expected` (rn_curve_expected_here) may be, dB, two of three are within: of the full
// picture's error by the place, of what is lost to it by how well pictures tell that themselves.
double rn_curve_spread_here(const struct rn_curve *curve, double expected, double psnr,
                            const struct rn_curve_here *here);
// The PSNR expected at the curve's views of what is worth `psnr` where the full pictures are so
// much better: what a picture differs from the full one by stays what it was.
double rn_curve_from_here(const struct rn_curve *curve, double psnr, double better);

// "tolerance=0.03,subsample=2"; "full" where nothing differs.
void rn_curve_setting_text(const struct rn_curve_setting *setting, char *ret_text, size_t size);

// The curve of scenes that were not measured, in the caller's points.
void rn_curve_of_presets(struct rn_curve_point points[RN_CURVE_POINTS], struct rn_curve *ret_curve);

#endif

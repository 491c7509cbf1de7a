// The curve of scenes that were not measured: what was measured on others. Its times are those of
// one machine; a render by a deadline learns from its first picture how much slower it is here.
#include "common/settings/curve.h"

// step and stop as trained where they are 0; a picture of 400 x 400 pixels.
static const struct {
    int subsample;
    double tolerance, stop, ms, ssim, psnr_full;
} measured[] = {
    {8, 0, 0.1, 2.5, 0.55, 20.8}, {4, 0, 0.1, 4.2, 0.75, 24.5},    {3, 0, 0.1, 6.6, 0.83, 27.0},
    {2, 0, 0.1, 11.0, 0.90, 30},  {1, 0.15, 0, 13.0, 0.936, 33.2}, {1, 0.1, 0, 15.7, 0.947, 35.6},
    {1, 0.06, 0, 19, 0.955, 39},  {1, 0.04, 0, 21.5, 0.958, 42},   {1, 0.02, 0, 25, 0.961, 48},
    {1, 0, 0, 33, 0.962, NAN},
};
#define COUNT (sizeof measured / sizeof *measured)

static void set(struct rn_curve_point *point, const char *name, double number) {
    const struct rn_setting *row = rn_settings_find(&rn_render_settings, name);
    *rn_settings_value(&rn_render_settings, point->setting.values, name) =
        rn_setting_of_number(row, number);
}

void rn_curve_of_presets(struct rn_curve_point points[RN_CURVE_POINTS],
                         struct rn_curve *ret_curve) {
    for (size_t i = 0; i < COUNT; i++) {
        struct rn_curve_point *p = &points[i];
        *p = (struct rn_curve_point){.ms_median = measured[i].ms,
                                     .ms_p95 = measured[i].ms,
                                     .psnr = NAN,
                                     .ssim = measured[i].ssim,
                                     .psnr_full = measured[i].psnr_full};
        for (size_t k = 0; k < RN_RENDER_SETTINGS; k++)
            p->setting.values[k] = rn_setting_absent(&rn_render_settings.rows[k]);
        if (measured[i].subsample > 1) set(p, "subsample", measured[i].subsample);
        if (measured[i].tolerance > 0) set(p, "tolerance", measured[i].tolerance);
        if (measured[i].stop > 0) set(p, "stop", measured[i].stop);
    }
    *ret_curve = (struct rn_curve){points, COUNT, 400, 400};
}

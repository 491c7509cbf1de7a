// The curve of scenes that were not measured: what was measured on others. Its times are those of
// one machine; a render by a deadline learns from its first picture how much slower it is here.
#include "common/settings/curve.h"

// step and stop as trained where they are 0; a picture of 400 x 400 pixels.
static const struct {
    int subsample;
    double tolerance, stop, ms, ssim, psnr_full, samples;
} measured[] = {
    {8, 0, 0.1, 3.8, 0.76, 20.3, 3500},     {4, 0, 0.1, 6, 0.83, 24.2, 16500},
    {3, 0, 0.1, 9, 0.88, 26.3, 40000},      {2, 0, 0.1, 14.3, 0.92, 28.7, 58600},
    {1, 0.2, 0.1, 17.5, 0.93, 31.5, 88400}, {1, 0.15, 0, 19.4, 0.934, 32.6, 96300},
    {1, 0.1, 0, 21.7, 0.943, 35.1, 121000}, {1, 0.07, 0, 25.5, 0.951, 37.5, 190000},
    {1, 0.045, 0, 28, 0.959, 40.6, 289000}, {1, 0.03, 0, 32.4, 0.962, 43.5, 340000},
    {1, 0, 0, 46, 0.966, NAN, 593000},
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
                                     .psnr_full = measured[i].psnr_full,
                                     .samples = measured[i].samples,
                                     .interpolation = NAN,
                                     .roughness = NAN};
        for (size_t k = 0; k < RN_RENDER_SETTINGS; k++)
            p->setting.values[k] = rn_setting_absent(&rn_render_settings.rows[k]);
        if (measured[i].subsample > 1) set(p, "subsample", measured[i].subsample);
        if (measured[i].tolerance > 0) set(p, "tolerance", measured[i].tolerance);
        if (measured[i].stop > 0) set(p, "stop", measured[i].stop);
    }
    *ret_curve = (struct rn_curve){.points = points, .count = COUNT, .width = 400, .height = 400};
}

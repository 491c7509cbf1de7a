#include "common/settings/optics.h"

#include <stdio.h>

#define PLACE(member) .offset = offsetof(struct rn_optics, member)
static const struct rn_setting rows[] = {
    {.name = "aperture",
     .type = RN_SETTING_NUMBER,
     .flags = RN_SETTING_OR_ZERO,
     PLACE(aperture),
     .min = 1e-9,
     .max = 1e9,
     .unit = "dataset units",
     .meaning = "depth of field: the lens's width in dataset units, with a focus; else a pinhole",
     .option = "aperture",
     .flag = "aperture",
     .settled = NAN},
    {.name = "focus",
     .type = RN_SETTING_NUMBER,
     .flags = RN_SETTING_OR_ZERO,
     PLACE(focus),
     .min = 1e-9,
     .max = 1e9,
     .unit = "dataset units",
     .meaning = "how far before the camera what is sharp lies, in dataset units",
     .option = "focus",
     .flag = "focus",
     .settled = NAN},
    {.name = "shutter",
     .type = RN_SETTING_NUMBER,
     .flags = RN_SETTING_OR_ZERO,
     PLACE(shutter),
     .min = 1e-3,
     .max = 1,
     .unit = "frames",
     .meaning = "motion blur of a path: the share of a frame's time that the shutter is open",
     .option = "shutter",
     .flag = "shutter",
     .settled = NAN},
    {.name = "exposure",
     .type = RN_SETTING_NUMBER,
     PLACE(exposure),
     .min = -20,
     .max = 20,
     .unit = "stops",
     .meaning = "film: stops by which the picture is lighter, or darker below 0",
     .option = "exposure",
     .flag = "exposure",
     .settled = NAN},
    {.name = "white_balance",
     .type = RN_SETTING_NUMBER,
     .flags = RN_SETTING_OR_ZERO,
     PLACE(white_balance),
     .min = 1700,
     .max = 25000,
     .unit = "K",
     .meaning = "film: temperature of the light that comes out white, in kelvins; 6504 as it is",
     .option = "white_balance",
     .flag = "white-balance",
     .settled = NAN},
    {.name = "ortho_height",
     .type = RN_SETTING_NUMBER,
     .flags = RN_SETTING_OR_ZERO,
     PLACE(ortho_height),
     .min = 1e-9,
     .max = 1e9,
     .unit = "dataset units",
     .meaning = "parallel rays (orthographic): the picture's height in dataset units",
     .option = "ortho_height",
     .flag = "ortho-height",
     .settled = NAN},
};
_Static_assert(sizeof rows / sizeof *rows == RN_OPTICS_SETTINGS, "a row for every member");
const struct rn_settings rn_optics_settings = {rows, RN_OPTICS_SETTINGS};

enum rn_status rn_optics_check(const struct rn_optics *optics, struct rn_error *err) {
    enum rn_status status = rn_settings_check(&rn_optics_settings, optics, err);
    if (status) return status;
    if (optics->aperture > 0 && !(optics->focus > 0))
        return rn_error_set(err, RN_ERROR_INVALID, "focus",
                            "must be given with an aperture: how far away what is sharp lies");
    return RN_OK;
}

bool rn_optics_spreads(const struct rn_optics *optics) {
    return optics->aperture > 0 || optics->shutter > 0;
}

static double mix(double a, double b, double u) {
    return a + (b - a) * u;
}

// Where one of them is none, it is `none`.
static double mix_or(double a, double b, double none_of_a, double none_of_b, double u) {
    if (a == 0 && b == 0) return 0;
    return mix(a > 0 ? a : none_of_a, b > 0 ? b : none_of_b, u);
}

struct rn_optics rn_optics_between(const struct rn_optics *a, const struct rn_optics *b, double u) {
    return (struct rn_optics){.aperture = mix(a->aperture, b->aperture, u),
                              .focus = mix_or(a->focus, b->focus, b->focus, a->focus, u),
                              .shutter = mix(a->shutter, b->shutter, u),
                              .exposure = mix(a->exposure, b->exposure, u),
                              .white_balance = mix_or(a->white_balance, b->white_balance,
                                                      RN_DAYLIGHT_K, RN_DAYLIGHT_K, u),
                              .ortho_height = mix_or(a->ortho_height, b->ortho_height,
                                                     b->ortho_height, a->ortho_height, u)};
}

struct rn_optics rn_optics_over(const struct rn_optics *optics, const struct rn_optics *over) {
    struct rn_optics out = *optics;
    for (size_t i = 0; i < RN_OPTICS_SETTINGS; i++) {
        double value = rn_setting_number(&rows[i], over);
        if (value != 0) rn_setting_put_number(&rows[i], value, &out);
    }
    return out;
}

void rn_optics_names(const struct rn_optics *o, char *ret_text, size_t size) {
    const struct {
        bool on;
        const char *name;
    } effects[] = {{o->aperture > 0, "depth-of-field"},
                   {o->shutter > 0, "shutter"},
                   {o->exposure != 0 || o->white_balance > 0, "film"},
                   {o->ortho_height > 0, "orthographic"}};
    size_t used = 0;
    *ret_text = 0;
    for (size_t i = 0; i < sizeof effects / sizeof *effects; i++)
        if (effects[i].on && used < size)
            used += (size_t)snprintf(ret_text + used, size - used, "%s%s", used ? ", " : "",
                                     effects[i].name);
}

// The effects of a camera that a pinhole at one instant has not: what a request for a picture, or a
// key of a camera path, may choose.
#ifndef RN_COMMON_SETTINGS_OPTICS_H
#define RN_COMMON_SETTINGS_OPTICS_H

#include "common/settings/setting.h"

// Plain values. Of each, 0 is none: that effect is off and costs nothing.
struct rn_optics {
    // Depth of field. A thin lens of this width (dataset units), and how far before it what is
    // sharp lies (dataset units, along the axis). A point at the distance d is spread over a disc
    // of fy aperture |d - focus| / (d focus) pixels.
    double aperture, focus;
    double shutter; // motion blur: the share of the time between two frames that it is open
    // Film: stops by which it is lighter, and the temperature of the light that comes out white, in
    // kelvins (server/engine/render/develop.h).
    double exposure, white_balance;
    double ortho_height; // of a picture by parallel rays, from top to bottom, dataset units
};

#define RN_DAYLIGHT_K 6504.0 // sRGB's white: a light of this temperature is left as it is

// The one table: a row for every member.
#define RN_OPTICS_SETTINGS 6
extern const struct rn_settings rn_optics_settings;

// Every member in its range, and what goes with what: an aperture needs a focus. RN_ERROR_INVALID
// names the setting.
enum rn_status rn_optics_check(const struct rn_optics *optics, struct rn_error *err) RN_MUST_CHECK;
// Whether pixels are the means of several places or instants: only their cones are dearer.
bool rn_optics_spreads(const struct rn_optics *optics);
// Between two keys' effects, u in [0, 1]. A focus that only one of them has is the focus; a light
// that only one of them has is compared with daylight's.
struct rn_optics rn_optics_between(const struct rn_optics *a, const struct rn_optics *b, double u);
// Those of `over` that are not none, in place of `optics`'.
struct rn_optics rn_optics_over(const struct rn_optics *optics, const struct rn_optics *over);
// "depth-of-field, film": the effects that are on, in the table's order; "" = none.
void rn_optics_names(const struct rn_optics *optics, char *ret_text, size_t size);

#endif

// Film: how light a picture is, and which light comes out white.
#ifndef RN_ENGINE_RENDER_DEVELOP_H
#define RN_ENGINE_RENDER_DEVELOP_H

#include "common/math/srgb.h"
#include "common/settings/optics.h"

// What is done to the linear light of a pixel. A plain value.
struct rn_development {
    bool on;
    float gain[3]; // of stored values, before
    float matrix[3][3];
};

// Lighter by `stops`, and as if a light of `white_k` kelvins (1700 .. 25000; 0: as it is) were
// white: chromatic adaptation by Bradford's matrix from that light to daylight's, both on the
// Planckian locus (Kim and others 2002). Off when both are 0.
struct rn_development rn_development_of(double stops, double white_k);
// As a photograph was exposed and its white balanced, beneath the film: undoes what made
// photographs even (rn_frame's `gain`). A first gain of 0: nothing.
void rn_development_expose(struct rn_development *development, const double gain[3]);
// A pixel of sRGB that covers `alpha` of what lies behind it, in place; above 1 where film would be
// burnt out. The background is no light of the scene's and stays.
void rn_develop(const struct rn_development *development, float alpha, const float background[3],
                float rgb[3]);

#endif

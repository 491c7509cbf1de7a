// What a picture is made of, pixel by pixel, beside colour, depth and opacity: where its time goes,
// and which way its surfaces face. Computed from the finished depth and opacity; nothing of it runs
// where it is not asked for.
#ifndef RN_ENGINE_RENDER_INSPECT_H
#define RN_ENGINE_RENDER_INSPECT_H

#include "server/engine/render/lattice.h"

#define RN_OUTPUTS_OF_SURFACES (RN_OUTPUT_NORMAL | RN_OUTPUT_LEVEL | RN_OUTPUT_FOOTPRINT)

// Plain; all pointers are the caller's and live for the call.
struct rn_inspection {
    struct rn_engine *engine;
    const struct rn_field *field; // ready on the CPU
    const struct rn_render_options *options;
    const struct rn_lattice *lattice;
    const uint16_t *costs; // of the lattice's points: samples; may be NULL without RN_OUTPUT_COST
    int points;            // of the lattice, a side of a pixel
    int cones;             // a side of a pixel
    double step;           // of the march, scene radii
};
// What must be rendered besides for these outputs.
unsigned rn_inspect_needs(unsigned outputs);
// Makes the outputs of RN_OUTPUT_COST and RN_OUTPUTS_OF_SURFACES that the options ask for, of a
// result that has depth and opacity, over the engine's threads. Surfaces are where at least half of
// a pixel is covered, at its depth; elsewhere all three are 0.
//
// normal: minus the gradient of the opacity of a short way through the density there, by central
//   differences in the planes' cube over the width of the cone or a texel, whichever is larger; of
//   length 1, dataset axes. As wide as that are edges rounded. 0 where nothing rises.
// level: of the ripmap, mean over the planes and their axes, of a sample's Gaussian there
//   (field/footprint.h), as it is drawn into the planes' cube; 0 where the field has none.
// footprint: diameter of one cone there, dataset units.
enum rn_status rn_inspect(const struct rn_inspection *inspection, struct rn_render_result *result,
                          struct rn_error *err) RN_MUST_CHECK;

#endif

// Interpolated pixels, or quarters of pixels that are several cones: every second pixel of a
// picture is traced on both axes first. Then come the pixels between four of these (their
// neighbours are the diagonal ones), then the rest (beside, above and below): each is interpolated
// where its four neighbours agree, and is traced where they do not. Neighbours may be interpolated
// themselves. The first are the neighbours' means; the last lie on cubic splines through sixteen
// pixels, and between the four.
//
// Neighbours agree when, of every output asked for, the root mean square distance from their mean
// is at most 0.7 (first) or 1.4 (last) of the tolerance: colour (over its three channels) and
// opacity in [0, 1], depth in scene radii. What is narrower than three pixels and lies between
// neighbours that agree may be lost: that is the price. Four that see nothing agree only where
// cells are wide enough (`dense`). A pixel at the border, or beside a value that is not finite, is
// traced.
//
// A pass reads what the passes before it wrote and nothing else: the tiles of one pass may be done
// in any order.
#ifndef RN_ENGINE_RENDER_LATTICE_H
#define RN_ENGINE_RENDER_LATTICE_H

#include "server/engine/render/cones.h"
#include "server/engine/render/render.h"

struct rn_lattice {
    struct rn_pixel *pixels; // width * height, of the field: depth in scene radii
    int width, height;
    unsigned outputs; // RN_OUTPUT_* ORed
    float tolerance;  // at most 0.5; 0: every pixel is traced, in one pass
    float earlier;    // of the pass before this one, where it was another; else 0
    bool dense;       // rn_lattice_is_dense
    bool late;        // no time is left: from the second pass on nothing is traced
};
// Part of a picture: columns [x0, x1), rows [y0, y1); even but for the picture's ends.
struct rn_tile {
    int x0, y0, x1, y1;
};

// Whether a cell of the training's occupancy, as large as it looks in the middle of the scene,
// covers one of four diagonal neighbours whenever it covers the pixel between them: a disc of its
// width, 2 sqrt(2) pixels, always does. Of a field at rest, whose cells are half as wide, a lone
// one may be missed.
bool rn_lattice_is_dense(const struct rn_field *field, const struct rn_camera *camera);
int rn_lattice_passes(const struct rn_lattice *lattice);
// Writes the tile's pixels of pass `pass` (from 0) that are interpolated, lists those to be traced,
// row by row, and returns their count: at most all of the tile's, and half where there are several
// passes. Adds to *interpolation what the colours of those that are interpolated are likely to be
// away from what would be traced, mean square over the channels.
int rn_lattice_choose(const struct rn_lattice *lattice, int pass, struct rn_tile tile,
                      struct rn_spot *ret_spots, double *interpolation);

// How many points of a pass a tolerance would have traced: by how much their neighbours disagree.
#define RN_LATTICE_MISS 0.1 // of a ray that sees nothing, its cost in rays that see something
#define RN_LATTICE_BINS 64  // quarter octaves of the distance's square, up to the largest tolerance
struct rn_lattice_census {
    uint32_t points, unseen; // all of the tile; of these, those whose neighbours see nothing
    uint32_t always, empty;  // traced whatever the tolerance is; of the unseen, those traced, too
    uint32_t above[RN_LATTICE_BINS]; // traced where the tolerance is below the bin's
};
// Adds the tile's points of pass `pass` (from 1), before it is chosen.
void rn_lattice_count(const struct rn_lattice *lattice, int pass, struct rn_tile tile,
                      struct rn_lattice_census *census);
// The smallest tolerance, above 0 and at most 0.5, that has at most `rays` points traced, of which
// ten that are likely to see nothing count as one.
float rn_lattice_tolerance_for(const struct rn_lattice_census *census, double rays);

#endif

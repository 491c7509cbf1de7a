// How far a photograph sees freely between the sparse points in it: what lies between points
// that nothing parts is taken for a surface through them.
#ifndef RN_ENGINE_TRAIN_SHEETS_H
#define RN_ENGINE_TRAIN_SHEETS_H

#include "server/engine/scene/pixels.h"

// The photograph in tiles, rows from the top. Owner: rn_sheet_finish.
struct rn_sheet {
    const struct rn_camera *camera;
    int columns, rows;
    float *clear;   // along the optical axis, dataset units, of each tile; 0: not known
    float farthest; // of these
};

// A point that the photograph saw: where, in tiles from the top-left corner, and how far along the
// optical axis, dataset units.
struct rn_sheet_point {
    float x, y, depth;
};

// Where a point of the world is in a photograph; false where it is not in it.
bool rn_sheet_place(const struct rn_camera *camera, const double point[3],
                    struct rn_sheet_point *ret_point);

// Of all tiles about which in three quadrants at least a point lies that no edge of the photograph
// parts from it: 0.96 of the depth at which a plane through these has it, where they lie
// on one within a twentieth, else 0.85 of the nearest's. Without memory nothing is known.
struct rn_sheet rn_sheet_make(const struct rn_pixels *pixels, const struct rn_pixel_frame *frame,
                              const struct rn_sheet_point *points, size_t count);
void rn_sheet_finish(struct rn_sheet *sheet);

// Whether a point of the world lies in what the photograph sees through.
bool rn_sheet_sees_through(const struct rn_sheet *sheet, const double point[3]);

#endif

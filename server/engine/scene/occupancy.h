// The occupancy grid that the march reads: from the grid that training measures and, once a field
// is no longer trained, at half its cells' width from the field itself.
#ifndef RN_ENGINE_SCENE_OCCUPANCY_H
#define RN_ENGINE_SCENE_OCCUPANCY_H

#include "server/engine/scene/scene.h"

// Makes room for the bits of `cells` a side that divide a space. RN_ERROR_NO_MEMORY.
enum rn_status rn_occupancy_bits_create(int cells, enum rn_space space,
                                        struct rn_occupancy_bits *ret_bits) RN_MUST_CHECK;
void rn_occupancy_bits_destroy(struct rn_occupancy_bits *bits);

// The pyramid's level whose texels are as wide as the cells that training measures.
float rn_level_of_cells(const struct rn_field_config *config);

// Rebuilds the bits and distances that the march reads from `occupancy` and `hull`.
void rn_field_refresh_occupancy(struct rn_field *field);

// For a field that is not trained any more, and whose configuration asks for it: cells half as
// wide, of which those are occupied whose density at one of 2 x 2 x 2 points would make an optical
// depth above RN_OCCUPANCY_SEEN from side to side; of a pyramid four points are looked up in the
// base maps and four at the level of the training's cells. There are none where no cell, or more
// than an eighth of all, is occupied, where cells are 256 a side already, or without memory. The
// result does not depend on the number of threads.
void rn_field_refine_occupancy(struct rn_field *field, struct rn_engine *engine);

// Of the cells that the march reads, those whose middle lies in a box of dataset coordinates: its
// faces are kept to half a cell. RN_ERROR_NO_MEMORY; else rn_occupancy_bits_destroy.
enum rn_status rn_occupancy_bits_crop(const struct rn_field *field, const struct rn_box *box,
                                      struct rn_occupancy_bits *ret_bits) RN_MUST_CHECK;

// Has the march read the finer cells where there are some that hold for cones of so many levels of
// the pyramid, else the training's. Rays that end at a transmittance `stop` of RN_OCCUPANCY_FIRM or
// more pass over haze anyway, such as cones twice as wide see beside those finer cells whose
// optical depth is as large: they read these alone (lego, 0.5 to 0.8 times as many pixels a side as
// its photographs have: 34 to 46 % fewer samples, PSNR to the full picture 0 to 0.1 dB more). Cones
// up to eight times as wide read the finer cells for them (0.2 to 0.45 times as many: 19 to 30 %
// fewer samples, 0 to 0.04 dB less).
void rn_field_choose_cells(struct rn_field *field, int levels, double stop);

#endif

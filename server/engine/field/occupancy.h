// The occupancy grid: which cells of the [-1, 1] cube may hold matter (paper, section 3.4; the
// released code's 128^3 grid).
#ifndef RN_ENGINE_FIELD_OCCUPANCY_H
#define RN_ENGINE_FIELD_OCCUPANCY_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "server/engine/field/real.h"

#define RN_OCCUPANCY_DECAY 0.95
#define RN_OCCUPANCY_LIMIT 5e-3 // of density times step, with the mean as the lower threshold
// Where cells are kept by what they showed (train/seen.c): the weight of a sample that others would
// miss, and what stands for a cell that no ray came to yet.
#define RN_SEEN_LIMIT 0.03f
#define RN_NEVER_SEEN 2.0f
#define RN_SEEN_LEAST 1e-9f  // of a cell that was looked at and showed nothing
#define RN_HIDDEN_DEPTH 2.3f // of what lies in front of a hidden cell: a tenth shines through
#define RN_SEEN_LEFT 0.6f    // share of what a cell showed that is left after a round
// Of a field at rest: a finer cell's optical depth from side to side. Thinner haze vanishes.
#define RN_OCCUPANCY_SEEN 1.5e-2f
// Of one that a picture's rays which end early pass over: less than they leave out at their ends.
#define RN_OCCUPANCY_FIRM 8e-2f

// Cell of a coordinate in [-1, 1]; clamped. NaN gives 0.
RN_HD int rn_cell_of(rn_real p, int cells) {
    return (int)rn_clamp((p + 1) * (rn_real)0.5 * (rn_real)cells, 0, (rn_real)(cells - 1));
}

// Index of cell (x, y, z) in a row-major grid.
RN_HD size_t rn_cell_index(int x, int y, int z, int cells) {
    return ((size_t)x * (size_t)cells + (size_t)y) * (size_t)cells + (size_t)z;
}

// The cell of an index.
RN_HD void rn_cell_at(size_t index, int cells, int ret[3]) {
    size_t n = (size_t)cells;
    ret[0] = (int)(index / n / n);
    ret[1] = (int)(index / n % n);
    ret[2] = (int)(index % n);
}

// What is kept of a cell after a round in which it showed `shown`, NaN where no ray came to it;
// when `all_looked`, one that no ray ever came to is empty.
RN_HD float rn_cell_kept(float kept, float shown, bool all_looked) {
    float left = RN_SEEN_LEFT * (kept < 1 ? kept : 1);
    if (shown >= 0) return shown > left ? shown : left;
    return all_looked && kept == RN_NEVER_SEEN ? 0 : kept;
}

#define RN_END 0.96875  // of the ball that all of space is drawn into: 16 radii of the inner one
#define RN_END_LAYERS 4 // of a disparity box, of the grid in training

// Whether a cell lies where a place ends, in unbounded space or, where `forward`, in a disparity
// box with `trained` cells a side in training. There is always something to see: a ray that nothing
// else stops ends there.
RN_HD bool rn_cell_ends(bool forward, const int at[3], int cells, int trained) {
    double squares = 0, end = RN_END * (double)cells;
    if (forward) return at[2] >= cells - RN_END_LAYERS * cells / trained;
    for (int i = 0; i < 3; i++)
        squares += (2 * at[i] + 1.0 - cells) * (2 * at[i] + 1.0 - cells);
    return squares > end * end;
}

// That a cell is among those drawn with replacement, `share` times as many draws as cells.
RN_HD double rn_chance_of_draw(double share) {
    return -expm1(-share);
}

// The released rule by which cells are drawn to be measured: of `cells` a quarter with replacement,
// and with them all that are occupied, or as many draws of these where they are more. Each cell is
// measured by a coin of its own with the same chance, of an empty one and of an occupied one.
RN_HD void rn_chances_of_cells(double cells, double occupied, float ret[2]) {
    double draws = cells / 4, empty = rn_chance_of_draw(0.25);
    double own = occupied > draws ? rn_chance_of_draw(draws / occupied) : 1;
    ret[0] = (float)empty;
    ret[1] = (float)(1 - (1 - empty) * (1 - own));
}

// Word and bit of a cell in the bricked bit grid (kernels/kernels.h).
RN_HD size_t rn_brick_word(int x, int y, int z, int cells) {
    size_t bricks = (size_t)cells / 8;
    size_t brick = ((size_t)(x >> 3) * bricks + (size_t)(y >> 3)) * bricks + (size_t)(z >> 3);
    return brick * 16 + (size_t)((z & 7) * 2 + ((y >> 2) & 1));
}
RN_HD uint32_t rn_brick_bit(int x, int y) {
    return (uint32_t)1 << ((y & 3) * 8 + (x & 7));
}

#endif

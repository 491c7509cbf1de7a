// Held-out evaluation under way.
#ifndef RN_ENGINE_TRAIN_VALIDATE_H
#define RN_ENGINE_TRAIN_VALIDATE_H

#include <stdbool.h>
#include <stddef.h>

#include "server/engine/kernels/kernels.h"
#include "server/engine/render/cones.h"

#define RN_VALIDATE_BLOCK 4096 // pixels a block
#define RN_VALIDATE_LEAST 8    // of it, a piece, at least
// Cones of one call of a device, at most: half of a launch, as a picture waits for its end.
#define RN_VALIDATE_CONES (1 << 16)

// Pixels of one of `views` that a round renders, at most: of larger ones every second, third, ...
// along both axes, so that photographs of 12 megapixels take no longer than these. The last figure
// of a schedule is of 2^21 in all, those on the way of 2^18, such as one that ends a training: they
// lay within 0.05 dB of it, and a fog's pixels would take longer than all steps until then.
static inline size_t rn_validate_most(bool last, int views) {
    return ((size_t)1 << (last ? 21 : 18)) / (size_t)views;
}

// Which ones, `most` at most: the middles of squares of `apart` pixels, rows of `width` of them.
struct rn_validate_grid {
    int apart, width, height;
};

static inline struct rn_validate_grid rn_validate_grid(int width, int height, size_t most) {
    struct rn_validate_grid grid = {.apart = 0};
    do {
        grid.apart++;
        grid.width = width / grid.apart;
        grid.height = height / grid.apart;
    } while ((size_t)grid.width * (size_t)grid.height > most);
    return grid;
}

static inline struct rn_spot rn_validate_spot(const struct rn_validate_grid *grid, size_t index) {
    size_t apart = (size_t)grid->apart, width = (size_t)grid->width;
    return (struct rn_spot){(int)(index % width * apart + apart / 2),
                            (int)(index / width * apart + apart / 2)};
}

// Errors of the pixels that count.
struct rn_validated {
    double squares;
    size_t pixels;
};

struct rn_validation {
    bool active;
    int frame;      // of those held out
    size_t pixel;   // where the block under way begins, of those that are rendered
    int next_piece; // of the block
    struct rn_validated pieces[RN_VALIDATE_BLOCK / RN_VALIDATE_LEAST]; // of it
    struct rn_validated sum;                                           // of the frame so far
    double psnr_sum;
};

#endif

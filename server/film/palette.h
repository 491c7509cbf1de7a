// The colours of a film that may have few: a median cut over all its frames, and ordered dither.
#ifndef RN_SERVER_FILM_PALETTE_H
#define RN_SERVER_FILM_PALETTE_H

#include <stdint.h>

struct rn_palette; // Thread-safety: one thread.

// At most `colours` (2 .. 256) of them for frames of width x height; NULL: no memory.
struct rn_palette *rn_palette_create(int width, int height, int colours);
void rn_palette_destroy(struct rn_palette **palette);
// RGBA, rows from the top: the frame's colours are counted.
void rn_palette_count(struct rn_palette *palette, const uint8_t *pixels);
// The colours, after all frames were counted. Median cut by variance: Wan, Wong and Prusinkiewicz,
// "An algorithm for multidimensional data clustering" (1988).
void rn_palette_choose(struct rn_palette *palette);
// Writes the frame's indices, `stride` bytes a row, and the 256 colours as 0xAARRGGBB.
void rn_palette_apply(const struct rn_palette *palette, const uint8_t *pixels, uint8_t *indices,
                      int stride, uint32_t colours[256]);

#endif

#include "server/film/palette.h"

#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

// Colours are counted in cells of 5 bits a channel.
enum { BITS = 5, SIDE = 1 << BITS, CELLS = SIDE * SIDE * SIDE };

struct rn_palette {
    int width, height, most, count;
    uint64_t weight[CELLS], sum[CELLS][3];
    uint8_t nearest[CELLS]; // after rn_palette_choose
    uint8_t colours[256][3];
};

// A box of cells, bounds included.
struct box {
    int low[3], high[3];
    double weight, mean[3], spread[3]; // spread: sum of squared distances from the mean
};

struct rn_palette *rn_palette_create(int width, int height, int colours) {
    struct rn_palette *palette = calloc(1, sizeof *palette);
    if (!palette) return NULL;
    palette->width = width;
    palette->height = height;
    palette->most = colours < 2 ? 2 : colours > 256 ? 256 : colours;
    return palette;
}

void rn_palette_destroy(struct rn_palette **palette) {
    free(*palette);
    *palette = NULL;
}

static int cell_of(const uint8_t *pixel) {
    return pixel[0] >> (8 - BITS) << (2 * BITS) | pixel[1] >> (8 - BITS) << BITS |
           pixel[2] >> (8 - BITS);
}

// The middle of a cell's side, 0 .. 255.
static double value_of(int side) {
    return (side + 0.5) * 255 / SIDE;
}

void rn_palette_count(struct rn_palette *palette, const uint8_t *pixels) {
    size_t count = (size_t)palette->width * (size_t)palette->height;
    for (size_t i = 0; i < count; i++) {
        const uint8_t *pixel = pixels + 4 * i;
        int cell = cell_of(pixel);
        palette->weight[cell]++;
        for (int c = 0; c < 3; c++)
            palette->sum[cell][c] += pixel[c];
    }
}

static void measure(const struct rn_palette *palette, struct box *box) {
    double sum[3] = {0}, squares[3] = {0};
    box->weight = 0;
    for (int r = box->low[0]; r <= box->high[0]; r++)
        for (int g = box->low[1]; g <= box->high[1]; g++)
            for (int b = box->low[2]; b <= box->high[2]; b++) {
                int cell = (r * SIDE + g) * SIDE + b;
                double weight = (double)palette->weight[cell];
                box->weight += weight;
                for (int i = 0; i < 3 && weight > 0; i++) {
                    double total = (double)palette->sum[cell][i];
                    sum[i] += total;
                    squares[i] += total * total / weight;
                }
            }
    for (int i = 0; i < 3; i++) {
        box->mean[i] = box->weight > 0 ? sum[i] / box->weight : 0;
        box->spread[i] = squares[i] - box->weight * box->mean[i] * box->mean[i];
    }
}

static int widest(const struct box *box) {
    int axis = 0;
    for (int i = 1; i < 3; i++)
        if (box->spread[i] > box->spread[axis]) axis = i;
    return axis;
}

// Splits the box of the greatest spread at its mean; false when none can be split.
static bool split(const struct rn_palette *palette, struct box *boxes, int count) {
    struct box *worst = NULL;
    for (int i = 0; i < count; i++) {
        int axis = widest(&boxes[i]);
        if (boxes[i].low[axis] < boxes[i].high[axis] && boxes[i].spread[axis] > 0 &&
            (!worst || boxes[i].spread[axis] > worst->spread[widest(worst)]))
            worst = &boxes[i];
    }
    if (!worst) return false;
    int axis = widest(worst), at = (int)(worst->mean[axis] * SIDE / 255 - 0.5);
    if (at < worst->low[axis]) at = worst->low[axis];
    if (at >= worst->high[axis]) at = worst->high[axis] - 1;
    boxes[count] = *worst;
    worst->high[axis] = at;
    boxes[count].low[axis] = at + 1;
    measure(palette, worst);
    measure(palette, &boxes[count]);
    return true;
}

static uint8_t find_nearest(const struct rn_palette *palette, int r, int g, int b) {
    double best = 1e30;
    int index = 0;
    for (int i = 0; i < palette->count; i++) {
        double dr = value_of(r) - palette->colours[i][0], dg = value_of(g) - palette->colours[i][1],
               db = value_of(b) - palette->colours[i][2];
        double distance = 2 * dr * dr + 4 * dg * dg + 3 * db * db; // as eyes weigh them
        if (distance < best) {
            best = distance;
            index = i;
        }
    }
    return (uint8_t)index;
}

void rn_palette_choose(struct rn_palette *palette) {
    struct box boxes[256] = {{.high = {SIDE - 1, SIDE - 1, SIDE - 1}}};
    int count = 1;
    measure(palette, &boxes[0]);
    while (count < palette->most && split(palette, boxes, count))
        count++;
    for (int i = 0; i < count; i++)
        if (boxes[i].weight > 0) {
            for (int c = 0; c < 3; c++)
                palette->colours[palette->count][c] = (uint8_t)(boxes[i].mean[c] + 0.5);
            palette->count++;
        }
    for (int i = 0; i < CELLS; i++)
        palette->nearest[i] = find_nearest(palette, i / (SIDE * SIDE), i / SIDE % SIDE, i % SIDE);
}

// Bayer's 4 x 4 matrix, -8 .. 7: a step of a cell.
static int dither(int x, int y) {
    static const int8_t matrix[16] = {-8, 0, -6, 2, 4, -4, 6, -2, -5, 3, -7, 1, 7, -1, 5, -3};
    return matrix[4 * (y & 3) + (x & 3)] / 2;
}

static uint8_t shift(uint8_t value, int by) {
    int moved = value + by;
    return (uint8_t)(moved < 0 ? 0 : moved > 255 ? 255 : moved);
}

void rn_palette_apply(const struct rn_palette *palette, const uint8_t *pixels, uint8_t *indices,
                      int stride, uint32_t colours[256]) {
    memset(colours, 0, 256 * sizeof *colours);
    for (int i = 0; i < palette->count; i++)
        colours[i] = 0xff000000u | (uint32_t)palette->colours[i][0] << 16 |
                     (uint32_t)palette->colours[i][1] << 8 | palette->colours[i][2];
    for (int y = 0; y < palette->height; y++)
        for (int x = 0; x < palette->width; x++) {
            const uint8_t *at = pixels + 4 * ((size_t)y * (size_t)palette->width + (size_t)x);
            int by = dither(x, y);
            uint8_t moved[3] = {shift(at[0], by), shift(at[1], by), shift(at[2], by)};
            indices[(size_t)y * (size_t)stride + (size_t)x] = palette->nearest[cell_of(moved)];
        }
}

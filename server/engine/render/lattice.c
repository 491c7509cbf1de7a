#include "server/engine/render/lattice.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

#define LARGEST 0.5f // tolerance

// Of a pass: its first pixel in an even row and in an odd one, how far apart its pixels are, and
// their neighbours, at +-(dx, dy) and +-(-dy, dx). NONE: no such row. What is interpolated first is
// interpolated from later: it is held to a smaller part of the tolerance.
#define NONE 2
static const struct pass {
    int first[2], apart, dx, dy;
    float part;
} all = {{0, 0}, 1, 0, 0, 1},
  passes[] = {{{0, NONE}, 2, 0, 0, 1}, {{NONE, 1}, 2, 1, 1, 0.7f}, {{1, 0}, 2, 1, 0, 1.4f}};

// Colour and opacity of a pixel.
typedef float numbers __attribute__((vector_size(16)));
typedef int32_t masks __attribute__((vector_size(16)));
_Static_assert(offsetof(struct rn_pixel, alpha) == sizeof(float[3]), "numbers of a pixel in turn");

static numbers numbers_of(const struct rn_pixel *p) {
    numbers x;
    memcpy(&x, p, sizeof x);
    return x;
}

static void put_numbers(numbers x, struct rn_pixel *p) {
    memcpy(p, &x, sizeof x);
}

static numbers chosen(masks which, numbers yes, numbers no) {
    return (numbers)((which & (masks)yes) | (~which & (masks)no));
}
static numbers smaller(numbers a, numbers b) {
    return chosen(a < b, a, b);
}
static numbers larger(numbers a, numbers b) {
    return chosen(a > b, a, b);
}

bool rn_lattice_is_dense(const struct rn_field *field, const struct rn_camera *camera) {
    const double pi = 3.14159265358979323846;
    double pixel = rn_cone_at_centre(field, camera) * sqrt(pi); // a disc of equal area
    double cell = 2 * field->bounds.radius / field->config.field.occupancy;
    return cell >= 2 * sqrt(2) * pixel;
}

int rn_lattice_passes(const struct rn_lattice *lattice) {
    return lattice->tolerance > 0 ? (int)(sizeof passes / sizeof *passes) : 1;
}

static numbers mean_numbers(const struct rn_pixel *const n[4]) {
    return 0.25f * ((numbers_of(n[0]) + numbers_of(n[1])) + (numbers_of(n[2]) + numbers_of(n[3])));
}

// Mean square distances of four neighbours from their mean.
static numbers squares_apart(const struct rn_pixel *const n[4]) {
    numbers mean = mean_numbers(n), a = numbers_of(n[0]) - mean, b = numbers_of(n[1]) - mean;
    numbers c = numbers_of(n[2]) - mean, d = numbers_of(n[3]) - mean;
    return 0.25f * ((a * a + b * b) + (c * c + d * d));
}

static float depths_apart(const struct rn_pixel *const n[4]) {
    float mean = 0.25f * ((n[0]->depth + n[1]->depth) + (n[2]->depth + n[3]->depth)), sum = 0;
    for (int i = 0; i < 4; i++)
        sum += (n[i]->depth - mean) * (n[i]->depth - mean);
    return 0.25f * sum;
}

static float colours_of(numbers squares) {
    return squares[0] + squares[1] + squares[2];
}

// The larger; NaN where one is.
static float worse(float a, float b) {
    return a > b || isnan(a) ? a : b;
}

// By how much neighbours disagree, of all that has to agree: a mean square.
static float disagreement(const struct rn_lattice *l, const struct rn_pixel *const n[4],
                          numbers squares) {
    float most = 0;
    if (l->outputs & RN_OUTPUT_RGB) most = colours_of(squares) / 3;
    if (l->outputs & RN_OUTPUT_ALPHA) most = worse(most, squares[3]);
    if (l->outputs & RN_OUTPUT_DEPTH) most = worse(most, depths_apart(n));
    return most;
}

// The neighbours of a point that is not of the first pass; false: one of them lies outside.
static bool find_neighbours(const struct rn_lattice *l, const struct pass *pass, int x, int y,
                            const struct rn_pixel *n[4]) {
    if (x < 1 || y < 1 || x + 1 >= l->width || y + 1 >= l->height) return false;
    const struct rn_pixel *at = l->pixels + (size_t)y * l->width + x;
    ptrdiff_t along = (ptrdiff_t)pass->dy * l->width + pass->dx;
    ptrdiff_t across = (ptrdiff_t)pass->dx * l->width - pass->dy;
    n[0] = at - along, n[1] = at + along, n[2] = at - across, n[3] = at + across;
    return true;
}

static float seen_by(const struct rn_pixel *const n[4]) {
    return n[0]->alpha + n[1]->alpha + n[2]->alpha + n[3]->alpha;
}

static struct rn_pixel mean_of(const struct rn_pixel *const n[4]) {
    struct rn_pixel mean;
    float seen = 0, depth = 0;
    for (int i = 0; i < 4; i++) {
        seen += n[i]->alpha;
        depth += n[i]->depth * n[i]->alpha;
    }
    put_numbers(mean_numbers(n), &mean);
    mean.depth = seen > 0 ? depth / seen : 0;
    return mean;
}

// Between the neighbours on both axes, by cubic splines (Catmull & Rom 1974) through the twelve
// around them too, and not beyond the four. Of the last pass all of these are there before it.
static numbers spline_of(const struct rn_lattice *l, int x, int y,
                         const struct rn_pixel *const n[4]) {
    const struct rn_pixel *at = l->pixels + (size_t)y * l->width + x;
    const ptrdiff_t w = l->width, beside[8] = {2 * w - 1, 2 * w + 1, -2 * w - 1, -2 * w + 1,
                                               w - 2,     w + 2,     -w - 2,     -w + 2};
    numbers side = {0}, mean = mean_numbers(n);
    for (int i = 0; i < 8; i++)
        side += numbers_of(at + beside[i]);
    numbers end = (numbers_of(at - 3) + numbers_of(at + 3)) +
                  (numbers_of(at - 3 * w) + numbers_of(at + 3 * w));
    numbers a = numbers_of(n[0]), b = numbers_of(n[1]), c = numbers_of(n[2]), d = numbers_of(n[3]);
    numbers low = smaller(smaller(a, b), smaller(c, d));
    numbers high = larger(larger(a, b), larger(c, d));
    numbers value = mean * (324.0f / 256) - side * (9.0f / 256) + end * (1.0f / 256);
    return smaller(larger(value, low), high);
}

// What lies between neighbours that agree.
static struct rn_pixel between(const struct rn_lattice *l, const struct pass *pass, int x, int y,
                               const struct rn_pixel *const n[4]) {
    struct rn_pixel pixel = mean_of(n);
    bool inside = x >= 3 && y >= 3 && x + 3 < l->width && y + 3 < l->height;
    if (inside && !pass->dy) put_numbers(spline_of(l, x, y, n), &pixel);
    return pixel;
}

// What a point between four neighbours whose colours lie `square` from their mean, mean square, is
// likely to be away from what would have been traced: fitted to lego, 10 views, tolerances from
// 0.02 to 0.5 and late ones. Of the last pass two neighbours are of the pass before it: where these
// were traced, as they disagreed as much themselves, it is the better for it.
static double likely_loss(const struct rn_lattice *l, const struct pass *pass, float square) {
    float before = passes[1].part * (l->earlier > 0 ? l->earlier : l->tolerance);
    bool beside_traced = 2 * square > before * before;
    double share = pass->dy ? 0.275 : beside_traced ? 0.15 : 0.33;
    return share * (double)sqrtf(square * sqrtf(square));
}

static bool interpolate(const struct rn_lattice *l, const struct pass *pass, int x, int y,
                        double *loss) {
    struct rn_pixel *at = l->pixels + (size_t)y * l->width + x;
    const struct rn_pixel *n[4];
    if (!pass->dx || !find_neighbours(l, pass, x, y, n)) return false;
    float seen = seen_by(n), limit = l->tolerance * pass->part;
    if (seen == 0) {
        if (l->dense) *at = *n[0];
        return l->dense;
    }
    numbers squares = squares_apart(n);
    if (!(seen > 0 && disagreement(l, n, squares) <= limit * limit)) return false;
    *at = between(l, pass, x, y, n);
    *loss += likely_loss(l, pass, colours_of(squares) / 3);
    return true;
}

// What no time is left for: the neighbours' mean; at the border a point of the first pass.
static bool fill_in(const struct rn_lattice *l, const struct pass *pass, int x, int y,
                    double *loss) {
    struct rn_pixel *at = l->pixels + (size_t)y * l->width + x;
    const struct rn_pixel *n[4];
    if (!l->late || !pass->dx) return false;
    bool inside = find_neighbours(l, pass, x, y, n);
    *at = inside ? mean_of(n) : l->pixels[(size_t)(y & ~1) * l->width + (x & ~1)];
    if (inside) *loss += likely_loss(l, pass, colours_of(squares_apart(n)) / 3);
    return true;
}

int rn_lattice_choose(const struct rn_lattice *lattice, int pass, struct rn_tile tile,
                      struct rn_spot *ret_spots, double *interpolation) {
    const struct pass *p = lattice->tolerance > 0 ? &passes[pass] : &all;
    int count = 0;
    double loss = 0;
    for (int y = tile.y0; y < tile.y1; y++) {
        if (p->first[y & 1] == NONE) continue;
        for (int x = tile.x0 + p->first[y & 1]; x < tile.x1; x += p->apart)
            if (!fill_in(lattice, p, x, y, &loss) && !interpolate(lattice, p, x, y, &loss))
                ret_spots[count++] = (struct rn_spot){x, y};
    }
    *interpolation += loss;
    return count;
}

// ---- what a tolerance costs -----------------------------------------------------------------

#define SMALLEST 1e-9f

// The bin of a squared distance; NaN and what is above the largest tolerance: RN_LATTICE_BINS.
static int bin_of(float square) {
    if (!(square <= LARGEST * LARGEST)) return RN_LATTICE_BINS;
    float octaves = square > 0 ? 4 * log2f(square / (LARGEST * LARGEST)) : -INFINITY;
    return octaves <= -RN_LATTICE_BINS ? 0 : RN_LATTICE_BINS - 1 + (int)octaves;
}

static void count_point(const struct rn_lattice *l, const struct pass *p, int x, int y,
                        struct rn_lattice_census *census) {
    const struct rn_pixel *n[4];
    census->points++;
    if (!find_neighbours(l, p, x, y, n)) {
        census->always++;
        return;
    }
    float seen = seen_by(n);
    if (seen == 0) {
        census->unseen++;
        census->empty += !l->dense;
        return;
    }
    float square = disagreement(l, n, squares_apart(n)) / (p->part * p->part);
    int bin = seen > 0 ? bin_of(square) : RN_LATTICE_BINS;
    if (bin < RN_LATTICE_BINS)
        census->above[bin]++;
    else
        census->always++;
}

void rn_lattice_count(const struct rn_lattice *lattice, int pass, struct rn_tile tile,
                      struct rn_lattice_census *census) {
    const struct pass *p = &passes[pass];
    for (int y = tile.y0; y < tile.y1; y++)
        for (int x = tile.x0 + p->first[y & 1]; p->first[y & 1] != NONE && x < tile.x1;
             x += p->apart)
            count_point(lattice, p, x, y, census);
}

float rn_lattice_tolerance_for(const struct rn_lattice_census *census, double rays) {
    double traced = census->always + RN_LATTICE_MISS * census->empty;
    int bin = RN_LATTICE_BINS - 1;
    while (bin >= 0 && traced + census->above[bin] <= rays)
        traced += census->above[bin--];
    // Bin b ends where the square is 2^((b + 1 - RN_LATTICE_BINS) / 4) of the largest.
    return bin < 0 ? SMALLEST : LARGEST * exp2f((float)(bin + 1 - RN_LATTICE_BINS) / 8);
}

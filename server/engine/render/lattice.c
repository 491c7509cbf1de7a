#include "server/engine/render/lattice.h"

#include <math.h>

#define LARGEST 0.5f // tolerance

// Of a pass: its first pixel in an even row and in an odd one, how far apart its pixels are, and
// their neighbours, at +-(dx, dy) and +-(-dy, dx). NONE: no such row.
#define NONE 2
static const struct pass {
    int first[2], apart, dx, dy;
} all = {{0, 0}, 1, 0, 0},
  passes[] = {{{0, NONE}, 2, 0, 0}, {{NONE, 1}, 2, 1, 1}, {{1, 0}, 2, 1, 0}};

bool rn_lattice_is_dense(const struct rn_field *field, const struct rn_camera *camera) {
    const double pi = 3.14159265358979323846;
    double pixel = rn_cone_at_centre(field, camera) * sqrt(pi); // a disc of equal area
    double cell = 2 * field->bounds.radius / field->config.field.occupancy;
    return cell >= 2 * sqrt(2) * pixel;
}

int rn_lattice_passes(const struct rn_lattice *lattice) {
    return lattice->tolerance > 0 ? (int)(sizeof passes / sizeof *passes) : 1;
}

static float squares_from_mean(float a, float b, float c, float d) {
    float mean = 0.25f * ((a + b) + (c + d));
    a -= mean, b -= mean, c -= mean, d -= mean;
    return 0.25f * ((a * a + b * b) + (c * c + d * d));
}
#define SQUARES(n, m) squares_from_mean((n)[0]->m, (n)[1]->m, (n)[2]->m, (n)[3]->m)

static float colours_apart(const struct rn_pixel *const n[4]) {
    return SQUARES(n, rgb[0]) + SQUARES(n, rgb[1]) + SQUARES(n, rgb[2]);
}

// Not true of anything with a NaN.
static bool agree(const struct rn_lattice *l, const struct rn_pixel *const n[4]) {
    float limit = l->tolerance * l->tolerance;
    if (l->outputs & RN_OUTPUT_RGB && !(colours_apart(n) <= 3 * limit)) return false;
    if (l->outputs & RN_OUTPUT_ALPHA && !(SQUARES(n, alpha) <= limit)) return false;
    return !(l->outputs & RN_OUTPUT_DEPTH) || SQUARES(n, depth) <= limit;
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
    return rn_cones_mean((const struct rn_pixel[]){*n[0], *n[1], *n[2], *n[3]}, 2, NULL);
}

static bool interpolate(const struct rn_lattice *l, const struct pass *pass, int x, int y,
                        double *apart) {
    struct rn_pixel *at = l->pixels + (size_t)y * l->width + x;
    const struct rn_pixel *n[4];
    if (!pass->dx || !find_neighbours(l, pass, x, y, n)) return false;
    float seen = seen_by(n);
    bool empty = seen == 0;
    if (empty ? !l->dense : !(seen > 0 && agree(l, n))) return false;
    *at = empty ? *n[0] : mean_of(n);
    *apart += (double)colours_apart(n);
    return true;
}

// What no time is left for: the neighbours' mean; at the border a point of the first pass.
static bool fill_in(const struct rn_lattice *l, const struct pass *pass, int x, int y,
                    double *apart) {
    struct rn_pixel *at = l->pixels + (size_t)y * l->width + x;
    const struct rn_pixel *n[4];
    if (!l->late || !pass->dx) return false;
    bool inside = find_neighbours(l, pass, x, y, n);
    *at = inside ? mean_of(n) : l->pixels[(size_t)(y & ~1) * l->width + (x & ~1)];
    if (inside) *apart += (double)colours_apart(n);
    return true;
}

// Of the mean square distance of four neighbours from their mean, how much the mean is likely to be
// away from what would have been traced: fitted to photographs of lego at tolerances from 0.05 to
// 0.5 of either pass, within 0.6 dB. What is interpolated as it is late is so whatever its
// neighbours are; from neighbours that were traced the last pass is the better.
static double likely_share(const struct rn_lattice *l, int pass) {
    double t = l->late ? (double)LARGEST : (double)l->tolerance;
    if (pass == 1) return 0.48 * pow(t, -0.36);
    double before = l->earlier > 0 ? fmin((double)l->earlier, t) : t;
    return 0.85 * pow(t, -0.18) * pow(before / t, 0.42);
}

int rn_lattice_choose(const struct rn_lattice *lattice, int pass, struct rn_tile tile,
                      struct rn_spot *ret_spots, double *interpolation) {
    const struct pass *p = lattice->tolerance > 0 ? &passes[pass] : &all;
    int count = 0;
    double apart = 0; // of the three channels
    for (int y = tile.y0; y < tile.y1; y++) {
        if (p->first[y & 1] == NONE) continue;
        for (int x = tile.x0 + p->first[y & 1]; x < tile.x1; x += p->apart)
            if (!fill_in(lattice, p, x, y, &apart) && !interpolate(lattice, p, x, y, &apart))
                ret_spots[count++] = (struct rn_spot){x, y};
    }
    if (apart > 0) *interpolation += likely_share(lattice, pass) * apart / 3;
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

// Of agree: the largest of what it compares.
static float disagreement(const struct rn_lattice *l, const struct rn_pixel *const n[4]) {
    float most = 0;
    if (l->outputs & RN_OUTPUT_RGB) most = colours_apart(n) / 3;
    if (l->outputs & RN_OUTPUT_ALPHA) most = fmaxf(most, SQUARES(n, alpha));
    if (l->outputs & RN_OUTPUT_DEPTH) most = fmaxf(most, SQUARES(n, depth));
    return most;
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
        census->always += !l->dense;
        return;
    }
    int bin = seen > 0 ? bin_of(disagreement(l, n)) : RN_LATTICE_BINS;
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
    double traced = census->always;
    int bin = RN_LATTICE_BINS - 1;
    while (bin >= 0 && traced + census->above[bin] <= rays)
        traced += census->above[bin--];
    // Bin b ends where the square is 2^((b + 1 - RN_LATTICE_BINS) / 4) of the largest.
    return bin < 0 ? SMALLEST : LARGEST * exp2f((float)(bin + 1 - RN_LATTICE_BINS) / 8);
}

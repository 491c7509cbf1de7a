#include "server/engine/render/lattice.h"

#include <math.h>

// Of a pass: its first pixel in an even row and in an odd one, how far apart its pixels are, and
// their neighbours, at +-(dx, dy) and +-(-dy, dx). NONE: no such row.
#define NONE 2
static const struct pass {
    int first[2], apart, dx, dy;
} all = {{0, 0}, 1, 0, 0},
  passes[] = {{{0, NONE}, 2, 0, 0}, {{NONE, 1}, 2, 1, 1}, {{1, 0}, 2, 1, 0}};

bool rn_lattice_is_dense(const struct rn_field *field, const struct rn_camera *camera) {
    const double pi = 3.14159265358979323846;
    double pixel = rn_cone_at_centre(&field->bounds, camera) * sqrt(pi); // a disc of equal area
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

// Not true of anything with a NaN.
static bool agree(const struct rn_lattice *l, const struct rn_pixel *const n[4]) {
    float limit = l->tolerance * l->tolerance;
    if (l->outputs & RN_OUTPUT_RGB &&
        !(SQUARES(n, rgb[0]) + SQUARES(n, rgb[1]) + SQUARES(n, rgb[2]) <= 3 * limit))
        return false;
    if (l->outputs & RN_OUTPUT_ALPHA && !(SQUARES(n, alpha) <= limit)) return false;
    return !(l->outputs & RN_OUTPUT_DEPTH) || SQUARES(n, depth) <= limit;
}

static bool interpolate(const struct rn_lattice *l, const struct pass *pass, int x, int y) {
    if (!pass->dx || x < 1 || y < 1 || x + 1 >= l->width || y + 1 >= l->height) return false;
    struct rn_pixel *at = l->pixels + (size_t)y * l->width + x;
    ptrdiff_t along = (ptrdiff_t)pass->dy * l->width + pass->dx;
    ptrdiff_t across = (ptrdiff_t)pass->dx * l->width - pass->dy;
    const struct rn_pixel *const n[4] = {at - along, at + along, at - across, at + across};
    float seen = n[0]->alpha + n[1]->alpha + n[2]->alpha + n[3]->alpha;
    bool empty = seen == 0;
    if (empty ? !l->dense : !(seen > 0 && agree(l, n))) return false;
    *at = empty ? *n[0]
                : rn_cones_mean((const struct rn_pixel[]){*n[0], *n[1], *n[2], *n[3]}, 2, NULL);
    return true;
}

int rn_lattice_choose(const struct rn_lattice *lattice, int pass, struct rn_tile tile,
                      struct rn_spot *ret_spots) {
    const struct pass *p = lattice->tolerance > 0 ? &passes[pass] : &all;
    int count = 0;
    for (int y = tile.y0; y < tile.y1; y++) {
        if (p->first[y & 1] == NONE) continue;
        for (int x = tile.x0 + p->first[y & 1]; x < tile.x1; x += p->apart)
            if (!interpolate(lattice, p, x, y)) ret_spots[count++] = (struct rn_spot){x, y};
    }
    return count;
}

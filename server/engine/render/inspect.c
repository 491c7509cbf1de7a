#include "server/engine/render/inspect.h"

#include <math.h>

#include "server/engine/field/footprint.h"
#include "server/engine/field/occupancy.h"
#include "server/engine/field/volume.h"
#include "server/engine/kernels/ray.h"
#include "server/engine/scene/scene.h"

#define COVERED 0.5f       // opacity from which on a pixel shows a surface
#define PROBES 6           // points around one, on three axes
#define BATCH 64           // pixels whose densities are asked for together
#define LEAST_LENGTH 1e-12 // square

// One pixel's surface.
struct surface {
    double point[3], direction[3]; // dataset coordinates
    double radius;                 // of one cone there: the cross-section's disc
};

struct work {
    const struct rn_inspection *in;
    struct rn_render_result *result;
    struct rn_camera cones; // a pixel a cone
};

unsigned rn_inspect_needs(unsigned outputs) {
    return outputs & RN_OUTPUTS_OF_SURFACES ? RN_OUTPUT_DEPTH | RN_OUTPUT_ALPHA
           : outputs & RN_OUTPUT_COST       ? RN_OUTPUT_RGB
                                            : 0;
}

// Density counts where the march looks for it: outside of occupied cells the field was not trained.
static bool is_occupied(const struct rn_field *field, const float cube[3]) {
    const struct rn_occupancy_bits *o = &field->cpu.occupancy;
    int cell[3];
    for (int i = 0; i < 3; i++)
        cell[i] = rn_cell_of((double)cube[i], o->cells);
    return (o->words[rn_brick_word(cell[0], cell[1], cell[2], o->cells)] &
            rn_brick_bit(cell[0], cell[1])) != 0;
}

static bool find_surface(const struct work *w, int x, int y, struct surface *ret) {
    const struct rn_camera *camera = &w->in->options->camera;
    size_t at = (size_t)y * camera->width + x;
    double distance = (double)w->result->depth.values[at];
    if (!(w->result->alpha.values[at] >= COVERED) || !(distance > 0)) return false;
    struct rn_ray ray = rn_camera_ray(camera, x + 0.5, y + 0.5);
    ret->radius = ray.radius / w->in->cones * distance;
    for (int i = 0; i < 3; i++) {
        ret->direction[i] = ray.direction[i];
        ret->point[i] = ray.origin[i] + ray.direction[i] * distance;
    }
    return true;
}

// ---- levels -----------------------------------------------------------------------------------

// How far a way from a point along `offset` (dataset coordinates) leads in the cube.
static void drawn(const struct rn_field *field, const double point[3], const double axis[3],
                  double length, double ret[3]) {
    double ends[2][3], from[3];
    for (int k = 0; k < 2; k++) {
        for (int i = 0; i < 3; i++)
            from[i] = point[i] + (k ? 0.5 : -0.5) * length * axis[i];
        rn_field_cube_of(field, from, ends[k]);
    }
    for (int i = 0; i < 3; i++)
        ret[i] = ends[1][i] - ends[0][i];
}

// Two axes across a direction.
static void across(const double d[3], double ret[2][3]) {
    int least = fabs(d[0]) < fabs(d[1]) ? 0 : 1;
    if (fabs(d[2]) < fabs(d[least])) least = 2;
    double size = sqrt(fmax(1 - d[least] * d[least], LEAST_LENGTH));
    for (int i = 0; i < 3; i++)
        ret[0][i] = ((i == least) - d[least] * d[i]) / size;
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        ret[1][i] = d[j] * ret[0][k] - d[k] * ret[0][j];
    }
}

// Standard deviation along a ray of what one sample spans.
static double sample_spread(const struct work *w, const struct surface *s) {
    const struct rn_field *field = w->in->field;
    double step = w->in->step, radius = field->bounds.radius, r = 0;
    if (field->config.cone_step)
        step *= rn_sample_stride(rn_cone_at_centre(field, &w->cones) / radius, step);
    if (field->config.field.space == RN_SPACE_UNBOUNDED) {
        for (int i = 0; i < 3; i++)
            r += pow((s->point[i] - field->bounds.centre[i]) / radius, 2);
        step *= rn_stretch_at(sqrt(r));
    }
    return step * radius / sqrt(12);
}

static double level_of(const struct work *w, const struct surface *s) {
    const struct rn_field *field = w->in->field;
    const struct rn_field_config *config = &field->config.field;
    double spread[3][3], axes[2][3], sum = 0;
    if (config->footprint == RN_FOOTPRINT_POINT || config->levels < 2) return 0;
    across(s->direction, axes);
    for (int k = 0; k < 2; k++) // of a uniform disc: half its radius
        drawn(field, s->point, axes[k], 0.5 * s->radius, spread[k]);
    drawn(field, s->point, s->direction, sample_spread(w, s), spread[2]);
    int base = rn_footprint_base(config);
    if (!rn_levels_by_axis(config))
        return rn_level_from_ball(2 * sqrt(rn_dot3(spread[0], spread[0])) * base, config->levels);
    for (int p = 0; p < 2 * config->planes; p++) {
        const double *axis =
            p % 2 ? field->cpu.solid.axis_v[p / 2] : field->cpu.solid.axis_u[p / 2];
        double variance = 0;
        for (int k = 0; k < 3; k++)
            variance += pow(rn_dot3(axis, spread[k]), 2);
        sum += rn_level_from_variance(variance, base, config->levels);
    }
    return sum / (2 * config->planes);
}

// ---- normals ----------------------------------------------------------------------------------

struct batch {
    int count, at[BATCH]; // columns
    float points[BATCH * PROBES][3], density[BATCH * PROBES];
    double jacobian[BATCH][3][3]; // [j]: where in the cube a unit of dataset axis j leads
    double reach[BATCH], level;   // in the cube; sum
};

static void add_probes(const struct work *w, const struct surface *s, int x, struct batch *b) {
    const struct rn_field *field = w->in->field;
    double cube[3], axes[2][3], cone[3], length = s->radius;
    double texel = 2.0 / rn_footprint_base(&field->config.field);
    rn_field_cube_of(field, s->point, cube);
    across(s->direction, axes);
    drawn(field, s->point, axes[0], length, cone);
    double reach = fmax(sqrt(rn_dot3(cone, cone)), texel);
    for (int k = 0; k < PROBES; k++)
        for (int i = 0; i < 3; i++)
            b->points[b->count * PROBES + k][i] =
                (float)(cube[i] + (i == k / 2 ? (k % 2 ? reach : -reach) : 0));
    for (int j = 0; j < 3; j++) {
        const double axis[3] = {j == 0, j == 1, j == 2};
        drawn(field, s->point, axis, length, b->jacobian[b->count][j]);
    }
    b->at[b->count] = x;
    b->reach[b->count++] = reach;
    b->level += level_of(w, s);
}

// The opacity of a way as long as the probes are apart: where the density rises steeply, it does
// not drown what is around.
static double opacity(const struct work *w, const struct batch *b, int probe) {
    double density = is_occupied(w->in->field, b->points[probe]) ? (double)b->density[probe] : 0;
    return -expm1(-fmax(density, 0) * RN_DENSITY_UNIT * 2 * b->reach[probe / PROBES]);
}

static void put_normals(const struct work *w, struct batch *b, int y, int thread) {
    float *row = w->result->normal.values + 3 * (size_t)y * w->result->normal.width;
    if (b->count == 0) return;
    w->in->engine->kernels->density(&w->in->field->cpu, b->points, b->count * PROBES,
                                    (float)(b->level / b->count),
                                    rn_engine_workspace(w->in->engine, thread), b->density);
    for (int j = 0; j < b->count; j++) {
        double slope[3], normal[3];
        for (int i = 0; i < 3; i++)
            slope[i] = opacity(w, b, j * PROBES + 2 * i) - opacity(w, b, j * PROBES + 2 * i + 1);
        for (int i = 0; i < 3; i++)
            normal[i] = rn_dot3(slope, b->jacobian[j][i]);
        double size = sqrt(rn_dot3(normal, normal));
        for (int i = 0; i < 3; i++)
            row[3 * b->at[j] + i] = size > 0 ? (float)(normal[i] / size) : 0;
    }
    b->count = 0;
    b->level = 0;
}

// ---- all of it --------------------------------------------------------------------------------

// Samples of a pixel: of the points that were traced in its place.
static float cost_of(const struct work *w, int x, int y) {
    const struct rn_inspection *in = w->in;
    const struct rn_camera *camera = &in->options->camera;
    int n = in->points, columns = in->lattice->width / n, rows = in->lattice->height / n;
    const uint16_t *from = in->costs +
                           (size_t)(y * rows / camera->height) * n * in->lattice->width +
                           (size_t)(x * columns / camera->width) * n;
    int cost = 0;
    for (int i = 0; i < n * n; i++)
        cost += from[(size_t)(i / n) * in->lattice->width + i % n];
    return (float)cost;
}

static void inspect_row(void *context, int y, int thread) {
    const struct work *w = context;
    struct rn_render_result *result = w->result;
    int width = w->in->options->camera.width;
    struct batch batch = {.count = 0};
    for (int x = 0; x < width; x++) {
        struct surface surface;
        size_t at = (size_t)y * width + x;
        if (result->cost.values) result->cost.values[at] = cost_of(w, x, y);
        if (!(w->in->options->outputs & RN_OUTPUTS_OF_SURFACES) || !find_surface(w, x, y, &surface))
            continue;
        if (result->footprint.values) result->footprint.values[at] = (float)(2 * surface.radius);
        if (result->level.values) result->level.values[at] = (float)level_of(w, &surface);
        if (!result->normal.values) continue;
        add_probes(w, &surface, x, &batch);
        if (batch.count == BATCH) put_normals(w, &batch, y, thread);
    }
    if (result->normal.values) put_normals(w, &batch, y, thread);
}

enum rn_status rn_inspect(const struct rn_inspection *inspection, struct rn_render_result *result,
                          struct rn_error *err) {
    const struct rn_render_options *o = inspection->options;
    struct rn_picture *pictures[4] = {&result->normal, &result->cost, &result->level,
                                      &result->footprint};
    const unsigned outputs[4] = {RN_OUTPUT_NORMAL, RN_OUTPUT_COST, RN_OUTPUT_LEVEL,
                                 RN_OUTPUT_FOOTPRINT};
    for (int i = 0; i < 4; i++) {
        if (!(o->outputs & outputs[i])) continue;
        enum rn_status status =
            rn_picture_init(o->camera.width, o->camera.height, i == 0 ? 3 : 1, pictures[i], err);
        if (status != RN_OK) return status;
    }
    struct work w = {inspection, result,
                     rn_camera_resized(&o->camera, o->camera.width * inspection->cones,
                                       o->camera.height * inspection->cones)};
    rn_pool_run(inspection->engine->pool, o->camera.height, inspect_row, &w);
    return RN_OK;
}

#include "server/engine/render/mesh.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/effects/effects.h"
#include "server/engine/field/occupancy.h"
#include "server/engine/field/volume.h"
#include "server/engine/scene/device.h"
#include "server/engine/scene/occupancy.h"
#include "server/engine/scene/scene.h"

#define BEFORE 2.0   // cells of the mesh from a vertex to the camera that looks at it
#define FARTHEST 4.0 // a disparity box ends at so many times the farthest depth given
#define MOST_CELLS 1024
#define PACKETS 1024 // of vertices, coloured between two looks at keep_going

struct meshing {
    struct rn_engine *engine;
    struct rn_field *field;
    struct rn_mesh_grid grid;
    double cell;      // its longest side, dataset units
    double thickness; // in the field's units of density
    int z;            // the slice under way
    float *values;
    bool (*keep_going)(void *context);
    void *context;
};

// ---- densities ------------------------------------------------------------------------------

static bool is_occupied(const struct rn_occupancy_bits *bits, const double at[3]) {
    int x = rn_cell_of(at[0], bits->cells), y = rn_cell_of(at[1], bits->cells),
        z = rn_cell_of(at[2], bits->cells);
    return bits->words[rn_brick_word(x, y, z, bits->cells)] & rn_brick_bit(x, y);
}

// Row y of a slice: opacities of RN_MESH_THICKNESS of what is there.
static void measure_row(void *context, int y, int thread) {
    const struct meshing *m = context;
    const struct rn_mesh_grid *g = &m->grid;
    int count = 0, which[MOST_CELLS + 1], place[3] = {0, y, m->z};
    float points[MOST_CELLS + 1][3], density[MOST_CELLS + 1];
    float *row = m->values + (size_t)y * (size_t)(g->cells[0] + 1);
    memset(row, 0, (size_t)(g->cells[0] + 1) * sizeof *row);
    for (place[0] = 0; place[0] <= g->cells[0]; place[0]++) {
        double p[3], at[3];
        for (int i = 0; i < 3; i++)
            p[i] = g->low[i] + (g->high[i] - g->low[i]) * place[i] / g->cells[i];
        if (!rn_field_cube_of(m->field, p, at) || !is_occupied(&m->field->cpu.occupancy, at))
            continue;
        for (int i = 0; i < 3; i++)
            points[count][i] = (float)at[i];
        which[count++] = place[0];
    }
    if (count == 0) return;
    m->engine->kernels->density(&m->field->cpu, points, count, 0,
                                rn_engine_workspace(m->engine, thread), density);
    for (int i = 0; i < count; i++)
        row[which[i]] = (float)-expm1(-(double)density[i] * m->thickness);
}

// Whoever is asked to keep going may render the field meanwhile, as it likes.
static enum rn_status make_ready(struct meshing *m, struct rn_error *err) {
    if (m->keep_going && !m->keep_going(m->context))
        return rn_error_set(err, RN_ERROR_CANCELLED, "mesh", "stopped on request");
    enum rn_status status = rn_field_make_ready(m->field, m->engine, 1, err);
    if (!status) rn_field_choose_cells(m->field, 1, 0);
    return status;
}

static enum rn_status take_slice(void *context, int z, float *ret_values, struct rn_error *err) {
    struct meshing *m = context;
    m->z = z;
    m->values = ret_values;
    enum rn_status status = make_ready(m, err);
    if (!status) rn_pool_run(m->engine->pool, m->grid.cells[1] + 1, measure_row, m);
    return status;
}

// ---- colours --------------------------------------------------------------------------------

struct colouring {
    const struct meshing *meshing;
    struct rn_mesh *mesh;
    float (*normals)[3];
    size_t first; // vertex of the packets under way
    struct rn_march_options march;
};

static struct rn_march_ray look_at(const struct colouring *c, size_t vertex) {
    const struct rn_field *field = c->meshing->field;
    const struct rn_disparity *space = &field->cpu.disparity;
    bool unbounded = field->config.field.space == RN_SPACE_UNBOUNDED;
    double away =
        BEFORE * c->meshing->cell + (unbounded ? RN_SPACE_NEAR * field->bounds.radius : 0);
    struct rn_ray ray = {.radius = fmax(field->finest_cone, 0) / field->bounds.radius};
    double size = 0;
    for (int i = 0; i < 3; i++) {
        double p = (double)c->mesh->vertices[vertex].position[i];
        double normal = (double)c->normals[vertex][i];
        ray.origin[i] = space->on ? space->origin[i] : p + away * normal;
        ray.direction[i] = space->on ? p - space->origin[i] : -normal;
        size += ray.direction[i] * ray.direction[i];
    }
    for (int i = 0; i < 3; i++)
        ray.direction[i] = size > 0 ? ray.direction[i] / sqrt(size) : i == 2;
    return rn_march_ray_from(field, &ray, (double)c->march.step, 0.5);
}

static void colour_packet(void *context, int index, int thread) {
    const struct colouring *c = context;
    struct rn_march_ray rays[RN_PACKET_RAYS];
    struct rn_pixel pixels[RN_PACKET_RAYS];
    size_t first = c->first + (size_t)index * RN_PACKET_RAYS, left = c->mesh->vertex_count - first;
    int n = left < RN_PACKET_RAYS ? (int)left : RN_PACKET_RAYS;
    for (int i = 0; i < n; i++)
        rays[i] = look_at(c, first + (size_t)i);
    c->meshing->engine->kernels->render(&c->meshing->field->cpu, &c->march, rays, n,
                                        rn_engine_workspace(c->meshing->engine, thread), pixels);
    for (int i = 0; i < n; i++)
        for (int k = 0; k < 3; k++) {
            float colour = pixels[i].rgb[k] / fmaxf(pixels[i].alpha, 1e-6f);
            c->mesh->vertices[first + (size_t)i].colour[k] =
                (uint8_t)(255 * fminf(fmaxf(colour, 0), 1) + 0.5f);
        }
}

static enum rn_status colour(struct meshing *m, struct rn_mesh *mesh, struct rn_error *err) {
    struct colouring c = {.meshing = m, .mesh = mesh, .march = rn_effects_march_trained(m->field)};
    memset(c.march.colour.background, 0, sizeof c.march.colour.background);
    c.normals = malloc((mesh->vertex_count + 1) * sizeof *c.normals);
    if (!c.normals) return rn_error_set(err, RN_ERROR_NO_MEMORY, "mesh", "out of memory");
    rn_mesh_normals(mesh, c.normals);
    enum rn_status status = RN_OK;
    for (; c.first < mesh->vertex_count && !status; c.first += PACKETS * RN_PACKET_RAYS) {
        size_t packets = (mesh->vertex_count - c.first + RN_PACKET_RAYS - 1) / RN_PACKET_RAYS;
        status = make_ready(m, err);
        if (!status)
            rn_pool_run(m->engine->pool, packets < PACKETS ? (int)packets : PACKETS, colour_packet,
                        &c);
    }
    free(c.normals);
    return status;
}

// ---- the box --------------------------------------------------------------------------------

// The box around what a forward-facing capture's cameras see as far as depths were given.
static void box_of_disparity(const struct rn_disparity *s, double box[2][3]) {
    for (int i = 0; i < 3; i++)
        box[0][i] = INFINITY, box[1][i] = -INFINITY;
    for (int corner = 0; corner < 8; corner++) {
        double z = corner & 4 ? fmax(s->far / FARTHEST, s->near) : s->near;
        double q[3] = {corner & 1 ? s->half[0] : -s->half[0], corner & 2 ? s->half[1] : -s->half[1],
                       s->scale[2] / z + s->shift[2]},
               seen[3];
        rn_disparity_unmap(s, q, seen);
        for (int i = 0; i < 3; i++) {
            double p = s->origin[i];
            for (int j = 0; j < 3; j++)
                p += s->axes[i][j] * seen[j] * s->unit;
            box[0][i] = fmin(box[0][i], p);
            box[1][i] = fmax(box[1][i], p);
        }
    }
}

static enum rn_status choose_grid(struct meshing *m, const struct rn_mesh_options *options,
                                  struct rn_error *err) {
    double box[2][3], longest = 0;
    const struct rn_bounds *bounds = &m->field->bounds;
    memcpy(box, options->box, sizeof box);
    if (isnan(box[0][0]) && m->field->cpu.disparity.on)
        box_of_disparity(&m->field->cpu.disparity, box);
    else if (isnan(box[0][0]))
        for (int i = 0; i < 3; i++) {
            box[0][i] = bounds->centre[i] - bounds->radius;
            box[1][i] = bounds->centre[i] + bounds->radius;
        }
    for (int i = 0; i < 3; i++) {
        if (!(box[1][i] > box[0][i]) || !isfinite(box[1][i] - box[0][i]))
            return rn_error_set(err, RN_ERROR_INVALID, "#/options/crop",
                                "its second corner must lie beyond its first along every axis");
        longest = fmax(longest, box[1][i] - box[0][i]);
    }
    m->cell = longest / options->cells;
    for (int i = 0; i < 3; i++) {
        m->grid.low[i] = box[0][i];
        m->grid.high[i] = box[1][i];
        m->grid.cells[i] = (int)fmax(1, ceil((box[1][i] - box[0][i]) / m->cell - 1e-6));
    }
    return RN_OK;
}

enum rn_status rn_field_mesh(struct rn_engine *engine, struct rn_field *field,
                             const struct rn_mesh_options *options,
                             bool (*keep_going)(void *context), void *context,
                             struct rn_mesh *ret_mesh, struct rn_error *err) {
    struct meshing m = {.engine = engine,
                        .field = field,
                        .thickness = RN_MESH_THICKNESS * RN_DENSITY_UNIT,
                        .keep_going = keep_going,
                        .context = context};
    struct rn_mesh mesh = {0};
    enum rn_status status = choose_grid(&m, options, err);
    if (!status) status = rn_field_fetch(field, NULL, err);
    if (status) return status;
    m.grid.slice = take_slice;
    m.grid.context = &m;
    status = rn_mesh_march(&m.grid, options->level, &mesh, err);
    if (!status) status = colour(&m, &mesh, err);
    if (status)
        rn_mesh_finish(&mesh);
    else
        *ret_mesh = mesh;
    return status;
}

#include "common/image/mesh.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/buf.h"

#define EDGES 7 // of a grid point, towards larger coordinates: bits of x, y, z, less 1
#define NONE UINT32_MAX

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "numbers are written as they lie");

// The six tetrahedra of a cell: corner 0, two more on the way, corner 7; bits of a corner are its
// x, y, z. Every edge leads from a corner to one that has all its bits.
static const struct {
    uint8_t corner[4];
    bool even; // corners 1, 2, 3 around 0 counterclockwise, seen from outside
} TETRAHEDRA[6] = {{{0, 1, 3, 7}, true},  {{0, 2, 3, 7}, false}, {{0, 2, 6, 7}, true},
                   {{0, 4, 6, 7}, false}, {{0, 4, 5, 7}, true},  {{0, 1, 5, 7}, false}};

// Two slices of the grid, and the vertices on the edges that begin in them.
struct front {
    const struct rn_mesh_grid *grid;
    double level;
    struct rn_mesh *mesh;
    size_t points;       // of a slice
    float *values[2];    // of the lower and the upper slice
    uint32_t *vertex[2]; // [points][EDGES]
};

// ---- growing --------------------------------------------------------------------------------

static bool make_room(void **items, size_t count, size_t *room, size_t item) {
    if (count < *room) return true;
    size_t more = *room ? 2 * *room : 4096;
    void *grown = realloc(*items, more * item);
    if (!grown) return false;
    *items = grown;
    *room = more;
    return true;
}

static enum rn_status full(size_t count, struct rn_error *err) {
    if (count >= RN_MESH_MOST)
        return rn_error_set(err, RN_ERROR_LIMIT, "mesh",
                            "has more than %d vertices or triangles; use fewer cells or a crop",
                            RN_MESH_MOST);
    return rn_error_set(err, RN_ERROR_NO_MEMORY, "mesh", "out of memory");
}

static enum rn_status add_vertex(struct rn_mesh *mesh, const double position[3],
                                 struct rn_error *err) {
    if (mesh->vertex_count >= RN_MESH_MOST ||
        !make_room((void **)&mesh->vertices, mesh->vertex_count, &mesh->vertex_room,
                   sizeof *mesh->vertices))
        return full(mesh->vertex_count, err);
    struct rn_mesh_vertex *v = &mesh->vertices[mesh->vertex_count++];
    *v = (struct rn_mesh_vertex){.colour = {128, 128, 128}};
    for (int i = 0; i < 3; i++)
        v->position[i] = (float)position[i];
    return RN_OK;
}

static enum rn_status add_triangle(struct rn_mesh *mesh, uint32_t a, uint32_t b, uint32_t c,
                                   struct rn_error *err) {
    if (mesh->triangle_count >= RN_MESH_MOST ||
        !make_room((void **)&mesh->triangles, mesh->triangle_count, &mesh->triangle_room,
                   sizeof *mesh->triangles))
        return full(mesh->triangle_count, err);
    uint32_t *t = mesh->triangles[mesh->triangle_count++];
    t[0] = a, t[1] = b, t[2] = c;
    return RN_OK;
}

// ---- a cell ---------------------------------------------------------------------------------

// A cell under way: its first point, and the values at its corners.
struct cell {
    int at[3];
    float value[8];
};

static size_t point_of(const struct front *f, const struct cell *c, int corner) {
    size_t x = (size_t)(c->at[0] + (corner & 1)), y = (size_t)(c->at[1] + (corner >> 1 & 1));
    return y * (size_t)(f->grid->cells[0] + 1) + x;
}

static bool is_inside(const struct front *f, const struct cell *c, int corner) {
    return (double)c->value[corner] > f->level;
}

// The vertex between two corners of which one is inside, made when it is first asked for.
static enum rn_status edge_vertex(struct front *f, const struct cell *c, int a, int b,
                                  uint32_t *ret_vertex, struct rn_error *err) {
    int low = a & b, way = a ^ b; // all bits of one are the other's
    uint32_t *slot = &f->vertex[low >> 2][point_of(f, c, low) * EDGES + (size_t)way - 1];
    if (*slot == NONE) {
        double from = (double)c->value[low], to = (double)c->value[low | way], p[3];
        double share = fmin(fmax((f->level - from) / (to - from), 0), 1);
        for (int i = 0; i < 3; i++) {
            double place = c->at[i] + (low >> i & 1) + (way >> i & 1 ? share : 0);
            p[i] = f->grid->low[i] +
                   (f->grid->high[i] - f->grid->low[i]) * (place / f->grid->cells[i]);
        }
        enum rn_status status = add_vertex(f->mesh, p, err);
        if (status) return status;
        *slot = (uint32_t)f->mesh->vertex_count - 1;
    }
    *ret_vertex = *slot;
    return RN_OK;
}

// Corners in an even order of the tetrahedron's, those inside first.
static int sort_corners(const struct front *f, const struct cell *c, const uint8_t corner[4],
                        int ret[4], bool *ret_even) {
    int inside = 0, from[4], swaps = 0;
    for (int i = 0; i < 4; i++)
        inside += is_inside(f, c, corner[i]);
    int next_in = 0, next_out = inside;
    for (int i = 0; i < 4; i++)
        from[is_inside(f, c, corner[i]) ? next_in++ : next_out++] = i;
    for (int i = 0; i < 4; i++) {
        ret[i] = corner[from[i]];
        for (int j = 0; j < i; j++)
            swaps += from[j] > from[i];
    }
    *ret_even = swaps % 2 == 0;
    return inside;
}

static enum rn_status march_tetrahedron(struct front *f, const struct cell *c, int which,
                                        struct rn_error *err) {
    // Edges between sorted corners, around what is cut off; of two inside and two, both halves.
    static const uint8_t around[3][4][2] = {{{0, 1}, {0, 2}, {0, 3}, {0, 3}},
                                            {{0, 2}, {0, 3}, {1, 3}, {1, 2}},
                                            {{0, 3}, {1, 3}, {2, 3}, {2, 3}}};
    int corner[4];
    bool even;
    uint32_t v[4];
    int inside = sort_corners(f, c, TETRAHEDRA[which].corner, corner, &even);
    if (inside == 0 || inside == 4) return RN_OK;
    enum rn_status status = RN_OK;
    for (int i = 0; i < 4 && !status; i++) {
        const uint8_t *edge = around[inside - 1][i];
        status = edge_vertex(f, c, corner[edge[0]], corner[edge[1]], &v[i], err);
    }
    bool as_is = even == TETRAHEDRA[which].even;
    int second = as_is ? 1 : 2, third = as_is ? 2 : 1;
    if (!status) status = add_triangle(f->mesh, v[0], v[second], v[third], err);
    if (!status && inside == 2)
        status = add_triangle(f->mesh, v[0], v[as_is ? 2 : 3], v[as_is ? 3 : 2], err);
    return status;
}

static enum rn_status march_layer(struct front *f, int z, struct rn_error *err) {
    enum rn_status status = RN_OK;
    for (int y = 0; y < f->grid->cells[1]; y++)
        for (int x = 0; x < f->grid->cells[0]; x++) {
            struct cell c = {.at = {x, y, z}};
            int inside = 0;
            for (int i = 0; i < 8; i++) {
                c.value[i] = f->values[i >> 2][point_of(f, &c, i)];
                inside += is_inside(f, &c, i);
            }
            for (int i = 0; i < 6 && inside > 0 && inside < 8 && !status; i++)
                status = march_tetrahedron(f, &c, i, err);
            if (status) return status;
        }
    return RN_OK;
}

// ---- the grid -------------------------------------------------------------------------------

static void forget_vertices(const struct front *f, int slice) {
    memset(f->vertex[slice], 255, f->points * EDGES * sizeof(uint32_t));
}

static void swap_slices(struct front *f) {
    float *values = f->values[0];
    uint32_t *vertex = f->vertex[0];
    f->values[0] = f->values[1], f->values[1] = values;
    f->vertex[0] = f->vertex[1], f->vertex[1] = vertex;
    forget_vertices(f, 1);
}

enum rn_status rn_mesh_march(const struct rn_mesh_grid *grid, double level, struct rn_mesh *mesh,
                             struct rn_error *err) {
    struct front f = {.grid = grid, .level = level, .mesh = mesh};
    f.points = (size_t)(grid->cells[0] + 1) * (size_t)(grid->cells[1] + 1);
    enum rn_status status = RN_OK;
    for (int i = 0; i < 2; i++) {
        f.values[i] = malloc(f.points * sizeof(float));
        f.vertex[i] = malloc(f.points * EDGES * sizeof(uint32_t));
        if (!f.values[i] || !f.vertex[i])
            status = rn_error_set(err, RN_ERROR_NO_MEMORY, "mesh", "out of memory");
        else
            forget_vertices(&f, i);
    }
    if (!status) status = grid->slice(grid->context, 0, f.values[0], err);
    for (int z = 0; z < grid->cells[2] && !status; z++) {
        status = grid->slice(grid->context, z + 1, f.values[1], err);
        if (!status) status = march_layer(&f, z, err);
        if (!status) swap_slices(&f);
    }
    for (int i = 0; i < 2; i++) {
        free(f.values[i]);
        free(f.vertex[i]);
    }
    return status;
}

void rn_mesh_normals(const struct rn_mesh *mesh, float (*ret_normals)[3]) {
    memset(ret_normals, 0, mesh->vertex_count * sizeof *ret_normals);
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangles[t];
        const float *a = mesh->vertices[v[0]].position, *b = mesh->vertices[v[1]].position,
                    *c = mesh->vertices[v[2]].position;
        for (int i = 0; i < 3; i++) {
            int j = (i + 1) % 3, k = (i + 2) % 3;
            float area = (b[j] - a[j]) * (c[k] - a[k]) - (b[k] - a[k]) * (c[j] - a[j]);
            for (int corner = 0; corner < 3; corner++)
                ret_normals[v[corner]][i] += area;
        }
    }
    for (size_t v = 0; v < mesh->vertex_count; v++) {
        float *n = ret_normals[v], size = hypotf(hypotf(n[0], n[1]), n[2]);
        for (int i = 0; i < 3; i++)
            n[i] = size > 0 ? n[i] / size : 0;
    }
}

void rn_mesh_finish(struct rn_mesh *mesh) {
    free(mesh->vertices);
    free(mesh->triangles);
    *mesh = (struct rn_mesh){0};
}

// ---- files ----------------------------------------------------------------------------------

enum rn_status rn_mesh_encode_ply(const struct rn_mesh *mesh, uint8_t **ret_bytes, size_t *ret_size,
                                  struct rn_error *err) {
    enum { VERTEX = 15, FACE = 13 };
    char header[320];
    int length = snprintf(header, sizeof header,
                          "ply\nformat binary_little_endian 1.0\nelement vertex %zu\n"
                          "property float x\nproperty float y\nproperty float z\n"
                          "property uchar red\nproperty uchar green\nproperty uchar blue\n"
                          "element face %zu\nproperty list uchar int vertex_indices\nend_header\n",
                          mesh->vertex_count, mesh->triangle_count);
    size_t size = (size_t)length + VERTEX * mesh->vertex_count + FACE * mesh->triangle_count;
    uint8_t *bytes = malloc(size), *at = bytes;
    if (!bytes) return rn_error_set(err, RN_ERROR_NO_MEMORY, "mesh", "out of memory");
    memcpy(at, header, (size_t)length);
    at += length;
    for (size_t i = 0; i < mesh->vertex_count; i++, at += VERTEX) {
        memcpy(at, mesh->vertices[i].position, 12);
        memcpy(at + 12, mesh->vertices[i].colour, 3);
    }
    for (size_t i = 0; i < mesh->triangle_count; i++, at += FACE) {
        *at = 3;
        memcpy(at + 1, mesh->triangles[i], 12);
    }
    *ret_bytes = bytes;
    *ret_size = size;
    return RN_OK;
}

enum rn_status rn_mesh_encode_obj(const struct rn_mesh *mesh, uint8_t **ret_bytes, size_t *ret_size,
                                  struct rn_error *err) {
    struct rn_buf text;
    rn_buf_init(&text, 128 * (mesh->vertex_count + mesh->triangle_count) + 64);
    for (size_t i = 0; i < mesh->vertex_count; i++) {
        const struct rn_mesh_vertex *v = &mesh->vertices[i];
        rn_buf_printf(&text, "v %.7g %.7g %.7g %.4g %.4g %.4g\n", (double)v->position[0],
                      (double)v->position[1], (double)v->position[2], v->colour[0] / 255.0,
                      v->colour[1] / 255.0, v->colour[2] / 255.0);
    }
    for (size_t i = 0; i < mesh->triangle_count; i++)
        rn_buf_printf(&text, "f %u %u %u\n", mesh->triangles[i][0] + 1, mesh->triangles[i][1] + 1,
                      mesh->triangles[i][2] + 1);
    enum rn_status status = rn_buf_status(&text, "mesh", err);
    if (status) {
        rn_buf_finish(&text);
        return status;
    }
    *ret_bytes = text.data;
    *ret_size = text.size;
    return RN_OK;
}

// Surfaces of triangles: where a quantity on a grid crosses a level, and files of them.
#ifndef RN_COMMON_IMAGE_MESH_H
#define RN_COMMON_IMAGE_MESH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "common/base/status.h"

struct rn_mesh_vertex {
    float position[3];
    uint8_t colour[3];
};
// Zero-initialise; rn_mesh_finish. Triangles are counterclockwise seen from outside, where the
// quantity is below the level.
struct rn_mesh {
    struct rn_mesh_vertex *vertices;
    uint32_t (*triangles)[3];
    size_t vertex_count, triangle_count, vertex_room, triangle_room;
};

#define RN_MESH_MOST 50000000 // vertices or triangles

// A quantity at the points of a grid, slice by slice: point (x, y, z) of 0 .. cells[i] lies at
// low + (high - low) * (x, y, z) / cells.
struct rn_mesh_grid {
    double low[3], high[3];
    int cells[3]; // along each axis, 1 to 4096
    // Fills `ret_values`, [y][x], of slice z; called for z = 0, 1, ..., cells[2].
    enum rn_status (*slice)(void *context, int z, float *ret_values, struct rn_error *err);
    void *context;
};

// Appends the surface on which the quantity, linear along edges, is `level`: each cell is six
// tetrahedra around its diagonal (Freudenthal's subdivision), so that neighbours agree and the
// surface has no crack and no edge of more than two triangles; it is closed where the grid's border
// is below the level. A vertex is shared by all its triangles. RN_ERROR_NO_MEMORY, RN_ERROR_LIMIT
// beyond RN_MESH_MOST, or what `slice` ends with.
enum rn_status rn_mesh_march(const struct rn_mesh_grid *grid, double level, struct rn_mesh *mesh,
                             struct rn_error *err) RN_MUST_CHECK;
// Per vertex, the mean direction of its triangles weighted by their areas, of length 1 (0 where
// they cancel): ret_normals[vertex_count][3].
void rn_mesh_normals(const struct rn_mesh *mesh, float (*ret_normals)[3]);
// Binary PLY, little endian: vertices x y z red green blue, faces of three indices. Or OBJ: text,
// "v x y z r g b" with colours in [0, 1], "f" with indices from 1. malloc'd. RN_ERROR_NO_MEMORY.
enum rn_status rn_mesh_encode_ply(const struct rn_mesh *mesh, uint8_t **ret_bytes, size_t *ret_size,
                                  struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_mesh_encode_obj(const struct rn_mesh *mesh, uint8_t **ret_bytes, size_t *ret_size,
                                  struct rn_error *err) RN_MUST_CHECK;
void rn_mesh_finish(struct rn_mesh *mesh);

#endif

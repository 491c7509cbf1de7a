// A field's surface as triangles.
#ifndef RN_ENGINE_RENDER_MESH_H
#define RN_ENGINE_RENDER_MESH_H

#include "common/image/mesh.h"
#include "common/math/camera.h"
#include "server/engine/scene/engine.h"

struct rn_mesh_options {
    // Low corner, then high one, dataset units: what is meshed. NAN first: the scene's ball, of
    // unbounded space the inner one, of a forward-facing capture what its cameras see to the
    // farthest depth given.
    double box[2][3];
    int cells; // along the box' longest side, 8 to 1024
    // The surface lies where RN_MESH_THICKNESS of the scene's radius of such matter are as opaque
    // as this, in (0, 1).
    double level;
};
#define RN_MESH_THICKNESS 0.01

// Where the density crosses the level, by marching tetrahedra, cut off (open) at the box: cells
// that training found empty are. A vertex has the colour that a camera just outside of it sees; in
// a forward-facing capture the mean camera. `keep_going` (may be NULL) is polled; false ends with
// RN_ERROR_CANCELLED. RN_ERROR_INVALID: a box without a size; RN_ERROR_LIMIT and RN_ERROR_NO_MEMORY
// as rn_mesh_march. The caller finishes the mesh.
enum rn_status rn_field_mesh(struct rn_engine *engine, struct rn_field *field,
                             const struct rn_mesh_options *options,
                             bool (*keep_going)(void *context), void *context,
                             struct rn_mesh *ret_mesh, struct rn_error *err) RN_MUST_CHECK;

#endif

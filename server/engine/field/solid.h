// The planes: normals from Platonic solids, and two axes on each (paper, section 3.2).
#ifndef RN_ENGINE_FIELD_SOLID_H
#define RN_ENGINE_FIELD_SOLID_H

#include "common/settings/train.h"

// Unit normals and orthonormal axes of up to RN_MAX_PLANES planes. Plain value.
// A point p in the [-1, 1] frame has plane coordinates (u, v) = (axis_u . p, axis_v . p).
struct rn_solid {
    int planes;
    double normal[RN_MAX_PLANES][3];
    double axis_u[RN_MAX_PLANES][3];
    double axis_v[RN_MAX_PLANES][3];
};

// Platonic: planes must be 3 (cube), 4 (tetrahedron), 6 (dodecahedron) or 10 (icosahedron): the
// vertices of the dual solid, antipodes merged, in the released code's order. Other orientations
// take any count in 1..RN_MAX_PLANES. Normals and axes are orthonormal to 1 ULP (long double
// inside). RN_ERROR_INVALID for other counts.
enum rn_status rn_solid_init(int planes, enum rn_orientation orientation, uint64_t seed,
                             struct rn_solid *ret_solid, struct rn_error *err) RN_MUST_CHECK;

#endif

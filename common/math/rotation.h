// Rotations: the 3 x 3 part of a pose [R | t], and unit quaternions w, x, y, z (Hamilton).
#ifndef RN_COMMON_MATH_ROTATION_H
#define RN_COMMON_MATH_ROTATION_H

#include <stdbool.h>

// A turn about `by` by its length, radians (Rodrigues), to 2e-15 up to a whole turn; NAN where the
// length is not finite. The pose's last column stays, here and below.
void rn_rotation_from_vector(const double by[3], double pose[3][4]);
// The quaternion is made a unit; false, and nothing written, where it has no length to speak of or
// is not finite.
bool rn_rotation_from_quaternion(const double wxyz[4], double pose[3][4]);
// One of the two quaternions of a rotation. Shepperd 1978.
void rn_rotation_to_quaternion(const double pose[3][4], double ret_wxyz[4]);
// The largest entry of |R^T R - 1|: how far the columns are from orthonormal. Finite numbers.
double rn_rotation_skew(const double pose[3][4]);
double rn_rotation_determinant(const double pose[3][4]);
// [R^T | -R^T t]: camera to world of world to camera, and back. ret: not the pose itself.
void rn_pose_invert(const double pose[3][4], double ret[3][4]);

#endif

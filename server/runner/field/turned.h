// Places to look at a scene from, where it came without its photographs.
#ifndef RN_SERVER_RUNNER_FIELD_TURNED_H
#define RN_SERVER_RUNNER_FIELD_TURNED_H

#include "server/engine/engine.h"

// `count` cameras, evenly spaced on a turn of the one that the scene's file begins with, about the
// direction that is up there, through the middle of the bounds: all around, or where the cameras
// that it was trained from looked less far apart than that, half as far as they did. Of a
// forward-facing scene the camera turns where it stands, as it is sharp from there alone. A file
// that tells no beginning is looked at from a little above, at RN_TURNED_SIDE pixels a side.
void rn_turned_cameras(const struct rn_field_info *info, int count, struct rn_camera *ret_cameras);
#define RN_TURNED_SIDE 400

#endif

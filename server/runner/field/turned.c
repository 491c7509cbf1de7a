#include "server/runner/field/turned.h"

#include <math.h>
#include <string.h>

#include "common/math/rotation.h"
#include "common/math/vector.h"

#define ROUND_DEG 75   // from the mean of the cameras' axes: those that go as far go all around
#define OUTSIDE 2.5    // radii from the middle of an object
#define INSIDE 0.65    // of a place, whose bounds are about the cameras
#define ELEVATION 0.35 // radians
#define FOV 0.7        // radians

// Upright, from beside the middle of the bounds: the z axis is up.
static void stand_somewhere(const struct rn_bounds *bounds, struct rn_camera *ret, double up[3]) {
    const double away = bounds->radius * (bounds->source == RN_BOUNDS_CAMERAS ? INSIDE : OUTSIDE);
    const double high = sin(ELEVATION), far = cos(ELEVATION);
    const double pose[3][3] = {{0, high, -far}, {1, 0, 0}, {0, -far, -high}}; // right, down, ahead
    *ret = (struct rn_camera){.width = RN_TURNED_SIDE, .height = RN_TURNED_SIDE};
    ret->fx = ret->fy = RN_TURNED_SIDE / (2 * tan(FOV / 2));
    ret->cx = ret->cy = RN_TURNED_SIDE / 2.0;
    for (int i = 0; i < 3; i++) {
        memcpy(ret->world_from_camera[i], pose[i], sizeof pose[i]);
        ret->world_from_camera[i][3] = bounds->centre[i] - away * pose[i][2];
    }
    memcpy(up, (double[]){0, 0, 1}, 3 * sizeof *up);
}

static struct rn_camera turned(const struct rn_camera *camera, const double up[3],
                               const double middle[3], double angle) {
    const double by[3] = {angle * up[0], angle * up[1], angle * up[2]};
    double turn[3][4];
    struct rn_camera ret = *camera;
    rn_rotation_from_vector(by, turn);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 4; j++) {
            double sum = j == 3 ? middle[i] : 0;
            for (int k = 0; k < 3; k++)
                sum += turn[i][k] * (camera->world_from_camera[k][j] - (j == 3 ? middle[k] : 0));
            ret.world_from_camera[i][j] = sum;
        }
    return ret;
}

void rn_turned_cameras(const struct rn_field_info *info, int count, struct rn_camera *ret_cameras) {
    const struct rn_effect_record *one_way = &info->effects[RN_EFFECT_FORWARD_FACING];
    struct rn_camera start = info->viewing.start;
    double up[3], middle[3], half = M_PI;
    memcpy(up, info->viewing.up, sizeof up);
    memcpy(middle, info->bounds.centre, sizeof middle);
    if (!info->viewing.has_start) stand_somewhere(&info->bounds, &start, up);
    for (int i = 0; i < 3 && one_way->on; i++)
        middle[i] = start.world_from_camera[i][3];
    if (one_way->number > 0 && one_way->number < ROUND_DEG) half = one_way->number / 2 * M_PI / 180;
    for (int k = 0; k < count; k++)
        ret_cameras[k] = turned(&start, up, middle, half * (2 * (k + 0.5) / count - 1));
}

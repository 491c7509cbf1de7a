#include "client/commands/turn.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "client/api.h"
#include "common/math/around.h"
#include "common/math/vector.h"
#include "common/path/formats/formats.h"
#include "proto/dataset.h"
#include "proto/doctor.h"
#include "proto/scene.h"

enum { KEYS = 8, SWING_KEYS = 32 };

#define LARGEST_GAP (M_PI / 2) // between photographs, that a whole turn flies over
#define LEAST_ARC 0.02         // less is no way to swing on
#define OVERHEAD 0.1 // nearer to the vertical, of its distance: it stands nowhere about it

// What the cameras say of how a scene is looked at.
struct stand {
    double up[3], elevation_rad, distance, fov_y_rad;
    double first_rad, arc_rad; // about up: where the cameras' arc begins, and how far it goes
    int width, height;
};

// Up as the dataset has it, or where it does not know, the mean of the cameras' upward directions;
// the means of their distances and of their elevations.
static void find_stand(const struct rn_camera_list_record *cameras, const double up[3],
                       const double centre[3], struct stand *ret) {
    struct stand stand = {.up = {up[0], up[1], up[2]}};
    size_t count = cameras->item_count;
    if (!isfinite(up[0])) memset(stand.up, 0, sizeof stand.up);
    for (size_t k = 0; k < count && !isfinite(up[0]); k++)
        for (int i = 0; i < 3; i++)
            stand.up[i] -= cameras->items[k].camera.world_from_camera[i][1];
    if (!rn_make_unit(stand.up)) memcpy(stand.up, (double[]){0, 0, 1}, sizeof stand.up);
    for (size_t k = 0; k < count; k++) {
        double out[3];
        for (int i = 0; i < 3; i++)
            out[i] = cameras->items[k].camera.world_from_camera[i][3] - centre[i];
        double distance = sqrt(rn_dot(out, out));
        stand.distance += distance / (double)count;
        if (distance > 0)
            stand.elevation_rad += asin(rn_dot(out, stand.up) / distance) / (double)count;
    }
    const struct rn_camera *first = &cameras->items[0].camera;
    stand.fov_y_rad = rn_camera_fov_from_focal(first->fy, first->height);
    stand.width = first->width;
    stand.height = first->height;
    *ret = stand;
}

// Where about `up` the cameras stand.
static enum rn_exit find_cover(const struct rn_camera_list_record *cameras, const double centre[3],
                               struct stand *stand) {
    double a[3], b[3], out[3];
    double *angles = malloc(cameras->item_count * sizeof *angles);
    size_t count = 0;
    if (!angles) {
        struct rn_error err;
        rn_error_set(&err, RN_ERROR_NO_MEMORY, "turntable", "out of memory");
        return rn_client_fail(&err);
    }
    rn_around_axes(stand->up, a, b);
    for (size_t k = 0; k < cameras->item_count; k++) {
        for (int i = 0; i < 3; i++)
            out[i] = cameras->items[k].camera.world_from_camera[i][3] - centre[i];
        double x = rn_dot(out, a), y = rn_dot(out, b);
        if (hypot(x, y) > OVERHEAD * sqrt(rn_dot(out, out))) angles[count++] = atan2(y, x);
    }
    double arc = rn_around_arc(angles, count, &stand->first_rad);
    bool whole = arc >= 2 * M_PI - LARGEST_GAP - 1e-6 || arc <= LEAST_ARC;
    stand->arc_rad = whole ? 2 * M_PI : arc;
    free(angles);
    return RN_EXIT_OK;
}

// Of `part` 0 .. 1 of the time: once around, or to the arc's end and back, slowest where it turns.
static double angle_at(const struct stand *stand, double part) {
    if (stand->arc_rad >= 2 * M_PI) return 2 * M_PI * part;
    return stand->first_rad + stand->arc_rad * 0.5 * (1 - cos(2 * M_PI * part));
}

static void fill_key(const struct stand *stand, const double centre[3], double angle,
                     struct rn_path_key *key) {
    double a[3], b[3], out[3], right[3], down[3], forward[3];
    rn_around_axes(stand->up, a, b);
    for (int i = 0; i < 3; i++) {
        out[i] = cos(stand->elevation_rad) * (cos(angle) * a[i] + sin(angle) * b[i]) +
                 sin(stand->elevation_rad) * stand->up[i];
        forward[i] = -out[i];
    }
    rn_cross(forward, stand->up, right);
    rn_make_unit(right);
    rn_cross(forward, right, down);
    for (int i = 0; i < 3; i++) {
        key->world_from_camera[i][0] = right[i];
        key->world_from_camera[i][1] = down[i];
        key->world_from_camera[i][2] = forward[i];
        key->world_from_camera[i][3] = centre[i] + stand->distance * out[i];
    }
    key->fov_y_rad = stand->fov_y_rad;
}

static enum rn_exit encode(const struct rn_turn *turn, struct stand stand, const double centre[3],
                           char **ret_json) {
    struct rn_error err = {0};
    struct rn_path_key keys[SWING_KEYS] = {{0}};
    if (turn->whole) stand.arc_rad = 2 * M_PI;
    int count = stand.arc_rad < 2 * M_PI ? SWING_KEYS : KEYS;
    struct rn_path path = {.keys = keys,
                           .key_count = (size_t)count,
                           .fps = turn->fps,
                           .interpolation = RN_INTERPOLATE_CIRCLE,
                           .loop = true,
                           .width = turn->width ? (int)turn->width : stand.width,
                           .height = turn->height ? (int)turn->height : stand.height};
    if (!isnan(turn->elevation_deg)) stand.elevation_rad = turn->elevation_deg * M_PI / 180;
    if (!isnan(turn->distance)) stand.distance = turn->distance;
    if (!isnan(turn->fov_deg)) stand.fov_y_rad = turn->fov_deg * M_PI / 180;
    for (int i = 0; i < count; i++) {
        keys[i].time_s = i * turn->seconds / count;
        fill_key(&stand, centre, angle_at(&stand, (double)i / count), &keys[i]);
    }
    enum rn_status status = rn_path_object_text(&path, ret_json, &err);
    return status == RN_OK ? RN_EXIT_OK : rn_client_fail(&err);
}

// Of a scene that came without its photographs, from a build whose files told no camera.
static const struct stand usual = {.up = {0, 0, 1},
                                   .elevation_rad = 0.35,
                                   .fov_y_rad = 0.7,
                                   .arc_rad = 2 * M_PI,
                                   .width = 400,
                                   .height = 400};
#define USUAL_DISTANCE 3 // radii of the scene

// As the dataset's cameras look at the scene.
static enum rn_exit stand_of_dataset(struct rn_client *client, const struct rn_scene *scene,
                                     struct stand *ret) {
    struct rn_camera_list_record cameras;
    struct rn_dataset_record dataset;
    const double *centre = scene->description.bounds.centre;
    enum rn_exit code =
        rn_api_get(client, "datasets", scene->dataset, "", &rn_dataset_table, &dataset);
    if (code != RN_EXIT_OK) return code;
    double up[3];
    memcpy(up, dataset.up, sizeof up);
    rn_message_finish(&rn_dataset_table, &dataset);
    code =
        rn_api_get(client, "datasets", scene->dataset, "/cameras", &rn_camera_list_table, &cameras);
    if (code != RN_EXIT_OK) return code;
    if (cameras.item_count) {
        find_stand(&cameras, up, centre, ret);
        code = find_cover(&cameras, centre, ret);
    } else {
        code = rn_client_usage(scene->name, "has a dataset without cameras");
    }
    rn_message_finish(&rn_camera_list_table, &cameras);
    return code;
}

// As the camera does at which one begins to look at a scene that came as a file.
static void stand_of_file(const struct rn_scene *scene, struct stand *ret) {
    const struct rn_scene_start *start = &scene->description.viewing.start;
    struct rn_dataset_camera first = {.camera = start->camera};
    const struct rn_camera_list_record cameras = {.items = &first, .item_count = 1};
    find_stand(&cameras, start->up, scene->description.bounds.centre, ret);
    ret->arc_rad = 2 * M_PI;
}

enum rn_exit rn_turn_path(struct rn_client *client, const char *scene, const struct rn_turn *turn,
                          char **ret_json, double *ret_covered_deg) {
    struct rn_scene record;
    struct stand stand = usual;
    enum rn_exit code = rn_api_get(client, "scenes", scene, "", &rn_scene_table, &record);
    if (code != RN_EXIT_OK) return code;
    const struct rn_bounds_record *bounds = &record.description.bounds;
    stand.distance = USUAL_DISTANCE * bounds->radius;
    if (!(bounds->radius > 0))
        code = rn_client_usage(scene, "is not trained yet: where its middle lies is not known");
    else if (*record.dataset)
        code = stand_of_dataset(client, &record, &stand);
    else if (record.description.viewing.start.camera.width > 0)
        stand_of_file(&record, &stand);
    if (code == RN_EXIT_OK) {
        *ret_covered_deg = stand.arc_rad * 180 / M_PI;
        code = encode(turn, stand, bounds->centre, ret_json);
    }
    rn_message_finish(&rn_scene_table, &record);
    return code;
}

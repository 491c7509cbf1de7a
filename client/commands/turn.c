#include "client/commands/turn.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "client/api.h"
#include "common/path/formats/formats.h"
#include "proto/doctor.h"
#include "proto/scene.h"

enum { KEYS = 8 };

// What the cameras say of how a scene is looked at.
struct stand {
    double up[3], elevation_rad, distance, fov_y_rad;
    int width, height;
};

static double dot(const double a[3], const double b[3]) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross(const double a[3], const double b[3], double ret[3]) {
    ret[0] = a[1] * b[2] - a[2] * b[1];
    ret[1] = a[2] * b[0] - a[0] * b[2];
    ret[2] = a[0] * b[1] - a[1] * b[0];
}

static bool make_unit(double v[3]) {
    double length = sqrt(dot(v, v));
    for (int i = 0; i < 3; i++)
        v[i] /= length;
    return length > 1e-9;
}

// The mean of the cameras' upward directions, of their distances and of their elevations.
static void find_stand(const struct rn_camera_list_record *cameras, const double centre[3],
                       struct stand *ret) {
    struct stand stand = {.up = {0, 0, 0}};
    size_t count = cameras->item_count;
    for (size_t k = 0; k < count; k++)
        for (int i = 0; i < 3; i++)
            stand.up[i] -= cameras->items[k].camera.world_from_camera[i][1];
    if (!make_unit(stand.up)) memcpy(stand.up, (double[]){0, 0, 1}, sizeof stand.up);
    for (size_t k = 0; k < count; k++) {
        double out[3];
        for (int i = 0; i < 3; i++)
            out[i] = cameras->items[k].camera.world_from_camera[i][3] - centre[i];
        double distance = sqrt(dot(out, out));
        stand.distance += distance / (double)count;
        if (distance > 0)
            stand.elevation_rad += asin(dot(out, stand.up) / distance) / (double)count;
    }
    const struct rn_camera *first = &cameras->items[0].camera;
    stand.fov_y_rad = 2 * atan(0.5 * first->height / first->fy);
    stand.width = first->width;
    stand.height = first->height;
    *ret = stand;
}

// Two axes that complete `up`.
static void ground_of(const double up[3], double a[3], double b[3]) {
    const double seed[3] = {fabs(up[0]) < 0.9, fabs(up[0]) >= 0.9, 0};
    double along = dot(seed, up);
    for (int i = 0; i < 3; i++)
        a[i] = seed[i] - along * up[i];
    make_unit(a);
    cross(up, a, b);
}

static void fill_key(const struct stand *stand, const double centre[3], double angle,
                     struct rn_path_key *key) {
    double a[3], b[3], out[3], right[3], down[3], forward[3];
    ground_of(stand->up, a, b);
    for (int i = 0; i < 3; i++) {
        out[i] = cos(stand->elevation_rad) * (cos(angle) * a[i] + sin(angle) * b[i]) +
                 sin(stand->elevation_rad) * stand->up[i];
        forward[i] = -out[i];
    }
    cross(forward, stand->up, right);
    make_unit(right);
    cross(forward, right, down);
    for (int i = 0; i < 3; i++) {
        key->world_from_camera[i][0] = right[i];
        key->world_from_camera[i][1] = down[i];
        key->world_from_camera[i][2] = forward[i];
        key->world_from_camera[i][3] = centre[i] + stand->distance * out[i];
    }
    key->fov_y_rad = stand->fov_y_rad;
}

static enum rn_exit get(struct rn_client *client, const char *kind, const char *reference,
                        const char *tail, const struct rn_table *table, void *ret_message) {
    struct rn_api_reply reply;
    char *path = rn_api_path(kind, reference, tail);
    if (!path) return RN_EXIT_FAILED;
    rn_api_send(client, "GET", path, NULL, &reply);
    free(path);
    enum rn_exit code = reply.code == RN_EXIT_OK ? rn_api_decode(&reply, table, ret_message)
                                                 : rn_api_complain(&reply);
    rn_api_reply_finish(&reply);
    return code;
}

static enum rn_exit encode(const struct rn_turn *turn, struct stand stand, const double centre[3],
                           char **ret_json) {
    struct rn_error err = {0};
    struct rn_path_key keys[KEYS] = {{0}};
    struct rn_path path = {.keys = keys,
                           .key_count = KEYS,
                           .fps = turn->fps,
                           .interpolation = RN_INTERPOLATE_CIRCLE,
                           .loop = true,
                           .width = turn->width ? (int)turn->width : stand.width,
                           .height = turn->height ? (int)turn->height : stand.height};
    if (!isnan(turn->elevation_deg)) stand.elevation_rad = turn->elevation_deg * M_PI / 180;
    if (!isnan(turn->distance)) stand.distance = turn->distance;
    if (!isnan(turn->fov_deg)) stand.fov_y_rad = turn->fov_deg * M_PI / 180;
    for (int i = 0; i < KEYS; i++) {
        keys[i].time_s = i * turn->seconds / KEYS;
        fill_key(&stand, centre, 2 * M_PI * i / KEYS, &keys[i]);
    }
    enum rn_status status = rn_path_object_text(&path, ret_json, &err);
    return status == RN_OK ? RN_EXIT_OK : rn_client_fail(&err);
}

enum rn_exit rn_turn_path(struct rn_client *client, const char *scene, const struct rn_turn *turn,
                          char **ret_json) {
    struct rn_scene record;
    struct rn_camera_list_record cameras;
    enum rn_exit code = get(client, "scenes", scene, "", &rn_scene_table, &record);
    if (code != RN_EXIT_OK) return code;
    code = get(client, "datasets", record.dataset, "/cameras", &rn_camera_list_table, &cameras);
    if (code == RN_EXIT_OK) {
        struct stand stand;
        if (cameras.item_count && record.description.bounds.radius > 0) {
            find_stand(&cameras, record.description.bounds.centre, &stand);
            code = encode(turn, stand, record.description.bounds.centre, ret_json);
        } else {
            code = rn_client_usage(scene, "is not trained yet: where its middle lies is not known");
        }
        rn_message_finish(&rn_camera_list_table, &cameras);
    }
    rn_message_finish(&rn_scene_table, &record);
    return code;
}

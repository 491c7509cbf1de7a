// A camera path once around a scene.
#ifndef RN_CLIENT_COMMANDS_TURN_H
#define RN_CLIENT_COMMANDS_TURN_H

#include "client/client.h"

struct rn_turn {
    double seconds, fps;
    double elevation_deg, distance, fov_deg; // NAN: as the dataset's cameras stand
    int64_t width, height;                   // 0: as its first camera's
};

// The path's object as JSON, malloc'd: about the vertical through the middle of the scene, upwards
// as its cameras are. Complains.
enum rn_exit rn_turn_path(struct rn_client *client, const char *scene, const struct rn_turn *turn,
                          char **ret_json);

#endif

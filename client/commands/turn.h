// A camera path around a scene: once, or to and fro where photographs cover only a part.
#ifndef RN_CLIENT_COMMANDS_TURN_H
#define RN_CLIENT_COMMANDS_TURN_H

#include "client/client.h"

struct rn_turn {
    double seconds, fps;
    double elevation_deg, distance, fov_deg; // NAN: as the dataset's cameras stand
    int64_t width, height;                   // 0: as its first camera's
    bool whole;                              // all around, wherever the cameras stood
};

// The path's object as JSON, malloc'd: about the vertical through the middle of the scene, upwards
// as its cameras are. Where they leave a gap of more than a quarter of the circle, it swings over
// the rest, and *ret_covered_deg tells how much that is; else 360. Complains.
enum rn_exit rn_turn_path(struct rn_client *client, const char *scene, const struct rn_turn *turn,
                          char **ret_json, double *ret_covered_deg);

#endif

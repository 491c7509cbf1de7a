// Numbers of pixels as colours.
#ifndef RN_SERVER_RUNNER_FIELD_HEAT_H
#define RN_SERVER_RUNNER_FIELD_HEAT_H

#include "server/engine/engine.h"

// A map of one channel, 0 to the end of its scale, as colours from dark violet over green to yellow
// (viridis); what is 0 or no number is black. *ret_high: the end, 1, 2 or 5 times a power of ten,
// so that pictures of one scene mostly share it.
enum rn_status rn_heat_picture(const struct rn_picture *map, struct rn_picture *ret_picture,
                               double *ret_high, struct rn_error *err) RN_MUST_CHECK;
// Normals as colours: each axis from -1 to 1; black where there is no surface.
enum rn_status rn_normal_picture(const struct rn_picture *normals, struct rn_picture *ret_picture,
                                 struct rn_error *err) RN_MUST_CHECK;

#endif

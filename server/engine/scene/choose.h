// Which kernel set is the quickest here, by measurement. Inside the engine only.
#ifndef RN_ENGINE_SCENE_CHOOSE_H
#define RN_ENGINE_SCENE_CHOOSE_H

#include "server/engine/scene/scene.h"

// The set that is quickest with these networks, or nearly: of those that are close the last one of
// the table, so that every process of a machine chooses the same and makes the same bytes.
const struct rn_kernels *rn_choose_kernels(const struct rn_field_config *config);

#endif

// A module with nothing of its own: the emulated backend's table is what is asked of it.
#include "server/engine/kernels/backend.h"

extern const struct rn_backend rn_backend_table;
extern const struct rn_backend *const rn_module_keeps;
const struct rn_backend *const rn_module_keeps = &rn_backend_table;

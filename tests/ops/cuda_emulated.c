// The backend under test is the emulated one.
#include "tests/ops/cuda_scene.h"

extern const struct rn_backend rn_backend_table;

const struct rn_backend *test_backend(void) {
    return &rn_backend_table;
}
bool test_is_emulated(void) {
    return true;
}

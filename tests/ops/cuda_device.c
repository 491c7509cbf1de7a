// The backend under test is the real one, on this machine's GPU. It stays loaded.
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>

#include "tests/ops/cuda_emulator/knobs.h"
#include "tests/ops/cuda_scene.h"

// The table of RIPNERF_CUDA_MODULE, if it opens a device.
static const struct rn_backend *find(void) {
    const char *path = getenv("RIPNERF_CUDA_MODULE");
    void *module = path ? dlopen(path, RTLD_NOW | RTLD_LOCAL) : NULL;
    const struct rn_backend *table = module ? dlsym(module, RN_BACKEND_SYMBOL) : NULL;
    struct rn_device *device;
    struct rn_device_about about;
    struct rn_error err = {0};
    if (!table || table->open(0, &device, &about, &err) != RN_OK) {
        printf("%s\n", table ? err.text : "no module at RIPNERF_CUDA_MODULE");
        return NULL;
    }
    printf("%s, %s\n", about.name, about.kernels);
    table->close(&device);
    return table;
}

const struct rn_backend *test_backend(void) {
    static const struct rn_backend *table;
    if (!table) table = find();
    return table;
}
bool test_is_emulated(void) {
    return false;
}

void rn_emulator_order(int order, uint64_t seed) {
    (void)order;
    (void)seed;
}
void rn_emulator_memory(size_t bytes) {
    (void)bytes;
}
size_t rn_emulator_memory_used(void) {
    return 0;
}
long rn_emulator_allocations(void) {
    return 0;
}
void rn_emulator_fail(int error) {
    (void)error;
}

// The backend under test is the real one, on this machine's GPU. It stays loaded.
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>

#include "tests/ops/cuda_emulator/knobs.h"
#include "tests/ops/cuda_scene.h"

static const struct rn_backend *table; // of RIPNERF_CUDA_MODULE

static bool opens(void) {
    struct rn_backend_device *device;
    struct rn_device_about about;
    struct rn_error err = {0};
    if (table->open(0, &device, &about, &err) != RN_OK) {
        printf("%s\n", err.text);
        return false;
    }
    printf("%s, %s\n", about.name, about.kernels);
    table->close(&device);
    return true;
}

const struct rn_backend *test_backend(void) {
    const char *path = getenv("RIPNERF_CUDA_MODULE");
    if (table) return table;
    void *module = path ? dlopen(path, RTLD_NOW | RTLD_LOCAL) : NULL;
    table = module ? dlsym(module, RN_BACKEND_SYMBOL) : NULL;
    if (!table) printf("no module at RIPNERF_CUDA_MODULE\n");
    if (table && !holds_in_a_child(opens)) table = NULL;
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
void rn_emulator_shared(size_t bytes) {
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

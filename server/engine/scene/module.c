#include "server/engine/scene/module.h"

#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

// The CUDA runtime does not survive being unloaded, nor does MPI.
#define FLAGS (RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE)

// `name` beside the running program.
static void beside_program(const char *name, char *ret, size_t size) {
    char program[1024];
    ssize_t n = readlink("/proc/self/exe", program, sizeof program - 1);
    program[n > 0 ? n : 0] = 0;
    char *slash = strrchr(program, '/');
    if (slash) *slash = 0;
    snprintf(ret, size, "%s/%s", program, name);
}

void *rn_module_open(const char *variable, const char *file, const char *place) {
    char path[2048], installed[1024];
    const char *given = getenv(variable);
    if (given) return dlopen(given, FLAGS);
    snprintf(installed, sizeof installed, "%s/%s", RN_MODULE_FOLDER, file);
    void *module = dlopen(installed, FLAGS);
    beside_program(place, path, sizeof path);
    if (!module && access(path, R_OK) == 0) module = dlopen(path, FLAGS);
    return module;
}

// Modules of the engine: what the runner loads only where it is asked for.
#ifndef RN_ENGINE_SCENE_MODULE_H
#define RN_ENGINE_SCENE_MODULE_H

// `file` as the variable of the environment names it, else installed, else at `place` beside the
// running program; for good. NULL: not there, dlerror() says why.
void *rn_module_open(const char *variable, const char *file, const char *place);

#endif

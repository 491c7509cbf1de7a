// The CUDA backend's own source, for the emulator.
#include "server/engine/cuda/module.cu"

// The module: one unit, since the kernels stand in their headers.
#include "server/engine/cuda/backend.cu"
#include "server/engine/cuda/field.cu"

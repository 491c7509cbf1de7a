// The tiny networks: a packet's rows through them, forward and backward, with the products of the
// kernel set being compiled. Either file has mlp_pack, mlp_forward, mlp_backward, hidden_stride and
// gemm_public.
#ifndef RN_ENGINE_CPU_MLP_H
#define RN_ENGINE_CPU_MLP_H

#if defined(__AMX_BF16__)
#define PRODUCT_UNIT RN_PRODUCT_AMX
#include "server/engine/cpu/mlp_bf16.h"
#elif defined(__AVX512BF16__)
#define PRODUCT_UNIT RN_PRODUCT_BF16_DOT
#include "server/engine/cpu/mlp_bf16.h"
#else
#define PRODUCT_UNIT RN_PRODUCT_FMA
#include "server/engine/cpu/mlp_fp32.h"
#endif

#endif

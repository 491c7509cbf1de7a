// One macro for code that a C17 compiler, a C++17 compiler and nvcc must all accept.
#ifndef RN_COMMON_MATH_HD_H
#define RN_COMMON_MATH_HD_H

#ifdef __CUDACC__
#define RN_HD __host__ __device__ static inline
#else
#define RN_HD static inline
#endif

#endif

// The part of the CUDA runtime that the backend's host side uses, over the emulator: streams run at
// once, a captured graph is the list of what was launched with the arguments that it had then. A stream
// that only copies to the host does so as late as it may, when somebody waits for it, and copies NaN
// bytes where it did not wait for all that was launched before.
#ifndef RN_TESTS_EMULATOR_RUNTIME_H
#define RN_TESTS_EMULATOR_RUNTIME_H

typedef int cudaError_t;
enum {
    cudaSuccess = 0,
    cudaErrorInvalidValue = 1,
    cudaErrorMemoryAllocation = 2,
    cudaErrorInitializationError = 3,
    cudaErrorNoDevice = 100,
    cudaErrorIllegalAddress = 700
};
enum { cudaMemcpyHostToDevice, cudaMemcpyDeviceToHost, cudaMemcpyDeviceToDevice };
enum { cudaStreamCaptureModeRelaxed, cudaStreamNonBlocking, cudaHostAllocDefault };
enum { cudaFuncAttributeMaxDynamicSharedMemorySize };
struct emu_stream {
    bool capturing = false, computes = false;
    uint64_t knows = 0; // of emu::launched, by the events that it waited for
    std::vector<std::function<void()>> operations; // captured, or late
};
typedef emu_stream *cudaStream_t;
struct emu_event {
    struct timespec at;
    emu_stream *stream;
    uint64_t launched;
};
typedef emu_event *cudaEvent_t;
typedef std::vector<std::function<void()>> *cudaGraph_t, *cudaGraphExec_t;
struct cudaDeviceProp {
    char name[256];
    size_t totalGlobalMem, sharedMemPerBlockOptin;
    int multiProcessorCount, major, minor;
};

namespace emu {
extern size_t memory_total, memory_used;
extern size_t shared_most; // bytes a block that kernels may ask for
extern long allocations;
extern uint64_t launched; // kernels so far
extern cudaError_t sticky; // what every call returns once it is set
extern const char *skips;  // kernels with this in their name do nothing; NULL: all do

// The third graph that a process launches after the check of its device meets an error for good,
// once: when the file exists that RIPNERF_EMULATOR_LOSES names, which is removed.
void maybe_lose();

inline cudaError_t enqueue(cudaStream_t stream, std::function<void()> operation,
                           bool late = false) {
    if (sticky) return sticky;
    if (stream && (stream->capturing || late))
        stream->operations.push_back(std::move(operation));
    else
        operation();
    return cudaSuccess;
}
inline cudaError_t catch_up(cudaStream_t stream) {
    std::vector<std::function<void()>> late;
    if (stream && !stream->capturing) late.swap(stream->operations);
    for (const std::function<void()> &operation : late)
        operation();
    return sticky;
}
} // namespace emu

inline const char *cudaGetErrorString(cudaError_t e) {
    return e == cudaErrorMemoryAllocation ? "out of memory" : "emulated error";
}
inline cudaError_t cudaGetLastError() {
    return emu::sticky;
}
inline cudaError_t cudaGetDeviceCount(int *count) {
    // A device belongs to the process that met it; what that forks cannot use it.
    static pid_t owner = getpid();
    *count = 1;
    return owner == getpid() ? cudaSuccess : cudaErrorInitializationError;
}
inline cudaError_t cudaSetDevice(int) {
    return cudaSuccess;
}
inline cudaError_t cudaGetDeviceProperties(cudaDeviceProp *p, int) {
    memset(p, 0, sizeof *p);
    snprintf(p->name, sizeof p->name, "emulated");
    p->totalGlobalMem = emu::memory_total;
    p->sharedMemPerBlockOptin = emu::shared_most;
    p->multiProcessorCount = 2;
    p->major = 8;
    return cudaSuccess;
}
inline cudaError_t cudaMemGetInfo(size_t *free, size_t *total) {
    *total = emu::memory_total;
    *free = emu::memory_total - emu::memory_used;
    return cudaSuccess;
}
// NaN bytes, and the size in front.
inline cudaError_t cudaMalloc(void **ret, size_t bytes) {
    if (emu::sticky) return emu::sticky;
    if (bytes > emu::memory_total - emu::memory_used) return cudaErrorMemoryAllocation;
    size_t rounded = (bytes + 255) / 256 * 256 + 256;
    unsigned char *block = (unsigned char *)aligned_alloc(256, rounded);
    memcpy(block, &bytes, sizeof bytes);
    memset(block + 256, 0xff, rounded - 256);
    emu::memory_used += bytes;
    emu::allocations++;
    *ret = block + 256;
    return cudaSuccess;
}
inline cudaError_t cudaFree(void *p) {
    if (!p) return cudaSuccess;
    size_t bytes;
    memcpy(&bytes, (unsigned char *)p - 256, sizeof bytes);
    emu::memory_used -= bytes;
    free((unsigned char *)p - 256);
    return cudaSuccess;
}
inline cudaError_t cudaHostAlloc(void **ret, size_t bytes, unsigned) {
    *ret = malloc(bytes);
    return *ret ? cudaSuccess : cudaErrorMemoryAllocation;
}
inline cudaError_t cudaFreeHost(void *p) {
    free(p);
    return cudaSuccess;
}
inline cudaError_t cudaMemcpyAsync(void *to, const void *from, size_t bytes, int way,
                                   cudaStream_t s) {
    bool late = way == cudaMemcpyDeviceToHost && !s->computes;
    bool there = !late || s->knows == emu::launched;
    return emu::enqueue(
        s, [=] { there ? memcpy(to, from, bytes) : memset(to, 0xff, bytes); }, late);
}
inline cudaError_t cudaMemsetAsync(void *to, int value, size_t bytes, cudaStream_t s) {
    return emu::enqueue(s, [=] { memset(to, value, bytes); });
}
inline cudaError_t cudaStreamCreateWithFlags(cudaStream_t *ret, unsigned) {
    *ret = new emu_stream;
    return cudaSuccess;
}
inline cudaError_t cudaStreamDestroy(cudaStream_t s) {
    delete s;
    return cudaSuccess;
}
inline cudaError_t cudaStreamSynchronize(cudaStream_t s) {
    return emu::catch_up(s);
}
inline cudaError_t cudaStreamWaitEvent(cudaStream_t s, cudaEvent_t e, unsigned) {
    s->knows = e->launched;
    return emu::sticky;
}
inline cudaError_t cudaStreamBeginCapture(cudaStream_t s, int) {
    s->capturing = true;
    s->operations.clear();
    return cudaSuccess;
}
inline cudaError_t cudaStreamEndCapture(cudaStream_t s, cudaGraph_t *ret) {
    s->capturing = false;
    *ret = new std::vector<std::function<void()>>();
    s->operations.swap(**ret);
    return cudaSuccess;
}
inline cudaError_t cudaGraphInstantiate(cudaGraphExec_t *ret, cudaGraph_t graph, unsigned long) {
    *ret = new std::vector<std::function<void()>>(*graph);
    return cudaSuccess;
}
inline cudaError_t cudaGraphDestroy(cudaGraph_t g) {
    delete g;
    return cudaSuccess;
}
inline cudaError_t cudaGraphExecDestroy(cudaGraphExec_t g) {
    delete g;
    return cudaSuccess;
}
inline cudaError_t cudaGraphLaunch(cudaGraphExec_t g, cudaStream_t) {
    emu::maybe_lose();
    if (emu::sticky) return emu::sticky;
    for (const std::function<void()> &operation : *g)
        operation();
    return cudaSuccess;
}
inline cudaError_t cudaEventCreate(cudaEvent_t *ret) {
    *ret = new emu_event();
    return cudaSuccess;
}
inline cudaError_t cudaEventDestroy(cudaEvent_t e) {
    delete e;
    return cudaSuccess;
}
inline cudaError_t cudaEventRecord(cudaEvent_t e, cudaStream_t s) {
    e->stream = s;
    e->launched = emu::launched;
    return emu::enqueue(s, [=] { clock_gettime(CLOCK_MONOTONIC, &e->at); });
}
inline cudaError_t cudaEventSynchronize(cudaEvent_t e) {
    return emu::catch_up(e->stream);
}
inline cudaError_t cudaEventElapsedTime(float *ret_ms, cudaEvent_t from, cudaEvent_t to) {
    *ret_ms =
        1e3f * (float)(to->at.tv_sec - from->at.tv_sec) +
        1e-6f * (float)(to->at.tv_nsec - from->at.tv_nsec);
    return cudaSuccess;
}
namespace emu {
enum { SHARED_AT_FIRST = 48 << 10 }; // bytes a block that a kernel may have unasked
inline std::map<const void *, size_t> shared_allowed;
template <typename F> void check_shared(const char *name, F kernel, size_t bytes) {
    size_t allowed = std::max<size_t>(SHARED_AT_FIRST, shared_allowed[(const void *)kernel]);
    m.kernel = name;
    if (bytes > allowed) die("launched with more shared memory than it was allowed");
}
} // namespace emu
template <typename F> cudaError_t cudaFuncSetAttribute(F kernel, int, int bytes) {
    if ((size_t)bytes > emu::shared_most) return cudaErrorInvalidValue;
    emu::shared_allowed[(const void *)kernel] = (size_t)bytes;
    return cudaSuccess;
}
template <typename F>
cudaError_t cudaOccupancyMaxActiveBlocksPerMultiprocessor(int *ret, F, int, size_t) {
    *ret = 2;
    return cudaSuccess;
}

namespace emu {
// The arguments as they are now, also where a graph that is captured runs the kernel later.
template <typename... P, typename... A>
cudaError_t launch_with(const char *name, void (*kernel)(P...), dim3 grid, dim3 block,
                        size_t shared, cudaStream_t stream, const A &...arguments) {
    std::tuple<P...> frozen(arguments...);
    if (skips && strstr(name, skips)) return sticky;
    stream->computes = true;
    launched++;
    return enqueue(stream, [=] {
        check_shared(name, kernel, shared);
        launch(name, grid, block, shared, [&] { std::apply(kernel, frozen); });
    });
}
} // namespace emu

// kernel<<<grid, block, shared, stream>>>(...)
#define RN_LAUNCH(kernel, grid, block, shared, stream, ...)                                        \
    emu::launch_with(#kernel, kernel, grid, block, shared, stream, __VA_ARGS__)

#endif

#include "common/image/lpips.h"

#include <errno.h>
#include <fcntl.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/threads.h"

#define MOST_HEADER (1 << 24) // bytes of the file's JSON
#define BLOCK 8               // output channels that one thread computes at once
#define TINY 1e-10f           // added to the length of a pixel's features
#define SMALLEST 16

// VGG-16's convolutions of 3 x 3; behind the last of each slice features are compared, then
// pooled.
static const struct {
    int slice, index, in, out;
    bool last;
} layers[] = {{1, 0, 3, 64, false},    {1, 2, 64, 64, true},     {2, 5, 64, 128, false},
              {2, 7, 128, 128, true},  {3, 10, 128, 256, false}, {3, 12, 256, 256, false},
              {3, 14, 256, 256, true}, {4, 17, 256, 512, false}, {4, 19, 512, 512, false},
              {4, 21, 512, 512, true}, {5, 24, 512, 512, false}, {5, 26, 512, 512, false},
              {5, 28, 512, 512, true}};
enum { LAYERS = sizeof layers / sizeof *layers, SLICES = 5 };

// Means and deviations of colours in [-1, 1] that the network was trained on.
static const float shift[3] = {-.030f, -.088f, -.188f}, scale[3] = {.458f, .448f, .450f};

struct rn_lpips {
    void *file;
    size_t size;
    const float *weight[LAYERS], *bias[LAYERS], *importance[SLICES];
};

// ---- the file -------------------------------------------------------------------------------

// A tensor's numbers, which must have these sizes.
static enum rn_status find_tensor(const struct rn_lpips *lpips, const char *path,
                                  const json_t *header, const char *name, const int sizes[4],
                                  const float **ret_values, struct rn_error *err) {
    const json_t *tensor = json_object_get(header, name), *shape, *offsets;
    size_t begin = 0, end = 0, count = 1, rank = 0, first = 0;
    if (!tensor)
        return rn_error_set(err, RN_ERROR_INVALID, path,
                            "has no tensor %s; these are not the weights of LPIPS with VGG", name);
    memcpy(&first, lpips->file, sizeof first);
    first += 8;
    shape = json_object_get(tensor, "shape");
    offsets = json_object_get(tensor, "data_offsets");
    bool fits = true;
    for (; rank < 4 && sizes[rank]; rank++) {
        count *= (size_t)sizes[rank];
        fits = fits && json_integer_value(json_array_get(shape, rank)) == sizes[rank];
    }
    const char *type = json_string_value(json_object_get(tensor, "dtype"));
    if (!fits || json_array_size(shape) != rank || !type || strcmp(type, "F32") != 0)
        return rn_error_set(err, RN_ERROR_INVALID, path,
                            "tensor %s must be F32 of %zu numbers in %zu dimensions", name, count,
                            rank);
    begin = (size_t)json_integer_value(json_array_get(offsets, 0));
    end = (size_t)json_integer_value(json_array_get(offsets, 1));
    size_t room = lpips->size - first;
    if (begin > room || end > room || end < begin || end - begin != count * sizeof(float) ||
        (first + begin) % sizeof(float) != 0)
        return rn_error_set(err, RN_ERROR_CORRUPT, path,
                            "tensor %s does not lie where the file's head says", name);
    *ret_values = (const float *)((const char *)lpips->file + first + begin);
    return RN_OK;
}

static enum rn_status find_tensors(struct rn_lpips *lpips, const char *path, const json_t *header,
                                   struct rn_error *err) {
    enum rn_status status = RN_OK;
    char name[64];
    for (int i = 0; i < LAYERS && !status; i++) {
        int in = layers[i].in, out = layers[i].out;
        snprintf(name, sizeof name, "net.slice%d.%d.weight", layers[i].slice, layers[i].index);
        status =
            find_tensor(lpips, path, header, name, (int[4]){out, in, 3, 3}, &lpips->weight[i], err);
        snprintf(name, sizeof name, "net.slice%d.%d.bias", layers[i].slice, layers[i].index);
        if (!status)
            status = find_tensor(lpips, path, header, name, (int[4]){out}, &lpips->bias[i], err);
        if (status || !layers[i].last) continue;
        snprintf(name, sizeof name, "lin%d.model.1.weight", layers[i].slice - 1);
        status = find_tensor(lpips, path, header, name, (int[4]){1, out, 1, 1},
                             &lpips->importance[layers[i].slice - 1], err);
    }
    return status;
}

static enum rn_status map_file(const char *path, struct rn_lpips *lpips, struct rn_error *err) {
    struct stat about;
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0 || fstat(fd, &about) != 0 || about.st_size < 16) {
        enum rn_status status =
            fd < 0 ? rn_error_set(err, RN_ERROR_NOT_FOUND, path, "%s", strerror(errno))
                   : rn_error_set(err, RN_ERROR_CORRUPT, path, "is no safetensors file");
        if (fd >= 0) close(fd);
        return status;
    }
    lpips->size = (size_t)about.st_size;
    lpips->file = mmap(NULL, lpips->size, PROT_READ, MAP_PRIVATE, fd, 0);
    close(fd);
    if (lpips->file != MAP_FAILED) return RN_OK;
    lpips->file = NULL;
    return rn_error_set(err, RN_ERROR_IO, path, "%s", strerror(errno));
}

enum rn_status rn_lpips_open(const char *path, struct rn_lpips **ret_lpips, struct rn_error *err) {
    struct rn_lpips *lpips = calloc(1, sizeof *lpips);
    if (!lpips) return rn_error_set(err, RN_ERROR_NO_MEMORY, path, "out of memory");
    json_t *header = NULL;
    uint64_t length = 0;
    enum rn_status status = map_file(path, lpips, err);
    if (!status) {
        memcpy(&length, lpips->file, sizeof length);
        if (length <= MOST_HEADER && length <= lpips->size - 8)
            header = json_loadb((const char *)lpips->file + 8, (size_t)length, 0, NULL);
        status = header ? find_tensors(lpips, path, header, err)
                        : rn_error_set(err, RN_ERROR_CORRUPT, path, "is no safetensors file");
    }
    json_decref(header);
    if (status)
        rn_lpips_close(&lpips);
    else
        *ret_lpips = lpips;
    return status;
}

void rn_lpips_close(struct rn_lpips **lpips) {
    if (!*lpips) return;
    if ((*lpips)->file) munmap((*lpips)->file, (*lpips)->size);
    free(*lpips);
    *lpips = NULL;
}

// ---- features -------------------------------------------------------------------------------

// Channels of height x width numbers, with a border of one zero around each.
struct features {
    float *values;
    int channels, height, width;
};

static size_t stride_of(const struct features *f) {
    return (size_t)f->width + 2;
}

static size_t plane_of(const struct features *f) {
    return stride_of(f) * ((size_t)f->height + 2);
}

// The first number of a row within the border.
static float *row_of(const struct features *f, int channel, int y) {
    return f->values + (size_t)channel * plane_of(f) + ((size_t)y + 1) * stride_of(f) + 1;
}

static bool make_features(int channels, int height, int width, struct features *ret) {
    *ret = (struct features){NULL, channels, height, width};
    ret->values = calloc((size_t)channels * plane_of(ret), sizeof(float));
    return ret->values;
}

struct convolution {
    const struct features *in;
    struct features *out;
    const float *weight, *bias;
    _Atomic bool failed; // out of memory
};

// One row of BLOCK output channels. Contraction is off: all machines round alike.
#ifdef __x86_64__
#ifndef __SANITIZE_THREAD__ // which is not there yet when the loader chooses a clone
__attribute__((target_clones("avx512f", "avx2", "default")))
#endif
#endif
static void
convolve_row(const struct convolution *c, int block, int y, float *restrict sums) {
    int width = c->in->width;
    for (int o = 0; o < BLOCK; o++)
        for (int x = 0; x < width; x++)
            sums[o * width + x] = c->bias[block + o];
    for (int i = 0; i < c->in->channels; i++)
        for (int dy = -1; dy <= 1; dy++) {
            const float *from = row_of(c->in, i, y + dy) - 1;
            for (int o = 0; o < BLOCK; o++) {
                const float *w = c->weight +
                                 ((size_t)(block + o) * (size_t)c->in->channels + (size_t)i) * 9 +
                                 3 * (dy + 1);
                float left = w[0], middle = w[1], right = w[2], *to = sums + o * width;
                for (int x = 0; x < width; x++)
                    to[x] += left * from[x] + middle * from[x + 1] + right * from[x + 2];
            }
        }
    for (int o = 0; o < BLOCK; o++) {
        float *to = row_of(c->out, block + o, y);
        for (int x = 0; x < width; x++)
            to[x] = sums[o * width + x] > 0 ? sums[o * width + x] : 0;
    }
}

// A block of output channels.
static void convolve_block(void *context, size_t index) {
    struct convolution *c = context;
    int block = (int)index * BLOCK;
    float *sums = malloc(BLOCK * (size_t)c->in->width * sizeof *sums);
    if (!sums) c->failed = true;
    for (int y = 0; y < c->in->height && sums; y++)
        convolve_row(c, block, y, sums);
    free(sums);
}

// Replaces features by those behind layer `i`.
static bool convolve(const struct rn_lpips *lpips, int i, int threads, struct features *f) {
    struct features out;
    if (!make_features(layers[i].out, f->height, f->width, &out)) return false;
    struct convolution c = {f, &out, lpips->weight[i], lpips->bias[i], false};
    rn_parallel_for(threads, (size_t)layers[i].out / BLOCK, convolve_block, &c);
    free(f->values);
    *f = out;
    return !c.failed;
}

// Replaces features by the largest of each 2 x 2.
static bool pool(struct features *f) {
    struct features out;
    if (!make_features(f->channels, f->height / 2, f->width / 2, &out)) return false;
    for (int c = 0; c < out.channels; c++)
        for (int y = 0; y < out.height; y++) {
            const float *upper = row_of(f, c, 2 * y), *lower = row_of(f, c, 2 * y + 1);
            float *to = row_of(&out, c, y);
            for (int x = 0; x < out.width; x++)
                to[x] = fmaxf(fmaxf(upper[2 * x], upper[2 * x + 1]),
                              fmaxf(lower[2 * x], lower[2 * x + 1]));
        }
    free(f->values);
    *f = out;
    return true;
}

static bool take_picture(const struct rn_picture *picture, struct features *ret) {
    if (!make_features(3, picture->height, picture->width, ret)) return false;
    for (int c = 0; c < 3; c++)
        for (int y = 0; y < picture->height; y++) {
            const float *from = picture->values + (size_t)y * (size_t)picture->width * 3 + c;
            float *to = row_of(ret, c, y);
            for (int x = 0; x < picture->width; x++)
                to[x] = (2 * from[3 * x] - 1 - shift[c]) / scale[c];
        }
    return true;
}

// ---- the distance ---------------------------------------------------------------------------

static float length_at(const struct features *f, int y, int x) {
    float squares = 0;
    for (int c = 0; c < f->channels; c++) {
        float value = row_of(f, c, y)[x];
        squares += value * value;
    }
    return sqrtf(squares) + TINY;
}

// The mean over pixels of how features of unit length differ, weighted by channel.
static double distance(const struct features *a, const struct features *b,
                       const float *importance) {
    double sum = 0;
    for (int y = 0; y < a->height; y++)
        for (int x = 0; x < a->width; x++) {
            float of_a = length_at(a, y, x), of_b = length_at(b, y, x);
            for (int c = 0; c < a->channels; c++) {
                float apart = row_of(a, c, y)[x] / of_a - row_of(b, c, y)[x] / of_b;
                sum += (double)(importance[c] * apart * apart);
            }
        }
    return sum / ((double)a->height * a->width);
}

// How a comparison is made.
struct run {
    const struct rn_lpips *lpips;
    int threads;
    bool (*keep_going)(void *context);
    void *context;
};

static enum rn_status compare(const struct run *run, struct features *a, struct features *b,
                              double *ret_distance) {
    double sum = 0;
    for (int i = 0; i < LAYERS; i++) {
        if (run->keep_going && !run->keep_going(run->context)) return RN_ERROR_CANCELLED;
        if (!convolve(run->lpips, i, run->threads, a) || !convolve(run->lpips, i, run->threads, b))
            return RN_ERROR_NO_MEMORY;
        if (!layers[i].last) continue;
        sum += distance(a, b, run->lpips->importance[layers[i].slice - 1]);
        if (i + 1 < LAYERS && (!pool(a) || !pool(b))) return RN_ERROR_NO_MEMORY;
    }
    *ret_distance = sum;
    return RN_OK;
}

enum rn_status rn_lpips_compare(const struct rn_lpips *lpips, const struct rn_picture *a,
                                const struct rn_picture *b, int threads,
                                bool (*keep_going)(void *context), void *context,
                                double *ret_distance, struct rn_error *err) {
    struct run run = {lpips, threads, keep_going, context};
    struct features of_a = {NULL}, of_b = {NULL};
    *ret_distance = NAN;
    if (a->width != b->width || a->height != b->height || a->channels != 3 || b->channels != 3)
        return rn_error_set(err, RN_ERROR_INVALID, "", "pictures of two sizes or not of colours");
    if (a->width < SMALLEST || a->height < SMALLEST) return RN_OK;
    enum rn_status status = take_picture(a, &of_a) && take_picture(b, &of_b)
                                ? compare(&run, &of_a, &of_b, ret_distance)
                                : RN_ERROR_NO_MEMORY;
    free(of_a.values);
    free(of_b.values);
    if (status == RN_ERROR_CANCELLED) return rn_error_set(err, status, "", "stopped");
    if (status != RN_ERROR_NO_MEMORY) return status;
    return rn_error_set(err, status, "", "LPIPS of %dx%d pixels needs %zu MiB of memory", a->width,
                        a->height, ((size_t)a->width * (size_t)a->height * 770) >> 20);
}

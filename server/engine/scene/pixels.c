#include "server/engine/scene/pixels.h"

#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

// Lists the wanted frames, finest scale first.
static enum rn_status list_frames(const struct rn_dataset *dataset,
                                  bool (*wanted)(void *, const struct rn_frame *), void *context,
                                  struct rn_pixels *pixels, struct rn_error *err) {
    bool *take = calloc(dataset->frame_count + 1, sizeof *take);
    pixels->frames = calloc(dataset->frame_count + 1, sizeof *pixels->frames);
    if (!take || !pixels->frames) {
        free(take);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, dataset->name, "out of memory");
    }
    for (size_t i = 0; i < dataset->frame_count; i++) {
        const struct rn_frame *frame = &dataset->frames[i];
        take[i] = wanted(context, frame);
        if (take[i] && frame->scale + 1 > pixels->scale_count)
            pixels->scale_count = frame->scale + 1;
    }
    for (int scale = 0; scale < pixels->scale_count; scale++) {
        pixels->scale_first[scale] = pixels->frame_count;
        for (size_t i = 0; i < dataset->frame_count; i++) {
            const struct rn_frame *frame = &dataset->frames[i];
            if (!take[i] || frame->scale != scale) continue;
            pixels->frames[pixels->frame_count++] =
                (struct rn_pixel_frame){.frame = frame,
                                        .camera = frame->camera,
                                        .offset = pixels->pixel_count,
                                        .before = pixels->scale_pixels[scale]};
            size_t n = (size_t)frame->camera.width * (size_t)frame->camera.height;
            pixels->scale_pixels[scale] += n;
            pixels->pixel_count += n;
        }
    }
    free(take);
    return RN_OK;
}

enum rn_status rn_mask_read(const struct rn_frame *frame, uint8_t *used, struct rn_error *err) {
    struct rn_image mask;
    enum rn_status status = rn_image_read(frame->mask_path, &rn_image_default_limits, &mask, err);
    if (status != RN_OK) return status;
    int w = frame->camera.width, h = frame->camera.height;
    if (mask.width != w || mask.height != h)
        status = rn_error_set(err, RN_ERROR_CORRUPT, frame->mask_path,
                              "is %dx%d but its photograph is %dx%d; import the dataset again",
                              mask.width, mask.height, w, h);
    for (size_t i = 0; status == RN_OK && i < (size_t)w * (size_t)h; i++)
        used[i] = mask.pixels[4 * i] >= 128;
    rn_image_finish(&mask);
    return status;
}

size_t rn_pixels_used(const struct rn_pixels *pixels, const struct rn_pixel_frame *frame) {
    size_t count = 0, n = (size_t)frame->camera.width * (size_t)frame->camera.height;
    if (!pixels->used) return n;
    for (size_t i = 0; i < n; i++)
        count += pixels->used[frame->offset + i];
    return count;
}

struct decode {
    struct rn_engine *engine;
    struct rn_pixels *pixels;
    bool even;
    atomic_bool cancelled;
    enum rn_status *status; // per frame
    struct rn_error *errors;
};

// Divides colours by the photograph's gains.
static void make_even(const double gain[3], uint8_t *rgba, size_t count) {
    uint8_t becomes[3][256];
    if (!(gain[0] > 0)) return;
    for (int c = 0; c < 3; c++)
        for (int v = 0; v < 256; v++)
            becomes[c][v] = (uint8_t)fmin(255, floor(v / gain[c] + 0.5));
    for (size_t i = 0; i < count; i++)
        for (int c = 0; c < 3; c++)
            rgba[4 * i + (size_t)c] = becomes[c][rgba[4 * i + (size_t)c]];
}

static void decode_frame(void *context, int index, int thread) {
    struct decode *decode = context;
    const struct rn_engine *engine = decode->engine; // its watcher is asked on its own thread
    if (thread == 0 && engine->keep_going && !engine->keep_going(engine->watcher))
        decode->cancelled = true;
    if (decode->cancelled) return;
    const struct rn_pixel_frame *f = &decode->pixels->frames[index];
    struct rn_error *err = &decode->errors[index];
    struct rn_image image;
    enum rn_status status = rn_image_read(f->frame->path, &rn_image_default_limits, &image, err);
    if (status == RN_OK) {
        int w = f->frame->camera.width, h = f->frame->camera.height;
        if (image.width != w || image.height != h)
            status = rn_error_set(err, RN_ERROR_CORRUPT, f->frame->path,
                                  "is %dx%d but the dataset says %dx%d; import it again",
                                  image.width, image.height, w, h);
        else
            memcpy(decode->pixels->rgba + 4 * f->offset, image.pixels, (size_t)w * h * 4);
        if (status == RN_OK && decode->even)
            make_even(f->frame->gain, decode->pixels->rgba + 4 * f->offset, (size_t)w * h);
        rn_image_finish(&image);
    }
    if (status == RN_OK && f->frame->mask_path)
        status = rn_mask_read(f->frame, decode->pixels->used + f->offset, err);
    decode->status[index] = status;
}

static enum rn_status decode_all(struct rn_pixels *pixels, struct rn_engine *engine, bool even,
                                 struct rn_error *err) {
    size_t n = (size_t)pixels->frame_count;
    struct decode decode = {.engine = engine,
                            .pixels = pixels,
                            .even = even,
                            .status = calloc(n + 1, sizeof(enum rn_status)),
                            .errors = calloc(n + 1, sizeof(struct rn_error))};
    enum rn_status status = RN_ERROR_NO_MEMORY;
    if (decode.status && decode.errors) {
        rn_pool_run(engine->pool, pixels->frame_count, decode_frame, &decode);
        status = RN_OK;
        if (decode.cancelled)
            status = rn_error_set(err, RN_ERROR_CANCELLED, "images", "stopped while loading");
        for (size_t i = 0; i < n && status == RN_OK; i++) {
            status = decode.status[i];
            if (status != RN_OK && err) *err = decode.errors[i];
        }
    }
    free(decode.status);
    free(decode.errors);
    return status;
}

enum rn_status rn_pixels_load(const struct rn_dataset *dataset,
                              bool (*wanted)(void *, const struct rn_frame *), void *context,
                              struct rn_engine *engine, bool even, size_t limit_bytes,
                              struct rn_pixels *ret_pixels, struct rn_error *err) {
    struct rn_pixels pixels = {0};
    enum rn_status status = list_frames(dataset, wanted, context, &pixels, err);
    if (status != RN_OK) goto fail;
    if (pixels.frame_count == 0) {
        status = rn_error_set(err, RN_ERROR_INVALID, dataset->name, "has no usable training image");
        goto fail;
    }
    bool masked = false;
    for (int f = 0; f < pixels.frame_count; f++)
        masked = masked || pixels.frames[f].frame->mask_path;
    size_t bytes = pixels.pixel_count * (masked ? 5 : 4);
    if (limit_bytes && bytes > limit_bytes) {
        status = rn_error_set(err, RN_ERROR_LIMIT, dataset->name,
                              "its pixels need %zu MiB and %zu MiB are left; import it with a "
                              "smaller --max-size",
                              bytes >> 20, limit_bytes >> 20);
        goto fail;
    }
    pixels.rgba = rn_block_create(pixels.pixel_count * 4);
    if (masked) pixels.used = rn_block_create(pixels.pixel_count);
    if (pixels.used) memset(pixels.used, 1, pixels.pixel_count);
    if (!pixels.rgba || (masked && !pixels.used)) {
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, dataset->name,
                              "its pixels need %zu MiB; import it with a smaller --max-size",
                              bytes >> 20);
        goto fail;
    }
    status = decode_all(&pixels, engine, even, err);
    if (status != RN_OK) goto fail;
    *ret_pixels = pixels;
    return RN_OK;
fail:
    rn_pixels_finish(&pixels);
    return status;
}

void rn_pixels_finish(struct rn_pixels *pixels) {
    free(pixels->frames);
    rn_block_destroy(pixels->rgba);
    rn_block_destroy(pixels->used);
    memset(pixels, 0, sizeof *pixels);
}

// The finest frame of a frame's view, where the one is a whole number of times as large; else NULL.
static const struct rn_pixel_frame *finest_of(const struct rn_pixels *pixels,
                                              const struct rn_pixel_frame *frame) {
    int i = (int)(frame - pixels->frames) - pixels->scale_first[frame->frame->scale];
    int factor = 1 << frame->frame->scale;
    if (i >= pixels->scale_first[1]) return NULL;
    const struct rn_pixel_frame *finest = &pixels->frames[i];
    bool same = finest->frame->split == frame->frame->split &&
                finest->frame->index == frame->frame->index &&
                finest->camera.width == factor * frame->camera.width &&
                finest->camera.height == factor * frame->camera.height;
    return same ? finest : NULL;
}

// The mean of factor x factor pixels, colours weighted by opacity.
static void weighted_mean(const struct rn_pixels *pixels, const struct rn_pixel_frame *finest,
                          int factor, int x, int y, uint8_t ret_rgba[4]) {
    uint64_t colour[3] = {0}, alpha = 0;
    for (int j = 0; j < factor; j++) {
        const uint8_t *from = rn_pixel_at(pixels, finest, x * factor, y * factor + j);
        for (int i = 0; i < factor; i++, from += 4) {
            alpha += from[3];
            for (int c = 0; c < 3; c++)
                colour[c] += (uint64_t)from[c] * from[3];
        }
    }
    uint64_t area = (uint64_t)factor * (uint64_t)factor;
    for (int c = 0; c < 3; c++)
        ret_rgba[c] = alpha > 0 ? (uint8_t)((2 * colour[c] + alpha) / (2 * alpha)) : 0;
    ret_rgba[3] = (uint8_t)((2 * alpha + area) / (2 * area));
}

double rn_pixels_scale_error(const struct rn_pixels *pixels, int frames) {
    static const float white[3] = {1, 1, 1};
    int scale = pixels->scale_count - 1, first = pixels->scale_first[scale];
    int count = pixels->frame_count - first;
    double squares = 0, channels = 0;
    for (int i = 0; i < frames && i < count; i++) {
        const struct rn_pixel_frame *frame = &pixels->frames[first + i * count / frames];
        const struct rn_pixel_frame *finest = finest_of(pixels, frame);
        for (int p = 0; finest && p < frame->camera.width * frame->camera.height; p++) {
            int x = p % frame->camera.width, y = p / frame->camera.width;
            uint8_t mean[4];
            float is[3];
            weighted_mean(pixels, finest, 1 << scale, x, y, mean);
            if (mean[3] == 0 || mean[3] == 255) continue;
            (void)rn_pixel_over(mean, white, is);
            double sum = 0;
            rn_pixel_add_error(pixels, frame, x, y, white, is, &sum);
            squares += sum;
            channels += 3;
        }
    }
    return channels > 0 ? sqrt(squares / channels) : 0;
}

struct remake {
    struct rn_pixels *pixels;
    int first; // frame of coarser scales
};

static void remake_frame(void *context, int index, int thread) {
    (void)thread;
    struct remake *remake = context;
    struct rn_pixels *pixels = remake->pixels;
    const struct rn_pixel_frame *frame = &pixels->frames[remake->first + index];
    const struct rn_pixel_frame *finest = finest_of(pixels, frame);
    int width = frame->camera.width;
    for (int p = 0; finest && p < width * frame->camera.height; p++)
        weighted_mean(pixels, finest, 1 << frame->frame->scale, p % width, p / width,
                      pixels->rgba + 4 * (frame->offset + (size_t)p));
}

void rn_pixels_remake_scales(struct rn_pixels *pixels, struct rn_engine *engine) {
    if (pixels->scale_count < 2) return;
    struct remake remake = {pixels, pixels->scale_first[1]};
    rn_pool_run(engine->pool, pixels->frame_count - remake.first, remake_frame, &remake);
}

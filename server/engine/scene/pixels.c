#include "server/engine/scene/pixels.h"

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

struct decode {
    struct rn_engine *engine;
    struct rn_pixels *pixels;
    atomic_bool cancelled;
    enum rn_status *status; // per frame
    struct rn_error *errors;
};

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
        rn_image_finish(&image);
    }
    decode->status[index] = status;
}

static enum rn_status decode_all(struct rn_pixels *pixels, struct rn_engine *engine,
                                 struct rn_error *err) {
    size_t n = (size_t)pixels->frame_count;
    struct decode decode = {.engine = engine,
                            .pixels = pixels,
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
                              struct rn_engine *engine, size_t limit_bytes,
                              struct rn_pixels *ret_pixels, struct rn_error *err) {
    struct rn_pixels pixels = {0};
    enum rn_status status = list_frames(dataset, wanted, context, &pixels, err);
    if (status != RN_OK) goto fail;
    if (pixels.frame_count == 0) {
        status = rn_error_set(err, RN_ERROR_INVALID, dataset->name, "has no usable training image");
        goto fail;
    }
    size_t bytes = pixels.pixel_count * 4;
    if (limit_bytes && bytes > limit_bytes) {
        status = rn_error_set(err, RN_ERROR_LIMIT, dataset->name,
                              "its pixels need %zu MiB and %zu MiB are left; import it with a "
                              "smaller --max-size",
                              bytes >> 20, limit_bytes >> 20);
        goto fail;
    }
    pixels.rgba = rn_block_create(bytes);
    if (!pixels.rgba) {
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, dataset->name,
                              "its pixels need %zu MiB; import it with a smaller --max-size",
                              bytes >> 20);
        goto fail;
    }
    status = decode_all(&pixels, engine, err);
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
    memset(pixels, 0, sizeof *pixels);
}

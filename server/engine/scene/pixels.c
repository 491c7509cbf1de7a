#include "server/engine/scene/pixels.h"

#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

// Lists the wanted frames, finest scale first.
static enum rn_status list_frames(const struct rn_dataset *dataset,
                                  bool (*wanted)(void *, const struct rn_frame *), void *context,
                                  int reduced, struct rn_pixels *pixels, struct rn_error *err) {
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
                                        .camera = rn_camera_reduced(&frame->camera, reduced),
                                        .offset = pixels->pixel_count,
                                        .before = pixels->scale_pixels[scale]};
            const struct rn_camera *camera = &pixels->frames[pixels->frame_count - 1].camera;
            size_t n = (size_t)camera->width * (size_t)camera->height;
            pixels->scale_pixels[scale] += n;
            pixels->pixel_count += n;
        }
    }
    free(take);
    return RN_OK;
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
    struct rn_pixel_treatment treatment;
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

// What a mask leaves out becomes transparent.
static void cut_out(const uint8_t *used, struct rn_image *image) {
    size_t count = (size_t)image->width * (size_t)image->height;
    for (size_t i = 0; i < count; i++)
        if (!used[i]) image->pixels[4 * i + 3] = 0;
}

// In part made smaller already, where that is quick: `most` times at most.
static enum rn_status read_photo(const struct rn_frame *frame, int most, struct rn_image *ret_image,
                                 struct rn_error *err) {
    int w = frame->camera.width, h = frame->camera.height, times;
    enum rn_status status =
        rn_image_read_smaller(frame->path, &rn_image_default_limits, most, ret_image, &times, err);
    if (status != RN_OK || (ret_image->width * times == w && ret_image->height * times == h))
        return status;
    rn_error_set(err, RN_ERROR_CORRUPT, frame->path,
                 "is %dx%d but the dataset says %dx%d; import it again", ret_image->width * times,
                 ret_image->height * times, w, h);
    rn_image_finish(ret_image);
    return RN_ERROR_CORRUPT;
}

static enum rn_status read_mask(const struct rn_frame *frame, uint8_t **ret_used,
                                struct rn_error *err) {
    uint8_t *used = malloc((size_t)frame->camera.width * (size_t)frame->camera.height);
    if (!used) return rn_error_set(err, RN_ERROR_NO_MEMORY, frame->mask_path, "out of memory");
    enum rn_status status = rn_mask_read(frame, used, err);
    if (status == RN_OK)
        *ret_used = used;
    else
        free(used);
    return status;
}

static enum rn_status keep_colours(const struct decode *decode, const struct rn_pixel_frame *f,
                                   const struct rn_image *image, struct rn_error *err) {
    uint8_t *to = decode->pixels->rgba + 4 * f->offset;
    size_t count = (size_t)f->camera.width * (size_t)f->camera.height;
    if (f->camera.width == image->width && f->camera.height == image->height) {
        memcpy(to, image->pixels, 4 * count);
    } else {
        struct rn_image small;
        enum rn_status status = rn_image_downscale(image, f->camera.width, f->camera.height,
                                                   RN_DOWNSCALE_PREMULTIPLIED, &small, err);
        if (status != RN_OK) return status;
        memcpy(to, small.pixels, 4 * count);
        rn_image_finish(&small);
    }
    if (decode->treatment.even) make_even(f->frame->gain, to, count);
    return RN_OK;
}

// A pixel is left out where any of those that it is made of is.
static void keep_mask(const struct decode *decode, const struct rn_pixel_frame *f,
                      const uint8_t *used) {
    int w = f->frame->camera.width, h = f->frame->camera.height;
    int64_t width = f->camera.width, height = f->camera.height;
    uint8_t *to = decode->pixels->used + f->offset;
    for (int64_t y = 0; y < h; y++)
        for (int64_t x = 0; x < w; x++, used++)
            for (int64_t j = y * height / h; !*used && j <= ((y + 1) * height - 1) / h; j++)
                for (int64_t i = x * width / w; i <= ((x + 1) * width - 1) / w; i++)
                    to[j * width + i] = 0;
}

static enum rn_status decode_photo(const struct decode *decode, const struct rn_pixel_frame *f,
                                   struct rn_error *err) {
    bool masked = f->frame->mask_path && !decode->treatment.unmasked;
    size_t count = (size_t)f->camera.width * (size_t)f->camera.height;
    uint8_t *used = NULL;
    struct rn_image image;
    // A mask that cuts out is of whole photographs.
    int most = masked && decode->treatment.cut_out ? 1 : decode->treatment.reduced;
    if (decode->pixels->used) memset(decode->pixels->used + f->offset, 1, count);
    enum rn_status status = read_photo(f->frame, most, &image, err);
    if (status != RN_OK) return status;
    if (masked) status = read_mask(f->frame, &used, err);
    if (status == RN_OK && masked && decode->treatment.cut_out) cut_out(used, &image);
    if (status == RN_OK) status = keep_colours(decode, f, &image, err);
    if (status == RN_OK && masked && !decode->treatment.cut_out) keep_mask(decode, f, used);
    rn_image_finish(&image);
    free(used);
    return status;
}

static void decode_frame(void *context, int index, int thread) {
    struct decode *decode = context;
    const struct rn_engine *engine = decode->engine; // its watcher is asked on its own thread
    if (thread == 0 && engine->keep_going && !engine->keep_going(engine->watcher))
        decode->cancelled = true;
    if (decode->cancelled) return;
    decode->status[index] =
        decode_photo(decode, &decode->pixels->frames[index], &decode->errors[index]);
    rn_pixels_let_go(decode->pixels);
}

static enum rn_status decode_all(struct rn_pixels *pixels, struct rn_engine *engine,
                                 struct rn_pixel_treatment treatment, struct rn_error *err) {
    size_t n = (size_t)pixels->frame_count;
    struct decode decode = {.engine = engine,
                            .pixels = pixels,
                            .treatment = treatment,
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

// Whether they lie on disk rather than in memory.
static bool lies_on_disk(const struct rn_engine *engine, const struct rn_pixel_treatment *treatment,
                         size_t bytes, size_t limit_bytes) {
    if (!*engine->folder) return false;
    size_t most = treatment->memory_bytes;
    return (most && bytes + treatment->taken_bytes > most) || (limit_bytes && bytes > limit_bytes);
}

// Room for the pixels that are listed.
static enum rn_status make_room(const struct rn_engine *engine,
                                const struct rn_pixel_treatment *treatment, const char *name,
                                bool masked, size_t limit_bytes, struct rn_pixels *pixels,
                                struct rn_error *err) {
    size_t count = pixels->pixel_count, bytes = rn_pixels_bytes(count, masked);
    if (lies_on_disk(engine, treatment, bytes, limit_bytes)) {
        enum rn_status status = rn_paged_create(engine->folder, bytes, &pixels->paged, err);
        if (status != RN_OK) return status;
        pixels->held_bytes = treatment->memory_bytes ? treatment->memory_bytes : limit_bytes;
        if (limit_bytes && limit_bytes < pixels->held_bytes) pixels->held_bytes = limit_bytes;
        pixels->rgba = (uint8_t *)pixels->paged.bytes;
        if (masked) pixels->used = pixels->rgba + 4 * count;
        return RN_OK;
    }
    if (limit_bytes && bytes > limit_bytes)
        return rn_error_set(err, RN_ERROR_LIMIT, name,
                            "its pixels need %zu MiB and %zu MiB are left; import it with a "
                            "smaller --max-size, or train with --train-scale",
                            bytes >> 20, limit_bytes >> 20);
    pixels->rgba = rn_block_create(4 * count);
    if (masked) pixels->used = rn_block_create(count);
    if (pixels->rgba && (pixels->used || !masked)) return RN_OK;
    return rn_error_set(err, RN_ERROR_NO_MEMORY, name,
                        "its pixels need %zu MiB; import it with a smaller --max-size, or train "
                        "with --train-scale",
                        bytes >> 20);
}

enum rn_status rn_pixels_load(const struct rn_dataset *dataset,
                              bool (*wanted)(void *, const struct rn_frame *), void *context,
                              struct rn_engine *engine, struct rn_pixel_treatment treatment,
                              size_t limit_bytes, struct rn_pixels *ret_pixels,
                              struct rn_error *err) {
    struct rn_pixels pixels = {0};
    enum rn_status status = list_frames(dataset, wanted, context, treatment.reduced, &pixels, err);
    if (status == RN_OK && pixels.frame_count == 0)
        status = rn_error_set(err, RN_ERROR_INVALID, dataset->name, "has no usable training image");
    bool masked = false;
    for (int f = 0; f < pixels.frame_count; f++)
        masked = masked || (pixels.frames[f].frame->mask_path && !treatment.unmasked);
    masked = masked && !treatment.cut_out;
    if (status == RN_OK)
        status = make_room(engine, &treatment, dataset->name, masked, limit_bytes, &pixels, err);
    if (status == RN_OK) status = decode_all(&pixels, engine, treatment, err);
    if (status == RN_OK)
        *ret_pixels = pixels;
    else
        rn_pixels_finish(&pixels);
    return status;
}

void rn_pixels_finish(struct rn_pixels *pixels) {
    free(pixels->frames);
    if (!pixels->paged.bytes) {
        rn_block_destroy(pixels->rgba);
        rn_block_destroy(pixels->used);
    }
    rn_paged_destroy(&pixels->paged);
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
        rn_pixels_let_go(pixels);
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
    rn_pixels_let_go(pixels);
}

void rn_pixels_remake_scales(struct rn_pixels *pixels, struct rn_engine *engine) {
    if (pixels->scale_count < 2) return;
    struct remake remake = {pixels, pixels->scale_first[1]};
    rn_pool_run(engine->pool, pixels->frame_count - remake.first, remake_frame, &remake);
}

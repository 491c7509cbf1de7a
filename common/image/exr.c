// EXR: linear light, by OpenEXR's own C interface. Colours are clamped to 0 to 1 and go through
// sRGB's curve, as the other formats' are stored; alpha stays linear.
#include <string.h>

#include "common/image/codec.h"

static bool is_exr(const uint8_t *bytes, size_t size_bytes) {
    return size_bytes >= 4 && memcmp(bytes, "\x76\x2f\x31\x01", 4) == 0;
}

#ifdef RN_HAVE_EXR
#include <openexr.h>
#include <stdlib.h>

struct source {
    const uint8_t *bytes;
    size_t size;
};

static int64_t take(exr_const_context_t context, void *user, void *to, uint64_t size,
                    uint64_t offset, exr_stream_error_func_ptr_t say) {
    const struct source *source = user;
    if (offset > source->size) return -1;
    // Headers are read in blocks of 4096 bytes, which may be more than a small file has.
    uint64_t left = source->size - offset, taken = size < left ? size : left;
    memcpy(to, source->bytes + offset, (size_t)taken);
    return (int64_t)taken;
}

static int64_t tell_size(exr_const_context_t context, void *user) {
    return (int64_t)((const struct source *)user)->size;
}

static void ignore_text(exr_const_context_t context, exr_result_t code, const char *text) {}

static enum rn_status damaged(exr_result_t code, const char *where, struct rn_error *err) {
    if (code == EXR_ERR_OUT_OF_MEMORY)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, where, "no memory to read the EXR");
    return rn_error_set(err, RN_ERROR_INVALID, where,
                        "the EXR file is damaged (%.100s): copy or export it again",
                        exr_get_default_error_message(code));
}

// Where a channel goes among R, G, B, A: 0 to 3; Y is all three colours' and goes to R; -1:
// nowhere.
static int place_of(const char *name) {
    static const char *const names[] = {"R", "G", "B", "A", "Y"};
    for (int i = 0; i < 5; i++)
        if (strcmp(name, names[i]) == 0) return i % 4;
    return -1;
}

static enum rn_status open_picture(struct source *source, const char *where,
                                   exr_context_t *ret_context, struct rn_image_info *ret_info,
                                   bool *ret_grey, struct rn_error *err) {
    exr_context_initializer_t how = EXR_DEFAULT_CONTEXT_INITIALIZER;
    how.user_data = source;
    how.read_fn = take;
    how.size_fn = tell_size;
    how.error_handler_fn = ignore_text;
    exr_context_t context = NULL;
    exr_storage_t storage;
    exr_attr_box2i_t window;
    const exr_attr_chlist_t *channels;
    exr_result_t code = exr_start_read(&context, where, &how);
    if (code == EXR_ERR_SUCCESS) code = exr_get_storage(context, 0, &storage);
    if (code == EXR_ERR_SUCCESS) code = exr_get_data_window(context, 0, &window);
    if (code == EXR_ERR_SUCCESS) code = exr_get_channels(context, 0, &channels);
    if (code != EXR_ERR_SUCCESS) {
        if (context) exr_finish(&context);
        return damaged(code, where, err);
    }
    bool found[4] = {false}, sampled = true;
    *ret_grey = false;
    for (int c = 0; c < channels->num_channels; c++) {
        const exr_attr_chlist_entry_t *channel = &channels->entries[c];
        int place = place_of(channel->name.str);
        if (place < 0) continue;
        found[place] = true;
        if (channel->name.str[0] == 'Y') *ret_grey = true;
        sampled = sampled && channel->x_sampling == 1 && channel->y_sampling == 1;
    }
    if (storage != EXR_STORAGE_SCANLINE || !sampled || !found[0]) {
        exr_finish(&context);
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, where,
                            "the EXR file is tiled or deep, or has neither R, G, B nor Y at full "
                            "size: save it as scan lines of RGB");
    }
    int64_t width = (int64_t)window.max.x - window.min.x + 1;
    int64_t height = (int64_t)window.max.y - window.min.y + 1;
    *ret_info = (struct rn_image_info){.width = (int)(width > INT32_MAX ? INT32_MAX : width),
                                       .height = (int)(height > INT32_MAX ? INT32_MAX : height),
                                       .bit_depth = 16,
                                       .has_alpha = found[3],
                                       .linear = true,
                                       .orientation = 1};
    *ret_context = context;
    return RN_OK;
}

static enum rn_status probe_exr(const uint8_t *bytes, size_t size_bytes, const char *where,
                                struct rn_image_info *ret_info, struct rn_error *err) {
    struct source source = {bytes, size_bytes};
    exr_context_t context;
    bool grey;
    enum rn_status status = open_picture(&source, where, &context, ret_info, &grey, err);
    if (status == RN_OK) exr_finish(&context);
    return status;
}

// One chunk of lines into `rows`, RGBA in floats, `height` lines of them at most.
static exr_result_t read_chunk(exr_context_t context, int line, float *rows, int width) {
    exr_chunk_info_t chunk;
    exr_decode_pipeline_t decoder = EXR_DECODE_PIPELINE_INITIALIZER;
    exr_result_t code = exr_read_scanline_chunk_info(context, 0, line, &chunk);
    if (code == EXR_ERR_SUCCESS) code = exr_decoding_initialize(context, 0, &chunk, &decoder);
    if (code != EXR_ERR_SUCCESS) return code;
    for (int c = 0; c < decoder.channel_count; c++) {
        exr_coding_channel_info_t *channel = &decoder.channels[c];
        int place = place_of(channel->channel_name);
        channel->decode_to_ptr = place < 0 ? NULL : (uint8_t *)(rows + place);
        channel->user_pixel_stride = 4 * sizeof *rows;
        channel->user_line_stride = (int32_t)(4 * sizeof *rows * (size_t)width);
        channel->user_bytes_per_element = sizeof *rows;
        channel->user_data_type = EXR_PIXEL_FLOAT;
    }
    code = exr_decoding_choose_default_routines(context, 0, &decoder);
    if (code == EXR_ERR_SUCCESS) code = exr_decoding_run(context, 0, &decoder);
    exr_decoding_destroy(context, &decoder);
    return code;
}

// Premultiplied linear light to straight sRGB.
static void convert_rows(const float *rows, size_t count, bool grey, bool has_alpha,
                         uint8_t *pixels) {
    for (size_t i = 0; i < count; i++, rows += 4, pixels += 4) {
        float alpha = has_alpha ? rows[3] : 1;
        for (int c = 0; c < 3; c++)
            pixels[c] = alpha > 0 ? rn_srgb_byte(rows[grey ? 0 : c] / alpha) : 0;
        pixels[3] = !(alpha > 0) ? 0 : alpha >= 1 ? 255 : (uint8_t)(alpha * 255 + 0.5f);
    }
}

static exr_result_t read_pixels(exr_context_t context, bool grey, struct rn_image *image) {
    int32_t lines;
    exr_attr_box2i_t window;
    exr_result_t code = exr_get_scanlines_per_chunk(context, 0, &lines);
    if (code == EXR_ERR_SUCCESS) code = exr_get_data_window(context, 0, &window);
    if (code != EXR_ERR_SUCCESS) return code;
    size_t width = (size_t)image->width;
    float *rows = calloc(width * (size_t)lines, 4 * sizeof *rows);
    if (!rows) return EXR_ERR_OUT_OF_MEMORY;
    for (int y = 0; y < image->height && code == EXR_ERR_SUCCESS; y += lines) {
        int count = image->height - y < lines ? image->height - y : lines;
        code = read_chunk(context, window.min.y + y, rows, image->width);
        convert_rows(rows, width * (size_t)count, grey, image->has_alpha,
                     image->pixels + 4 * width * (size_t)y);
    }
    free(rows);
    return code;
}

static enum rn_status decode_exr(const uint8_t *bytes, size_t size_bytes, const char *where,
                                 const struct rn_image_limits *limits, struct rn_image *ret_image,
                                 struct rn_error *err) {
    struct source source = {bytes, size_bytes};
    struct rn_image_info info = {0};
    struct rn_image image = {0};
    exr_context_t context;
    bool grey;
    enum rn_status status = open_picture(&source, where, &context, &info, &grey, err);
    if (status) return status;
    status = rn_image_check_size(info.width, info.height, limits, where, err);
    if (status == RN_OK) status = rn_image_init(info.width, info.height, &image, err);
    if (status == RN_OK) {
        image.has_alpha = info.has_alpha;
        exr_result_t code = read_pixels(context, grey, &image);
        if (code != EXR_ERR_SUCCESS) status = damaged(code, where, err);
    }
    exr_finish(&context);
    if (status == RN_OK)
        *ret_image = image;
    else
        rn_image_finish(&image);
    return status;
}
#endif

const struct rn_codec rn_codec_exr = {.title = "EXR",
                                      .library = "libopenexr-dev",
#ifdef RN_HAVE_EXR
                                      .probe = probe_exr,
                                      .decode = decode_exr,
#endif
                                      .is = is_exr};

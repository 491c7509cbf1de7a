// EXR files of rendered planes, by OpenEXR's own C interface, in memory.
#include <string.h>

#include "common/image/image.h"

#ifdef RN_HAVE_EXR
#include <openexr.h>
#include <stdlib.h>

// A file in memory: offsets go back once, to the table of chunks.
struct target {
    uint8_t *bytes;
    size_t size, capacity;
};

static int64_t put(exr_const_context_t context, void *user, const void *from, uint64_t size,
                   uint64_t offset, exr_stream_error_func_ptr_t say) {
    struct target *target = user;
    size_t end = (size_t)(offset + size);
    if (end > target->capacity) {
        size_t capacity = end + end / 2 + 4096;
        uint8_t *grown = realloc(target->bytes, capacity);
        if (!grown) return -1;
        memset(grown + target->size, 0, capacity - target->size);
        target->bytes = grown;
        target->capacity = capacity;
    }
    memcpy(target->bytes + offset, from, (size_t)size);
    if (end > target->size) target->size = end;
    return (int64_t)size;
}

static void ignore_text(exr_const_context_t context, exr_result_t code, const char *text) {}

static exr_result_t describe(exr_context_t context, const struct rn_exr_plane *planes, size_t count,
                             const char *comment) {
    int part;
    const struct rn_picture *first = planes[0].picture;
    exr_result_t code = exr_add_part(context, "picture", EXR_STORAGE_SCANLINE, &part);
    if (code == EXR_ERR_SUCCESS)
        code = exr_initialize_required_attr_simple(context, part, first->width, first->height,
                                                   EXR_COMPRESSION_ZIP);
    for (size_t i = 0; i < count && code == EXR_ERR_SUCCESS; i++)
        code = exr_add_channel(context, part, planes[i].name,
                               planes[i].is_whole ? EXR_PIXEL_FLOAT : EXR_PIXEL_HALF,
                               EXR_PERCEPTUALLY_LINEAR, 1, 1);
    if (code == EXR_ERR_SUCCESS) code = exr_attr_set_string(context, part, "comments", comment);
    if (code == EXR_ERR_SUCCESS) code = exr_write_header(context);
    return code;
}

static const struct rn_exr_plane *find_plane(const struct rn_exr_plane *planes, size_t count,
                                             const char *name) {
    for (size_t i = 0; i < count; i++)
        if (strcmp(planes[i].name, name) == 0) return &planes[i];
    return NULL;
}

// The lines of one chunk, from line `y` on.
static exr_result_t write_chunk(exr_context_t context, const struct rn_exr_plane *planes,
                                size_t count, int y) {
    exr_chunk_info_t chunk;
    exr_encode_pipeline_t encoder = EXR_ENCODE_PIPELINE_INITIALIZER;
    exr_result_t code = exr_write_scanline_chunk_info(context, 0, y, &chunk);
    if (code == EXR_ERR_SUCCESS) code = exr_encoding_initialize(context, 0, &chunk, &encoder);
    if (code != EXR_ERR_SUCCESS) return code;
    for (int c = 0; c < encoder.channel_count; c++) {
        exr_coding_channel_info_t *channel = &encoder.channels[c];
        const struct rn_exr_plane *plane = find_plane(planes, count, channel->channel_name);
        const struct rn_picture *picture = plane->picture;
        size_t stride = (size_t)picture->channels * sizeof(float);
        const float *from =
            picture->values + (size_t)y * (size_t)picture->width * (size_t)picture->channels;
        channel->encode_from_ptr = (const uint8_t *)(from + plane->channel);
        channel->user_pixel_stride = (int32_t)stride;
        channel->user_line_stride = (int32_t)(stride * (size_t)picture->width);
        channel->user_bytes_per_element = sizeof(float);
        channel->user_data_type = EXR_PIXEL_FLOAT;
    }
    code = exr_encoding_choose_default_routines(context, 0, &encoder);
    if (code == EXR_ERR_SUCCESS) code = exr_encoding_run(context, 0, &encoder);
    exr_encoding_destroy(context, &encoder);
    return code;
}

static exr_result_t write_picture(struct target *target, const struct rn_exr_plane *planes,
                                  size_t count, const char *comment) {
    exr_context_initializer_t how = EXR_DEFAULT_CONTEXT_INITIALIZER;
    how.user_data = target;
    how.write_fn = put;
    how.error_handler_fn = ignore_text;
    exr_context_t context = NULL;
    int32_t lines = 1;
    exr_result_t code = exr_start_write(&context, "picture.exr", EXR_WRITE_FILE_DIRECTLY, &how);
    if (code == EXR_ERR_SUCCESS) code = describe(context, planes, count, comment);
    if (code == EXR_ERR_SUCCESS) code = exr_get_scanlines_per_chunk(context, 0, &lines);
    for (int y = 0; y < planes[0].picture->height && code == EXR_ERR_SUCCESS; y += lines)
        code = write_chunk(context, planes, count, y);
    exr_result_t end = context ? exr_finish(&context) : EXR_ERR_SUCCESS;
    return code == EXR_ERR_SUCCESS ? end : code;
}

enum rn_status rn_exr_check(struct rn_error *err) {
    return RN_OK;
}

enum rn_status rn_exr_encode(const struct rn_exr_plane *planes, size_t count, const char *comment,
                             uint8_t **ret_bytes, size_t *ret_size, struct rn_error *err) {
    struct target target = {0};
    for (size_t i = 0; i < count; i++) {
        const struct rn_picture *picture = planes[i].picture;
        if (picture->width != planes[0].picture->width ||
            picture->height != planes[0].picture->height || planes[i].channel < 0 ||
            planes[i].channel >= picture->channels)
            return rn_error_set(err, RN_ERROR_INVALID, planes[i].name,
                                "is of another size than the first plane, or has no such channel");
    }
    if (count < 1) return rn_error_set(err, RN_ERROR_INVALID, "planes", "there are none");
    exr_result_t code = write_picture(&target, planes, count, comment);
    if (code != EXR_ERR_SUCCESS) {
        free(target.bytes);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "cannot write an EXR: %s",
                            exr_get_default_error_message(code));
    }
    *ret_bytes = target.bytes;
    *ret_size = target.size;
    return RN_OK;
}
#else
enum rn_status rn_exr_check(struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_UNSUPPORTED, "#/format",
                        "EXR files need OpenEXR, without which this was built: build with "
                        "libopenexr-dev, or take png16");
}

enum rn_status rn_exr_encode(const struct rn_exr_plane *planes, size_t count, const char *comment,
                             uint8_t **ret_bytes, size_t *ret_size, struct rn_error *err) {
    return rn_exr_check(err);
}
#endif

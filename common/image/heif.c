// HEIC and AVIF: the photographs of phones.
#include <string.h>

#include "common/image/codec.h"

static bool is_heif(const uint8_t *bytes, size_t size_bytes) {
    static const char brands[][5] = {"heic", "heix", "heim", "heis", "hevc",
                                     "mif1", "msf1", "avif", "avis", "miaf"};
    if (size_bytes < 12 || memcmp(bytes + 4, "ftyp", 4) != 0) return false;
    for (size_t i = 0; i < sizeof brands / sizeof *brands; i++)
        if (memcmp(bytes + 8, brands[i], 4) == 0) return true;
    return false;
}

#ifdef RN_HAVE_HEIF
#include <libheif/heif.h>
#include <stdlib.h>

static enum rn_status failed(struct heif_error problem, const char *where, struct rn_error *err) {
    int told = (int)strcspn(problem.message, "\n");
    if (told > 160) told = 160;
    if (problem.subcode == heif_suberror_Security_limit_exceeded)
        return rn_error_set(
            err, RN_ERROR_LIMIT, where,
            "the HEIC or AVIF file is over a limit (%d x %d pixels) of what is read "
            "of such files (%.*s): scale it down, or convert it to JPEG",
            rn_image_default_limits.max_width, rn_image_default_limits.max_height, told,
            problem.message);
    if (problem.code == heif_error_Memory_allocation_error)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, where, "no memory to read the HEIC or AVIF");
    if (problem.code == heif_error_Unsupported_filetype ||
        problem.code == heif_error_Unsupported_feature ||
        problem.code == heif_error_Decoder_plugin_error)
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, where,
                            "libheif cannot read this HEIC or AVIF file (%.*s): convert it to "
                            "JPEG",
                            told, problem.message);
    return rn_error_set(err, RN_ERROR_INVALID, where,
                        "the HEIC or AVIF file is damaged (%.*s): copy or export it again", told,
                        problem.message);
}

// The most pixels a side of what is decoded, whichever part of the file says how many; the library
// refuses a grid of as many as it is told, and its own limit would let a few bytes ask for 4 GB.
static int most_pixels(void) {
    const struct rn_image_limits *most = &rn_image_default_limits;
    return (most->max_width > most->max_height ? most->max_width : most->max_height) + 1;
}

static enum rn_status open_picture(const uint8_t *bytes, size_t size_bytes, const char *where,
                                   struct heif_context **ret_context,
                                   struct heif_image_handle **ret_handle, struct rn_error *err) {
    enum rn_status status = rn_heif_check_parts(bytes, size_bytes, where, err);
    if (status) return status;
    struct heif_context *context = heif_context_alloc();
    if (!context) return rn_error_set(err, RN_ERROR_NO_MEMORY, where, "no memory to read the HEIC");
    // Whoever reads many photographs has threads of its own; the library's would only take turns
    // with them, and where none can be made they end the process.
    heif_context_set_max_decoding_threads(context, 0);
    heif_context_set_maximum_image_size_limit(context, most_pixels());
    struct heif_error problem =
        heif_context_read_from_memory_without_copy(context, bytes, size_bytes, NULL);
    if (problem.code == heif_error_Ok)
        problem = heif_context_get_primary_image_handle(context, ret_handle);
    if (problem.code == heif_error_Ok) {
        *ret_context = context;
        return RN_OK;
    }
    status = failed(problem, where, err);
    heif_context_free(context);
    return status;
}

static void close_picture(struct heif_context *context, struct heif_image_handle *handle) {
    heif_image_handle_release(handle);
    heif_context_free(context);
}

static struct rn_image_info describe(const struct heif_image_handle *handle) {
    return (struct rn_image_info){.width = heif_image_handle_get_width(handle),
                                  .height = heif_image_handle_get_height(handle),
                                  .bit_depth = heif_image_handle_get_luma_bits_per_pixel(handle),
                                  .has_alpha = heif_image_handle_has_alpha_channel(handle) != 0,
                                  .orientation = 1};
}

// What the photograph's EXIF says of its camera; how that was held the decoder heeds itself.
static void read_exif(const struct heif_image_handle *handle, struct rn_image_info *info) {
    heif_item_id id;
    if (heif_image_handle_get_list_of_metadata_block_IDs(handle, "Exif", &id, 1) != 1) return;
    size_t size = heif_image_handle_get_metadata_size(handle, id);
    uint8_t *block = size > 4 ? malloc(size) : NULL;
    if (block && heif_image_handle_get_metadata(handle, id, block).code == heif_error_Ok) {
        // It begins with the number, big-endian, of bytes before the TIFF header.
        size_t from = 4 + ((size_t)block[0] << 24 | (size_t)block[1] << 16 | (size_t)block[2] << 8 |
                           block[3]);
        if (from < size) rn_exif_read(block + from, size - from, info);
    }
    info->orientation = 1;
    free(block);
}

static enum rn_status probe_heif(const uint8_t *bytes, size_t size_bytes, const char *where,
                                 struct rn_image_info *ret_info, struct rn_error *err) {
    struct heif_context *context = NULL;
    struct heif_image_handle *handle = NULL;
    enum rn_status status = open_picture(bytes, size_bytes, where, &context, &handle, err);
    if (status) return status;
    *ret_info = describe(handle);
    read_exif(handle, ret_info);
    close_picture(context, handle);
    return RN_OK;
}

static enum rn_status copy_pixels(const struct heif_image *from, const char *where,
                                  struct rn_image *image, struct rn_error *err) {
    int stride;
    const uint8_t *plane = heif_image_get_plane_readonly(from, heif_channel_interleaved, &stride);
    if (!plane || heif_image_get_width(from, heif_channel_interleaved) != image->width ||
        heif_image_get_height(from, heif_channel_interleaved) != image->height)
        return rn_error_set(err, RN_ERROR_INVALID, where,
                            "the HEIC or AVIF file's picture is of another size than its header "
                            "says: export it again");
    for (int y = 0; y < image->height; y++)
        memcpy(image->pixels + 4 * (size_t)y * (size_t)image->width, plane + (ptrdiff_t)y * stride,
               4 * (size_t)image->width);
    return RN_OK;
}

static enum rn_status decode_handle(const struct heif_image_handle *handle, const char *where,
                                    const struct rn_image_limits *limits,
                                    struct rn_image *ret_image, struct rn_error *err) {
    struct rn_image_info info = describe(handle);
    struct rn_image image;
    struct heif_image *decoded;
    enum rn_status status = rn_image_check_size(info.width, info.height, limits, where, err);
    if (status) return status;
    struct heif_error problem = heif_decode_image(handle, &decoded, heif_colorspace_RGB,
                                                  heif_chroma_interleaved_RGBA, NULL);
    if (problem.code != heif_error_Ok) return failed(problem, where, err);
    status = rn_image_init(info.width, info.height, &image, err);
    if (status == RN_OK) {
        image.has_alpha = info.has_alpha;
        status = copy_pixels(decoded, where, &image, err);
        if (status) rn_image_finish(&image);
    }
    heif_image_release(decoded);
    if (status == RN_OK) *ret_image = image;
    return status;
}

static enum rn_status decode_heif(const uint8_t *bytes, size_t size_bytes, const char *where,
                                  const struct rn_image_limits *limits, struct rn_image *ret_image,
                                  struct rn_error *err) {
    struct heif_context *context = NULL;
    struct heif_image_handle *handle = NULL;
    enum rn_status status = open_picture(bytes, size_bytes, where, &context, &handle, err);
    if (status) return status;
    status = rn_heif_check_sizes(bytes, size_bytes, limits, where, err);
    if (!status) status = decode_handle(handle, where, limits, ret_image, err);
    close_picture(context, handle);
    return status;
}

static bool profile_heif(const uint8_t *bytes, size_t size_bytes, uint8_t **ret_profile,
                         size_t *ret_size) {
    struct heif_context *context = NULL;
    struct heif_image_handle *handle = NULL;
    if (open_picture(bytes, size_bytes, "", &context, &handle, NULL)) return false;
    size_t size = heif_image_handle_get_raw_color_profile_size(handle);
    uint8_t *profile = size ? malloc(size) : NULL;
    if (profile && heif_image_handle_get_raw_color_profile(handle, profile).code != heif_error_Ok) {
        free(profile);
        profile = NULL;
    }
    close_picture(context, handle);
    *ret_profile = profile;
    *ret_size = size;
    return profile != NULL;
}
#endif

const struct rn_codec rn_codec_heif = {.title = "HEIC or AVIF",
                                       .library = "libheif-dev",
#ifdef RN_HAVE_HEIF
                                       .probe = probe_heif,
                                       .decode = decode_heif,
                                       .profile = profile_heif,
#endif
                                       .is = is_heif};

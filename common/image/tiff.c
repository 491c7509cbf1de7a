#include <string.h>

#include "common/image/codec.h"

static bool is_tiff(const uint8_t *bytes, size_t size_bytes) {
    return size_bytes >= 4 && (memcmp(bytes, "II*\0", 4) == 0 || memcmp(bytes, "MM\0*", 4) == 0 ||
                               memcmp(bytes, "II+\0", 4) == 0 || memcmp(bytes, "MM\0+", 4) == 0);
}

#ifdef RN_HAVE_TIFF
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <tiffio.h>

#define MEMORY_MAX ((tmsize_t)1 << 30) // bytes of one allocation of the library

// The file in memory, and what the library says of it.
struct source {
    const uint8_t *bytes;
    uint64_t size, at;
    char problem[160];
};

static tmsize_t take(thandle_t handle, void *to, tmsize_t size) {
    struct source *source = handle;
    uint64_t left = source->at < source->size ? source->size - source->at : 0;
    if ((uint64_t)size > left) size = (tmsize_t)left;
    memcpy(to, source->bytes + source->at, (size_t)size);
    source->at += (uint64_t)size;
    return size;
}

static tmsize_t refuse_write(thandle_t handle, void *from, tmsize_t size) {
    return 0;
}

static toff_t seek(thandle_t handle, toff_t offset, int from) {
    struct source *source = handle;
    source->at = from == SEEK_SET   ? offset
                 : from == SEEK_CUR ? source->at + offset
                                    : source->size + offset;
    return source->at;
}

static int keep_open(thandle_t handle) {
    return 0;
}

static toff_t tell_size(thandle_t handle) {
    return ((struct source *)handle)->size;
}

__attribute__((format(printf, 4, 0))) static int
keep_problem(TIFF *tiff, void *context, const char *module, const char *text, va_list arguments) {
    struct source *source = context;
    if (!source->problem[0]) vsnprintf(source->problem, sizeof source->problem, text, arguments);
    return 1;
}

__attribute__((format(printf, 4, 0))) static int
ignore_warning(TIFF *tiff, void *context, const char *module, const char *text, va_list arguments) {
    return 1;
}

static TIFF *open_source(struct source *source) {
    TIFFOpenOptions *options = TIFFOpenOptionsAlloc();
    if (!options) return NULL;
    TIFFOpenOptionsSetMaxSingleMemAlloc(options, MEMORY_MAX);
    TIFFOpenOptionsSetErrorHandlerExtR(options, keep_problem, source);
    TIFFOpenOptionsSetWarningHandlerExtR(options, ignore_warning, source);
    // m: no mapping of the file into memory, it is there already
    TIFF *tiff = TIFFClientOpenExt("", "rm", source, take, refuse_write, seek, keep_open, tell_size,
                                   NULL, NULL, options);
    TIFFOpenOptionsFree(options);
    return tiff;
}

static enum rn_status damaged(const struct source *source, const char *where,
                              struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_INVALID, where,
                        "the TIFF file is damaged or of an unusual kind (%s): export it again",
                        source->problem[0] ? source->problem : "it ends too early");
}

static enum rn_status read_header(TIFF *tiff, const struct source *source, const char *where,
                                  struct rn_image_info *ret_info, struct rn_error *err) {
    uint32_t width = 0, height = 0;
    uint16_t bits = 1, samples = 1, extra = 0, *kinds = NULL, orientation = 1;
    char problem[1024] = "";
    if (TIFFGetField(tiff, TIFFTAG_IMAGEWIDTH, &width) != 1 ||
        TIFFGetField(tiff, TIFFTAG_IMAGELENGTH, &height) != 1)
        return damaged(source, where, err);
    if (!TIFFRGBAImageOK(tiff, problem))
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, where,
                            "the TIFF file is of a kind that is not read (%.120s): export it with "
                            "8 or 16 bits a channel",
                            problem);
    TIFFGetFieldDefaulted(tiff, TIFFTAG_BITSPERSAMPLE, &bits);
    TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLESPERPIXEL, &samples);
    TIFFGetFieldDefaulted(tiff, TIFFTAG_EXTRASAMPLES, &extra, &kinds);
    TIFFGetFieldDefaulted(tiff, TIFFTAG_ORIENTATION, &orientation);
    if (width > INT32_MAX || height > INT32_MAX) width = height = INT32_MAX; // over any limit
    bool alpha =
        extra > 0 && (kinds[0] == EXTRASAMPLE_ASSOCALPHA || kinds[0] == EXTRASAMPLE_UNASSALPHA);
    *ret_info = (struct rn_image_info){.width = (int)width,
                                       .height = (int)height,
                                       .bit_depth = bits,
                                       .has_alpha = alpha,
                                       .orientation =
                                           orientation >= 1 && orientation <= 8 ? orientation : 1};
    return RN_OK;
}

static enum rn_status probe_tiff(const uint8_t *bytes, size_t size_bytes, const char *where,
                                 struct rn_image_info *ret_info, struct rn_error *err) {
    struct source source = {.bytes = bytes, .size = size_bytes};
    TIFF *tiff = open_source(&source);
    if (!tiff) return damaged(&source, where, err);
    enum rn_status status = read_header(tiff, &source, where, ret_info, err);
    TIFFClose(tiff);
    if (status) return status;
    int orientation = ret_info->orientation;
    rn_exif_read(bytes, size_bytes, ret_info); // whose tags are among the file's own
    ret_info->orientation = orientation;
    return RN_OK;
}

// The library multiplies colours with alpha; ours are straight.
static void unpack(const uint32_t *raster, struct rn_image *image) {
    size_t count = (size_t)image->width * (size_t)image->height;
    for (size_t i = 0; i < count; i++) {
        uint32_t alpha = TIFFGetA(raster[i]);
        uint32_t colour[3] = {TIFFGetR(raster[i]), TIFFGetG(raster[i]), TIFFGetB(raster[i])};
        for (int c = 0; c < 3; c++) {
            uint32_t straight = alpha ? (colour[c] * 255 + alpha / 2) / alpha : 0;
            image->pixels[4 * i + (size_t)c] = (uint8_t)(straight > 255 ? 255 : straight);
        }
        image->pixels[4 * i + 3] = (uint8_t)alpha;
    }
}

static bool read_pixels(TIFF *tiff, struct source *source, struct rn_image *image) {
    char problem[1024] = "";
    TIFFRGBAImage reader;
    uint32_t *raster = malloc(4 * (size_t)image->width * (size_t)image->height);
    if (!raster || !TIFFRGBAImageBegin(&reader, tiff, 1, problem)) {
        if (!source->problem[0])
            snprintf(source->problem, sizeof source->problem, "%.150s", problem);
        free(raster);
        return false;
    }
    reader.req_orientation = reader.orientation; // as stored
    bool whole =
        TIFFRGBAImageGet(&reader, raster, (uint32_t)image->width, (uint32_t)image->height) == 1;
    TIFFRGBAImageEnd(&reader);
    if (whole) unpack(raster, image);
    free(raster);
    return whole && !source->problem[0];
}

static enum rn_status decode_tiff(const uint8_t *bytes, size_t size_bytes, const char *where,
                                  const struct rn_image_limits *limits, struct rn_image *ret_image,
                                  struct rn_error *err) {
    struct source source = {.bytes = bytes, .size = size_bytes};
    struct rn_image_info info = {0};
    struct rn_image image = {0};
    TIFF *tiff = open_source(&source);
    if (!tiff) return damaged(&source, where, err);
    enum rn_status status = read_header(tiff, &source, where, &info, err);
    if (status == RN_OK) status = rn_image_check_size(info.width, info.height, limits, where, err);
    if (status == RN_OK) status = rn_image_init(info.width, info.height, &image, err);
    if (status == RN_OK) {
        image.has_alpha = info.has_alpha;
        if (!read_pixels(tiff, &source, &image)) status = damaged(&source, where, err);
    }
    TIFFClose(tiff);
    if (status == RN_OK)
        *ret_image = image;
    else
        rn_image_finish(&image);
    return status;
}

static bool profile_tiff(const uint8_t *bytes, size_t size_bytes, uint8_t **ret_profile,
                         size_t *ret_size) {
    struct source source = {.bytes = bytes, .size = size_bytes};
    TIFF *tiff = open_source(&source);
    uint8_t *copy = NULL;
    uint32_t size = 0;
    void *profile;
    if (!tiff) return false;
    if (TIFFGetField(tiff, TIFFTAG_ICCPROFILE, &size, &profile) == 1 && (copy = malloc(size + 1)))
        memcpy(copy, profile, size);
    TIFFClose(tiff);
    *ret_profile = copy;
    *ret_size = size;
    return copy != NULL;
}
#endif

const struct rn_codec rn_codec_tiff = {.title = "TIFF",
                                       .library = "libtiff-dev",
#ifdef RN_HAVE_TIFF
                                       .probe = probe_tiff,
                                       .decode = decode_tiff,
                                       .profile = profile_tiff,
#endif
                                       .is = is_tiff};

// Pictures in memory, and their files.
#ifndef RN_COMMON_IMAGE_IMAGE_H
#define RN_COMMON_IMAGE_IMAGE_H

#include <stddef.h>
#include <stdint.h>

#include "common/base/status.h"

// 8-bit RGBA with straight (not premultiplied) alpha, rows top to bottom, no padding.
// Thread-safety: one writer or many readers.
struct rn_image {
    int width, height;
    bool has_alpha;  // false: the file had no alpha; every alpha byte is 255
    uint8_t *pixels; // width * height * 4, owned
};

// fp32 planes of a rendered picture, interleaved, rows top to bottom.
struct rn_picture {
    int width, height;
    int channels;  // 3 = rgb, 1 = depth or alpha, 4 = rgba (straight alpha)
    float *values; // width * height * channels, owned
};

// Limits that hold before anything is decoded.
struct rn_image_limits {
    int max_width, max_height; // pixels
    size_t max_pixels;
    size_t max_file_bytes;
};
extern const struct rn_image_limits rn_image_default_limits; // 16384, 16384, 2^27, 2^30

// Every function below is thread-safe. `limits` may be NULL for the default. Statuses: a damaged,
// truncated or unknown file and a wrong argument are RN_ERROR_INVALID, a passed limit
// RN_ERROR_LIMIT (before anything of that size is allocated), memory RN_ERROR_NO_MEMORY.

void rn_image_finish(struct rn_image *image); // frees, zeroes; NULL-safe pixels
void rn_picture_finish(struct rn_picture *picture);
// All zero: transparent black with has_alpha set. Sizes within the default limits.
enum rn_status rn_image_init(int width, int height, struct rn_image *ret_image,
                             struct rn_error *err) RN_MUST_CHECK;
// All zero. channels 1, 3 or 4.
enum rn_status rn_picture_init(int width, int height, int channels, struct rn_picture *ret_picture,
                               struct rn_error *err) RN_MUST_CHECK;

struct rn_image_info {
    int width, height;
    int bit_depth;  // of the file
    bool has_alpha; // alpha channel or transparency chunk
    bool linear;    // light itself, which decoding clamps to 0 to 1 and curves
    // How the camera was held, as EXIF counts: 1 upright or not said, 2 to 8 mirrored, turned or
    // both; 5 to 8 swap width and height. The sizes above are those of the pixels as stored.
    int orientation;
    uint32_t camera_key;  // equal for pictures of one make and model at one focal length, by EXIF;
                          // 0: not said
    bool located;         // GPS said where the camera stood
    double located_at[3]; // degrees north and east (WGS 84), metres above the sea
};
// Reads a header only: PNG, JPEG, and WebP, TIFF, HEIC, AVIF and EXR where the build has their
// libraries (else RN_ERROR_UNSUPPORTED, which names the library). Errors name the file.
enum rn_status rn_image_probe(const char *path, const struct rn_image_limits *limits,
                              struct rn_image_info *ret_info, struct rn_error *err) RN_MUST_CHECK;
// Decodes such a file (PNG of any colour type, depth, interlace; JPEG grey, YCbCr, RGB) to RGBA8.
// 16 bits are rounded to 8; linear light (EXR) is clamped to 0 to 1 and goes through sRGB's curve;
// an embedded ICC profile of grey or RGB is converted to sRGB, PNG's gAMA is ignored. CMYK JPEG and
// animations are RN_ERROR_UNSUPPORTED. The content decides, not the file's extension. Pixels stay
// as they are stored: EXIF's orientation is not applied (HEIC's own turns are: they are part of how
// its pixels are stored).
enum rn_status rn_image_read(const char *path, const struct rn_image_limits *limits,
                             struct rn_image *ret_image, struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_image_decode(const void *bytes, size_t size_bytes, const char *where,
                               const struct rn_image_limits *limits, struct rn_image *ret_image,
                               struct rn_error *err) RN_MUST_CHECK;
// As rn_image_read, of a picture that is to be made `most` times smaller: where its format can do
// part of that while it decodes, each pixel is the mean of *ret_times x *ret_times of the file's,
// in its own colours. *ret_times divides `most` and both sides; it is 1 where the picture is whole.
// JPEG can, by 2, 4 and 8: what differs from the mean of decoded pixels is where those are rounded
// and cut at 0 and 255, and that chroma stored at half the size is not widened before.
enum rn_status rn_image_read_smaller(const char *path, const struct rn_image_limits *limits,
                                     int most, struct rn_image *ret_image, int *ret_times,
                                     struct rn_error *err) RN_MUST_CHECK;
// By how much, of at most `most`, JPEGs are: the library's reduced inverse DCTs are means of a
// whole one's pixels, where blocks are whole.
static inline int rn_image_times_smaller(int width, int height, int most) {
    for (int times = 8; times > 1; times /= 2)
        if (most % times == 0 && width % times == 0 && height % times == 0) return times;
    return 1;
}
// The file without what is not the picture: EXIF (who took it, when and where), profiles, comments.
// It decodes to the same pixels. Of a JPEG in sRGB; RN_ERROR_UNSUPPORTED for any other file. An
// orientation is lost. *ret_bytes is malloc'd.
enum rn_status rn_image_strip(const char *path, const struct rn_image_limits *limits,
                              uint8_t **ret_bytes, size_t *ret_size,
                              struct rn_error *err) RN_MUST_CHECK;

// Turns the picture upright: undoes an EXIF orientation of 1 to 8.
enum rn_status rn_image_turn(struct rn_image *image, int orientation,
                             struct rn_error *err) RN_MUST_CHECK;

// Encoders: *ret_bytes is malloc'd and owned by the caller. level: zlib 0..9 / JPEG 1..100. PNG is
// RGBA when has_alpha, else RGB. JPEG has no alpha: colours are written as they are (4:4:4).
enum rn_status rn_image_encode_png(const struct rn_image *image, int level, uint8_t **ret_bytes,
                                   size_t *ret_size, struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_image_encode_jpeg(const struct rn_image *image, int quality, uint8_t **ret_bytes,
                                    size_t *ret_size, struct rn_error *err) RN_MUST_CHECK;
// 16-bit grey PNG, used for depth: value = round(clamp(v / scale, 0, 1) * 65535), and a tEXt chunk
// "ripnerf:depth_scale" with `scale` in dataset units.
enum rn_status rn_picture_encode_depth_png(const struct rn_picture *depth, float scale, int level,
                                           uint8_t **ret_bytes, size_t *ret_size,
                                           struct rn_error *err) RN_MUST_CHECK;
// What that wrote: depths within scale / 131070 of what they were, INFINITY where they were the
// scale or more. RN_ERROR_CORRUPT for another picture, RN_ERROR_LIMIT, RN_ERROR_NO_MEMORY.
enum rn_status rn_picture_decode_depth_png(const void *bytes, size_t size,
                                           struct rn_picture *ret_depth,
                                           struct rn_error *err) RN_MUST_CHECK;
// 16 bits a channel, big endian: round(clamp(v, 0, 1) * 65535) of 1 (grey), 3 (RGB) or 4 (RGBA)
// channels; what is not finite is 0.
enum rn_status rn_picture_encode_png16(const struct rn_picture *picture, int level,
                                       uint8_t **ret_bytes, size_t *ret_size,
                                       struct rn_error *err) RN_MUST_CHECK;

// A channel of an EXR: one of a picture's.
struct rn_exr_plane {
    const char *name; // "R", "Z", "N.X"; each once
    const struct rn_picture *picture;
    int channel;
    bool is_whole; // 32 bits a value; else a half's 16
};
// Scan lines of `count` planes of one size, ZIP-compressed, with a text. Values go out as they are:
// an EXR's colours are linear light times alpha. RN_ERROR_UNSUPPORTED in a build without OpenEXR.
enum rn_status rn_exr_encode(const struct rn_exr_plane *planes, size_t count, const char *comment,
                             uint8_t **ret_bytes, size_t *ret_size,
                             struct rn_error *err) RN_MUST_CHECK;
// Whether it can at all: RN_ERROR_UNSUPPORTED says what is missing.
enum rn_status rn_exr_check(struct rn_error *err) RN_MUST_CHECK;

// Writes a temporary file beside `path`, fsyncs, renames.
enum rn_status rn_image_write_png(const struct rn_image *image, const char *path, int level,
                                  struct rn_error *err) RN_MUST_CHECK;

// fp32 -> 8 bit: clamp to [0,1], round half up (value * 255 + 0.5). rgb gets alpha 255; one
// channel becomes grey; rgba keeps its alpha. Non-finite values become 0.
enum rn_status rn_picture_to_image(const struct rn_picture *picture, struct rn_image *ret_image,
                                   struct rn_error *err) RN_MUST_CHECK;
// 8 bit -> fp32 rgb over a background: rgb * a + (1 - a) * background, all in [0,1]; a background
// outside is RN_ERROR_INVALID. Error at most 5 * 2^-24; bytes with alpha 255 survive the way back.
enum rn_status rn_image_composite(const struct rn_image *image, const float background[3],
                                  struct rn_picture *ret_picture,
                                  struct rn_error *err) RN_MUST_CHECK;

enum rn_downscale {
    RN_DOWNSCALE_PREMULTIPLIED, // mean of premultiplied colour, rounded (the default)
    RN_DOWNSCALE_STRAIGHT,      // the published benchmark's: mean of straight RGBA, truncated
};
// Area-averages to exactly width x height (each 1 .. the source's). Equal sizes copy. Weights and
// sums are exact integers, so the only error is the one rounding (0.5 of 255) or truncation.
enum rn_status rn_image_downscale(const struct rn_image *image, int width, int height,
                                  enum rn_downscale mode, struct rn_image *ret_image,
                                  struct rn_error *err) RN_MUST_CHECK;
// The published multi-scale converter, bit for bit: `levels` images; level 0 is the source, each
// next a float32 2x2 box mean of the *unrounded* previous one, stored as truncation of v*255.
// Sizes must be divisible by 2^(levels-1), else RN_ERROR_INVALID. ret_levels has `levels` slots.
enum rn_status rn_image_legacy_pyramid(const struct rn_image *image, int levels,
                                       struct rn_image *ret_levels,
                                       struct rn_error *err) RN_MUST_CHECK;

#endif

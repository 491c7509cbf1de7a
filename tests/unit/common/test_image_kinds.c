// The kinds of pictures that people have beside plain PNG and JPEG: how they were held, colour
// profiles, WebP, TIFF, HEIC, EXR. What a build goes without is refused with its library's name.
#include <lcms2.h>
#include <math.h>

#include "common/image/codec.h"
#include "tests/unit/common/dataset_fixture.h"

#ifdef RN_HAVE_WEBP
#include <webp/encode.h>
#endif
#ifdef RN_HAVE_TIFF
#include <tiffio.h>
#endif
#ifdef RN_HAVE_HEIF
#include <libheif/heif.h>
#endif

enum { WIDE = 48, HIGH = 32 };

// A smooth picture, which lossy formats keep.
static struct rn_image ramp(int width, int height) {
    struct rn_image image;
    ck_assert_int_eq(rn_image_init(width, height, &image, &err), RN_OK);
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            uint8_t *pixel = image.pixels + 4 * (y * width + x);
            pixel[0] = (uint8_t)(255 * x / width);
            pixel[1] = (uint8_t)(255 * y / height);
            pixel[2] = (uint8_t)(128 + 100 * (x + y) / (width + height));
            pixel[3] = 255;
        }
    image.has_alpha = false;
    return image;
}

static int worst_difference(const struct rn_image *a, const struct rn_image *b) {
    int worst = 0;
    ck_assert_int_eq(a->width, b->width);
    ck_assert_int_eq(a->height, b->height);
    for (int i = 0; i < 4 * a->width * a->height; i++)
        worst = abs(a->pixels[i] - b->pixels[i]) > worst ? abs(a->pixels[i] - b->pixels[i]) : worst;
    return worst;
}

static void read_kind(const char *name, struct rn_image *ret_image) {
    enum rn_status status = rn_image_read(in_folder(name), NULL, ret_image, &err);
    ck_assert_msg(status == RN_OK, "%s: %s", err.where, err.text);
}

static struct rn_image_info probe_kind(const char *name) {
    struct rn_image_info info = {0};
    enum rn_status status = rn_image_probe(in_folder(name), NULL, &info, &err);
    ck_assert_msg(status == RN_OK, "%s: %s", err.where, err.text);
    return info;
}

// Every beginning of a file, and the file with any byte changed, is a picture or a clean error.
static void survives_damage(const char *name, size_t every) {
    uint8_t *bytes;
    size_t size;
    struct rn_image image;
    struct rn_image_info info;
    struct rn_image_limits limits = rn_image_default_limits;
    limits.max_pixels = 1 << 20;
    ck_assert_int_eq(rn_file_read(in_folder(name), 1 << 20, &bytes, &size, &err), RN_OK);
    for (size_t cut = 0; cut < size; cut += every) {
        put_bytes("cut", bytes, cut);
        bool header = rn_image_probe(in_folder("cut"), &limits, &info, &err) == RN_OK;
        if (rn_image_read(in_folder("cut"), &limits, &image, &err) == RN_OK) {
            ck_assert_msg(header, "%zu of %zu bytes", cut, size);
            rn_image_finish(&image);
        } else {
            ck_assert_msg(err.text[0] && strstr(err.where, "cut"), "%zu of %zu bytes", cut, size);
        }
    }
    for (size_t at = 0; at < size; at += every) {
        uint8_t kept = bytes[at];
        bytes[at] ^= (uint8_t)(1 + at % 255);
        if (rn_image_decode(bytes, size, "changed", &limits, &image, &err) == RN_OK)
            rn_image_finish(&image);
        bytes[at] = kept;
    }
    free(bytes);
}

// ---- how the camera was held ----

// A JPEG of the ramp with an EXIF block in front of the picture.
static void put_held(const char *name, int orientation, bool big) {
    const uint8_t little_block[] = {
        'I', 'I', 42, 0, 8, 0, 0, 0, 1, 0, 0x12, 0x01, 3, 0, 1, 0, 0, 0, (uint8_t)orientation,
        0,   0,   0,  0, 0, 0, 0};
    const uint8_t big_block[] = {'M',  'M',  0, 42, 0, 0, 0, 8, 0, 1,
                                 0x01, 0x12, 0, 3,  0, 0, 0, 1, 0, (uint8_t)orientation,
                                 0,    0,    0, 0,  0, 0};
    const uint8_t head[] = {0xff, 0xd8, 0xff, 0xe1, 0, 8 + sizeof little_block,
                            'E',  'x',  'i',  'f',  0, 0};
    struct rn_image image = ramp(WIDE, HIGH);
    uint8_t *jpeg, file[16384];
    size_t size;
    ck_assert_int_eq(rn_image_encode_jpeg(&image, 95, &jpeg, &size, &err), RN_OK);
    memcpy(file, head, sizeof head);
    memcpy(file + sizeof head, big ? big_block : little_block, sizeof big_block);
    memcpy(file + sizeof head + sizeof big_block, jpeg + 2, size - 2);
    put_bytes(name, file, sizeof head + sizeof big_block + size - 2);
    free(jpeg);
    rn_image_finish(&image);
}

START_TEST(orientation_is_told_not_applied) {
    struct rn_image image;
    put_held("a.jpg", 1 + _i % 8, _i >= 8);
    struct rn_image_info info = probe_kind("a.jpg");
    ck_assert_int_eq(info.orientation, 1 + _i % 8);
    ck_assert_uint_eq(info.camera_key, 0); // nothing is said of the camera
    ck_assert_int_eq(info.width, WIDE);
    read_kind("a.jpg", &image);
    ck_assert_int_eq(image.width, WIDE);
    rn_image_finish(&image);
}
END_TEST

START_TEST(orientation_out_of_range_is_none) {
    put_held("a.jpg", 9, false);
    ck_assert_int_eq(probe_kind("a.jpg").orientation, 1);
    put_held("a.jpg", 0, true);
    ck_assert_int_eq(probe_kind("a.jpg").orientation, 1);
    survives_damage("a.jpg", 1);
}
END_TEST

// Where the stored top left corner is seen, and its right neighbour, by CIPA DC-008's table: 6 says
// that the 0th row is the visual right-hand side, the 0th column the visual top.
START_TEST(turning) {
    static const struct {
        bool lies;
        int x, y, next_x, next_y; // of 3 x 2 stored pixels
    } seen[] = {{false, 0, 0, 1, 0}, {false, 2, 0, 1, 0}, {false, 2, 1, 1, 1}, {false, 0, 1, 1, 1},
                {true, 0, 0, 0, 1},  {true, 1, 0, 1, 1},  {true, 1, 2, 1, 1},  {true, 0, 2, 0, 1}};
    struct rn_image image = noise(3, 2, 1);
    uint8_t first[4], next[4];
    memcpy(first, image.pixels, 4);
    memcpy(next, image.pixels + 4, 4);
    ck_assert_int_eq(rn_image_turn(&image, _i + 1, &err), RN_OK);
    ck_assert_int_eq(image.width, seen[_i].lies ? 2 : 3);
    ck_assert_int_eq(image.height, seen[_i].lies ? 3 : 2);
    ck_assert_mem_eq(image.pixels + 4 * (seen[_i].y * image.width + seen[_i].x), first, 4);
    ck_assert_mem_eq(image.pixels + 4 * (seen[_i].next_y * image.width + seen[_i].next_x), next, 4);
    ck_assert_int_eq(rn_image_turn(&image, 9, &err), RN_ERROR_INVALID);
    rn_image_finish(&image);
}
END_TEST

// A document of the stored size leaves the pixels; one of the upright size turns them.
START_TEST(poses_decide_on_turning) {
    bool upright = _i;
    char text[512];
    struct rn_image image;
    put_held("images/a.jpg", 6, false);
    snprintf(text, sizeof text,
             "{\"fl_x\":40,\"w\":%d,\"h\":%d,\"frames\":[{\"file_path\":\"images/a.jpg\","
             "\"transform_matrix\":" POSE "}]}",
             upright ? HIGH : WIDE, upright ? WIDE : HIGH);
    put_text("transforms.json", text);
    read_ok(folder);
    ck_assert_uint_eq(problems.errors, 0);
    ck_assert_ptr_nonnull(
        strstr(problems.items[0].text, upright ? "turned upright" : "taken as they are stored"));
    ck_assert_int_eq(dataset->frames[0].camera.width, upright ? HIGH : WIDE);
    struct rn_import_options options = {.scales = 1, .threads = 1};
    ck_assert_int_eq(
        rn_dataset_import(dataset, "n", &options, in_folder("out"), NULL, NULL, NULL, &err), RN_OK);
    read_kind(upright ? "out/images/train_00000_d0.png" : "out/images/train_00000_d0.jpg", &image);
    ck_assert_int_eq(image.width, upright ? HIGH : WIDE);
    rn_image_finish(&image);
}
END_TEST

// ---- colour profiles ----

// PNG and JPEG of the ramp, with a profile.
static struct rn_image with_profile(cmsHPROFILE profile, bool png, bool grey) {
    uint8_t icc[16384], file[65536], *bytes;
    cmsUInt32Number size = 0;
    size_t picture_size;
    struct rn_image image = ramp(WIDE, HIGH), read;
    ck_assert(cmsSaveProfileToMem(profile, NULL, &size) && size <= sizeof icc);
    ck_assert(cmsSaveProfileToMem(profile, icc, &size));
    cmsCloseProfile(profile);
    if (png) {
        FILE *out = fopen(in_folder("p"), "wb");
        png_structp writer = png_create_write_struct(PNG_LIBPNG_VER_STRING, NULL, NULL, NULL);
        png_infop info = png_create_info_struct(writer);
        png_init_io(writer, out);
        png_set_IHDR(writer, info, WIDE, HIGH, 8, grey ? PNG_COLOR_TYPE_GRAY : PNG_COLOR_TYPE_RGBA,
                     PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
        png_set_iCCP(writer, info, "a", PNG_COMPRESSION_TYPE_BASE, icc, size);
        png_write_info(writer, info);
        for (int y = 0; y < HIGH; y++) {
            uint8_t row[4 * WIDE];
            for (int x = 0; x < WIDE; x++)
                row[x] = image.pixels[4 * (y * WIDE + x)];
            png_write_row(writer, grey ? row : image.pixels + 4 * WIDE * y);
        }
        png_write_end(writer, info);
        png_destroy_write_struct(&writer, &info);
        ck_assert_int_eq(fclose(out), 0);
    } else { // in two segments, the second first
        size_t at = 2, half = size / 2;
        ck_assert_int_eq(rn_image_encode_jpeg(&image, 100, &bytes, &picture_size, &err), RN_OK);
        memcpy(file, "\xff\xd8", 2);
        for (int part = 2; part >= 1; part--) {
            size_t from = part == 2 ? half : 0, count = part == 2 ? size - half : half;
            uint8_t head[18] = {0xff, 0xe2, (uint8_t)((count + 16) >> 8), (uint8_t)(count + 16)};
            memcpy(head + 4, "ICC_PROFILE", 12);
            head[16] = (uint8_t)part;
            head[17] = 2;
            memcpy(file + at, head, 18);
            memcpy(file + at + 18, icc + from, count);
            at += 18 + count;
        }
        memcpy(file + at, bytes + 2, picture_size - 2);
        put_bytes("p", file, at + picture_size - 2);
        free(bytes);
    }
    rn_image_finish(&image);
    read_kind("p", &read);
    return read;
}

// Display P3's primaries with sRGB's curve, and pure curves.
static cmsHPROFILE wide_profile(double gamma) {
    cmsCIExyY white = {0.3127, 0.3290, 1};
    cmsCIExyYTRIPLE primaries = {{0.680, 0.320, 1}, {0.265, 0.690, 1}, {0.150, 0.060, 1}};
    cmsToneCurve *curve = cmsBuildGamma(NULL, gamma), *curves[3] = {curve, curve, curve};
    cmsHPROFILE profile = cmsCreateRGBProfile(&white, &primaries, curves);
    cmsFreeToneCurve(curve);
    return profile;
}

// By hand, in doubles: D65 to D65, so no adaptation enters. The matrix is P3 to sRGB.
static double p3_red_in_srgb(double r, double g, double b) {
    double linear = 1.2249 * pow(r, 2.2) - 0.2247 * pow(g, 2.2) + 0.0 * b;
    if (linear <= 0) return 0;
    if (linear >= 1) return 1;
    return linear <= 0.0031308 ? 12.92 * linear : 1.055 * pow(linear, 1 / 2.4) - 0.055;
}

START_TEST(profile_of_wide_colours) {
    struct rn_image plain = ramp(WIDE, HIGH), image = with_profile(wide_profile(2.2), _i, false);
    int tolerance = _i ? 2 : 9, worst = 0; // JPEG's own error grows where the curve is steep
    for (int i = 0; i < WIDE * HIGH; i++) {
        const uint8_t *from = plain.pixels + 4 * i;
        double want = 255 * p3_red_in_srgb(from[0] / 255.0, from[1] / 255.0, from[2] / 255.0);
        if (fabs(want - image.pixels[4 * i]) > worst) worst = (int)fabs(want - image.pixels[4 * i]);
        ck_assert_int_eq(image.pixels[4 * i + 3], 255);
    }
    ck_assert_int_le(worst, tolerance);
    ck_assert_int_gt(worst_difference(&plain, &image), 20);
    rn_image_finish(&plain);
    rn_image_finish(&image);
}
END_TEST

START_TEST(profile_of_srgb_changes_nothing) {
    struct rn_image plain = ramp(WIDE, HIGH);
    struct rn_image image = with_profile(cmsCreate_sRGBProfile(), true, false);
    ck_assert_int_eq(worst_difference(&plain, &image), 0);
    rn_image_finish(&plain);
    rn_image_finish(&image);
}
END_TEST

static enum rn_status strip_kind(uint8_t **ret_bytes, size_t *ret_size) {
    return rn_image_strip(in_folder("p"), NULL, ret_bytes, ret_size, &err);
}

// What is kept of a JPEG is the picture; a PNG and what has to be converted are not kept.
START_TEST(only_srgb_is_kept_as_it_is) {
    uint8_t *bytes;
    size_t size;
    struct rn_image image = with_profile(wide_profile(2.2), false, false), kept;
    ck_assert_int_eq(strip_kind(&bytes, &size), RN_ERROR_UNSUPPORTED);
    rn_image_finish(&image);
    image = with_profile(cmsCreate_sRGBProfile(), true, false);
    ck_assert_int_eq(strip_kind(&bytes, &size), RN_ERROR_UNSUPPORTED);
    rn_image_finish(&image);
    image = with_profile(cmsCreate_sRGBProfile(), false, false);
    ck_assert_int_eq(strip_kind(&bytes, &size), RN_OK);
    ck_assert_ptr_null(memmem(bytes, size, "ICC_PROFILE", 11));
    ck_assert_int_eq(rn_image_decode(bytes, size, "", NULL, &kept, &err), RN_OK);
    ck_assert_int_eq(worst_difference(&image, &kept), 0);
    free(bytes);
    rn_image_finish(&kept);
    rn_image_finish(&image);
}
END_TEST

START_TEST(profile_of_grey) {
    cmsCIExyY white = {0.3127, 0.3290, 1};
    cmsToneCurve *linear = cmsBuildGamma(NULL, 1);
    struct rn_image image = with_profile(cmsCreateGrayProfile(&white, linear), true, true);
    cmsFreeToneCurve(linear);
    for (int x = 0; x < WIDE; x++) { // 255 x / WIDE of light
        double light = (255 * x / WIDE) / 255.0;
        double want = light <= 0.0031308 ? 12.92 * light : 1.055 * pow(light, 1 / 2.4) - 0.055;
        for (int c = 0; c < 3; c++)
            ck_assert_double_eq_tol(image.pixels[4 * x + c], 255 * want, 1.6);
    }
    rn_image_finish(&image);
}
END_TEST

START_TEST(profile_that_is_damaged) {
    struct rn_image image = ramp(WIDE, HIGH);
    uint8_t *jpeg, file[16384] = {0xff, 0xd8, 0xff, 0xe2, 0, 36};
    size_t size;
    ck_assert_int_eq(rn_image_encode_jpeg(&image, 90, &jpeg, &size, &err), RN_OK);
    rn_image_finish(&image);
    memcpy(file + 6, "ICC_PROFILE", 12);
    file[18] = file[19] = 1;
    memcpy(file + 40, jpeg + 2, size - 2);
    ck_assert_int_eq(rn_image_decode(file, size + 38, "f.jpg", NULL, &image, &err),
                     RN_ERROR_INVALID);
    ck_assert_ptr_nonnull(strstr(err.text, "colour profile is damaged"));
    ck_assert_str_eq(err.where, "f.jpg");
    free(jpeg);
}
END_TEST

// ---- what a build may go without ----

START_TEST(absent_libraries_are_named) {
    static const struct {
        const char *head, *library;
        size_t size;
        bool there;
    } kinds[] = {
#ifdef RN_HAVE_WEBP
        {"RIFF\0\0\0\0WEBPVP8 ", "libwebp-dev", 16, true},
#else
        {"RIFF\0\0\0\0WEBPVP8 ", "libwebp-dev", 16, false},
#endif
#ifdef RN_HAVE_TIFF
        {"II*\0\xff\xff\xff\xff", "libtiff-dev", 8, true},
#else
        {"II*\0\xff\xff\xff\xff", "libtiff-dev", 8, false},
#endif
#ifdef RN_HAVE_HEIF
        {"\0\0\0\x18"
         "ftypheic",
         "libheif-dev", 12, true},
#else
        {"\0\0\0\x18"
         "ftypheic",
         "libheif-dev", 12, false},
#endif
#ifdef RN_HAVE_EXR
        {"\x76\x2f\x31\x01\x02\0\0\0", "libopenexr-dev", 8, true},
#else
        {"\x76\x2f\x31\x01\x02\0\0\0", "libopenexr-dev", 8, false},
#endif
    };
    struct rn_image image;
    struct rn_image_info info;
    put_bytes("a", kinds[_i].head, kinds[_i].size);
    enum rn_status want = kinds[_i].there ? RN_ERROR_INVALID : RN_ERROR_UNSUPPORTED;
    ck_assert_int_eq(rn_image_probe(in_folder("a"), NULL, &info, &err), want);
    ck_assert_int_eq(rn_image_read(in_folder("a"), NULL, &image, &err), want);
    ck_assert_int_eq(strstr(err.text, kinds[_i].library) != NULL, !kinds[_i].there);
}
END_TEST

#ifdef RN_HAVE_WEBP
START_TEST(webp) {
    struct rn_image image = noise(WIDE, HIGH, 3), read;
    uint8_t *bytes;
    size_t size = WebPEncodeLosslessRGBA(image.pixels, WIDE, HIGH, 4 * WIDE, &bytes);
    put_bytes("a.webp", bytes, size);
    WebPFree(bytes);
    struct rn_image_info info = probe_kind("a.webp");
    ck_assert_int_eq(info.width, WIDE);
    ck_assert_int_eq(info.height, HIGH);
    ck_assert(info.has_alpha);
    read_kind("a.webp", &read);
    ck_assert(read.has_alpha);
    for (int i = 0; i < WIDE * HIGH; i++) // colours below no alpha are the encoder's to choose
        if (image.pixels[4 * i + 3]) ck_assert_mem_eq(image.pixels + 4 * i, read.pixels + 4 * i, 4);
    rn_image_finish(&image);
    rn_image_finish(&read);
    survives_damage("a.webp", 3);
}
END_TEST
#endif

#if defined RN_HAVE_TIFF || defined RN_HAVE_HEIF
// EXIF of a camera whose model is "abc", held upside down.
static const uint8_t abc_exif[] = {'I', 'I', 42, 0, 8, 0,   0,   0,   2, 0,    0x10, 0x01, 2,
                                   0,   4,   0,  0, 0, 'a', 'b', 'c', 0, 0x12, 0x01, 3,    0,
                                   1,   0,   0,  0, 3, 0,   0,   0,   0, 0,    0,    0};

static uint32_t abc_key(void) {
    struct rn_image_info info;
    rn_exif_read(abc_exif, sizeof abc_exif, &info);
    ck_assert_int_eq(info.orientation, 3);
    ck_assert_uint_ne(info.camera_key, 0);
    return info.camera_key;
}
#endif

#ifdef RN_HAVE_TIFF
// Straight colours and alpha, the alpha high enough that multiplying and dividing keeps colours.
static void put_tiff(const char *name, int bits, int channels, int compression) {
    TIFF *tiff = TIFFOpen(in_folder(name), "w");
    struct rn_image image = ramp(WIDE, HIGH);
    TIFFSetField(tiff, TIFFTAG_IMAGEWIDTH, WIDE);
    TIFFSetField(tiff, TIFFTAG_IMAGELENGTH, HIGH);
    TIFFSetField(tiff, TIFFTAG_BITSPERSAMPLE, bits);
    TIFFSetField(tiff, TIFFTAG_SAMPLESPERPIXEL, channels);
    TIFFSetField(tiff, TIFFTAG_COMPRESSION, compression);
    TIFFSetField(tiff, TIFFTAG_PHOTOMETRIC,
                 channels == 1 ? PHOTOMETRIC_MINISBLACK : PHOTOMETRIC_RGB);
    TIFFSetField(tiff, TIFFTAG_PLANARCONFIG, PLANARCONFIG_CONTIG);
    TIFFSetField(tiff, TIFFTAG_ROWSPERSTRIP, 7);
    TIFFSetField(tiff, TIFFTAG_ORIENTATION, 6);
    TIFFSetField(tiff, TIFFTAG_MODEL, "abc");
    uint16_t straight = EXTRASAMPLE_UNASSALPHA;
    if (channels == 4) TIFFSetField(tiff, TIFFTAG_EXTRASAMPLES, 1, &straight);
    for (int y = 0; y < HIGH; y++) {
        uint8_t narrow[WIDE * 4];
        uint16_t wide[WIDE * 4];
        for (int i = 0; i < WIDE * channels; i++) {
            int x = i / channels, c = i % channels;
            int value = c == 3 ? 200 : image.pixels[4 * (y * WIDE + x) + c];
            narrow[i] = (uint8_t)value;
            wide[i] = (uint16_t)(value * 257 + (y + x) % 100 - 50 * (value > 0 && value < 255));
        }
        ck_assert_int_eq(
            TIFFWriteScanline(tiff, bits == 16 ? (void *)wide : narrow, (uint32_t)y, 0), 1);
    }
    TIFFClose(tiff);
    rn_image_finish(&image);
}

START_TEST(tiff) {
    static const struct {
        int bits, channels, compression;
    } kinds[] = {{8, 3, COMPRESSION_NONE},     {8, 4, COMPRESSION_LZW},
                 {16, 3, COMPRESSION_LZW},     {16, 4, COMPRESSION_NONE},
                 {8, 1, COMPRESSION_PACKBITS}, {16, 1, COMPRESSION_NONE}};
    struct rn_image plain = ramp(WIDE, HIGH), read;
    put_tiff("a.tif", kinds[_i].bits, kinds[_i].channels, kinds[_i].compression);
    struct rn_image_info info = probe_kind("a.tif");
    ck_assert_int_eq(info.bit_depth, kinds[_i].bits);
    ck_assert_int_eq(info.orientation, 6);
    ck_assert_uint_eq(info.camera_key, abc_key());
    ck_assert_int_eq(info.has_alpha, kinds[_i].channels == 4);
    read_kind("a.tif", &read);
    for (int i = 0; i < WIDE * HIGH; i++)
        for (int c = 0; c < 4; c++) {
            int want = c == 3 ? (kinds[_i].channels == 4 ? 200 : 255)
                              : plain.pixels[4 * i + (kinds[_i].channels == 1 ? 0 : c)];
            ck_assert_int_le(abs(want - read.pixels[4 * i + c]), 1);
        }
    rn_image_finish(&plain);
    rn_image_finish(&read);
    survives_damage("a.tif", 31);
}
END_TEST

// A few bytes that ask for two billion pixels a side.
START_TEST(tiff_of_huge_size) {
    struct rn_image image;
    uint8_t file[] = {'I', 'I', 42, 0, 8,    0,    0,    0,    2,    0,    0x00, 0x01, 4,
                      0,   1,   0,  0, 0,    0xff, 0xff, 0xff, 0x7f, 0x01, 0x01, 4,    0,
                      1,   0,   0,  0, 0xff, 0xff, 0xff, 0x7f, 0,    0,    0,    0};
    ck_assert_int_ne(rn_image_decode(file, sizeof file, "huge.tif", NULL, &image, &err), RN_OK);
    ck_assert_str_eq(err.where, "huge.tif");
}
END_TEST
#endif

#ifdef RN_HAVE_HEIF
static void put_heif(const char *name, enum heif_compression_format format) {
    struct heif_context *context = heif_context_alloc();
    struct heif_encoder *encoder;
    struct heif_image *out;
    struct heif_image_handle *handle;
    struct rn_image image = ramp(2 * WIDE, 2 * HIGH);
    int stride;
    ck_assert_int_eq(heif_context_get_encoder_for_format(context, format, &encoder).code, 0);
    heif_encoder_set_lossy_quality(encoder, 95);
    ck_assert_int_eq(heif_image_create(image.width, image.height, heif_colorspace_RGB,
                                       heif_chroma_interleaved_RGB, &out)
                         .code,
                     0);
    heif_image_add_plane(out, heif_channel_interleaved, image.width, image.height, 24);
    uint8_t *plane = heif_image_get_plane(out, heif_channel_interleaved, &stride);
    for (int y = 0; y < image.height; y++)
        for (int x = 0; x < image.width; x++)
            memcpy(plane + y * stride + 3 * x, image.pixels + 4 * (y * image.width + x), 3);
    ck_assert_int_eq(heif_context_encode_image(context, out, encoder, NULL, &handle).code, 0);
    ck_assert_int_eq(
        heif_context_add_exif_metadata(context, handle, abc_exif, sizeof abc_exif).code, 0);
    ck_assert_int_eq(heif_context_write_to_file(context, in_folder(name)).code, 0);
    heif_image_handle_release(handle);
    heif_image_release(out);
    heif_encoder_release(encoder);
    heif_context_free(context);
    rn_image_finish(&image);
}

START_TEST(heif) {
    enum heif_compression_format format = _i ? heif_compression_AV1 : heif_compression_HEVC;
    if (!heif_have_encoder_for_format(format) || !heif_have_decoder_for_format(format)) return;
    struct rn_image plain = ramp(2 * WIDE, 2 * HIGH), read;
    put_heif("a.heic", format);
    struct rn_image_info info = probe_kind("a.heic");
    ck_assert_int_eq(info.width, 2 * WIDE);
    ck_assert(!info.has_alpha);
    ck_assert_uint_eq(info.camera_key, abc_key());
    ck_assert_int_eq(info.orientation, 1); // the decoder turns it where the file says so
    read_kind("a.heic", &read);
    ck_assert_int_le(worst_difference(&plain, &read), 16);
    rn_image_finish(&plain);
    rn_image_finish(&read);
    survives_damage("a.heic", 151);
}
END_TEST
#endif

#ifdef RN_HAVE_EXR
static void put_le(uint8_t **at, uint64_t value, int bytes) {
    for (int i = 0; i < bytes; i++)
        *(*at)++ = (uint8_t)(value >> 8 * i);
}

static void put_attribute(uint8_t **at, const char *name, const char *type, int size) {
    *at = (uint8_t *)stpcpy((char *)*at, name) + 1;
    *at = (uint8_t *)stpcpy((char *)*at, type) + 1;
    put_le(at, (uint64_t)size, 4);
}

static void put_box(uint8_t **at, const char *name, int across, int down) {
    put_attribute(at, name, "box2i", 16);
    put_le(at, 0, 8);
    put_le(at, (uint64_t)across - 1, 4);
    put_le(at, (uint64_t)down - 1, 4);
}

static void put_float(uint8_t **at, float value) {
    uint32_t bits;
    memcpy(&bits, &value, 4);
    put_le(at, bits, 4);
}

// Uncompressed scan lines of floats A, B, G, R (the order of names), premultiplied: linear light
// x / width over alpha 0.5.
static void put_exr(const char *name, int across, int down) {
    uint8_t file[65536], *at = file;
    put_le(&at, 20000630, 4);
    put_le(&at, 2, 4);
    put_attribute(&at, "channels", "chlist", 4 * 18 + 1);
    for (const char *c = "ABGR"; *c; c++) {
        *at++ = (uint8_t)*c;
        *at++ = 0;
        put_le(&at, 2, 4); // float
        put_le(&at, 0, 4);
        put_le(&at, 1, 4);
        put_le(&at, 1, 4);
    }
    *at++ = 0;
    put_attribute(&at, "compression", "compression", 1);
    *at++ = 0;
    put_box(&at, "dataWindow", across, down);
    put_box(&at, "displayWindow", across, down);
    put_attribute(&at, "lineOrder", "lineOrder", 1);
    *at++ = 0;
    put_attribute(&at, "pixelAspectRatio", "float", 4);
    put_float(&at, 1);
    put_attribute(&at, "screenWindowCenter", "v2f", 8);
    put_le(&at, 0, 8);
    put_attribute(&at, "screenWindowWidth", "float", 4);
    put_float(&at, 1);
    *at++ = 0;
    int line = 4 * 4 * WIDE + 8;
    int rows = down < HIGH ? down : HIGH;
    uint64_t first = (uint64_t)(at - file) + 8 * (uint64_t)rows;
    for (int y = 0; y < rows; y++)
        put_le(&at, first + (uint64_t)(y * line), 8);
    for (int y = 0; y < rows; y++) {
        put_le(&at, (uint64_t)y, 4);
        put_le(&at, 4 * 4 * WIDE, 4);
        for (int c = 0; c < 4; c++)
            for (int x = 0; x < WIDE; x++)
                put_float(&at, c == 0 ? 0.5f : c == 3 ? 0.5f * (float)x / WIDE : 0.25f);
    }
    put_bytes(name, file, (size_t)(at - file));
}

START_TEST(exr) {
    struct rn_image read;
    put_exr("a.exr", WIDE, HIGH);
    struct rn_image_info info = probe_kind("a.exr");
    ck_assert_int_eq(info.width, WIDE);
    ck_assert(info.has_alpha);
    read_kind("a.exr", &read);
    for (int x = 0; x < WIDE; x++) {
        double light = (double)x / WIDE;
        double want = light <= 0.0031308 ? 12.92 * light : 1.055 * pow(light, 1 / 2.4) - 0.055;
        ck_assert_double_eq_tol(read.pixels[4 * x], 255 * want, 0.51);
        ck_assert_int_eq(read.pixels[4 * x + 1], 188); // light 0.5
        ck_assert_int_eq(read.pixels[4 * x + 3], 128);
    }
    rn_image_finish(&read);
    survives_damage("a.exr", 61);
}
END_TEST

// Smaller than a block that the library reads of its header.
START_TEST(exr_of_one_line) {
    struct rn_image read;
    put_exr("a.exr", WIDE, 1);
    read_kind("a.exr", &read);
    ck_assert_int_eq(read.height, 1);
    ck_assert_int_eq(read.pixels[1], 188);
    rn_image_finish(&read);
}
END_TEST

START_TEST(exr_of_huge_size) {
    struct rn_image image;
    put_exr("a.exr", 1000000, 1000000);
    ck_assert_int_ne(rn_image_read(in_folder("a.exr"), NULL, &image, &err), RN_OK);
}
END_TEST
#endif

int main(void) {
    TCase *kinds = tcase_create("kinds");
    tcase_add_checked_fixture(kinds, setup, teardown);
    tcase_set_timeout(kinds, 60);
    tcase_add_loop_test(kinds, orientation_is_told_not_applied, 0, 16);
    tcase_add_test(kinds, orientation_out_of_range_is_none);
    tcase_add_loop_test(kinds, turning, 0, 8);
    tcase_add_loop_test(kinds, poses_decide_on_turning, 0, 2);
    tcase_add_loop_test(kinds, profile_of_wide_colours, 0, 2);
    tcase_add_test(kinds, profile_of_srgb_changes_nothing);
    tcase_add_test(kinds, only_srgb_is_kept_as_it_is);
    tcase_add_test(kinds, profile_of_grey);
    tcase_add_test(kinds, profile_that_is_damaged);
    tcase_add_loop_test(kinds, absent_libraries_are_named, 0, 4);
#ifdef RN_HAVE_WEBP
    tcase_add_test(kinds, webp);
#endif
#ifdef RN_HAVE_TIFF
    tcase_add_loop_test(kinds, tiff, 0, 6);
    tcase_add_test(kinds, tiff_of_huge_size);
#endif
#ifdef RN_HAVE_HEIF
    tcase_add_loop_test(kinds, heif, 0, 2);
#endif
#ifdef RN_HAVE_EXR
    tcase_add_test(kinds, exr);
    tcase_add_test(kinds, exr_of_one_line);
    tcase_add_test(kinds, exr_of_huge_size);
#endif
    Suite *suite = suite_create("image kinds");
    suite_add_tcase(suite, kinds);
    return run_suite(suite);
}

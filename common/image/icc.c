// Colour profiles to sRGB, by lcms2.
#include <lcms2.h>
#include <math.h>
#include <stdlib.h>

#include "common/image/codec.h"
#include "common/math/srgb.h"

#define GRID 9 // colours a channel on which a profile is compared with sRGB

static enum rn_status damaged(const char *where, const char *problem, struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_INVALID, where,
                        "its colour profile %s: export the picture as sRGB", problem);
}

// Whether the transform leaves colours where they are, to one of 255.
static bool changes_nothing(cmsHTRANSFORM transform) {
    uint8_t from[GRID * GRID * GRID][4], to[GRID * GRID * GRID][4];
    for (int i = 0; i < GRID * GRID * GRID; i++) {
        from[i][0] = (uint8_t)(i % GRID * 255 / (GRID - 1));
        from[i][1] = (uint8_t)(i / GRID % GRID * 255 / (GRID - 1));
        from[i][2] = (uint8_t)(i / GRID / GRID * 255 / (GRID - 1));
        from[i][3] = to[i][3] = 255;
    }
    cmsDoTransform(transform, from, to, GRID * GRID * GRID);
    for (int i = 0; i < GRID * GRID * GRID; i++)
        for (int c = 0; c < 3; c++)
            if (abs(from[i][c] - to[i][c]) > 1) return false;
    return true;
}

static void convert_colours(cmsHTRANSFORM transform, struct rn_image *image) {
    for (int y = 0; y < image->height; y++) {
        uint8_t *row = image->pixels + 4 * (size_t)y * (size_t)image->width;
        cmsDoTransform(transform, row, row, (cmsUInt32Number)image->width);
    }
}

// A grey picture has equal channels: each of 256 values is converted once (without the library's
// optimisation, whose coarse table is off by 7 of 255 in the dark).
static void convert_greys(cmsHTRANSFORM transform, uint8_t ret_to[256][4]) {
    uint8_t from[256];
    for (int i = 0; i < 256; i++)
        from[i] = (uint8_t)i;
    cmsDoTransform(transform, from, ret_to, 256);
}

static bool changes_no_grey(cmsHTRANSFORM transform) {
    uint8_t to[256][4];
    convert_greys(transform, to);
    for (int i = 0; i < 256; i++)
        if (abs(to[i][0] - i) > 1) return false;
    return true;
}

static void convert_grey(cmsHTRANSFORM transform, struct rn_image *image) {
    uint8_t to[256][4];
    convert_greys(transform, to);
    size_t count = (size_t)image->width * (size_t)image->height;
    for (size_t i = 0; i < count; i++)
        for (int c = 2; c >= 0; c--)
            image->pixels[4 * i + (size_t)c] = to[image->pixels[4 * i]][c];
}

// A profile, and the way from it to sRGB.
struct way {
    cmsContext context;
    cmsHPROFILE from, to;
    cmsHTRANSFORM transform;
    bool grey;
};

static void end_way(struct way *way) {
    if (way->transform) cmsDeleteTransform(way->transform);
    if (way->from) cmsCloseProfile(way->from);
    if (way->to) cmsCloseProfile(way->to);
    if (way->context) cmsDeleteContext(way->context);
}

// To be ended, also where it fails.
static enum rn_status find_way(const uint8_t *profile, size_t size_bytes, const char *where,
                               struct way *way, struct rn_error *err) {
    *way = (struct way){.context = cmsCreateContext(NULL, NULL)};
    if (size_bytes <= UINT32_MAX)
        way->from = cmsOpenProfileFromMemTHR(way->context, profile, (cmsUInt32Number)size_bytes);
    way->to = cmsCreate_sRGBProfileTHR(way->context);
    cmsColorSpaceSignature space = way->from ? cmsGetColorSpace(way->from) : 0;
    way->grey = space == cmsSigGrayData;
    if (!way->context || !way->to)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, where, "no memory to convert colours");
    if (!way->from) return damaged(where, "is damaged", err);
    if (!way->grey && space != cmsSigRgbData)
        return damaged(where, "is of other colours than grey and RGB", err);
    way->transform = cmsCreateTransformTHR(
        way->context, way->from, way->grey ? TYPE_GRAY_8 : TYPE_RGBA_8, way->to, TYPE_RGBA_8,
        INTENT_RELATIVE_COLORIMETRIC,
        cmsFLAGS_BLACKPOINTCOMPENSATION | (way->grey ? cmsFLAGS_NOOPTIMIZE : cmsFLAGS_COPY_ALPHA));
    return way->transform ? RN_OK : damaged(where, "cannot be used", err);
}

static bool leads_nowhere(const struct way *way) {
    return way->grey ? changes_no_grey(way->transform) : changes_nothing(way->transform);
}

enum rn_status rn_icc_to_srgb(const uint8_t *profile, size_t size_bytes, const char *where,
                              struct rn_image *image, struct rn_error *err) {
    struct way way;
    enum rn_status status = find_way(profile, size_bytes, where, &way, err);
    if (status == RN_OK && !leads_nowhere(&way))
        (way.grey ? convert_grey : convert_colours)(way.transform, image);
    end_way(&way);
    return status;
}

bool rn_icc_is_srgb(const uint8_t *profile, size_t size_bytes) {
    struct way way;
    bool same = find_way(profile, size_bytes, "", &way, NULL) == RN_OK && leads_nowhere(&way);
    end_way(&way);
    return same;
}

uint8_t rn_srgb_byte(float linear) {
    if (!(linear > 0)) return 0;
    if (linear >= 1) return 255;
    return (uint8_t)(rn_srgb_from_linear(linear) * 255 + 0.5f);
}

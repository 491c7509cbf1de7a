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
    if (changes_nothing(transform)) return;
    for (int y = 0; y < image->height; y++) {
        uint8_t *row = image->pixels + 4 * (size_t)y * (size_t)image->width;
        cmsDoTransform(transform, row, row, (cmsUInt32Number)image->width);
    }
}

// A grey picture has equal channels: each of 256 values is converted once (without the library's
// optimisation, whose coarse table is off by 7 of 255 in the dark).
static void convert_grey(cmsHTRANSFORM transform, struct rn_image *image) {
    uint8_t from[256], to[256][4], furthest = 0;
    for (int i = 0; i < 256; i++)
        from[i] = (uint8_t)i;
    cmsDoTransform(transform, from, to, 256);
    for (int i = 0; i < 256; i++)
        if (abs(to[i][0] - i) > furthest) furthest = (uint8_t)abs(to[i][0] - i);
    if (furthest <= 1) return;
    size_t count = (size_t)image->width * (size_t)image->height;
    for (size_t i = 0; i < count; i++)
        for (int c = 2; c >= 0; c--)
            image->pixels[4 * i + (size_t)c] = to[image->pixels[4 * i]][c];
}

enum rn_status rn_icc_to_srgb(const uint8_t *profile, size_t size_bytes, const char *where,
                              struct rn_image *image, struct rn_error *err) {
    enum rn_status status = RN_OK;
    cmsHTRANSFORM transform = NULL;
    cmsContext context = cmsCreateContext(NULL, NULL);
    cmsHPROFILE from = size_bytes <= UINT32_MAX
                           ? cmsOpenProfileFromMemTHR(context, profile, (cmsUInt32Number)size_bytes)
                           : NULL;
    cmsHPROFILE to = cmsCreate_sRGBProfileTHR(context);
    cmsColorSpaceSignature space = from ? cmsGetColorSpace(from) : 0;
    bool grey = space == cmsSigGrayData;
    if (!context || !to)
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, where, "no memory to convert colours");
    else if (!from)
        status = damaged(where, "is damaged", err);
    else if (!grey && space != cmsSigRgbData)
        status = damaged(where, "is of other colours than grey and RGB", err);
    else if (!(transform =
                   cmsCreateTransformTHR(context, from, grey ? TYPE_GRAY_8 : TYPE_RGBA_8, to,
                                         TYPE_RGBA_8, INTENT_RELATIVE_COLORIMETRIC,
                                         cmsFLAGS_BLACKPOINTCOMPENSATION |
                                             (grey ? cmsFLAGS_NOOPTIMIZE : cmsFLAGS_COPY_ALPHA))))
        status = damaged(where, "cannot be used", err);
    else if (grey)
        convert_grey(transform, image);
    else
        convert_colours(transform, image);
    if (transform) cmsDeleteTransform(transform);
    if (from) cmsCloseProfile(from);
    if (to) cmsCloseProfile(to);
    if (context) cmsDeleteContext(context);
    return status;
}

uint8_t rn_srgb_byte(float linear) {
    if (!(linear > 0)) return 0;
    if (linear >= 1) return 255;
    return (uint8_t)(rn_srgb_from_linear(linear) * 255 + 0.5f);
}

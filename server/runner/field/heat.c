#include "server/runner/field/heat.h"

#include <math.h>

// Evenly spaced (Smith & van der Walt 2015). web/css/views.css shows the same ones.
static const uint8_t colours[][3] = {
    {0x44, 0x01, 0x54}, {0x47, 0x2d, 0x7b}, {0x3b, 0x52, 0x8b},
    {0x2c, 0x72, 0x8e}, {0x21, 0x91, 0x8c}, {0x28, 0xae, 0x80},
    {0x5e, 0xc9, 0x62}, {0xad, 0xdc, 0x30}, {0xfd, 0xe7, 0x25},
};
#define LAST (sizeof colours / sizeof *colours - 1)

static double end_of_scale(double most) {
    if (!(most > 0)) return 1;
    double power = pow(10, floor(log10(most))), high = power;
    while (high < most) // 1, 2, 5, 10
        high = high < 1.5 * power ? 2 * power : high < 3 * power ? 5 * power : 10 * power;
    return high;
}

static void put_colour(double unit, float ret[3]) {
    double at = fmin(unit, 1) * LAST;
    size_t first = (size_t)fmin(floor(at), LAST - 1);
    for (int c = 0; c < 3; c++) {
        double low = colours[first][c], high = colours[first + 1][c];
        ret[c] = (float)((low + (high - low) * (at - (double)first)) / 255);
    }
}

enum rn_status rn_heat_picture(const struct rn_picture *map, struct rn_picture *ret_picture,
                               double *ret_high, struct rn_error *err) {
    struct rn_picture picture;
    enum rn_status status = rn_picture_init(map->width, map->height, 3, &picture, err);
    if (status) return status;
    size_t count = (size_t)map->width * (size_t)map->height;
    double most = 0;
    for (size_t i = 0; i < count; i++)
        if (isfinite(map->values[i])) most = fmax(most, (double)map->values[i]);
    double high = end_of_scale(most);
    for (size_t i = 0; i < count; i++)
        if (map->values[i] > 0 && isfinite(map->values[i]))
            put_colour((double)map->values[i] / high, picture.values + 3 * i);
    *ret_high = high;
    *ret_picture = picture;
    return RN_OK;
}

enum rn_status rn_normal_picture(const struct rn_picture *normals, struct rn_picture *ret_picture,
                                 struct rn_error *err) {
    struct rn_picture picture;
    enum rn_status status = rn_picture_init(normals->width, normals->height, 3, &picture, err);
    if (status) return status;
    size_t count = (size_t)normals->width * (size_t)normals->height;
    for (size_t i = 0; i < count; i++) {
        const float *n = normals->values + 3 * i;
        for (int c = 0; c < 3 && (n[0] != 0 || n[1] != 0 || n[2] != 0); c++)
            picture.values[3 * i + c] = 0.5f + 0.5f * n[c];
    }
    *ret_picture = picture;
    return RN_OK;
}

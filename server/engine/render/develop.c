#include "server/engine/render/develop.h"

#include <math.h>
#include <string.h>

// XYZ of a black body's light, Y = 1: the cubic fit of Kim, Park and others (2002), 1667 to 25000
// K.
static void light_of(double kelvins, double ret_xyz[3]) {
    double t = 1e3 / kelvins, x, y;
    if (kelvins < 4000)
        x = ((-0.2661239 * t - 0.2343589) * t + 0.8776956) * t + 0.179910;
    else
        x = ((-3.0258469 * t + 2.1070379) * t + 0.2226347) * t + 0.240390;
    if (kelvins < 2222)
        y = ((-1.1063814 * x - 1.34811020) * x + 2.18555832) * x - 0.20219683;
    else if (kelvins < 4000)
        y = ((-0.9549476 * x - 1.37418593) * x + 2.09137015) * x - 0.16748867;
    else
        y = ((3.0817580 * x - 5.87338670) * x + 3.75112997) * x - 0.37001483;
    ret_xyz[0] = x / y;
    ret_xyz[1] = 1;
    ret_xyz[2] = (1 - x - y) / y;
}

static void multiply(double a[3][3], double b[3][3], double ret[3][3]) {
    double out[3][3] = {{0}};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            for (int k = 0; k < 3; k++)
                out[i][j] += a[i][k] * b[k][j];
    memcpy(ret, out, sizeof out);
}

static void invert(double m[3][3], double ret[3][3]) {
    double determinant = 0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            int a = (j + 1) % 3, b = (j + 2) % 3, c = (i + 1) % 3, d = (i + 2) % 3;
            ret[i][j] = m[a][c] * m[b][d] - m[a][d] * m[b][c];
        }
    for (int k = 0; k < 3; k++)
        determinant += m[0][k] * ret[k][0];
    for (int i = 0; i < 9; i++)
        ret[i / 3][i % 3] /= determinant;
}

// Linear sRGB as the eye's cones see it: Bradford's matrix times that from linear sRGB to XYZ.
static void cones_of_srgb(double ret_bradford[3][3], double ret[3][3]) {
    double bradford[3][3] = {
        {0.8951, 0.2664, -0.1614}, {-0.7502, 1.7135, 0.0367}, {0.0389, -0.0685, 1.0296}};
    double xyz[3][3] = {{0.4124564, 0.3575761, 0.1804375},
                        {0.2126729, 0.7151522, 0.0721750},
                        {0.0193339, 0.1191920, 0.9503041}};
    memcpy(ret_bradford, bradford, sizeof bradford);
    multiply(bradford, xyz, ret);
}

static void adapt(double white_k, double ret[3][3]) {
    double bradford[3][3], into[3][3], from[3][3], gains[3][3] = {{0}}, light[3], white[3];
    cones_of_srgb(bradford, into);
    invert(into, from);
    light_of(white_k, light);
    light_of(RN_DAYLIGHT_K, white);
    for (int i = 0; i < 3; i++) {
        double seen = 0, wanted = 0;
        for (int k = 0; k < 3; k++) {
            seen += bradford[i][k] * light[k];
            wanted += bradford[i][k] * white[k];
        }
        gains[i][i] = wanted / seen;
    }
    multiply(gains, into, gains);
    multiply(from, gains, ret);
}

struct rn_development rn_development_of(double stops, double white_k) {
    struct rn_development out = {.on = stops != 0 || white_k > 0, .gain = {1, 1, 1}};
    double matrix[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    if (white_k > 0) adapt(white_k, matrix);
    for (int i = 0; i < 9; i++)
        out.matrix[i / 3][i % 3] = (float)(matrix[i / 3][i % 3] * exp2(stops));
    return out;
}

void rn_development_expose(struct rn_development *development, const double gain[3]) {
    if (!(gain[0] > 0)) return;
    development->on = true;
    for (int c = 0; c < 3; c++)
        development->gain[c] = (float)gain[c];
}

void rn_develop(const struct rn_development *development, float alpha, const float background[3],
                float rgb[3]) {
    float light[3];
    if (!development->on || !(alpha > 0) || !isfinite(rgb[0] + rgb[1] + rgb[2])) return;
    for (int c = 0; c < 3; c++)
        light[c] = rn_srgb_to_linear(development->gain[c] *
                                     ((rgb[c] - (1 - alpha) * background[c]) / alpha));
    for (int i = 0; i < 3; i++) {
        const float *row = development->matrix[i];
        float mixed = row[0] * light[0] + row[1] * light[1] + row[2] * light[2];
        rgb[i] = alpha * rn_srgb_from_linear(mixed) + (1 - alpha) * background[i];
    }
}

#include "common/image/metrics.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define MAX_WINDOW 11
#define SIGMA 1.5
#define C1 (0.01 * 0.01)
#define C2 (0.03 * 0.03)
#define FIELDS 4 // a, b, a^2 + b^2, a b

static bool comparable(const struct rn_picture *a, const struct rn_picture *b) {
    if (a->width != b->width || a->height != b->height || a->channels != b->channels) return false;
    size_t count = (size_t)a->width * (size_t)a->height * (size_t)a->channels;
    for (size_t i = 0; i < count; i++) {
        float x = a->values[i], y = b->values[i];
        if (!(x >= 0 && x <= 1 && y >= 0 && y <= 1)) return false;
    }
    return count > 0;
}

enum rn_status rn_psnr(const struct rn_picture *a, const struct rn_picture *b, double *ret_db) {
    if (!comparable(a, b)) return RN_ERROR_INVALID;
    size_t row = (size_t)a->width * (size_t)a->channels;
    double total = 0;
    for (size_t y = 0; y < (size_t)a->height; y++) {
        double sum = 0;
        for (size_t i = y * row; i < (y + 1) * row; i++) {
            double difference = (double)a->values[i] - (double)b->values[i];
            sum += difference * difference;
        }
        total += sum;
    }
    *ret_db = total > 0 ? -10 * log10(total / ((double)row * a->height)) : INFINITY;
    return RN_OK;
}

// Both pictures' windows are separable, so each row is filtered along x once and kept in a ring of
// `window` rows, which are then filtered along y.
struct ssim {
    const struct rn_picture *a, *b;
    int window;                       // taps, odd
    double taps[MAX_WINDOW];          // sum 1
    size_t columns;                   // positions of the window along x
    double *row[FIELDS];              // the fields of one row, unfiltered: width each
    double *ring[MAX_WINDOW][FIELDS]; // filtered along x: columns each
    double *mean[FIELDS];             // filtered along x and y: columns each
};

static void init_taps(struct ssim *ssim) {
    double sum = 0;
    for (int i = 0; i < ssim->window; i++) {
        double x = i - ssim->window / 2;
        sum += ssim->taps[i] = exp(-x * x / (2 * SIGMA * SIGMA));
    }
    for (int i = 0; i < ssim->window; i++)
        ssim->taps[i] /= sum;
}

// Cuts one block into the rows of `ssim`; NULL when there is no memory.
static double *allocate(struct ssim *ssim) {
    size_t width = (size_t)ssim->a->width, kept = (size_t)ssim->window + 1;
    double *block = malloc(FIELDS * (width + kept * ssim->columns) * sizeof *block), *next = block;
    if (!block) return NULL;
    for (int f = 0; f < FIELDS; f++, next += width)
        ssim->row[f] = next;
    for (int f = 0; f < FIELDS; f++, next += ssim->columns)
        ssim->mean[f] = next;
    for (int i = 0; i < ssim->window; i++)
        for (int f = 0; f < FIELDS; f++, next += ssim->columns)
            ssim->ring[i][f] = next;
    return block;
}

static void load_row(struct ssim *ssim, int y, int channel) {
    size_t channels = (size_t)ssim->a->channels, width = (size_t)ssim->a->width;
    size_t start = (size_t)y * width * channels + (size_t)channel;
    const float *a = ssim->a->values + start, *b = ssim->b->values + start;
    for (size_t x = 0; x < width; x++) {
        double va = (double)a[x * channels], vb = (double)b[x * channels];
        ssim->row[0][x] = va;
        ssim->row[1][x] = vb;
        ssim->row[2][x] = va * va + vb * vb;
        ssim->row[3][x] = va * vb;
    }
}

// to[x] = sum over i of taps[i] * from[i][x].
static void weighted_sum(const struct ssim *ssim, const double *const *from, double *to) {
    for (size_t x = 0; x < ssim->columns; x++)
        to[x] = ssim->taps[0] * from[0][x];
    for (int i = 1; i < ssim->window; i++) {
        double tap = ssim->taps[i];
        const double *source = from[i];
        for (size_t x = 0; x < ssim->columns; x++)
            to[x] += tap * source[x];
    }
}

static void filter_row(struct ssim *ssim, int y) {
    const double *shifted[MAX_WINDOW];
    for (int f = 0; f < FIELDS; f++) {
        for (int i = 0; i < ssim->window; i++)
            shifted[i] = ssim->row[f] + i;
        weighted_sum(ssim, shifted, ssim->ring[y % ssim->window][f]);
    }
}

// Sum of the index over the windows whose last row is y.
static double index_of_row(struct ssim *ssim, int y) {
    const double *rows[MAX_WINDOW];
    for (int f = 0; f < FIELDS; f++) {
        for (int i = 0; i < ssim->window; i++)
            rows[i] = ssim->ring[(y + 1 + i) % ssim->window][f];
        weighted_sum(ssim, rows, ssim->mean[f]);
    }
    double sum = 0;
    for (size_t x = 0; x < ssim->columns; x++) {
        double ma = ssim->mean[0][x], mb = ssim->mean[1][x];
        double squares = ma * ma + mb * mb, product = ma * mb;
        double variances = ssim->mean[2][x] - squares, covariance = ssim->mean[3][x] - product;
        sum += (2 * product + C1) * (2 * covariance + C2) / ((squares + C1) * (variances + C2));
    }
    return sum;
}

enum rn_status rn_ssim(const struct rn_picture *a, const struct rn_picture *b, double *ret_ssim) {
    if (!comparable(a, b)) return RN_ERROR_INVALID;
    int smaller = a->width < a->height ? a->width : a->height;
    struct ssim ssim = {.a = a, .b = b};
    ssim.window = smaller >= MAX_WINDOW ? MAX_WINDOW : smaller - (smaller + 1) % 2;
    ssim.columns = (size_t)(a->width - ssim.window + 1);
    init_taps(&ssim);
    double *block = allocate(&ssim);
    if (!block) return RN_ERROR_NO_MEMORY;
    double total = 0;
    for (int channel = 0; channel < a->channels; channel++)
        for (int y = 0; y < a->height; y++) {
            load_row(&ssim, y, channel);
            filter_row(&ssim, y);
            if (y >= ssim.window - 1) total += index_of_row(&ssim, y);
        }
    free(block);
    *ret_ssim = total / ((double)ssim.columns * (a->height - ssim.window + 1) * a->channels);
    return RN_OK;
}

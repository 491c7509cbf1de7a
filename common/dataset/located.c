// Where cameras stood by GPS, and so which way is up and how long a unit is. From the air, straight
// down, nothing in the pictures says it.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/dataset/dataset.h"
#include "common/math/numbers.h"
#include "common/math/rotation.h"
#include "common/math/symmetric.h"
#include "common/math/vector.h"

#define FEWEST 4     // cameras that GPS placed
#define ROUNDS 4     // of leaving out what is off
#define OFF 4        // times the median distance, from which a place is one that GPS got wrong
#define SHARPEST 0.1 // of the cameras' second longest spread, that GPS is off by at most

#define EQUATOR_M 6378137.0      // WGS 84
#define ECCENTRICITY2 6.69438e-3 // squared

// A camera in the dataset and on Earth.
struct stand {
    double at[3], earth[3]; // dataset units; metres east, north and up of the first
    double off;             // metres between the two, as fitted
    bool kept;
};

void rn_located_metres(const double of[3], const double from[3], double ret_metres[3]) {
    double radians = M_PI / 180, sine = sin(from[0] * radians);
    double curve = 1 - ECCENTRICITY2 * sine * sine;
    double across = EQUATOR_M / sqrt(curve), along = across * (1 - ECCENTRICITY2) / curve;
    ret_metres[0] = remainder(of[1] - from[1], 360) * radians * across * cos(from[0] * radians);
    ret_metres[1] = (of[0] - from[0]) * radians * along;
    ret_metres[2] = of[2] - from[2];
}

static size_t gather(const struct rn_dataset *dataset, struct stand *stands) {
    const double *from = NULL;
    size_t count = 0;
    for (size_t f = 0; f < dataset->frame_count; f++) {
        const struct rn_frame *frame = &dataset->frames[f];
        if (!frame->located || frame->scale > 0) continue;
        struct stand *stand = &stands[count++];
        if (!from) from = frame->located_at;
        rn_located_metres(frame->located_at, from, stand->earth);
        for (int i = 0; i < 3; i++)
            stand->at[i] = frame->camera.world_from_camera[i][3];
        stand->kept = true;
    }
    return count;
}

// Means of those that are kept; how many they are.
static size_t find_middles(const struct stand *stands, size_t count, double at[3],
                           double earth[3]) {
    size_t kept = 0;
    memset(at, 0, 3 * sizeof *at);
    memset(earth, 0, 3 * sizeof *earth);
    for (size_t n = 0; n < count; n++) {
        kept += stands[n].kept;
        for (int i = 0; i < 3 && stands[n].kept; i++) {
            at[i] += stands[n].at[i];
            earth[i] += stands[n].earth[i];
        }
    }
    for (int i = 0; i < 3 && kept; i++) {
        at[i] /= (double)kept;
        earth[i] /= (double)kept;
    }
    return kept;
}

// The rotation of dataset directions to Earth's for which the sum over `m`, m[i][j] the products of
// dataset axis i with Earth's j, is the largest: Horn 1987, section 4.
static bool find_turn(double m[3][3], double turn[3][4]) {
    double n[4][4] = {
        {m[0][0] + m[1][1] + m[2][2], m[1][2] - m[2][1], m[2][0] - m[0][2], m[0][1] - m[1][0]},
        {m[1][2] - m[2][1], m[0][0] - m[1][1] - m[2][2], m[0][1] + m[1][0], m[2][0] + m[0][2]},
        {m[2][0] - m[0][2], m[0][1] + m[1][0], m[1][1] - m[0][0] - m[2][2], m[1][2] + m[2][1]},
        {m[0][1] - m[1][0], m[2][0] + m[0][2], m[1][2] + m[2][1], m[2][2] - m[0][0] - m[1][1]}};
    double axes[4][4], wxyz[4];
    int most = 0;
    rn_symmetric_axes4(n, axes);
    for (int i = 1; i < 4; i++)
        if (n[i][i] > n[most][most]) most = i;
    for (int i = 0; i < 4; i++)
        wxyz[i] = axes[i][most];
    return rn_rotation_from_quaternion(wxyz, turn);
}

// The second longest of the standard deviations along three axes: 0 where all stand in a line,
// about which nothing tells how the scene is turned.
static double second_spread(double covariance[3][3]) {
    double axes[3][3], along[3];
    rn_symmetric_axes3(covariance, axes);
    for (int i = 0; i < 3; i++)
        along[i] = covariance[i][i];
    return sqrt(fmax(0, rn_numbers_quantile(along, 3, 0.5)));
}

// The similarity of those that are kept; false where they do not say one.
static bool fit(struct stand *stands, size_t count, struct rn_located *found) {
    double at[3], earth[3], products[3][3] = {{0}}, covariance[3][3] = {{0}}, turn[3][4];
    double size = 0, along = 0, squares = 0;
    found->count = find_middles(stands, count, at, earth);
    if (found->count < FEWEST) return false;
    for (size_t n = 0; n < count; n++)
        for (int i = 0; i < 3 && stands[n].kept; i++) {
            double a = stands[n].at[i] - at[i], e = stands[n].earth[i] - earth[i];
            size += a * a;
            for (int j = 0; j < 3; j++) {
                products[i][j] += a * (stands[n].earth[j] - earth[j]);
                covariance[i][j] += e * (stands[n].earth[j] - earth[j]) / (double)found->count;
            }
        }
    if (!(size > 0) || !find_turn(products, turn)) return false;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            along += turn[j][i] * products[i][j];
    found->metres = along / size;
    for (size_t n = 0; n < count; n++) {
        double off[3];
        for (int j = 0; j < 3; j++) {
            off[j] = stands[n].earth[j] - earth[j];
            for (int i = 0; i < 3; i++)
                off[j] -= found->metres * turn[j][i] * (stands[n].at[i] - at[i]);
        }
        stands[n].off = sqrt(rn_dot(off, off));
        squares += stands[n].kept ? rn_dot(off, off) / (double)found->count : 0;
    }
    for (int i = 0; i < 3; i++)
        found->up[i] = turn[2][i];
    rn_make_unit(found->up); // to the last bit
    found->off_m = sqrt(squares);
    return found->metres > 0 && found->off_m < SHARPEST * second_spread(covariance);
}

// Keeps those that are not far off.
static void sift(struct stand *stands, size_t count, double *work) {
    for (size_t n = 0; n < count; n++)
        work[n] = stands[n].off;
    double most = OFF * rn_numbers_quantile(work, count, 0.5);
    for (size_t n = 0; n < count; n++)
        stands[n].kept = stands[n].off <= most;
}

enum rn_status rn_dataset_locate(const struct rn_dataset *dataset, struct rn_located *ret_located,
                                 struct rn_error *err) {
    struct stand *stands = calloc(dataset->frame_count + 1, sizeof *stands);
    double *work = calloc(dataset->frame_count + 1, sizeof *work);
    struct rn_located found = {0};
    bool said = false;
    if (stands && work) {
        size_t count = found.of = gather(dataset, stands);
        for (int round = 0; round < ROUNDS; round++) {
            said = fit(stands, count, &found) && 2 * found.count > count;
            sift(stands, count, work);
        }
    }
    *ret_located = said ? found : (struct rn_located){0};
    enum rn_status status =
        stands && work ? RN_OK
                       : rn_error_set(err, RN_ERROR_NO_MEMORY, dataset->name, "out of memory");
    free(stands);
    free(work);
    return status;
}

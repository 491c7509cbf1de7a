// Cases 12 and 13: picture metrics against their definitions in long double, and what scaling,
// rounding and compositing do to pictures against exact integers.
#include <stdbool.h>
#include <string.h>

#include "common/image/image.h"
#include "common/image/metrics.h"
#include "tests/support/naive_metrics.h"
#include "tests/support/numerics.h"

static void must(enum rn_status status) {
    if (status == RN_OK) return;
    fprintf(stderr, "unexpected status: %s\n", rn_status_name(status));
    exit(1);
}

static int whole(struct numerics_random *random, int low, int high) {
    return (int)numerics_uniform(random, low, high + 1.0);
}

static struct rn_picture new_picture(int width, int height, int channels) {
    struct rn_picture picture;
    must(rn_picture_init(width, height, channels, &picture, NULL));
    return picture;
}

static int values_of(const struct rn_picture *picture) {
    return picture->width * picture->height * picture->channels;
}

// ---- case 12: metrics ----

enum content { NOISE, NEAR, TINY, CONSTANT, NEARLY_CONSTANT, BLACK_WHITE, EDGE, CONTENTS };
static const char *const content_names[] = {
    "noise",           "noise of 1e-3 apart", "1e-30 apart", "constant",
    "nearly constant", "black against white", "edge"};

static void fill(enum content content, struct numerics_random *random, struct rn_picture *a,
                 struct rn_picture *b) {
    double level_a = numerics_uniform(random, 0, 1), level_b = numerics_uniform(random, 0, 1);
    for (int i = 0; i < values_of(a); i++) {
        double u = numerics_uniform(random, 0, 1), v = numerics_uniform(random, 0, 1);
        double x = u, y = v;
        if (content == NEAR) y = fmin(1, u + 1e-3 * v);
        if (content == TINY) x = 1e-30 * u, y = 1e-30 * v;
        if (content == CONSTANT) x = level_a, y = level_b;
        if (content == NEARLY_CONSTANT) x = 1 - 1e-7 * u, y = 1 - 1e-7 * v;
        if (content == BLACK_WHITE) x = 0, y = 1;
        if (content == EDGE) x = i % 7 < 3, y = i % 7 < 3 ? 1 - 0.01 * v : 0;
        a->values[i] = (float)x;
        b->values[i] = (float)y;
    }
}

struct metric_cases {
    struct numerics_case psnr, ssim, symmetry, identity;
};

static void see_metrics(struct metric_cases *cases, const struct rn_picture *a,
                        const struct rn_picture *b, const char *content) {
    double psnr, ssim, swapped, same_psnr, same_ssim;
    must(rn_psnr(a, b, &psnr));
    must(rn_ssim(a, b, &ssim));
    must(rn_ssim(b, a, &swapped));
    must(rn_psnr(a, a, &same_psnr));
    must(rn_ssim(a, a, &same_ssim));
    double psnr_truth = naive_psnr(a, b);
    double psnr_error = psnr == psnr_truth ? 0 : fabs(psnr - psnr_truth);
    const char *where = "%s, %d x %d x %d";
    int w = a->width, h = a->height, c = a->channels;
    numerics_see(&cases->psnr, psnr_error, where, content, w, h, c);
    numerics_see(&cases->ssim, fabs(ssim - naive_ssim(a, b)), where, content, w, h, c);
    numerics_see(&cases->symmetry, fabs(ssim - swapped), where, content, w, h, c);
    double identity = fabs(same_ssim - 1) + (same_psnr == INFINITY ? 0 : 1);
    numerics_see(&cases->identity, identity, where, content, w, h, c);
}

static int check_metrics(struct numerics_random *random) {
    static const int sizes[][2] = {{1, 1},   {2, 1},   {2, 2},   {3, 3},   {10, 10}, {11, 11},
                                   {12, 12}, {11, 90}, {90, 11}, {10, 64}, {400, 1}, {60, 45}};
    const char *range = "1x1 to 400x1 and 60x45, 1 to 4 channels, also below the window";
    struct metric_cases cases = {
        {"12 PSNR against its definition", range, "dB", 1e-12, 0, ""},
        {"12 SSIM against its definition", range, "absolute", 5e-11, 0, ""},
        {"12 SSIM of swapped pictures", range, "absolute", 0, 0, ""},
        {"12 identical pictures: SSIM 1, PSNR infinite", range, "absolute", 0, 0, ""}};
    const int corners = sizeof sizes / sizeof *sizes;
    for (int i = 0; i < corners + 8; i++)
        for (int content = 0; content < CONTENTS; content++) {
            int width = i < corners ? sizes[i][0] : whole(random, 1, 50);
            int height = i < corners ? sizes[i][1] : whole(random, 1, 50);
            int channels = whole(random, 0, 2);
            channels += channels > 0 ? 2 : 1; // 1, 3 or 4
            struct rn_picture a = new_picture(width, height, channels);
            struct rn_picture b = new_picture(width, height, channels);
            fill((enum content)content, random, &a, &b);
            see_metrics(&cases, &a, &b, content_names[content]);
            rn_picture_finish(&a);
            rn_picture_finish(&b);
        }
    return numerics_close(&cases.psnr) + numerics_close(&cases.ssim) +
           numerics_close(&cases.symmetry) + numerics_close(&cases.identity);
}

// ---- case 13: pictures ----

// Random bytes; a third of the pixels is transparent, a third opaque.
static struct rn_image random_image(struct numerics_random *random, int width, int height,
                                    bool alpha) {
    struct rn_image image;
    must(rn_image_init(width, height, &image, NULL));
    for (int i = 0; i < width * height * 4; i++)
        image.pixels[i] = (uint8_t)whole(random, 0, 255);
    for (int i = 0; i < width * height; i++) {
        int kind = whole(random, 0, 2);
        if (!alpha || kind == 1) image.pixels[4 * i + 3] = 255;
        if (alpha && kind == 0) image.pixels[4 * i + 3] = 0;
    }
    return image;
}

// Exact sums over one target pixel by counting cells of the grid that both sizes divide:
// channels 0..2 of c * a, 3 of a, 4..6 of c; *ret_cells is how many cells.
static void count_cells(const struct rn_image *image, int width, int height, int tx, int ty,
                        uint64_t sums[7], uint64_t *ret_cells) {
    memset(sums, 0, 7 * sizeof *sums);
    for (int y = ty * image->height; y < (ty + 1) * image->height; y++)
        for (int x = tx * image->width; x < (tx + 1) * image->width; x++) {
            const uint8_t *p = image->pixels + 4 * (y / height * image->width + x / width);
            for (int c = 0; c < 3; c++) {
                sums[c] += (uint64_t)p[c] * p[3];
                sums[4 + c] += p[c];
            }
            sums[3] += p[3];
        }
    *ret_cells = (uint64_t)image->width * (uint64_t)image->height;
}

struct scale_cases {
    struct numerics_case colour, alpha, straight;
};

static void see_downscale(struct scale_cases *cases, const struct rn_image *image, int width,
                          int height) {
    struct rn_image soft, hard;
    must(rn_image_downscale(image, width, height, RN_DOWNSCALE_PREMULTIPLIED, &soft, NULL));
    must(rn_image_downscale(image, width, height, RN_DOWNSCALE_STRAIGHT, &hard, NULL));
    for (int i = 0; i < width * height; i++) {
        uint64_t sums[7], cells;
        count_cells(image, width, height, i % width, i / width, sums, &cells);
        const uint8_t *p = soft.pixels + 4 * i, *q = hard.pixels + 4 * i;
        const char *where = "%d x %d to %d x %d, pixel %d";
        for (int c = 0; c < 4; c++) {
            double truth = c == 3 ? (double)sums[3] / (double)cells
                                  : (double)sums[c] / (double)sums[3]; // unseen without alpha
            if (c == 3 || sums[3] > 0)
                numerics_see(c == 3 ? &cases->alpha : &cases->colour, fabs(p[c] - truth), where,
                             image->width, image->height, width, height, i);
            uint64_t floor_of_mean = (c == 3 ? sums[3] : sums[4 + c]) / cells;
            numerics_see(&cases->straight, fabs(q[c] - (double)floor_of_mean), where, image->width,
                         image->height, width, height, i);
        }
    }
    rn_image_finish(&soft);
    rn_image_finish(&hard);
}

static int check_downscale(struct numerics_random *random) {
    const char *range = "1x1..40x40 to any smaller size, alpha 0 included";
    struct scale_cases cases = {
        {"13 premultiplied downscale, colour", range, "levels of 255", 0.5, 0, ""},
        {"13 premultiplied downscale, alpha", range, "levels of 255", 0.5, 0, ""},
        {"13 straight downscale against the truncated exact mean", range, "levels of 255", 0, 0,
         ""}};
    static const int corners[][4] = {{1, 1, 1, 1},   {2, 2, 1, 1},     {3, 1, 2, 1},
                                     {40, 40, 1, 1}, {40, 39, 39, 38}, {17, 5, 16, 1}};
    const int count = sizeof corners / sizeof *corners;
    for (int i = 0; i < count + 60; i++) {
        int w = i < count ? corners[i][0] : whole(random, 1, 40);
        int h = i < count ? corners[i][1] : whole(random, 1, 40);
        struct rn_image image = random_image(random, w, h, i % 4 != 0);
        see_downscale(&cases, &image, i < count ? corners[i][2] : whole(random, 1, w),
                      i < count ? corners[i][3] : whole(random, 1, h));
        rn_image_finish(&image);
    }
    return numerics_close(&cases.colour) + numerics_close(&cases.alpha) +
           numerics_close(&cases.straight);
}

// What lies under alpha 0 may be anything: it changes nothing that is seen.
static int check_hidden(struct numerics_random *random) {
    struct numerics_case hidden = {"13 colour under alpha 0, seen over any background",
                                   "premultiplied, 2x2..40x40 to any smaller size",
                                   "levels of 255",
                                   0,
                                   0,
                                   ""};
    for (int i = 0; i < 40; i++) {
        int w = whole(random, 2, 40), h = whole(random, 2, 40);
        int tw = whole(random, 1, w - 1), th = whole(random, 1, h - 1);
        struct rn_image image = random_image(random, w, h, true), a, b;
        must(rn_image_downscale(&image, tw, th, RN_DOWNSCALE_PREMULTIPLIED, &a, NULL));
        for (int k = 0; k < w * h; k++)
            for (int c = 0; c < 3 && image.pixels[4 * k + 3] == 0; c++)
                image.pixels[4 * k + c] = (uint8_t)whole(random, 0, 255);
        must(rn_image_downscale(&image, tw, th, RN_DOWNSCALE_PREMULTIPLIED, &b, NULL));
        for (int k = 0; k < tw * th * 4; k++)
            numerics_see(&hidden, abs(a.pixels[k] - b.pixels[k]), "%d x %d to %d x %d, byte %d", w,
                         h, tw, th, k);
        rn_image_finish(&image);
        rn_image_finish(&a);
        rn_image_finish(&b);
    }
    return numerics_close(&hidden);
}

// A half-covered pixel over white. The straight mean's known errors are -0.25 and -0.125.
static int check_edge(void) {
    static const struct {
        const char *name;
        enum rn_downscale mode;
        double surface, known;
    } edges[] = {
        {"13 edge, premultiplied, white: 1", RN_DOWNSCALE_PREMULTIPLIED, 1, 1},
        {"13 edge, premultiplied, mid-grey: 0.75", RN_DOWNSCALE_PREMULTIPLIED, 0.5, 0.75},
        {"13 edge, straight, white: the known 0.75", RN_DOWNSCALE_STRAIGHT, 1, 0.75},
        {"13 edge, straight, mid-grey: the known 0.625", RN_DOWNSCALE_STRAIGHT, 0.5, 0.625}};
    int failed = 0;
    for (int i = 0; i < 4; i++) {
        // Bytes are multiples of 1/255, so half of one is off by up to half a level, twice.
        struct numerics_case edge = {
            edges[i].name, "2x2 to 1x1, half covered, over white", "absolute", 1.0 / 255, 0, ""};
        uint8_t level = (uint8_t)(edges[i].surface * 255 + 0.5);
        uint8_t pixels[16] = {level, level, level, 255, 0, 0, 0, 0,
                              level, level, level, 255, 0, 0, 0, 0};
        struct rn_image image = {.width = 2, .height = 2, .has_alpha = true, .pixels = pixels}, out;
        struct rn_picture seen;
        must(rn_image_downscale(&image, 1, 1, edges[i].mode, &out, NULL));
        must(rn_image_composite(&out, (const float[3]){1, 1, 1}, &seen, NULL));
        double got = (double)seen.values[0];
        numerics_see(&edge, fabs(got - edges[i].known), "%.4f for %g", got, edges[i].known);
        failed += numerics_close(&edge);
        rn_picture_finish(&seen);
        rn_image_finish(&out);
    }
    return failed;
}

// fp32 compositing against float64, at every alpha.
static int check_composite(struct numerics_random *random) {
    struct numerics_case cases[2] = {
        {"13 composite against float64", "every colour and alpha, backgrounds in [0,1]", "2^-24", 5,
         0, ""},
        {"13 bytes to fp32 and back", "every byte, any background, alpha 255", "levels of 255", 0,
         0, ""}};
    struct rn_image image, back;
    must(rn_image_init(256, 256, &image, NULL));
    for (int i = 0; i < 65536; i++)
        memset(image.pixels + 4 * i, i % 256, 3), image.pixels[4 * i + 3] = (uint8_t)(i / 256);
    for (int round = 0; round < 8; round++) {
        float background[3] = {0, 1, (float)numerics_uniform(random, 0, 1)};
        struct rn_picture seen;
        must(rn_image_composite(&image, background, &seen, NULL));
        must(rn_picture_to_image(&seen, &back, NULL));
        for (int i = 0; i < 3 * 65536; i++) {
            double colour = i / 3 % 256 / 255.0, alpha = i / 3 / 256 / 255.0;
            double truth = colour * alpha + (1 - alpha) * (double)background[i % 3];
            numerics_see(&cases[0], fabs((double)seen.values[i] - truth) * 0x1p24,
                         "colour %d, alpha %d, background %.9g", i / 3 % 256, i / 3 / 256,
                         (double)background[i % 3]);
            if (alpha == 1)
                numerics_see(&cases[1], abs(back.pixels[i / 3 * 4 + i % 3] - i / 3 % 256),
                             "colour %d", i / 3 % 256);
        }
        rn_picture_finish(&seen);
        rn_image_finish(&back);
    }
    rn_image_finish(&image);
    return numerics_close(&cases[0]) + numerics_close(&cases[1]);
}

// 16-bit samples: every value is written by the depth encoder and read back as 8 bits.
static int check_sixteen_bits(void) {
    struct numerics_case reading = {
        "13 16-bit PNG read as 8 bits", "every 16-bit value", "levels of 255", 0.5, 0, ""};
    struct rn_picture depth = new_picture(256, 256, 1);
    for (int i = 0; i < 65536; i++)
        depth.values[i] = (float)i;
    uint8_t *bytes;
    size_t size;
    must(rn_picture_encode_depth_png(&depth, 65535, 1, &bytes, &size, NULL));
    struct rn_image image;
    must(rn_image_decode(bytes, size, "", NULL, &image, NULL));
    for (int i = 0; i < 65536; i++)
        numerics_see(&reading, fabs(image.pixels[4 * i] - i / 257.0), "%d", i);
    rn_image_finish(&image);
    rn_picture_finish(&depth);
    free(bytes);
    return numerics_close(&reading);
}

// The PSNR an exact model can reach against pictures stored in 8 bits: the error of rounding is
// uniform in +-1/2 level, of truncation in [0, 1) levels: 20 log10(255) + 10 log10(12) and
// + 10 log10(3). The bound is six standard deviations of the mean square of the samples drawn.
#define ROUNDING_CAP 58.9226
#define TRUNCATION_CAP 52.9020

static void see_cap(struct numerics_case *c, const struct rn_picture *truth,
                    const struct rn_picture *stored, double cap) {
    double psnr;
    must(rn_psnr(truth, stored, &psnr));
    numerics_see(c, fabs(psnr - cap), "%.3f dB, known %.2f dB", psnr, cap);
}

static int check_caps_of_values(struct numerics_random *random) {
    struct numerics_case cases[2] = {
        {"13 rounding's PSNR cap 58.9 dB", "786432 uniform values to bytes", "dB", 0.03, 0, ""},
        {"13 truncation's PSNR cap 52.9 dB", "786432 uniform values to bytes", "dB", 0.03, 0, ""}};
    struct rn_picture truth = new_picture(512, 512, 3), truncated = new_picture(512, 512, 3);
    for (int i = 0; i < values_of(&truth); i++) {
        truth.values[i] = (float)numerics_uniform(random, 0, 1);
        truncated.values[i] = (float)(int)(truth.values[i] * 255.0f) / 255.0f;
    }
    struct rn_image image;
    struct rn_picture rounded;
    must(rn_picture_to_image(&truth, &image, NULL));
    must(rn_image_composite(&image, (const float[3]){0}, &rounded, NULL));
    see_cap(&cases[0], &truth, &rounded, ROUNDING_CAP);
    see_cap(&cases[1], &truth, &truncated, TRUNCATION_CAP);
    rn_image_finish(&image);
    rn_picture_finish(&rounded);
    rn_picture_finish(&truncated);
    rn_picture_finish(&truth);
    return numerics_close(&cases[0]) + numerics_close(&cases[1]);
}

// The exact means of 16x16 blocks of opaque colours.
static struct rn_picture block_means(const struct rn_image *image) {
    int side = image->width / 16;
    struct rn_picture means = new_picture(side, side, 3);
    for (int i = 0; i < values_of(&means); i++) {
        int x = i / 3 % side * 16, y = i / 3 / side * 16, sum = 0;
        for (int k = 0; k < 256; k++)
            sum += image->pixels[4 * ((y + k / 16) * image->width + x + k % 16) + i % 3];
        means.values[i] = (float)(sum / (256 * 255.0));
    }
    return means;
}

// The same caps of whole conversions: 1024 x 1024 random pixels to 64 x 64.
static int check_caps_of_scaling(struct numerics_random *random) {
    const char *range = "random 1024x1024 to 64x64, against the exact mean";
    struct numerics_case cases[2] = {
        {"13 downscale reaches rounding's cap", range, "dB", 0.3, 0, ""},
        {"13 published pyramid has truncation's cap", range, "dB", 0.3, 0, ""}};
    const float black[3] = {0};
    struct rn_image image = random_image(random, 1024, 1024, false), soft, levels[5];
    struct rn_picture truth = block_means(&image), seen;
    must(rn_image_downscale(&image, 64, 64, RN_DOWNSCALE_PREMULTIPLIED, &soft, NULL));
    must(rn_image_composite(&soft, black, &seen, NULL));
    see_cap(&cases[0], &truth, &seen, ROUNDING_CAP);
    rn_picture_finish(&seen);
    must(rn_image_legacy_pyramid(&image, 5, levels, NULL));
    must(rn_image_composite(&levels[4], black, &seen, NULL));
    see_cap(&cases[1], &truth, &seen, TRUNCATION_CAP);
    rn_picture_finish(&seen);
    rn_picture_finish(&truth);
    rn_image_finish(&soft);
    rn_image_finish(&image);
    for (int i = 0; i < 5; i++)
        rn_image_finish(&levels[i]);
    return numerics_close(&cases[0]) + numerics_close(&cases[1]);
}

int main(void) {
    struct numerics_random random = numerics_random();
    int failed = check_metrics(&random);
    failed += check_downscale(&random);
    failed += check_hidden(&random);
    failed += check_edge();
    failed += check_composite(&random);
    failed += check_sixteen_bits();
    failed += check_caps_of_values(&random);
    failed += check_caps_of_scaling(&random);
    return failed > 0;
}

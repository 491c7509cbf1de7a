// LPIPS on weights made here, against the definition in float64.
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/base/buf.h"
#include "common/image/lpips.h"
#include "common/math/rng.h"
#include "tests/support/suite.h"

enum { WIDTH = 37, HEIGHT = 33, LAYERS = 13 };

static const int slices[LAYERS] = {1, 1, 2, 2, 3, 3, 3, 4, 4, 4, 5, 5, 5};
static const int indices[LAYERS] = {0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28};
static const int channels[LAYERS + 1] = {3,   64,  64,  128, 128, 256, 256,
                                         256, 512, 512, 512, 512, 512, 512};
static char path[] = "/tmp/ripnerf-lpips-XXXXXX";
static float *weights[LAYERS], *biases[LAYERS], *importances[5];

static bool is_last(int layer) {
    return layer + 1 == LAYERS || slices[layer + 1] != slices[layer];
}

static float normal(uint64_t stream, uint64_t i) {
    struct rn_rng4 draw = rn_rng_draw(11, stream, i);
    double u = 1 - (double)rn_rng_unit(draw.v[0]), v = (double)rn_rng_unit(draw.v[1]);
    return (float)(sqrt(-2 * log(u)) * cos(2 * M_PI * v));
}

static float *make(uint64_t stream, size_t count, double deviation, bool positive) {
    float *values = malloc(count * sizeof *values);
    ck_assert_ptr_nonnull(values);
    for (size_t i = 0; i < count; i++) {
        values[i] = (float)deviation * normal(stream, i);
        if (positive) values[i] = fabsf(values[i]);
    }
    return values;
}

// Adds a tensor to the file's head and its numbers to the rest.
static void add(struct rn_buf *head, struct rn_buf *body, const char *name, const char *shape,
                const float *values, size_t count) {
    size_t begin = body->size;
    rn_buf_append(body, values, count * sizeof *values);
    rn_buf_printf(head, "%s\"%s\":{\"dtype\":\"F32\",\"shape\":%s,\"data_offsets\":[%zu,%zu]}",
                  head->size > 1 ? "," : "", name, shape, begin, body->size);
}

static void write_file(const struct rn_buf *head, const struct rn_buf *body, size_t cut) {
    FILE *file = fopen(path, "wb");
    uint64_t length = head->size;
    ck_assert_ptr_nonnull(file);
    ck_assert_uint_eq(fwrite(&length, 8, 1, file), 1);
    ck_assert_uint_eq(fwrite(head->data, 1, head->size, file), head->size);
    ck_assert_uint_eq(fwrite(body->data, 1, body->size - cut, file), body->size - cut);
    ck_assert_int_eq(fclose(file), 0);
}

// A file of weights, `but` one tensor of them, `cut` bytes short.
static void make_file(const char *but, size_t cut) {
    struct rn_buf head, body;
    char name[64], shape[64];
    rn_buf_init(&head, 1 << 16);
    rn_buf_init(&body, 1 << 26);
    rn_buf_printf(&head, "{");
    for (int i = 0; i < LAYERS; i++) {
        size_t in = (size_t)channels[i], out = (size_t)channels[i + 1];
        snprintf(name, sizeof name, "net.slice%d.%d.weight", slices[i], indices[i]);
        snprintf(shape, sizeof shape, "[%zu,%zu,3,3]", out, in);
        if (!but || strcmp(but, name) != 0)
            add(&head, &body, name, shape, weights[i], out * in * 9);
        snprintf(name, sizeof name, "net.slice%d.%d.bias", slices[i], indices[i]);
        snprintf(shape, sizeof shape, "[%zu]", out);
        add(&head, &body, name, shape, biases[i], out);
        if (!is_last(i)) continue;
        snprintf(name, sizeof name, "lin%d.model.1.weight", slices[i] - 1);
        snprintf(shape, sizeof shape, "[1,%zu,1,1]", out);
        add(&head, &body, name, shape, importances[slices[i] - 1], out);
    }
    rn_buf_printf(&head, "}");
    while (head.size % 8)
        rn_buf_printf(&head, " ");
    OK(rn_buf_status(&head, "", &err));
    OK(rn_buf_status(&body, "", &err));
    write_file(&head, &body, cut);
    rn_buf_finish(&head);
    rn_buf_finish(&body);
}

static void setup(void) {
    strcpy(path + sizeof path - 7, "XXXXXX");
    int fd = mkstemp(path);
    ck_assert_int_ge(fd, 0);
    close(fd);
    for (int i = 0; i < LAYERS; i++) {
        size_t in = (size_t)channels[i], out = (size_t)channels[i + 1];
        weights[i] = make(3 * (uint64_t)i, out * in * 9, sqrt(2.0 / (9.0 * (double)in)), false);
        biases[i] = make(3 * (uint64_t)i + 1, out, 0.1, false);
        if (is_last(i)) importances[slices[i] - 1] = make(3 * (uint64_t)i + 2, out, 0.1, true);
    }
}

static void teardown(void) {
    unlink(path);
    for (int i = 0; i < LAYERS; i++) {
        free(weights[i]);
        free(biases[i]);
        if (is_last(i)) free(importances[slices[i] - 1]);
    }
}

static struct rn_picture picture(int width, int height, uint64_t stream) {
    struct rn_picture made;
    ck_assert_int_eq(rn_picture_init(width, height, 3, &made, NULL), RN_OK);
    for (int i = 0; i < width * height * 3; i++)
        made.values[i] = rn_rng_unit(rn_rng_draw(5, stream, (uint64_t)i).v[0]);
    return made;
}

// ---- the definition, in float64 ----

// [channel][y][x].
static double *convolved(const double *from, int layer, int h, int w) {
    int in = channels[layer], out = channels[layer + 1];
    double *to = malloc((size_t)out * (size_t)(h * w) * sizeof *to);
    ck_assert_ptr_nonnull(to);
    for (int o = 0; o < out; o++)
        for (int y = 0; y < h; y++)
            for (int x = 0; x < w; x++) {
                double sum = (double)biases[layer][o];
                for (int i = 0; i < in; i++)
                    for (int k = 0; k < 9; k++) {
                        int yy = y + k / 3 - 1, xx = x + k % 3 - 1;
                        if (yy < 0 || yy >= h || xx < 0 || xx >= w) continue;
                        sum += (double)weights[layer][(o * in + i) * 9 + k] *
                               from[(i * h + yy) * w + xx];
                    }
                to[(o * h + y) * w + x] = fmax(sum, 0);
            }
    return to;
}

static double *pooled(const double *from, int count, int h, int w) {
    double *to = malloc((size_t)count * (size_t)(h / 2 * (w / 2)) * sizeof *to);
    ck_assert_ptr_nonnull(to);
    for (int c = 0; c < count; c++)
        for (int y = 0; y < h / 2; y++)
            for (int x = 0; x < w / 2; x++) {
                const double *at = from + (c * h + 2 * y) * w + 2 * x;
                to[(c * (h / 2) + y) * (w / 2) + x] =
                    fmax(fmax(at[0], at[1]), fmax(at[w], at[w + 1]));
            }
    return to;
}

static double apart(const double *a, const double *b, int count, int pixels,
                    const float *importance) {
    double sum = 0;
    for (int p = 0; p < pixels; p++) {
        double of_a = 0, of_b = 0;
        for (int c = 0; c < count; c++) {
            of_a += a[c * pixels + p] * a[c * pixels + p];
            of_b += b[c * pixels + p] * b[c * pixels + p];
        }
        for (int c = 0; c < count; c++)
            sum += (double)importance[c] * pow(a[c * pixels + p] / (sqrt(of_a) + 1e-10) -
                                                   b[c * pixels + p] / (sqrt(of_b) + 1e-10),
                                               2);
    }
    return sum / pixels;
}

static double *taken(const struct rn_picture *p) {
    const double shift[3] = {-.030, -.088, -.188}, scale[3] = {.458, .448, .450};
    int pixels = p->width * p->height;
    double *to = malloc(3 * (size_t)pixels * sizeof *to);
    ck_assert_ptr_nonnull(to);
    for (int c = 0; c < 3; c++)
        for (int i = 0; i < pixels; i++)
            to[c * pixels + i] = (2 * (double)p->values[3 * i + c] - 1 - shift[c]) / scale[c];
    return to;
}

static double defined(const struct rn_picture *a, const struct rn_picture *b) {
    double *of[2] = {taken(a), taken(b)}, sum = 0;
    int h = a->height, w = a->width;
    for (int layer = 0; layer < LAYERS; layer++) {
        for (int k = 0; k < 2; k++) {
            double *next = convolved(of[k], layer, h, w);
            free(of[k]);
            of[k] = next;
        }
        if (!is_last(layer)) continue;
        sum += apart(of[0], of[1], channels[layer + 1], h * w, importances[slices[layer] - 1]);
        for (int k = 0; k < 2; k++) {
            double *next = pooled(of[k], channels[layer + 1], h, w);
            free(of[k]);
            of[k] = next;
        }
        h /= 2;
        w /= 2;
    }
    free(of[0]);
    free(of[1]);
    return sum;
}

// ---- tests ----

static double compared(const struct rn_lpips *lpips, const struct rn_picture *a,
                       const struct rn_picture *b, int threads) {
    double distance;
    OK(rn_lpips_compare(lpips, a, b, threads, NULL, NULL, &distance, &err));
    return distance;
}

START_TEST(as_defined) {
    struct rn_lpips *lpips;
    struct rn_picture a = picture(WIDTH, HEIGHT, 1), b = picture(WIDTH, HEIGHT, 2);
    make_file(NULL, 0);
    OK(rn_lpips_open(path, &lpips, &err));
    double truth = defined(&a, &b), found = compared(lpips, &a, &b, 1);
    ck_assert_double_gt(truth, 0.01);
    ck_assert_msg(fabs(found - truth) < 1e-5 * truth, "%.9f, not %.9f", found, truth);
    ck_assert_double_eq(compared(lpips, &a, &b, 3), found);
    ck_assert_double_eq(compared(lpips, &b, &a, 2), found);
    ck_assert_double_eq(compared(lpips, &a, &a, 2), 0);
    rn_picture_finish(&a);
    rn_picture_finish(&b);
    a = picture(40, 15, 1);
    ck_assert_double_nan(compared(lpips, &a, &a, 1));
    rn_picture_finish(&a);
    rn_lpips_close(&lpips);
}
END_TEST

static void check_refused(const char *words) {
    struct rn_lpips *lpips = NULL;
    struct rn_error err = {0};
    ck_assert_int_ne(rn_lpips_open(path, &lpips, &err), RN_OK);
    ck_assert_ptr_null(lpips);
    ck_assert_msg(strstr(err.text, words) && strcmp(err.where, path) == 0, "%s: %s", err.where,
                  err.text);
}

START_TEST(what_is_no_such_file) {
    make_file("net.slice3.12.weight", 0);
    check_refused("has no tensor net.slice3.12.weight");
    make_file(NULL, 4);
    check_refused("does not lie where the file's head says");
    FILE *file = fopen(path, "wb");
    ck_assert_ptr_nonnull(file);
    fputs("\x50\0\0\0\0\0\0\0{\"a\":1}          ", file);
    fputs("0123456789abcdef0123", file);
    ck_assert_int_eq(fclose(file), 0);
    check_refused("is no safetensors file");
    unlink(path);
    check_refused("No such file");
}
END_TEST

int main(void) {
    Suite *suite = suite_create("LPIPS");
    TCase *tests = tcase_create("LPIPS");
    tcase_add_checked_fixture(tests, setup, teardown);
    tcase_set_timeout(tests, 120);
    tcase_add_test(tests, as_defined);
    tcase_add_test(tests, what_is_no_such_file);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}

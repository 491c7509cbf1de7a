// Photographs that stand on one colour: which do, and what is left of them once it is cut off.
#include <math.h>

#include "common/dataset/reader.h"
#include "tests/unit/common/dataset_fixture.h"

#define W 48
#define H 40
#define VIEWS 5

static struct rn_image image;

static uint8_t *at(int x, int y) {
    return image.pixels + 4 * (y * image.width + x);
}

static void fill(uint8_t r, uint8_t g, uint8_t b) {
    for (int i = 0; i < image.width * image.height; i++)
        memcpy(image.pixels + 4 * i, (uint8_t[]){r, g, b, 255}, 4);
}

static void setup_image(void) {
    setup();
    ck_assert_int_eq(rn_image_init(W, H, &image, &err), RN_OK);
    image.has_alpha = false;
}

static void teardown_image(void) {
    rn_image_finish(&image);
    teardown();
}

// How much of a pixel lies within a disc, by 16 x 16 places in it.
static double within(int x, int y, double cx, double cy, double radius) {
    int inside = 0;
    for (int i = 0; i < 256; i++)
        inside += hypot(x + (i % 16 + 0.5) / 16 - cx, y + (i / 16 + 0.5) / 16 - cy) < radius;
    return inside / 256.0;
}

// A disc in two colours on a backdrop, its edge smooth; returns how much of each pixel it covers.
static void put_disc(const uint8_t ground[3], double truth[W * H]) {
    for (int i = 0; i < W * H; i++) {
        static const uint8_t halves[2][3] = {{200, 40, 30}, {20, 90, 160}};
        int x = i % W, y = i / W;
        truth[i] = within(x, y, 23.3, 19.8, 12.4);
        for (int c = 0; c < 3; c++)
            at(x, y)[c] = (uint8_t)lrint(truth[i] * halves[y > 19][c] + (1 - truth[i]) * ground[c]);
        at(x, y)[3] = 255;
    }
}

static const uint8_t grounds[][3] = {{255, 255, 255}, {0, 0, 0}, {120, 200, 90}};

// Alpha is what is covered, and over the backdrop there is what there was.
START_TEST(what_stands_on_it_is_cut_out) {
    const uint8_t *ground = grounds[_i];
    double truth[W * H], worst = 0;
    uint8_t before[4 * W * H];
    put_disc(ground, truth);
    memcpy(before, image.pixels, sizeof before);
    ck_assert_int_eq(rn_backdrop_cut(ground, &image, &err), RN_OK);
    ck_assert(image.has_alpha);
    for (int i = 0; i < W * H; i++) {
        const uint8_t *pixel = image.pixels + 4 * i;
        double alpha = pixel[3] / 255.0;
        if (truth[i] == 0) ck_assert_int_eq(pixel[3], 0);
        worst = fmax(worst, fabs(alpha - truth[i]));
        for (int c = 0; c < 3; c++)
            ck_assert_double_le(
                fabs(alpha * pixel[c] + (1 - alpha) * ground[c] - before[4 * i + c]),
                alpha > 0 ? 1 : 4);
    }
    ck_assert_double_lt(worst, 0.15); // where the disc's two colours meet at its edge
}
END_TEST

// What its colour shows through, or is of its colour, but not from the edge on; what winds; wires.
START_TEST(from_the_edges_on) {
    fill(250, 251, 255);
    for (int y = 10; y < 30; y++)
        for (int x = 10; x < 30; x++)
            if (x < 14 || y < 14 || x >= 26 || y >= 26) memset(at(x, y), 60, 3);
    for (int y = 0; y < H; y++)
        at(40, y)[0] = at(40, y)[1] = at(40, y)[2] = 30; // a wire, and two rows behind it
    for (int i = 0; i < 3; i++)
        memcpy(at(18 + i, 20), (uint8_t[]){246, 247, 251}, 3);
    ck_assert_int_eq(rn_backdrop_cut((uint8_t[]){250, 251, 255}, &image, &err), RN_OK);
    for (int y = 0; y < H; y++)
        for (int x = 0; x < W; x++) {
            bool thing = x >= 10 && y >= 10 && x < 30 && y < 30;
            ck_assert_msg((at(x, y)[3] == 255) == (thing || x == 40), "%d, %d", x, y);
        }
    fill(255, 255, 255);
    for (int y = 1; y < H; y += 2) // a path to and fro
        for (int x = 0; x < W - 1; x++)
            memset(at(y % 4 == 1 ? x : W - 1 - x, y), 0, 3);
    ck_assert_int_eq(rn_backdrop_cut((uint8_t[]){255, 255, 255}, &image, &err), RN_OK);
    for (int y = 0; y < H; y++)
        for (int x = 0; x < W; x++)
            ck_assert_int_eq(at(x, y)[3], at(x, y)[0] == 0 && y % 2 ? 255 : 0);
}
END_TEST

START_TEST(as_small_as_a_pixel) {
    image.width = 1;
    for (int h = 1; h < 4; h += 2) {
        image.height = h;
        fill(9, 9, 9);
        memset(at(0, h / 2), 200, 3);
        ck_assert_int_eq(rn_backdrop_cut((uint8_t[]){9, 9, 9}, &image, &err), RN_OK);
        for (int y = 0; y < h; y++)
            ck_assert_int_eq(at(0, y)[3], y == h / 2 ? 255 : 0);
    }
    image.width = W;
    image.height = H;
}
END_TEST

// ---- which photographs do

static void put_view(int i) {
    char name[32];
    snprintf(name, sizeof name, "train/r_%d.png", i);
    ck_assert_int_eq(rn_image_write_png(&image, in_folder(name), 1, &err), RN_OK);
}

static void put_views(void) {
    char frames[4096] = "";
    for (int i = 0; i < VIEWS; i++) {
        put_view(i);
        snprintf(frames + strlen(frames), sizeof frames - strlen(frames),
                 "%s{\"file_path\":\"train/r_%d\",\"transform_matrix\":" POSE "}", i ? "," : "", i);
    }
    put_transforms("train", frames);
}

static bool is_cut(void) {
    bool cut = dataset->frames[0].has_alpha;
    for (size_t f = 0; f < dataset->frame_count; f++)
        ck_assert(dataset->frames[f].has_alpha == cut && dataset->frames[f].backdrop.known == cut);
    ck_assert_int_eq(problems_tell(RN_SEVERITY_INFO, "--backdrop keep trains it"), cut);
    return cut;
}

static const struct {
    int other;       // photograph that differs
    int cut_off;     // of its lower edge's pixels, on which something stands
    bool alpha;      // it has an alpha channel
    bool mask;       // or a mask
    int grey, noise; // of its edge
    bool expected;
} kinds[] = {
    {0, 0, false, false, 255, 0, true},      {2, W, false, false, 255, 0, true},
    {0, W, false, false, 255, 2, true},      {2, 0, true, false, 255, 0, false},
    {2, 0, false, true, 255, 0, false},      {2, 0, false, false, 250, 0, false},
    {2, 0, false, false, 255, 9, false},     {2, 2 * W, false, false, 255, 0, false},
    {0, 2 * W, false, false, 255, 0, false},
};

START_TEST(on_one_colour) {
    double truth[W * H];
    put_disc(grounds[0], truth);
    put_views();
    if (kinds[_i].alpha) {
        image.has_alpha = true;
        at(0, 0)[3] = 0;
    }
    for (int i = 0; i < W * H; i++) {
        bool edge = i % W == 0 || i % W == W - 1 || i / W == 0 || i / W == H - 1;
        if (edge) memset(image.pixels + 4 * i, kinds[_i].grey - i * 7 % (kinds[_i].noise + 1), 3);
    }
    for (int i = 0; i < kinds[_i].cut_off; i++)
        memset(at(i % W, H - 1 - i / W * (H - 1)), 90, 3);
    put_view(kinds[_i].other);
    if (kinds[_i].mask) {
        fill(255, 255, 255);
        char name[32];
        snprintf(name, sizeof name, "masks/r_%d.png", kinds[_i].other);
        ck_assert_int_eq(rn_image_write_png(&image, in_folder(name), 1, &err), RN_OK);
    }
    read_ok(folder);
    if (kinds[_i].alpha)
        ck_assert(!dataset->frames[0].backdrop.known);
    else
        ck_assert_int_eq(is_cut(), kinds[_i].expected);
}
END_TEST

// An import writes what is left, at each scale, and remembers the colour; where it is kept, the
// files.
START_TEST(imported) {
    double truth[W * H];
    struct rn_import_options options = {.scales = 2, .threads = 2};
    struct rn_read_options how = {.keep_backdrop = _i == 1};
    put_disc(grounds[2], truth);
    put_views();
    ck_assert_int_eq(rn_dataset_read_as(folder, &how, &problems, &dataset, &err), RN_OK);
    ck_assert_int_eq(is_cut(), _i == 0);
    ck_assert_int_eq(problems_tell(RN_SEVERITY_INFO, "--backdrop cut takes it"), _i == 1);
    ck_assert_int_eq(rn_dataset_import(dataset, "disc", &options, in_folder("once"), &problems,
                                       NULL, NULL, &err),
                     RN_OK);
    for (int again = 0; again < 2; again++) { // an import of an import, too
        rn_dataset_destroy(&dataset);
        options.scales = 1;
        ck_assert_int_eq(rn_dataset_read(in_folder(again ? "twice" : "once"), NULL, &dataset, &err),
                         RN_OK);
        ck_assert_uint_eq(dataset->frame_count, 2 * VIEWS);
        for (size_t f = 0; f < dataset->frame_count; f++) {
            const struct rn_frame *frame = &dataset->frames[f];
            struct rn_image read;
            ck_assert(frame->has_alpha == (_i == 0) && frame->backdrop.known == (_i == 0));
            ck_assert(!frame->backdrop.to_cut);
            if (_i == 0) ck_assert_mem_eq(frame->backdrop.colour, grounds[2], 3);
            ck_assert_int_eq(rn_frame_decode(frame, NULL, &read, &err), RN_OK);
            ck_assert_int_eq(read.pixels[3], _i == 0 ? 0 : 255);
            size_t middle = (size_t)(read.height / 2 * read.width + read.width / 2);
            ck_assert_int_eq(read.pixels[4 * middle + 3], 255);
            rn_image_finish(&read);
        }
        if (!again)
            ck_assert_int_eq(rn_dataset_import(dataset, "disc", &options, in_folder("twice"),
                                               &problems, NULL, NULL, &err),
                             RN_OK);
    }
}
END_TEST

int main(void) {
    Suite *suite = suite_create("backdrop");
    TCase *tests = tcase_create("backdrop");
    tcase_add_checked_fixture(tests, setup_image, teardown_image);
    tcase_add_loop_test(tests, what_stands_on_it_is_cut_out, 0, sizeof grounds / sizeof *grounds);
    tcase_add_test(tests, from_the_edges_on);
    tcase_add_test(tests, as_small_as_a_pixel);
    tcase_add_loop_test(tests, on_one_colour, 0, sizeof kinds / sizeof *kinds);
    tcase_add_loop_test(tests, imported, 0, 2);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}

// How large the pictures of a HEIC file are by their own data: within the limits, and as is said.
#include "common/base/file.h"
#include "common/image/codec.h"
#include "common/image/heif_sizes.h"
#include "tests/unit/common/dataset_fixture.h"

#define CORPUS "tests/fuzz/corpus/photo/"

static const struct {
    const char *name, *said;
    enum rn_status status;
} files[] = {
    {"gps.heic", "", RN_OK},
    {"gps.avif", "", RN_OK},
    {"overlay.heic", "laid over others", RN_ERROR_UNSUPPORTED},
    {"other-grid.heic", "(16384 x 8192) than its header says (16 x 16)", RN_ERROR_INVALID},
    {"coded-larger.avif", "a picture in it is 32768 x 32768", RN_ERROR_LIMIT},
    {"coded-larger.heic", "a picture in it is 32768 x 32768", RN_ERROR_LIMIT},
};

static uint8_t *bytes;
static size_t size;

static void read_file(int which) {
    char path[256];
    snprintf(path, sizeof path, CORPUS "%s", files[which].name);
    ck_assert_int_eq(rn_file_read(path, 1 << 16, &bytes, &size, &err), RN_OK);
}

static enum rn_status check_sizes(const struct rn_image_limits *limits) {
    return rn_heif_check_sizes(bytes, size, limits, "a.heic", &err);
}

START_TEST(by_their_own_data) {
    read_file(_i);
    ck_assert_int_eq(check_sizes(&rn_image_default_limits), files[_i].status);
    if (files[_i].status) ck_assert_ptr_nonnull(strstr(err.text, files[_i].said));
    free(bytes);
}
END_TEST

// Coded with 64 x 64 pixels.
START_TEST(limits_of_the_caller) {
    struct rn_image_limits limits = rn_image_default_limits;
    read_file(0);
    limits.max_pixels = 64 * 64;
    ck_assert_int_eq(check_sizes(&limits), RN_OK);
    limits.max_pixels--;
    ck_assert_int_eq(check_sizes(&limits), RN_ERROR_LIMIT);
    limits = rn_image_default_limits;
    limits.max_height = 63;
    ck_assert_int_eq(check_sizes(&limits), RN_ERROR_LIMIT);
    free(bytes);
}
END_TEST

// Whatever is cut off or changed: an answer, and within the bytes that are there.
START_TEST(damaged) {
    read_file(_i);
    for (size_t cut = 0; cut <= size; cut++) {
        uint8_t *copy = malloc(cut + 1);
        ck_assert_ptr_nonnull(copy);
        memcpy(copy + 1, bytes, cut);
        enum rn_status status =
            rn_heif_check_sizes(copy + 1, cut, &rn_image_default_limits, "cut", NULL);
        ck_assert(status == RN_OK || status == files[_i].status);
        free(copy);
    }
    for (size_t at = 0; at < size; at++)
        for (int value = 0; value < 256; value++) {
            uint8_t kept = bytes[at];
            bytes[at] = (uint8_t)value;
            enum rn_status status = check_sizes(&rn_image_default_limits);
            ck_assert(status == RN_OK || status == RN_ERROR_INVALID || status == RN_ERROR_LIMIT ||
                      status == RN_ERROR_UNSUPPORTED);
            bytes[at] = kept;
        }
    free(bytes);
}
END_TEST

// A parameter set of three layers, the second of which tells its own profile, and with an escape
// before its size of 64 x 48.
START_TEST(parameters_of_layers) {
    uint8_t unit[64] = {RN_HEVC_SPS << 1, 1, 0x04};
    // 12 bytes of the first and the escape; 01, 11 and six times nothing; a level, a profile and a
    // level.
    size_t at = 3 + 13;
    memset(unit + 3, 0xff, 13 + 2 + 13);
    memcpy(unit + 3, (const uint8_t[]){0, 0, 3}, 3);
    unit[at] = 0x70;
    unit[at + 1] = 0;
    at += 2 + 1 + 11 + 1;
    // 1 (id 0), 010 (4:2:0), 0000001000001 (64), 00000110001 (48)
    static const uint8_t rest[] = {0xa0, 0x20, 0x83, 0x18, 0x80};
    memcpy(unit + at, rest, sizeof rest);
    struct rn_extent found = {0, 0};
    ck_assert(rn_hevc_size((struct rn_span){unit, unit + at + sizeof rest}, &found));
    ck_assert_uint_eq(found.width, 64);
    ck_assert_uint_eq(found.height, 48);
    ck_assert(!rn_hevc_size((struct rn_span){unit, unit + at + 2}, &found));
    ck_assert(!rn_hevc_size((struct rn_span){unit, unit + 1}, &found));
    unit[0] = 32 << 1;
    ck_assert(!rn_hevc_size((struct rn_span){unit, unit + at + sizeof rest}, &found));
}
END_TEST

// Not a reduced still picture: with timing, two operating points, the first of a level with a tier,
// and delays of 3 bits; units before it and after.
START_TEST(sequence_of_frames) {
    static const char header[] = "000"
                                 "0"
                                 "0"
                                 "1"
                                 "00000000000000000000000000000001"
                                 "00000000000000000000000000000001"
                                 "1"
                                 "00100"
                                 "1"
                                 "00010"
                                 "00000000000000000000000000000001"
                                 "00000"
                                 "00000"
                                 "1"
                                 "00001"
                                 "000000000001"
                                 "01000"
                                 "1"
                                 "1"
                                 "101"
                                 "101"
                                 "0"
                                 "1"
                                 "0011"
                                 "000000000001"
                                 "00111"
                                 "0"
                                 "0"
                                 "0101"
                                 "0100"
                                 "111111"
                                 "01111";
    uint8_t units[64] = {0x12, 0, 0x0a, 0};
    size_t bits = sizeof header - 1, length = (bits + 7) / 8;
    for (size_t i = 0; i < bits; i++)
        units[4 + i / 8] |= (uint8_t)((header[i] == '1') << (7 - i % 8));
    units[3] = (uint8_t)length;
    units[4 + length] = 0x32;
    struct rn_extent found = rn_av1_size((struct rn_span){units, units + 6 + length});
    ck_assert_uint_eq(found.width, 64);
    ck_assert_uint_eq(found.height, 16);
    found = rn_av1_size((struct rn_span){units, units + length});
    ck_assert_uint_eq(found.width, 0);
}
END_TEST

int main(void) {
    TCase *sizes = tcase_create("sizes");
    tcase_add_loop_test(sizes, by_their_own_data, 0, sizeof files / sizeof *files);
    tcase_add_test(sizes, limits_of_the_caller);
    tcase_add_loop_test(sizes, damaged, 0, sizeof files / sizeof *files);
    tcase_add_test(sizes, parameters_of_layers);
    tcase_add_test(sizes, sequence_of_frames);
    Suite *suite = suite_create("heif sizes");
    suite_add_tcase(suite, sizes);
    return run_suite(suite);
}

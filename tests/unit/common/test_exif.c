// What a photograph's EXIF block says of its camera.
#include "common/dataset/photos.h"
#include "common/image/codec.h"
#include "tests/unit/common/dataset_fixture.h"

// Writes `value` as the block has numbers; returns the place behind it.
static uint8_t *put_number(uint8_t *to, bool big, int bytes, uint32_t value) {
    for (int i = 0; i < bytes; i++)
        to[i] = (uint8_t)(value >> 8 * (big ? bytes - 1 - i : i));
    return to + bytes;
}

// One entry of a folder: numbers of types 1 and 2 stand in it, of others and longer texts their
// place; returns the place behind it.
static uint8_t *put_entry(uint8_t *to, bool big, uint32_t tag, uint32_t type, uint32_t count,
                          uint32_t value) {
    int bytes = type > 2 || count > 4 ? 4 : 1;
    to = put_number(put_number(to, big, 2, tag), big, 2, type);
    return put_number(put_number(to, big, 4, count), big, bytes, value) + 4 - bytes;
}

// The header of a block, whose folder of `count` entries follows; returns the place of these.
static uint8_t *put_header(uint8_t *to, bool big, uint32_t count) {
    *to++ = big ? 'M' : 'I';
    *to++ = big ? 'M' : 'I';
    to = put_number(put_number(to, big, 2, 42), big, 4, 8);
    return put_number(to, big, 2, count);
}

// The key of a camera whose model's name has `length` bytes in the block, at a focal length.
static uint32_t key_of(bool big, const char *maker, const char *model, uint32_t length,
                       uint32_t over, uint32_t under) {
    enum { INNER = 48, MAKER = 64, TEXT = 72, FOCAL = 104, SIZE = 112 };
    uint8_t block[SIZE] = {0}, *at = block;
    struct rn_image_info info;
    at = put_entry(put_header(at, big, 3), big, 0x010f, 2, 8, MAKER);
    at = put_entry(at, big, 0x0110, 2, length, TEXT);
    put_entry(at, big, 0x8769, 4, 1, INNER);
    put_entry(put_number(block + INNER, big, 2, 1), big, 0x920a, 5, 1, FOCAL);
    memcpy(block + MAKER, maker, strlen(maker));
    memcpy(block + TEXT, model, strlen(model));
    put_number(put_number(block + FOCAL, big, 4, over), big, 4, under);
    rn_exif_read(block, SIZE, &info);
    return info.camera_key;
}

// Editors write EXIF anew: in the other order of bytes, the focal length reduced, names padded.
START_TEST(a_camera_is_the_same_however_its_exif_is_written) {
    uint32_t key = key_of(false, "Maker", "Model", 6, 361, 100);
    ck_assert_uint_ne(key, 0);
    ck_assert_uint_eq(key_of(true, "Maker", "Model", 6, 361, 100), key);
    ck_assert_uint_eq(key_of(false, "Maker", "Model", 30, 361, 100), key);
    ck_assert_uint_eq(key_of(false, "Maker", "Model  ", 8, 3610, 1000), key);
    ck_assert_uint_ne(key_of(false, "Maker", "Model", 6, 362, 100), key);
    ck_assert_uint_ne(key_of(false, "Maker", "Modem", 6, 361, 100), key);
    ck_assert_uint_ne(key_of(false, "Maker", "Model", 6, 361, 0), key);
    ck_assert_uint_ne(key_of(false, "MakerM", "odel", 6, 361, 100), key);
}
END_TEST

// A block whose GPS says 41 degrees 30' 18" `south_north`, 83 degrees 15' 36" `west_east`, and 12.5
// m over a `floor` of which 1 is below the sea's; over `under` instead of 1 where that is 0.
static struct rn_image_info located(bool big, char south_north, char west_east, uint32_t floor,
                                    uint32_t under, size_t cut) {
    enum { GPS = 32, NUMBERS = 120, SIZE = 176 };
    static const uint32_t rationals[7][2] = {{41, 1}, {30, 1},   {18, 1}, {83, 1},
                                             {15, 1}, {360, 10}, {25, 2}};
    uint8_t block[SIZE] = {0}, *at = block;
    struct rn_image_info info;
    put_entry(put_header(at, big, 1), big, 0x8825, 4, 1, GPS);
    at = put_number(block + GPS, big, 2, 6);
    at = put_entry(at, big, 1, 2, 2, (uint32_t)south_north);
    at = put_entry(at, big, 2, 5, 3, NUMBERS);
    at = put_entry(at, big, 3, 2, 2, (uint32_t)west_east);
    at = put_entry(at, big, 4, 5, 3, NUMBERS + 24);
    at = put_entry(at, big, 5, 1, 1, floor);
    put_entry(at, big, 6, 5, 1, NUMBERS + 48);
    at = block + NUMBERS;
    for (int i = 0; i < 7; i++)
        at = put_number(put_number(at, big, 4, rationals[i][0]), big, 4,
                        i == 2 ? under : rationals[i][1]);
    rn_exif_read(block, cut ? cut : SIZE, &info);
    return info;
}

START_TEST(gps_says_where_a_photograph_was_taken) {
    struct rn_image_info info = located(_i, 'N', 'W', 0, 1, 0);
    ck_assert(info.located);
    ck_assert_double_eq_tol(info.located_at[0], 41.505, 1e-12);
    ck_assert_double_eq_tol(info.located_at[1], -83.26, 1e-12);
    ck_assert_double_eq(info.located_at[2], 12.5);
    info = located(_i, 'S', 'E', 1, 1, 0);
    ck_assert_double_eq_tol(info.located_at[0], -41.505, 1e-12);
    ck_assert_double_eq_tol(info.located_at[1], 83.26, 1e-12);
    ck_assert_double_eq(info.located_at[2], -12.5);
    ck_assert(!located(_i, 'N', 'W', 0, 0, 0).located); // seconds over nothing
    for (size_t cut = 1; cut < 176; cut++)
        ck_assert(!located(_i, 'N', 'W', 0, 1, cut).located);
}
END_TEST

// COLMAP is given copies of photographs that it does not read, which have no EXIF.
START_TEST(what_exif_said_holds_for_a_copy) {
    struct rn_photo photo = {
        .name = (char *)(_i ? "a.png" : "b.png"),
        .info = {.camera_key = 7, .located = true, .located_at = {1, 2, 3}, .orientation = 6}};
    struct rn_photos taken = {.items = &photo, .count = 1};
    struct rn_read_options options = {.taken = &taken};
    struct rn_image image = noise(8, 8, 1);
    ck_assert_int_eq(rn_mkdirs(in_folder("images"), 0777, &err), RN_OK);
    ck_assert_int_eq(rn_image_write_png(&image, in_folder("images/a.png"), 1, &err), RN_OK);
    rn_image_finish(&image);
    put_text("transforms.json", "{\"fl_x\":40,\"w\":8,\"h\":8,\"frames\":[{\"file_path\":"
                                "\"images/a.png\",\"transform_matrix\":" POSE "}]}");
    ck_assert_int_eq(rn_dataset_read_as(folder, &options, &problems, &dataset, &err), RN_OK);
    const struct rn_frame *frame = &dataset->frames[0];
    ck_assert_uint_eq(frame->camera_key, _i ? 7 : 0);
    ck_assert_int_eq(frame->located, _i);
    ck_assert_double_eq(frame->located_at[2], _i ? 3 : 0);
    ck_assert_int_eq(frame->held, 1); // the copy stands upright
}
END_TEST

int main(void) {
    TCase *exif = tcase_create("exif");
    tcase_add_checked_fixture(exif, setup, teardown);
    tcase_add_loop_test(exif, what_exif_said_holds_for_a_copy, 0, 2);
    tcase_add_test(exif, a_camera_is_the_same_however_its_exif_is_written);
    tcase_add_loop_test(exif, gps_says_where_a_photograph_was_taken, 0, 2);
    Suite *suite = suite_create("exif");
    suite_add_tcase(suite, exif);
    return run_suite(suite);
}

// What a photograph's EXIF block says of its camera.
#include <string.h>

#include "common/image/codec.h"
#include "tests/support/suite.h"

// Writes `value` as the block has numbers; returns the place behind it.
static uint8_t *put_number(uint8_t *to, bool big, int bytes, uint32_t value) {
    for (int i = 0; i < bytes; i++)
        to[i] = (uint8_t)(value >> 8 * (big ? bytes - 1 - i : i));
    return to + bytes;
}

// The key of a camera whose model's name has `length` bytes in the block, at a focal length.
static uint32_t key_of(bool big, const char *maker, const char *model, uint32_t length,
                       uint32_t over, uint32_t under) {
    enum { INNER = 48, MAKER = 64, TEXT = 72, FOCAL = 104, SIZE = 112 };
    uint8_t block[SIZE] = {0}, *at = block;
    struct rn_image_info info;
    *at++ = big ? 'M' : 'I';
    *at++ = big ? 'M' : 'I';
    at = put_number(at, big, 2, 42);
    at = put_number(at, big, 4, 8);
    at = put_number(at, big, 2, 3);
    const uint32_t entries[3][4] = {
        {0x010f, 2, 8, MAKER}, {0x0110, 2, length, TEXT}, {0x8769, 4, 1, INNER}};
    for (int i = 0; i < 3; i++) {
        at = put_number(at, big, 2, entries[i][0]);
        at = put_number(at, big, 2, entries[i][1]);
        at = put_number(at, big, 4, entries[i][2]);
        at = put_number(at, big, 4, entries[i][3]);
    }
    at = put_number(block + INNER, big, 2, 1);
    at = put_number(at, big, 2, 0x920a);
    at = put_number(at, big, 2, 5);
    at = put_number(at, big, 4, 1);
    put_number(at, big, 4, FOCAL);
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

int main(void) {
    TCase *exif = tcase_create("exif");
    tcase_add_test(exif, a_camera_is_the_same_however_its_exif_is_written);
    Suite *suite = suite_create("exif");
    suite_add_tcase(suite, exif);
    return run_suite(suite);
}

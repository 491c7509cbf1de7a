// What a HEIC or AVIF picture is made of: none of itself, none without end.
#include "common/image/codec.h"
#include "tests/unit/common/dataset_fixture.h"

static uint8_t file[1 << 20];
static size_t size;

static void put(uint64_t value, int width) {
    ck_assert_uint_le(size + (size_t)width, sizeof file);
    for (int i = width - 1; i >= 0; i--)
        file[size++] = (uint8_t)(value >> 8 * i);
}

static size_t begin_box(const char *type) {
    put(0, 4);
    for (int i = 0; i < 4; i++)
        put((uint8_t)type[i], 1);
    return size - 8;
}

static void end_box(size_t begin) {
    size_t end = size;
    size = begin;
    put(end - begin, 4);
    size = end;
}

// A file up to its references; of items by `width` bytes.
static void begin_file(int width, size_t *ret_meta, size_t *ret_references) {
    size = 0;
    size_t box = begin_box("ftyp");
    put(0x68656963, 4); // "heic"
    put(0, 4);
    end_box(box);
    *ret_meta = begin_box("meta");
    put(0, 4);
    end_box(begin_box("free"));
    *ret_references = begin_box("iref");
    put(width == 2 ? 0 : (uint64_t)1 << 24, 4);
}

static void end_file(size_t meta, size_t references) {
    end_box(references);
    end_box(meta);
}

// One box of references: `from` to the items from `first`, `count` of them, or as many times the
// first.
static void refer(const char *type, int width, uint32_t from, uint32_t first, int count,
                  bool again) {
    size_t box = begin_box(type);
    put(from, width);
    put((uint64_t)count, 2);
    for (int i = 0; i < count; i++)
        put(first + (again ? 0 : (uint32_t)i), width);
    end_box(box);
}

static enum rn_status check_parts(void) {
    enum rn_status status = rn_heif_check_parts(file, size, "a.heic", &err);
    if (status) ck_assert_str_eq(err.where, "a.heic");
    return status;
}

// A grid with its own tiles, a thumbnail, a depth of its own grid, and what tells of it.
START_TEST(photograph_of_a_phone) {
    int width = _i ? 4 : 2;
    size_t meta, references;
    begin_file(width, &meta, &references);
    refer("dimg", width, 49, 1, 48, false);
    refer("thmb", width, 50, 49, 1, false);
    refer("auxl", width, 51, 49, 1, false);
    refer("dimg", width, 51, 60, 12, false);
    refer("cdsc", width, 52, 49, 1, false);
    refer("cdsc", width, 49, 52, 1, false); // goes round, but nothing is decoded by it
    end_file(meta, references);
    ck_assert_int_eq(check_parts(), RN_OK);
}
END_TEST

START_TEST(made_of_itself) {
    int width = _i ? 4 : 2, length = 1 + _i % 7;
    size_t meta, references;
    begin_file(width, &meta, &references);
    refer("dimg", width, 100, 1, 2, false);
    for (int i = 1; i <= length; i++)
        refer("dimg", width, (uint32_t)i, i < length ? (uint32_t)i + 1 : 1, 1, false);
    end_file(meta, references);
    ck_assert_int_eq(check_parts(), RN_ERROR_INVALID);
    ck_assert_ptr_nonnull(strstr(err.text, "made of itself"));
    ck_assert_ptr_nonnull(strstr(err.text, "export it again"));
}
END_TEST

// Each is the alpha channel of the other, or a channel is made of what it belongs to.
START_TEST(channel_of_itself) {
    size_t meta, references;
    begin_file(2, &meta, &references);
    refer("auxl", 2, 1, 2, 1, false);
    refer(_i ? "auxl" : "dimg", 2, _i ? 2 : 1, _i ? 1 : 2, 1, false);
    end_file(meta, references);
    ck_assert_int_eq(check_parts(), RN_ERROR_INVALID);
}
END_TEST

// The longest chain that is followed, and one more; whichever end comes first in the file.
START_TEST(depth) {
    for (int length = 8; length <= 9; length++) {
        size_t meta, references;
        begin_file(2, &meta, &references);
        for (int i = 0; i < length; i++) {
            int at = _i ? length - i : i + 1;
            refer("dimg", 2, (uint32_t)at, (uint32_t)at + 1, 1, false);
        }
        end_file(meta, references);
        ck_assert_int_eq(check_parts(), length == 8 ? RN_OK : RN_ERROR_LIMIT);
    }
    ck_assert_ptr_nonnull(strstr(err.text, "8 deep"));
    ck_assert_ptr_nonnull(strstr(err.text, "convert it to JPEG"));
}
END_TEST

// A few bytes that ask for 255 to the power of four tiles; and what a grid may have.
START_TEST(tiles_of_tiles) {
    size_t meta, references;
    for (int levels = 1; levels <= 4; levels++) {
        begin_file(2, &meta, &references);
        for (int i = 1; i <= levels; i++)
            refer("dimg", 2, (uint32_t)i, (uint32_t)i + 1, 255, true);
        end_file(meta, references);
        ck_assert_int_eq(check_parts(), levels <= 2 ? RN_OK : RN_ERROR_LIMIT);
    }
    ck_assert_ptr_nonnull(strstr(err.text, "65536 parts"));
    begin_file(2, &meta, &references);
    refer("dimg", 2, 1, 2, 65535, true);
    end_file(meta, references);
    ck_assert_int_eq(check_parts(), RN_OK);
    begin_file(2, &meta, &references);
    for (uint32_t i = 1; i <= 2; i++)
        refer("dimg", 2, i, 3, 65535, true);
    end_file(meta, references);
    ck_assert_int_eq(check_parts(), RN_ERROR_LIMIT);
}
END_TEST

// Boxes with a size of 64 bits or to the end of the file, and those with a name of 16 bytes, are
// passed.
START_TEST(sizes_of_boxes) {
    static const uint8_t before[] = {
        0, 0, 0, 1,  'm', 'd', 'a', 't', 0, 0, 0, 0, 0, 0, 0, 20, 9, 9, 9, 9, // 64 bits
        0, 0, 0, 27, 'u', 'u', 'i', 'd', 0, 0, 0, 0, 0, 0, 0, 0,  0, 0, 0, 0, 0, 0, 0, 0, 9, 9, 9};
    size_t meta, references;
    begin_file(2, &meta, &references);
    refer("dimg", 2, 1, 1, 1, false);
    end_file(meta, references);
    memmove(file + sizeof before, file, size);
    memcpy(file, before, sizeof before);
    size += sizeof before;
    ck_assert_int_eq(check_parts(), RN_ERROR_INVALID);
    memset(file + sizeof before + meta, 0, 4);
    ck_assert_int_eq(check_parts(), RN_ERROR_INVALID);
}
END_TEST

// Whatever is cut off or changed: an answer, and within the bytes that are there.
START_TEST(damaged) {
    size_t meta, references;
    begin_file(2, &meta, &references);
    refer("dimg", 2, 1, 2, 3, false);
    refer("auxl", 2, 5, 1, 1, false);
    end_file(meta, references);
    size_t whole = size;
    for (size_t cut = 0; cut <= whole; cut++) {
        uint8_t *copy = malloc(cut + 1);
        ck_assert_ptr_nonnull(copy);
        memcpy(copy, file, cut);
        ck_assert_int_eq(rn_heif_check_parts(copy, cut, "cut", NULL), RN_OK);
        free(copy);
    }
    for (size_t at = 0; at < whole; at++)
        for (int value = 0; value < 256; value++) {
            uint8_t kept = file[at];
            file[at] = (uint8_t)value;
            enum rn_status status = check_parts();
            ck_assert(status == RN_OK || status == RN_ERROR_INVALID || status == RN_ERROR_LIMIT);
            file[at] = kept;
        }
}
END_TEST

int main(void) {
    TCase *parts = tcase_create("parts");
    tcase_add_loop_test(parts, photograph_of_a_phone, 0, 2);
    tcase_add_loop_test(parts, made_of_itself, 0, 14);
    tcase_add_loop_test(parts, channel_of_itself, 0, 2);
    tcase_add_loop_test(parts, depth, 0, 2);
    tcase_add_test(parts, tiles_of_tiles);
    tcase_add_test(parts, sizes_of_boxes);
    tcase_add_test(parts, damaged);
    Suite *suite = suite_create("heif parts");
    suite_add_tcase(suite, parts);
    return run_suite(suite);
}

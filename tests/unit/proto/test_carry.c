// Files and messages that travel together.
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/file.h"
#include "proto/carry.h"
#include "tests/support/suite.h"

#define BYTES (3 * (1 << 20) + 17) // several pieces

static char folder[] = "/tmp/carry-XXXXXX";
static int pair[2];
static struct rn_carry from, to;

static void set_up(void) {
    strcpy(folder, "/tmp/carry-XXXXXX");
    ck_assert_ptr_nonnull(mkdtemp(folder));
    ck_assert_int_eq(socketpair(AF_UNIX, SOCK_STREAM, 0, pair), 0);
    rn_carry_init(&from, pair[0], false);
    rn_carry_init(&to, pair[1], true);
}

static void tear_down(void) {
    rn_carry_finish(&from);
    rn_carry_finish(&to);
    close(pair[0]);
    close(pair[1]);
    OK(rn_remove_tree(folder, &err));
}

static char *path_of(const char *name) {
    static char paths[4][128];
    static int next;
    char *path = paths[next++ % 4];
    snprintf(path, sizeof paths[0], "%s/%s", folder, name);
    return path;
}

static void write_file(const char *name, size_t size) {
    uint8_t *bytes = malloc(size + 1);
    for (size_t i = 0; i < size; i++)
        bytes[i] = (uint8_t)(i * 31 >> 3);
    OK(rn_file_write_atomic(path_of(name), bytes, size, &err));
    free(bytes);
}

static bool are_equal(const char *a, const char *b) {
    uint8_t *x, *y;
    size_t x_size, y_size;
    OK(rn_file_read(path_of(a), BYTES, &x, &x_size, &err));
    OK(rn_file_read(path_of(b), BYTES, &y, &y_size, &err));
    bool equal = x_size == y_size && memcmp(x, y, x_size) == 0;
    free(x);
    free(y);
    return equal;
}

// The next message that arrives; pieces are put together at `name` on the way.
static int receive(const char *name, int *ret_files) {
    for (;;) {
        struct rn_wire_message message;
        struct rn_wire_file file;
        bool ready = false, whole;
        OK(rn_carry_flush(&from, &err));
        OK(rn_wire_read(&to.reader, &ready, &message, &err));
        if (!ready) continue;
        int type = message.type;
        if (type == RN_WIRE_PIECE) {
            OK(rn_wire_take(&message, &file, &err));
            OK(rn_carry_take(&to, &file, &message, path_of(name), &whole, &err));
            *ret_files += whole;
        }
        rn_wire_message_finish(&message);
        if (type != RN_WIRE_PIECE) return type;
    }
}

START_TEST(a_file_is_there_before_what_speaks_of_it) {
    struct rn_wire_file gone = {.root = RN_CARRY_SCENE, .path = "x"};
    int files = 0;
    write_file("a", BYTES);
    write_file("nothing", 0);
    OK(rn_carry_send(&from, RN_CARRY_SCENE, "a", path_of("a"), &err));
    OK(rn_carry_post(&from, RN_WIRE_GONE, &gone, &err));
    OK(rn_carry_send(&from, RN_CARRY_SCENE, "nothing", path_of("nothing"), &err));
    OK(rn_carry_post(&from, RN_WIRE_WANT, &gone, &err));
    ck_assert(!rn_carry_is_empty(&from));
    ck_assert_int_eq(receive("b", &files), RN_WIRE_GONE);
    ck_assert_int_eq(files, 1);
    ck_assert(are_equal("a", "b"));
    ck_assert_int_eq(receive("c", &files), RN_WIRE_WANT);
    ck_assert_int_eq(files, 2);
    ck_assert(are_equal("nothing", "c"));
    ck_assert(rn_carry_is_empty(&from));
}
END_TEST

// The file as it was when it was sent, whatever has become of its name.
START_TEST(a_file_that_is_removed_arrives) {
    struct rn_wire_file gone = {.root = RN_CARRY_SCENE, .path = "x"};
    int files = 0;
    write_file("a", 1000);
    write_file("same", 1000);
    OK(rn_carry_send(&from, RN_CARRY_SCENE, "a", path_of("a"), &err));
    OK(rn_carry_post(&from, RN_WIRE_GONE, &gone, &err));
    ck_assert_int_eq(unlink(path_of("a")), 0);
    ck_assert_int_eq(receive("b", &files), RN_WIRE_GONE);
    ck_assert_int_eq(files, 1);
    ck_assert(are_equal("same", "b"));
}
END_TEST

START_TEST(what_is_not_as_it_was_sent_is_refused) {
    uint8_t bytes[] = "abc";
    const struct rn_wire_message message = {.blob = bytes, .blob_size = 3};
    struct rn_wire_file piece = {.size = 3, .sha256 = "00"};
    struct stat about;
    bool whole;
    ck_assert_int_eq(rn_carry_take(&to, &piece, &message, path_of("b"), &whole, NULL),
                     RN_ERROR_CORRUPT);
    piece.size = 6; // another piece is to come, but not this one
    OK(rn_carry_take(&to, &piece, &message, path_of("b"), &whole, &err));
    ck_assert(!whole);
    piece.offset = 2;
    ck_assert_int_eq(rn_carry_take(&to, &piece, &message, path_of("b"), &whole, NULL),
                     RN_ERROR_CORRUPT);
    piece = (struct rn_wire_file){.size = 2};
    ck_assert_int_eq(rn_carry_take(&to, &piece, &message, path_of("b"), &whole, NULL),
                     RN_ERROR_CORRUPT);
    ck_assert_int_ne(stat(path_of("b"), &about), 0);
    ck_assert_int_eq(rmdir(folder), 0); // nothing is left
    ck_assert_int_eq(mkdir(folder, 0700), 0);
}
END_TEST

START_TEST(names_stay_in_their_folder) {
    static const char *const good[] = {"a", "checkpoints/step-1.safetensors", "frames/job_a/.step",
                                       "a/b/c/d"};
    static const char *const bad[] = {"",     "/a",   "a/",     "..",      "a/../b",
                                      ".a",   "a//b", "a/.b/c", ".step/a", "a/b/c/d/e",
                                      "a\nb", ".",    "./a",    "a/.steps"};
    for (size_t i = 0; i < sizeof good / sizeof *good; i++)
        ck_assert_msg(rn_carry_is_name(good[i]), "%s", good[i]);
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        ck_assert_msg(!rn_carry_is_name(bad[i]), "%s", bad[i]);
}
END_TEST

START_TEST(folders_are_moved) {
    static const char before[] = "{\"folder\":\"/data/x/frames/j\",\"job\":\"/data/x\",\"n\":0.1}";
    struct rn_wire_message message = {.json = strdup(before), .json_size = sizeof before - 1};
    OK(rn_carry_move(&message, "/data/x", "/node/scratch", &err));
    ck_assert_str_eq(message.json, "{\"folder\":\"/node/scratch/frames/j\",\"job\":\"/data/x\","
                                   "\"n\":0.1}");
    ck_assert_uint_eq(message.json_size, strlen(message.json));
    OK(rn_carry_move(&message, "/node/scratc", "/elsewhere", &err)); // of another name
    ck_assert_ptr_nonnull(strstr(message.json, "/node/scratch/frames"));
    rn_wire_message_finish(&message);
}
END_TEST

int main(void) {
    TCase *tests = tcase_create("carry");
    tcase_add_checked_fixture(tests, set_up, tear_down);
    tcase_add_test(tests, a_file_is_there_before_what_speaks_of_it);
    tcase_add_test(tests, a_file_that_is_removed_arrives);
    tcase_add_test(tests, what_is_not_as_it_was_sent_is_refused);
    tcase_add_test(tests, names_stay_in_their_folder);
    tcase_add_test(tests, folders_are_moved);
    Suite *suite = suite_create("proto");
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}

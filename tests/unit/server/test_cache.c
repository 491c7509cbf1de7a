// What a node keeps of the files that it was sent.
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/file.h"
#include "server/runner/link/cache.h"
#include "tests/support/suite.h"

#define MOST 1000

static char outer[] = "/tmp/cache-XXXXXX";
static struct rn_cache cache;

static char *path_of(const char *name) {
    static char paths[4][128];
    static int next;
    char *path = paths[next++ % 4];
    snprintf(path, sizeof paths[0], "%s/%s", outer, name);
    return path;
}

static void set_up(void) {
    strcpy(outer, "/tmp/cache-XXXXXX");
    ck_assert_ptr_nonnull(mkdtemp(outer));
    OK(rn_mkdirs(path_of("node"), 0700, &err));
    OK(rn_cache_open(path_of("node"), MOST, &cache, &err));
}

static void tear_down(void) {
    OK(rn_remove_tree(outer, &err));
}

static const char *digest_of(char letter) {
    static char digests[4][65];
    static int next;
    char *digest = digests[next++ % 4];
    memset(digest, letter, 64);
    return digest;
}

static void keep(char letter, size_t size) {
    char bytes[MOST] = "";
    OK(rn_file_write_atomic(path_of("new"), bytes, size, &err));
    rn_cache_keep(&cache, digest_of(letter), path_of("new"));
    ck_assert_int_eq(unlink(path_of("new")), 0);
}

START_TEST(what_is_kept_is_linked) {
    struct stat about;
    keep('a', 10);
    ck_assert(!rn_cache_take(&cache, digest_of('b'), path_of("x")));
    ck_assert(!rn_cache_take(&cache, "../../secret", path_of("x")));
    ck_assert(rn_cache_take(&cache, digest_of('a'), path_of("x")));
    ck_assert(rn_cache_take(&cache, digest_of('a'), path_of("x"))); // in place of the first
    ck_assert_int_eq(stat(path_of("x"), &about), 0);
    ck_assert_int_eq(about.st_size, 10);
}
END_TEST

START_TEST(what_was_used_longest_ago_goes_first) {
    struct stat about;
    keep('a', 400);
    usleep(20000);
    keep('b', 400);
    usleep(20000);
    ck_assert(rn_cache_take(&cache, digest_of('a'), path_of("x")));
    rn_cache_trim(&cache);
    ck_assert(rn_cache_take(&cache, digest_of('b'), path_of("y")));
    usleep(20000);
    ck_assert(rn_cache_take(&cache, digest_of('a'), path_of("x")));
    usleep(20000);
    keep('c', 400);
    rn_cache_trim(&cache);
    ck_assert(!rn_cache_take(&cache, digest_of('b'), path_of("z")));
    ck_assert(rn_cache_take(&cache, digest_of('a'), path_of("z")));
    ck_assert(rn_cache_take(&cache, digest_of('c'), path_of("z")));
    ck_assert_int_eq(stat(path_of("y"), &about), 0); // who has it keeps it
}
END_TEST

START_TEST(a_folder_is_one_process_s) {
    char path[PATH_MAX], other[PATH_MAX];
    struct stat about;
    int lock, second;
    OK(rn_cache_work(&cache, "r1", path, &lock, &err));
    ck_assert_int_eq(rn_cache_work(&cache, "r1", other, &second, NULL), RN_ERROR_BUSY);
    OK(rn_cache_work(&cache, "r2", other, &second, &err));
    ck_assert_int_eq(stat(path, &about), 0);
    close(lock); // its process is gone
    OK(rn_cache_work(&cache, "r3", other, &lock, &err));
    ck_assert_int_ne(stat(path, &about), 0);
    ck_assert_int_eq(rn_cache_work(&cache, "../r4", other, &lock, NULL), RN_ERROR_INVALID);
    close(lock);
    close(second);
}
END_TEST

START_TEST(a_folder_that_others_write_is_none) {
    ck_assert_int_eq(chmod(path_of("node"), 0777), 0);
    ck_assert_int_eq(rn_cache_open(path_of("node"), MOST, &cache, NULL), RN_ERROR_INVALID);
    ck_assert_int_eq(chmod(path_of("node"), 0700), 0);
    ck_assert_int_eq(chmod(outer, 0777), 0);
    ck_assert_int_eq(rn_cache_open(path_of("node"), MOST, &cache, NULL), RN_ERROR_INVALID);
}
END_TEST

int main(void) {
    TCase *tests = tcase_create("cache");
    tcase_add_checked_fixture(tests, set_up, tear_down);
    tcase_add_test(tests, what_is_kept_is_linked);
    tcase_add_test(tests, what_was_used_longest_ago_goes_first);
    tcase_add_test(tests, a_folder_is_one_process_s);
    tcase_add_test(tests, a_folder_that_others_write_is_none);
    Suite *suite = suite_create("runner");
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}

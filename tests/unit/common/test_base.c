// Clocks, files, buffers, log, hash and the parallel loop.
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/buf.h"
#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/log.h"
#include "common/base/seal.h"
#include "common/base/sha256.h"
#include "common/base/threads.h"
#include "common/base/trace.h"
#include "tests/support/suite.h"

static char folder[64];

static void enter_folder(void) {
    strcpy(folder, "/tmp/test_base.XXXXXX");
    ck_assert_ptr_nonnull(mkdtemp(folder));
}

static void leave_folder(void) {
    ck_assert_int_eq(rn_remove_tree(folder, NULL), RN_OK);
    ck_assert_int_ne(access(folder, F_OK), 0);
}

static const char *in_folder(const char *name) {
    static char path[256];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    return path;
}

static int64_t fixed_ns(void) {
    return 42;
}

static int64_t fixed_ms(void) {
    return 1769860800123; // 2026-01-31T12:00:00.123Z
}

START_TEST(clock_source) {
    int64_t before = rn_clock_ns(), wall = rn_clock_wall_ms();
    ck_assert_int_ge(rn_clock_ns(), before);
    ck_assert_int_gt(wall, INT64_C(1600000000000));
    rn_clock_set_source(fixed_ns, fixed_ms);
    ck_assert_int_eq(rn_clock_ns(), 42);
    ck_assert_int_eq(rn_clock_wall_ms(), fixed_ms());
    rn_clock_set_source(NULL, NULL);
    ck_assert_int_ge(rn_clock_ns(), before);
}
END_TEST

static int64_t moved_ns, moved_ms;

static int64_t get_moved_ns(void) {
    return moved_ns;
}

static int64_t get_moved_ms(void) {
    return moved_ms;
}

// The time passes, and the wall clock is set besides.
static void pass(int64_t ms, int64_t set_by_ms) {
    moved_ns += ms * 1000000;
    moved_ms += ms + set_by_ms;
}

START_TEST(clock_that_is_set) {
    const int64_t year = INT64_C(31557600000);
    moved_ns = 7, moved_ms = fixed_ms();
    rn_clock_set_source(get_moved_ns, get_moved_ms);
    int64_t older = moved_ms - 5000, before = moved_ms;
    pass(1000, 0);
    ck_assert_int_eq(rn_clock_since_ms(before), 1000);
    ck_assert_int_eq(rn_clock_since_ms(older), 6000);
    pass(1000, 10 * year);
    ck_assert_int_eq(rn_clock_since_ms(before), 2000);
    ck_assert_int_eq(rn_clock_since_ms(older), 7000);
    int64_t after = moved_ms;
    pass(3000, 0);
    ck_assert_int_eq(rn_clock_since_ms(after), 3000);
    ck_assert_int_eq(rn_clock_since_ms(before), 5000);
    pass(0, -20 * year);
    ck_assert_int_eq(rn_clock_since_ms(before), 5000);
    after = moved_ms;
    pass(4000, 0);
    ck_assert_int_eq(rn_clock_since_ms(after), 4000);
    ck_assert_int_eq(rn_clock_since_ms(before), 9000);
    rn_clock_set_source(NULL, NULL);
}
END_TEST

START_TEST(traces) {
    const char *caller = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-00";
    char own[RN_TRACE_MAX], other[RN_TRACE_MAX], trace[RN_TRACE_ID_MAX], span[17];
    rn_trace_begin(caller, own);
    ck_assert(rn_trace_is_good(own));
    rn_trace_ids(own, trace, span);
    ck_assert_str_eq(trace, "0af7651916cd43dd8448eb211c80319c");
    ck_assert_str_ne(span, "b7ad6b7169203331");
    ck_assert_str_eq(own + 53, "00");
    const char *const bad[] = {NULL,
                               "",
                               "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-0",
                               "01-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-00",
                               "00-0AF7651916cd43dd8448eb211c80319c-b7ad6b7169203331-00",
                               "00-00000000000000000000000000000000-b7ad6b7169203331-00",
                               "00-0af7651916cd43dd8448eb211c80319c-0000000000000000-00",
                               "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-0g",
                               "00-0af7651916cd43dd8448eb211c80319c_b7ad6b7169203331-00"};
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        ck_assert(!rn_trace_is_good(bad[i]));
        rn_trace_begin(bad[i], other);
        ck_assert(rn_trace_is_good(other));
        ck_assert(strncmp(other, own, 35) != 0);
        ck_assert_str_eq(other + 52, "-01");
    }
}
END_TEST

// Runs rn_log with stderr sent to a file and returns what arrived.
static char *logged(enum rn_log_level least, enum rn_log_level level, const char *text) {
    const char *path = in_folder("log");
    int kept = dup(STDERR_FILENO), fd = open(path, O_CREAT | O_TRUNC | O_WRONLY, 0600);
    ck_assert_int_ge(dup2(fd, STDERR_FILENO), 0);
    rn_log_set_level(least);
    errno = EXDEV;
    rn_log(level, "%s", text);
    ck_assert_int_eq(errno, EXDEV);
    ck_assert_int_ge(dup2(kept, STDERR_FILENO), 0);
    close(kept);
    close(fd);
    uint8_t *bytes;
    size_t size;
    ck_assert_int_eq(rn_file_read(path, 1 << 20, &bytes, &size, NULL), RN_OK);
    return (char *)bytes;
}

START_TEST(log_lines) {
    rn_clock_set_source(NULL, fixed_ms);
    char *line = logged(RN_LOG_INFO, RN_LOG_WARN, "two\nlines\x1b");
    ck_assert_str_eq(line, "2026-01-31T12:00:00.123Z warn two?lines?\n");
    free(line);
    line = logged(RN_LOG_INFO, RN_LOG_DEBUG, "hidden");
    ck_assert_str_eq(line, "");
    free(line);
    line = logged(RN_LOG_DEBUG, RN_LOG_DEBUG, "shown");
    ck_assert_ptr_nonnull(strstr(line, " debug shown\n"));
    free(line);
    char longer[3000];
    memset(longer, 'x', sizeof longer - 1);
    longer[sizeof longer - 1] = 0;
    line = logged(RN_LOG_INFO, RN_LOG_ERROR, longer);
    size_t size = strlen(line);
    ck_assert_uint_gt(size, 1000);
    ck_assert_uint_lt(size, 1100);
    ck_assert_int_eq(line[size - 1], '\n');
    free(line);
    rn_log_set_level(RN_LOG_INFO);
    const char *own = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-00";
    ck_assert_ptr_null(rn_log_set_trace(own));
    line = logged(RN_LOG_INFO, RN_LOG_INFO, "of it");
    ck_assert_str_eq(line, "2026-01-31T12:00:00.123Z info of it "
                           "trace_id=0af7651916cd43dd8448eb211c80319c span_id=b7ad6b7169203331\n");
    free(line);
    ck_assert_ptr_eq(rn_log_set_trace(NULL), own);
    rn_clock_set_source(NULL, NULL);
}
END_TEST

START_TEST(file_round_trip) {
    const char *path = in_folder("file");
    char text[10000];
    for (size_t i = 0; i < sizeof text; i++)
        text[i] = (char)(i * 7);
    for (size_t size = 0; size <= sizeof text; size = size * 3 + 1) {
        ck_assert_int_eq(rn_file_write_atomic(path, text, size, NULL), RN_OK);
        uint8_t *bytes;
        size_t got;
        ck_assert_int_eq(rn_file_read(path, size, &bytes, &got, NULL), RN_OK);
        ck_assert_uint_eq(got, size);
        ck_assert_mem_eq(bytes, text, size);
        ck_assert_int_eq(bytes[size], 0);
        free(bytes);
    }
}
END_TEST

START_TEST(file_read_errors) {
    uint8_t *bytes = NULL;
    size_t size = 77;
    struct rn_error err = {0};
    const char *path = in_folder("file");
    ck_assert_int_eq(rn_file_read(path, 10, &bytes, &size, &err), RN_ERROR_NOT_FOUND);
    ck_assert_str_eq(err.where, path);
    ck_assert_int_eq(rn_file_write_atomic(path, "12345678901", 11, NULL), RN_OK);
    ck_assert_int_eq(rn_file_read(path, 10, &bytes, &size, &err), RN_ERROR_LIMIT);
    ck_assert_ptr_nonnull(strstr(err.text, "10 bytes"));
    ck_assert_int_eq(rn_file_read(folder, 10, &bytes, &size, &err), RN_ERROR_INVALID);
    path = in_folder("pipe");
    ck_assert_int_eq(mkfifo(path, 0600), 0);
    ck_assert_int_eq(rn_file_read(path, 10, &bytes, &size, &err), RN_ERROR_INVALID);
    ck_assert_ptr_null(bytes);
    ck_assert_uint_eq(size, 77);
}
END_TEST

// Files whose size the file system gives as 0, and the limit on them.
START_TEST(file_of_unknown_size) {
    uint8_t *bytes;
    size_t size;
    ck_assert_int_eq(rn_file_read("/proc/self/status", 1 << 20, &bytes, &size, NULL), RN_OK);
    ck_assert_uint_gt(size, 100);
    ck_assert_ptr_nonnull(strstr((char *)bytes, "VmRSS"));
    free(bytes);
    ck_assert_int_eq(rn_file_read("/proc/self/status", 100, &bytes, &size, NULL), RN_ERROR_LIMIT);
}
END_TEST

START_TEST(file_head) {
    uint8_t head[8];
    size_t size;
    uint64_t file_size;
    const char *path = in_folder("file");
    ck_assert_int_eq(rn_file_write_atomic(path, "0123456789", 10, NULL), RN_OK);
    ck_assert_int_eq(rn_file_read_head(path, head, 8, &size, &file_size, NULL), RN_OK);
    ck_assert_uint_eq(size, 8);
    ck_assert_uint_eq(file_size, 10);
    ck_assert_mem_eq(head, "01234567", 8);
    ck_assert_int_eq(rn_file_read_head(folder, head, 8, &size, &file_size, NULL), RN_ERROR_INVALID);
}
END_TEST

// A write that fails half way leaves the old content and no other file.
START_TEST(file_write_is_atomic) {
    static char large[1 << 16];
    const char *path = in_folder("file");
    ck_assert_int_eq(rn_file_write_atomic(path, "old", 3, NULL), RN_OK);
    struct rlimit old, small = {4096, RLIM_INFINITY};
    ck_assert_int_eq(getrlimit(RLIMIT_FSIZE, &old), 0);
    signal(SIGXFSZ, SIG_IGN);
    small.rlim_max = old.rlim_max;
    ck_assert_int_eq(setrlimit(RLIMIT_FSIZE, &small), 0);
    struct rn_error err = {0};
    enum rn_status status = rn_file_write_atomic(path, large, sizeof large, &err);
    ck_assert_int_eq(setrlimit(RLIMIT_FSIZE, &old), 0);
    ck_assert_int_eq(status, RN_ERROR_NO_SPACE);
    ck_assert_str_eq(err.where, path);
    uint8_t *bytes;
    size_t size;
    ck_assert_int_eq(rn_file_read(path, 100, &bytes, &size, NULL), RN_OK);
    ck_assert_str_eq((char *)bytes, "old");
    free(bytes);
    ck_assert_int_eq(unlink(path), 0);
    ck_assert_int_eq(rmdir(folder), 0); // fails when a temporary file is left
    ck_assert_int_eq(mkdir(folder, 0700), 0);
    ck_assert_int_eq(rn_file_write_atomic(in_folder("no/such"), "x", 1, NULL), RN_ERROR_NOT_FOUND);
}
END_TEST

START_TEST(folders) {
    ck_assert_int_eq(rn_mkdirs(in_folder("a/b/c"), 0755, NULL), RN_OK);
    ck_assert_int_eq(rn_mkdirs(in_folder("a//b/c//"), 0755, NULL), RN_OK);
    ck_assert_int_eq(rn_mkdirs("/", 0755, NULL), RN_OK);
    ck_assert_int_ne(rn_mkdirs("", 0755, NULL), RN_OK);
    ck_assert_int_eq(rn_file_write_atomic(in_folder("a/b/file"), "x", 1, NULL), RN_OK);
    struct rn_error err = {0};
    ck_assert_int_eq(rn_mkdirs(in_folder("a/b/file/d"), 0755, &err), RN_ERROR_IO);
    ck_assert_ptr_nonnull(strstr(err.where, "a/b/file"));
    ck_assert_int_eq(rn_mkdir(in_folder("a/b/d"), 0755, NULL), RN_OK);
    ck_assert_int_eq(rn_mkdir(in_folder("a/b/d"), 0755, NULL), RN_OK);
    ck_assert_int_eq(rn_mkdir(in_folder("e/f"), 0755, &err), RN_ERROR_NOT_FOUND);
    ck_assert_ptr_nonnull(strstr(err.where, "e/f"));
    // What should be there already is not made.
    char above[256];
    snprintf(above, sizeof above, "%s", in_folder("a"));
    ck_assert_int_eq(rn_mkdirs_in(above, in_folder("a/g/h"), 0755, NULL), RN_OK);
    ck_assert_int_eq(rn_mkdirs_in(above, in_folder("a"), 0755, NULL), RN_OK);
    ck_assert_int_eq(access(in_folder("a/g/h"), F_OK), 0);
    snprintf(above, sizeof above, "%s", in_folder("e"));
    ck_assert_int_eq(rn_mkdirs_in(above, in_folder("e/g/h"), 0755, &err), RN_ERROR_NOT_FOUND);
    ck_assert_int_ne(access(above, F_OK), 0);
    // Links are removed, not followed.
    char target[256];
    snprintf(target, sizeof target, "%s", in_folder("kept"));
    ck_assert_int_eq(rn_mkdirs(target, 0755, NULL), RN_OK);
    ck_assert_int_eq(symlink(target, in_folder("a/link")), 0);
    ck_assert_int_eq(rn_remove_tree(in_folder("a"), NULL), RN_OK);
    ck_assert_int_ne(access(in_folder("a"), F_OK), 0);
    ck_assert_int_eq(access(target, F_OK), 0);
    ck_assert_int_eq(rn_remove_tree(in_folder("a"), NULL), RN_OK);
}
END_TEST

START_TEST(a_folder_is_emptied) {
    struct stat before, after;
    struct rn_error err = {0};
    ck_assert_int_eq(rn_mkdirs(in_folder("a/b/c"), 0755, NULL), RN_OK);
    ck_assert_int_eq(rn_file_write_atomic(in_folder("a/b/file"), "x", 1, NULL), RN_OK);
    ck_assert_int_eq(mkdir(in_folder("kept"), 0755), 0);
    ck_assert_int_eq(symlink("../../kept", in_folder("a/b/link")), 0);
    int open_folder =
        open(in_folder("a/b"), O_RDONLY | O_DIRECTORY); // nothing else gets its number
    ck_assert(open_folder >= 0 && fstat(open_folder, &before) == 0);
    ck_assert_int_eq(rn_folder_empty(in_folder("a/b"), NULL), RN_OK);
    ck_assert_int_eq(stat(in_folder("a/b"), &after), 0);
    ck_assert(before.st_ino == after.st_ino && close(open_folder) == 0);
    ck_assert_int_eq(rmdir(in_folder("a/b")), 0); // fails when something is left
    ck_assert_int_eq(access(in_folder("kept"), F_OK), 0);
    ck_assert_int_eq(rn_folder_empty(in_folder("a/b"), &err), RN_ERROR_NOT_FOUND);
    ck_assert_ptr_nonnull(strstr(err.where, "a/b"));
}
END_TEST

START_TEST(deep_tree_is_refused) {
    char path[512];
    strcpy(path, in_folder("d"));
    for (int i = 0; i < 70; i++)
        strcat(path, "/d");
    ck_assert_int_eq(rn_mkdirs(path, 0755, NULL), RN_OK);
    ck_assert_int_eq(rn_remove_tree(folder, NULL), RN_ERROR_LIMIT);
    strcpy(path, in_folder("d/d/d/d/d/d/d/d/d/d")); // close enough to the bottom to be removed
    ck_assert_int_eq(rn_remove_tree(path, NULL), RN_OK);
}
END_TEST

START_TEST(safe_names) {
    static const char *const good[] = {"a", "lego", "r_12.png", "Ä ö", "a..b", "\xf0\x9f\x8c\x8d"};
    static const char *const bad[] = {
        "",     ".",        "..",           ".hidden",          "a/b",
        "/a",   "a\n",      "\x7f",         "a\xc2\x85",        "\xff",
        "\xc3", "\xc0\xaf", "\xed\xa0\x80", "\xf4\x90\x80\x80", "\xe2\x82"};
    for (size_t i = 0; i < sizeof good / sizeof *good; i++)
        ck_assert_msg(rn_path_is_safe_name(good[i]), "%s", good[i]);
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        ck_assert_msg(!rn_path_is_safe_name(bad[i]), "%zu", i);
    char name[202];
    memset(name, 'x', 201);
    name[201] = 0;
    ck_assert(!rn_path_is_safe_name(name));
    name[200] = 0;
    ck_assert(rn_path_is_safe_name(name));
}
END_TEST

START_TEST(buffers) {
    struct rn_buf buf;
    rn_buf_init(&buf, 1000);
    ck_assert_ptr_null(buf.data);
    for (int i = 0; i < 100; i++)
        rn_buf_printf(&buf, "%04d|", i);
    ck_assert_uint_eq(buf.size, 500);
    ck_assert_mem_eq(buf.data + 495, "0099|", 6);
    rn_buf_append(&buf, buf.data, 0);
    char rest[500];
    memset(rest, 'x', sizeof rest);
    rn_buf_append(&buf, rest, 500);
    ck_assert_int_eq(rn_buf_status(&buf, "b", NULL), RN_OK);
    rn_buf_append(&buf, rest, 1);
    ck_assert(buf.failed);
    ck_assert_uint_eq(buf.size, 1000);
    struct rn_error err;
    ck_assert_int_eq(rn_buf_status(&buf, "reply", &err), RN_ERROR_LIMIT);
    ck_assert_str_eq(err.where, "reply");
    rn_buf_append(&buf, rest, 0); // sticky
    ck_assert(buf.failed);
    size_t size = 1;
    ck_assert_ptr_null(rn_buf_take(&buf, &size));
    ck_assert_uint_eq(size, 0);
    rn_buf_printf(&buf, "again");
    uint8_t *taken = rn_buf_take(&buf, &size);
    ck_assert_str_eq((char *)taken, "again");
    ck_assert_uint_eq(size, 5);
    ck_assert_ptr_null(buf.data);
    free(taken);
    rn_buf_finish(&buf);
    rn_buf_finish(&buf);
}
END_TEST

START_TEST(buffer_limit_of_one_print) {
    struct rn_buf buf;
    rn_buf_init(&buf, 3);
    rn_buf_printf(&buf, "%s", "1234");
    ck_assert(buf.failed);
    rn_buf_finish(&buf);
    rn_buf_printf(&buf, "%s", "123");
    ck_assert(!buf.failed);
    ck_assert_str_eq((char *)buf.data, "123");
    rn_buf_finish(&buf);
    rn_buf_init(&buf, 0);
    rn_buf_append(&buf, "", 0);
    ck_assert(!buf.failed);
    ck_assert_str_eq((char *)buf.data, "");
    rn_buf_finish(&buf);
}
END_TEST

static void assert_hash(const char *text, size_t repeat, size_t piece, const char *expected) {
    size_t length = strlen(text), size = length * repeat;
    char *all = malloc(size + 1);
    ck_assert_ptr_nonnull(all);
    for (size_t i = 0; i < repeat; i++)
        memcpy(all + i * length, text, length);
    struct rn_sha256 hash;
    rn_sha256_init(&hash);
    for (size_t at = 0; at < size; at += piece)
        rn_sha256_update(&hash, all + at, size - at < piece ? size - at : piece);
    char hex[65];
    rn_sha256_final_hex(&hash, hex);
    ck_assert_str_eq(hex, expected);
    free(all);
}

// The examples of FIPS 180-4 and of NIST's CAVP, in pieces of several sizes.
START_TEST(hashes) {
    static const size_t pieces[] = {1, 3, 63, 64, 65, 1000};
    for (size_t i = 0; i < sizeof pieces / sizeof *pieces; i++) {
        assert_hash("", 1, pieces[i],
                    "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
        assert_hash("abc", 1, pieces[i],
                    "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
        assert_hash("abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq", 1, pieces[i],
                    "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1");
        assert_hash("a", 1000000, pieces[i],
                    "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
    }
}
END_TEST

struct counters {
    atomic_int calls[1000];
};

static void count_call(void *context, size_t index) {
    struct counters *counters = context;
    atomic_fetch_add(&counters->calls[index], 1);
}

START_TEST(parallel_for) {
    static const int threads[] = {-1, 0, 1, 2, 8, 100000};
    for (size_t t = 0; t < sizeof threads / sizeof *threads; t++) {
        static struct counters counters;
        memset(&counters, 0, sizeof counters);
        rn_parallel_for(threads[t], 1000, count_call, &counters);
        for (int i = 0; i < 1000; i++)
            ck_assert_int_eq(atomic_load(&counters.calls[i]), 1);
        rn_parallel_for(threads[t], 0, count_call, &counters);
        ck_assert_int_eq(atomic_load(&counters.calls[0]), 1);
    }
}
END_TEST

// Every byte that changes is found, those of the seal included; a file without one passes.
START_TEST(seal) {
    static const char text[] = "{" RN_SEAL ",\"a\":[1,2,3],\"tail\":\"0123456789\"}";
    char path[] = "/tmp/test_seal.XXXXXX", sealed[65], read[65];
    int fd = mkstemp(path);
    ck_assert_int_eq(write(fd, text, sizeof text - 1), (ssize_t)sizeof text - 1);
    ck_assert_int_eq(rn_seal_close(fd, path, sealed, NULL), RN_OK);
    ck_assert_int_eq(rn_seal_check(path, read, NULL), RN_OK);
    ck_assert_str_eq(read, sealed);
    ck_assert_int_eq(rn_seal_read(path, read, NULL), RN_OK);
    ck_assert_str_eq(read, sealed);
    for (off_t at = 0; at < (off_t)sizeof text - 1; at++) {
        char byte, wrong;
        ck_assert_int_eq(pread(fd, &byte, 1, at), 1);
        wrong = (char)(byte ^ 4);
        ck_assert_int_eq(pwrite(fd, &wrong, 1, at), 1);
        ck_assert_msg(rn_seal_check(path, read, NULL) == RN_ERROR_CORRUPT, "byte %d", (int)at);
        ck_assert_int_eq(pwrite(fd, &byte, 1, at), 1);
    }
    ck_assert_int_eq(rn_seal_check(path, read, NULL), RN_OK);
    ck_assert_int_eq(ftruncate(fd, 60), 0);
    ck_assert_int_eq(rn_seal_close(fd, path, read, NULL), RN_ERROR_INVALID);
    ck_assert_int_eq(rn_seal_check(path, read, NULL), RN_OK);
    close(fd);
    unlink(path);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("base");
    TCase *plain = tcase_create("plain"), *files = tcase_create("files");
    tcase_add_test(plain, clock_source);
    tcase_add_test(plain, clock_that_is_set);
    tcase_add_test(plain, traces);
    tcase_add_test(plain, file_of_unknown_size);
    tcase_add_test(plain, safe_names);
    tcase_add_test(plain, buffers);
    tcase_add_test(plain, buffer_limit_of_one_print);
    tcase_add_test(plain, hashes);
    tcase_add_test(plain, parallel_for);
    tcase_add_checked_fixture(files, enter_folder, leave_folder);
    tcase_add_test(files, log_lines);
    tcase_add_test(files, file_round_trip);
    tcase_add_test(files, file_read_errors);
    tcase_add_test(files, file_head);
    tcase_add_test(files, file_write_is_atomic);
    tcase_add_test(files, folders);
    tcase_add_test(files, seal);
    tcase_add_test(files, a_folder_is_emptied);
    tcase_add_test(files, deep_tree_is_refused);
    suite_add_tcase(suite, plain);
    suite_add_tcase(suite, files);
    return run_suite(suite);
}

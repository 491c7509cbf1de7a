// The client's parts that need no daemon: event streams, command lines, archives, figures.
#include <archive.h>
#include <archive_entry.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "client/follow.h"
#include "client/http.h"
#include "client/options.h"
#include "client/outcome.h"
#include "client/progress.h"
#include "client/sse.h"
#include "common/base/tar.h"
#include "common/base/file.h"
#include "tests/support/suite.h"

// ---- server-sent events ----

struct events {
    char text[512]; // "type=data;" for each event
    int limit;      // after which no more are wanted
};

static bool note_event(void *context, const struct rn_sse_event *event) {
    struct events *events = context;
    size_t used = strlen(events->text);
    ck_assert_uint_eq(strlen(event->data), event->size_bytes);
    snprintf(events->text + used, sizeof events->text - used, "%s=%s;", event->type, event->data);
    return --events->limit > 0;
}

static const char stream[] =
    ": comment\n\nid: 1\nevent: state\ndata: {\"a\":1}\n\n"
    "id:2\r\nevent:progress\r\ndata:one\r\ndata: two\r\n\r\n"
    "retry: 5\nid: 3\n\ndata\n\nunknown: x\ndata: last\nid: 4\n\ndata: cut";

START_TEST(events_in_pieces_of_any_size) {
    for (size_t piece = 1; piece < sizeof stream; piece++) {
        struct events events = {.limit = 100};
        struct rn_sse sse;
        rn_sse_init(&sse, note_event, &events);
        for (size_t at = 0; at < sizeof stream - 1; at += piece) {
            size_t left = sizeof stream - 1 - at;
            ck_assert(rn_sse_feed(&sse, stream + at, left < piece ? left : piece));
        }
        ck_assert_str_eq(events.text, "state={\"a\":1};progress=one\ntwo;message=last;");
        ck_assert_str_eq(sse.last_id, "4");
        rn_sse_finish(&sse);
    }
}
END_TEST

START_TEST(events_after_a_lost_connection) {
    struct events events = {.limit = 100};
    struct rn_sse sse;
    rn_sse_init(&sse, note_event, &events);
    ck_assert(rn_sse_feed(&sse, "id: 7\ndata: a\n\nid: 8\ndata: ha", 29));
    ck_assert_str_eq(sse.last_id, "7");
    rn_sse_restart(&sse);
    ck_assert(rn_sse_feed(&sse, "data: b\n\n", 9));
    ck_assert_str_eq(events.text, "message=a;message=b;");
    ck_assert_str_eq(sse.last_id, "7");
    rn_sse_finish(&sse);
}
END_TEST

START_TEST(events_stop_when_told_and_are_bounded) {
    struct events events = {.limit = 1};
    struct rn_sse sse;
    rn_sse_init(&sse, note_event, &events);
    ck_assert(!rn_sse_feed(&sse, "data: a\n\ndata: b\n\n", 18));
    ck_assert_str_eq(events.text, "message=a;");
    rn_sse_finish(&sse);
    events.limit = 100;
    rn_sse_init(&sse, note_event, &events);
    static char megabyte[1 << 20];
    memset(megabyte, 'x', sizeof megabyte);
    bool taken = rn_sse_feed(&sse, "data: ", 6);
    for (size_t i = 0; taken && i <= RN_SSE_MAX_LINE / sizeof megabyte; i++)
        taken = rn_sse_feed(&sse, megabyte, sizeof megabyte);
    ck_assert(!taken);
    rn_sse_finish(&sse);
}
END_TEST

// ---- command lines ----

struct wanted {
    bool flag;
    const char *text, *choice;
    int64_t integer;
    double number, seconds;
    struct rn_option_pair size, range;
};
static const char *const numbers[] = {"one", "three", NULL};
#define FIELD(m) .name = #m, .offset = offsetof(struct wanted, m)
static const struct rn_option wanted_table[] = {
    {FIELD(flag), .letter = 'f', .kind = RN_OPTION_FLAG},
    {FIELD(text), .letter = 't', .kind = RN_OPTION_TEXT},
    {FIELD(choice), .kind = RN_OPTION_CHOICE, .choices = numbers},
    {FIELD(integer), .kind = RN_OPTION_INTEGER, .value = "N", .min = 1, .max = 100},
    {FIELD(number), .kind = RN_OPTION_NUMBER, .value = "X", .min = 0, .max = 1},
    {FIELD(seconds), .kind = RN_OPTION_SECONDS, .value = "T", .min = 0, .max = 1e6},
    {FIELD(size), .kind = RN_OPTION_SIZE, .value = "WxH", .min = 1, .max = 100},
    {FIELD(range), .kind = RN_OPTION_RANGE, .value = "A-B", .min = 0, .max = 100},
    {0}};
static const struct rn_option no_table[] = {{0}};

// Parses words separated by blanks.
static enum rn_status parse(const char *line, struct wanted *ret_wanted, const char **args,
                            size_t *count) {
    static char words[256];
    char *argv[24];
    int argc = 0;
    struct rn_error err = {0};
    struct rn_option_tables tables = {wanted_table, no_table, ret_wanted, NULL};
    snprintf(words, sizeof words, "%s", line);
    for (char *word = strtok(words, " "); word; word = strtok(NULL, " "))
        argv[argc++] = word;
    rn_options_clear(wanted_table, ret_wanted);
    return rn_options_parse(&tables, argc, argv, 2, args, count, &err);
}

START_TEST(options_of_every_kind) {
    struct wanted wanted;
    const char *args[3];
    size_t count;
    ck_assert_int_eq(parse("a -f --text=x --choice three --integer 7 --number .5 --seconds 1.5m "
                           "--size 4x3 --range 2-5 -- -b",
                           &wanted, args, &count),
                     RN_OK);
    ck_assert(wanted.flag && wanted.integer == 7 && wanted.number == .5 && wanted.seconds == 90);
    ck_assert_str_eq(wanted.text, "x");
    ck_assert_str_eq(wanted.choice, "three");
    ck_assert(wanted.size.first == 4 && wanted.size.second == 3);
    ck_assert(wanted.range.first == 2 && wanted.range.second == 5);
    ck_assert_uint_eq(count, 2);
    ck_assert_str_eq(args[1], "-b");
    ck_assert_int_eq(parse("--range 9 --seconds 60s -t -", &wanted, args, &count), RN_OK);
    ck_assert(wanted.range.first == 9 && wanted.range.second == 9 && wanted.seconds == 60);
    ck_assert(!wanted.flag && !wanted.choice && wanted.integer == RN_OPTION_ABSENT);
    ck_assert(isnan(wanted.number) && wanted.size.first == RN_OPTION_ABSENT);
}
END_TEST

START_TEST(options_that_are_refused) {
    static const char *const lines[] = {"--flag=1",
                                        "--text",
                                        "--text=",
                                        "--choice on",
                                        "--choice one|three",
                                        "--integer 0",
                                        "--integer 101",
                                        "--integer 1x",
                                        "--integer -5",
                                        "--integer 99999999999999999999",
                                        "--number nan",
                                        "--number 2",
                                        "--number 1e999",
                                        "--seconds 5d",
                                        "--seconds -1s",
                                        "--size 4x",
                                        "--size 4x3x2",
                                        "--size 0x3",
                                        "--size 4,3",
                                        "--range 5-2",
                                        "--range -2",
                                        "--unknown 1",
                                        "--tex x",
                                        "-x",
                                        "a b c",
                                        "--textual x"};
    for (size_t i = 0; i < sizeof lines / sizeof *lines; i++) {
        struct wanted wanted;
        const char *args[3];
        size_t count;
        ck_assert_msg(parse(lines[i], &wanted, args, &count) == RN_ERROR_INVALID, "%s", lines[i]);
    }
}
END_TEST

// ---- archives ----

static char folder[] = "/tmp/ripnerf-test-XXXXXX";

static void make_folder(void) {
    struct rn_error err;
    strcpy(folder + sizeof folder - 7, "XXXXXX");
    ck_assert_ptr_nonnull(mkdtemp(folder));
    ck_assert_int_eq(chdir(folder), 0);
    ck_assert_int_eq(rn_mkdirs("in/sub", 0777, &err), RN_OK);
}

static void remove_folder(void) {
    struct rn_error err;
    ck_assert_int_eq(chdir("/"), 0);
    ck_assert_int_eq(rn_remove_tree(folder, &err), RN_OK);
}

static void write_file(const char *name, size_t size) {
    struct rn_error err;
    char *bytes = malloc(size + 1);
    ck_assert_ptr_nonnull(bytes);
    for (size_t i = 0; i < size; i++)
        bytes[i] = (char)(i * 7 + size);
    ck_assert_int_eq(rn_file_write_atomic(name, bytes, size, &err), RN_OK);
    free(bytes);
}

// Reads the whole archive in pieces of `piece` bytes into malloc'd memory.
static char *read_all(struct rn_tar *tar, size_t piece) {
    size_t size = (size_t)rn_tar_size(tar), used = 0;
    char *bytes = malloc(size + piece);
    ck_assert_ptr_nonnull(bytes);
    for (size_t got; (got = rn_tar_read(tar, bytes + used, piece)) > 0; used += got)
        ck_assert(got <= piece && used + got <= size);
    ck_assert_uint_eq(used, size);
    return bytes;
}

START_TEST(archives_are_read_back_by_libarchive) {
    char long_name[256] = "sub/", longest[256] = "sub/"; // 105 bytes' record counts its own size
    const struct {
        const char *name;
        size_t size;
    } files[] = {{"a.json", 0},         {"sub/b.png", 1}, {"sub/c.png", 511}, {"sub/d.png", 512},
                 {"sub/e.png", 100000}, {long_name, 513}, {longest, 0}};
    memset(long_name + 4, 'm', 101);
    memset(longest + 4, 'n', 200);
    enum { FILES = sizeof files / sizeof *files };
    static const size_t pieces[] = {1, 7, 512, 65536};
    struct rn_error err;
    for (size_t i = 0; i < FILES; i++) {
        char path[300];
        snprintf(path, sizeof path, "in/%s", files[i].name);
        write_file(path, files[i].size);
    }
    for (size_t p = 0; p < 4; p++) {
        struct rn_tar *tar = NULL;
        ck_assert_int_eq(rn_tar_create("in", &tar, &err), RN_OK);
        for (size_t i = 0; i < FILES; i++) {
            ck_assert_int_eq(rn_tar_add(tar, files[i].name, &err), RN_OK);
            ck_assert_int_eq(rn_tar_add(tar, files[i].name, &err), RN_OK); // once is enough
        }
        char *bytes = read_all(tar, pieces[p]);
        struct archive *archive = archive_read_new();
        struct archive_entry *entry;
        archive_read_support_format_tar(archive);
        ck_assert_int_eq(archive_read_open_memory(archive, bytes, (size_t)rn_tar_size(tar)), 0);
        for (size_t i = 0; i < FILES; i++) {
            static char data[100001];
            ck_assert_int_eq(archive_read_next_header(archive, &entry), ARCHIVE_OK);
            ck_assert_str_eq(archive_entry_pathname(entry), files[i].name);
            ck_assert_int_eq(archive_entry_filetype(entry), AE_IFREG);
            ck_assert_int_eq(archive_read_data(archive, data, sizeof data), (int)files[i].size);
            for (size_t k = 0; k < files[i].size; k++)
                ck_assert_int_eq(data[k], (char)(k * 7 + files[i].size));
        }
        ck_assert_int_eq(archive_read_next_header(archive, &entry), ARCHIVE_EOF);
        archive_read_free(archive);
        free(bytes);
        rn_tar_destroy(&tar);
    }
}
END_TEST

START_TEST(archives_refuse_what_is_not_theirs) {
    struct rn_tar *tar = NULL;
    struct rn_error err;
    char name[RN_TAR_NAME_MAX + 2];
    write_file("outside", 3);
    ck_assert_int_eq(rn_tar_create("in", &tar, &err), RN_OK);
    uint64_t empty = rn_tar_size(tar);
    ck_assert_int_eq(rn_tar_add(tar, "../outside", &err), RN_ERROR_INVALID);
    ck_assert_int_eq(rn_tar_add(tar, "sub/../../outside", &err), RN_ERROR_INVALID);
    ck_assert_int_eq(rn_tar_add(tar, "/etc/passwd", &err), RN_ERROR_INVALID);
    ck_assert_int_eq(rn_tar_add(tar, "", &err), RN_ERROR_INVALID);
    ck_assert_int_ne(rn_tar_add(tar, "sub", &err), RN_OK);
    ck_assert_int_eq(rn_tar_add(tar, "missing", &err), RN_ERROR_NOT_FOUND);
    memset(name, 'n', sizeof name);
    name[RN_TAR_NAME_MAX + 1] = '\0';
    ck_assert_int_eq(rn_tar_add(tar, name, &err), RN_ERROR_INVALID);
    ck_assert_uint_eq(rn_tar_size(tar), empty);
    rn_tar_destroy(&tar);
}
END_TEST

START_TEST(archives_notice_a_file_that_shrinks) {
    struct rn_tar *tar = NULL;
    struct rn_error err;
    char buffer[4096];
    write_file("in/a", 3000);
    ck_assert_int_eq(rn_tar_create("in", &tar, &err), RN_OK);
    ck_assert_int_eq(rn_tar_add(tar, "a", &err), RN_OK);
    ck_assert_int_eq(truncate("in/a", 1000), 0);
    ck_assert(rn_tar_read(tar, buffer, sizeof buffer) == SIZE_MAX);
    ck_assert_int_eq(rn_tar_error(tar)->status, RN_ERROR_IO);
    ck_assert_str_eq(rn_tar_error(tar)->where, "a");
    rn_tar_destroy(&tar);
}
END_TEST

// ---- figures and paths ----

START_TEST(figures_for_people) {
    static const struct {
        double value;
        const char *count, *seconds, *bytes;
    } cases[] = {{0, "0", "0.0 s", "0 B"},
                 {999.4, "999", "16:39", "999 B"},
                 {999.6, "1.00k", "16:39", "1.00 kB"},
                 {99.9, "100", "99.9 s", "100 B"},
                 {12345, "12.3k", "3:25:45", "12.3 kB"},
                 {3.1e6, "3.10M", "861:06:40", "3.10 MB"}};
    char text[32];
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        rn_format_count(cases[i].value, text, sizeof text);
        ck_assert_str_eq(text, cases[i].count);
        rn_format_seconds(cases[i].value, text, sizeof text);
        ck_assert_str_eq(text, cases[i].seconds);
        rn_format_bytes(cases[i].value, text, sizeof text);
        ck_assert_str_eq(text, cases[i].bytes);
    }
    rn_format_seconds(NAN, text, sizeof text);
    ck_assert_str_eq(text, "-");
}
END_TEST

START_TEST(names_are_escaped_in_paths) {
    struct rn_buf buf;
    rn_buf_init(&buf, 256);
    rn_http_escape(&buf, "a-b_c.d~/ ü?&%");
    ck_assert_str_eq((char *)buf.data, "a-b_c.d~%2F%20%C3%BC%3F%26%25");
    rn_buf_finish(&buf);
}
END_TEST

// ---- how jobs went ----

#define SHA256 "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
static const struct {
    int type;
    const char *result, *words;
} outcomes[] = {
    {RN_JOB_DOCTOR,
     "{\"passed\":false,\"seed\":4,\"kernels\":\"avx2\",\"cases\":["
     "{\"name\":\"exp\",\"kernels\":\"avx2\",\"worst\":7,\"bound\":2,\"unit\":\"ULP\","
     "\"passed\":false,\"skipped\":false,\"where\":\"x = 1\"},"
     "{\"name\":\"log\",\"kernels\":\"cuda\",\"worst\":null,\"bound\":null,\"unit\":\"ULP\","
     "\"passed\":false,\"skipped\":true,\"where\":\"\"}]}",
     "2 cases, 1 failed, 1 skipped"},
    {RN_JOB_VALIDATE,
     "{\"report\":{\"layout\":\"blender\",\"usable\":{\"train\":4,\"val\":0,\"test\":1},"
     "\"unusable\":{\"train\":0,\"val\":0,\"test\":0},\"scales\":1,\"footprint\":{\"min\":1,"
     "\"max\":2},"
     "\"camera_distance\":{\"min\":1,\"max\":2},\"looking_at_bounds\":1,\"with_alpha\":5,\"width\":"
     "{\"min\":1,\"max\":2},"
     "\"height\":{\"min\":1,\"max\":2},\"errors\":1,\"warnings\":2,\"dropped\":0,\"problems\":[]},"
     "\"bounds\":{\"centre\":[0,0,0],\"radius\":1.5,\"source\":\"layout\"},\"up\":[0,0,1],"
     "\"views\":{\"train\":4,\"val\":0,\"test\":1},\"scales\":1,\"items\":[]}",
     "4 to train, 0 to validate, 1 to test; 1 errors, 2 warnings"},
    {RN_JOB_CURVE,
     "{\"machine\":\"m\",\"device\":\"cpu\",\"kernels\":\"avx2\",\"threads\":2,\"version\":\"1\","
     "\"digest\":null,\"step\":5,\"measured_at\":\"2026-01-01T00:00:00.000Z\",\"stale\":false,"
     "\"width\":200,\"height\":200,\"views\":6,\"photographs\":true,\"seconds\":9,\"points\":["
     "{\"setting\":{\"tolerance\":0.06},\"ms_median\":8,\"ms_p95\":9,\"psnr\":27.5,\"ssim\":0.9,"
     "\"psnr_full\":30,\"psnr_spread\":0.5,\"rays\":1,\"samples\":1},"
     "{\"setting\":{\"tolerance\":0},\"ms_median\":200,\"ms_p95\":210,\"psnr\":31.25,\"ssim\":0.9,"
     "\"psnr_full\":null,\"psnr_spread\":0.5,\"rays\":1,\"samples\":1}],\"around\":[]}",
     "2 settings, 8.0 to 200.0 ms, 27.50 to 31.25 dB"},
    {RN_JOB_EFFECTS,
     "{\"machine\":\"m\",\"device\":\"cpu\",\"kernels\":\"avx2\",\"threads\":2,\"version\":\"1\","
     "\"measured_at\":\"2026-01-01T00:00:00.000Z\",\"seconds\":10,\"seeds\":1,\"held_out\":\"5\","
     "\"gains\":[{\"name\":\"anisotropy\",\"on\":true,\"psnr\":27.1,\"psnr_without\":26.3,"
     "\"gain\":0.8,\"gain_spread\":null,\"cost\":0.12,\"picture_cost\":-0.03},"
     "{\"name\":\"distortion\",\"on\":true,\"psnr\":null,\"psnr_without\":null,\"gain\":null,"
     "\"gain_spread\":null,\"cost\":0,\"picture_cost\":0}]}",
     "anisotropy +0.80 dB, distortion not measured"},
    {RN_JOB_TRAIN,
     "{\"steps\":2400,\"train_seconds\":60,\"samples\":9,\"psnr\":26.1,"
     "\"parameters_sha256\":\"" SHA256 "\",\"finished_by\":\"time\"}",
     "2400 steps in 60.0 s, 26.10 dB"},
    {RN_JOB_TRAIN,
     "{\"steps\":2400,\"train_seconds\":60,\"samples\":9,\"psnr\":26.1,\"psnr_step\":2400,"
     "\"parameters_sha256\":\"" SHA256 "\",\"finished_by\":\"time\"}",
     "2400 steps in 60.0 s, 26.10 dB"},
    {RN_JOB_TRAIN,
     "{\"steps\":2400,\"train_seconds\":60,\"samples\":9,\"psnr\":26.1,\"psnr_step\":1200,"
     "\"parameters_sha256\":\"" SHA256 "\",\"finished_by\":\"time\"}",
     "2400 steps in 60.0 s, 26.10 dB at step 1200"},
    {RN_JOB_TRAIN,
     "{\"steps\":2400,\"train_seconds\":60,\"samples\":9,\"psnr\":26.1,"
     "\"parameters_sha256\":\"" SHA256 "\",\"finished_by\":\"time\",\"estimate\":"
     "{\"job\":\"job_a2c4e6g3i5k7\",\"seconds\":61.5,\"psnr\":26.52,\"passings\":[]}}",
     "2400 steps in 60.0 s, 26.10 dB; 26.52 dB after 61.5 s were estimated"},
    {RN_JOB_INGEST, "{\"dataset\":\"ds_a2c4e6g3i5k7\"}", ""},
    {RN_JOB_DOCTOR, "{\"passed\":1}", ""},
};

// Where a daemon is said to be, and its URL.
static const struct {
    const char *said, *url;
} hosts[] = {
    {"localhost", "http://localhost:" RN_HTTP_DEFAULT_PORT},
    {"10.0.0.7/", "http://10.0.0.7:" RN_HTTP_DEFAULT_PORT},
    {"localhost:80", "http://localhost:80"},
    {"[::1]", "http://[::1]:" RN_HTTP_DEFAULT_PORT},
    {"[::1]:80/x", "http://[::1]:80/x"},
    {"http://localhost", "http://localhost"}, // of a URL it is the scheme's
    {"https://a/b//", "https://a/b"},
};

START_TEST(hosts_without_a_port_have_the_daemons) {
    struct rn_http *http;
    struct rn_error err = {0};
    ck_assert_int_eq(rn_http_create(hosts[_i].said, NULL, &http, &err), RN_OK);
    ck_assert_str_eq(rn_http_host(http), hosts[_i].url);
    rn_http_destroy(&http);
}
END_TEST

START_TEST(jobs_tell_their_figures) {
    struct rn_job job = {.type = outcomes[_i].type, .result = (char *)outcomes[_i].result};
    char text[200];
    rn_format_outcome(&job, text, sizeof text);
    ck_assert_str_eq(text, outcomes[_i].words);
    char few[8];
    rn_format_outcome(&job, few, sizeof few);
    ck_assert_int_eq(strncmp(few, text, strlen(few)), 0);
}
END_TEST

// A training's line: before there is a PSNR its step is absent, which no sum must take for a number
// (the sanitizer tells); an old PSNR is told with its step.
static const struct {
    const char *psnr, *psnr_step, *text;
} followed[] = {
    {"null", "null", "step 90  12.0 s  ETA 3.0 s"},
    {"24.5", "90", "step 90  12.0 s  24.50 dB  ETA 3.0 s"},
    {"24.5", "70", "step 90  12.0 s  24.50 dB  ETA 3.0 s"},
    {"24.5", "50", "step 90  12.0 s  24.50 dB at step 50  ETA 3.0 s"},
    {"24.5", "0", "step 90  12.0 s  24.50 dB at step 0  ETA 3.0 s"},
};

START_TEST(trainings_tell_their_progress) {
    char json[800], text[200];
    double fraction;
    struct rn_job job = {.type = RN_JOB_TRAIN, .state = RN_JOB_RUNNING};
    snprintf(json, sizeof json,
             "{\"step\":90,\"max_steps\":0,\"max_seconds\":0,"
             "\"train_seconds\":12,\"load_seconds\":0,\"evaluate_seconds\":0,"
             "\"paused_seconds\":0,\"yielded_seconds\":0,\"loss\":null,\"rays_per_second\":0,"
             "\"samples_per_second\":0,\"samples\":0,\"level_samples\":[],\"psnr\":%s,"
             "\"psnr_step\":%s,\"nonfinite\":{\"rays\":0,\"steps_rejected\":0,\"rollbacks\":0},"
             "\"eta_seconds\":3,\"fraction\":0.8,\"evaluating_first\":false}",
             followed[_i].psnr, followed[_i].psnr_step);
    rn_format_progress(&job, json, &fraction, text, sizeof text);
    ck_assert_str_eq(text, followed[_i].text);
    ck_assert_double_eq(fraction, 0.8);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("client");
    TCase *plain = tcase_create("plain"), *files = tcase_create("files");
    tcase_add_test(plain, events_in_pieces_of_any_size);
    tcase_add_test(plain, events_after_a_lost_connection);
    tcase_add_test(plain, events_stop_when_told_and_are_bounded);
    tcase_add_test(plain, options_of_every_kind);
    tcase_add_test(plain, options_that_are_refused);
    tcase_add_test(plain, figures_for_people);
    tcase_add_test(plain, names_are_escaped_in_paths);
    tcase_add_loop_test(plain, jobs_tell_their_figures, 0, sizeof outcomes / sizeof *outcomes);
    tcase_add_loop_test(plain, trainings_tell_their_progress, 0,
                        sizeof followed / sizeof *followed);
    tcase_add_loop_test(plain, hosts_without_a_port_have_the_daemons, 0,
                        sizeof hosts / sizeof *hosts);
    tcase_set_timeout(files, 60); // a busy disk
    tcase_add_checked_fixture(files, make_folder, remove_folder);
    tcase_add_test(files, archives_are_read_back_by_libarchive);
    tcase_add_test(files, archives_refuse_what_is_not_theirs);
    tcase_add_test(files, archives_notice_a_file_that_shrinks);
    suite_add_tcase(suite, plain);
    suite_add_tcase(suite, files);
    return run_suite(suite);
}

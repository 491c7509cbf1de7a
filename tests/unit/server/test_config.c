// Options: precedence, kinds, refusals.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/file.h"
#include "server/config.h"
#include "tests/support/suite.h"

static char folder[64], file[128];
static struct rn_config config;
static struct rn_error err;
static const char *variables[8][2];

static void enter(void) {
    strcpy(folder, "/tmp/test_config.XXXXXX");
    ck_assert_ptr_nonnull(mkdtemp(folder));
    snprintf(file, sizeof file, "%s/config", folder);
    memset(variables, 0, sizeof variables);
}

static void leave(void) {
    rn_config_finish(&config);
    ck_assert_int_eq(rn_remove_tree(folder, NULL), RN_OK);
}

static const char *get_variable(const char *name) {
    for (int i = 0; i < 8 && variables[i][0] != NULL; i++)
        if (strcmp(variables[i][0], name) == 0) return variables[i][1];
    return NULL;
}

// The words of the command line, separated by spaces.
static enum rn_status load(const char *line) {
    static char copy[1024];
    char *argv[32] = {"ripnerfd"}, *rest = copy, *word;
    int argc = 1;
    snprintf(copy, sizeof copy, "%s", line);
    while ((word = strsep(&rest, " ")) != NULL)
        if (*word != '\0') argv[argc++] = word;
    rn_config_finish(&config);
    return rn_config_load(argc, argv, get_variable, &config, &err);
}

static void write_text(const char *path, const char *text) {
    ck_assert_int_eq(rn_file_write_atomic(path, text, strlen(text), &err), RN_OK);
}

START_TEST(test_defaults) {
    ck_assert_int_eq(load("--data /d"), RN_OK);
    ck_assert_str_eq(config.address, "127.0.0.1");
    ck_assert_int_eq(config.port, 7373);
    ck_assert_int_eq(config.training_slots, 1);
    ck_assert_int_eq(config.keep_alive_s, 600);
    ck_assert_int_eq(config.max_upload_bytes, 16ll << 30);
    ck_assert_ptr_null(config.token);
}
END_TEST

START_TEST(test_precedence) {
    char line[256];
    write_text(file, "# a comment\n\n threads = 1 \ntraining-slots=2\nkeep-alive = 2h\n"
                     "dataset-root = /tmp\n");
    variables[0][0] = "RIPNERFD_TRAINING_SLOTS";
    variables[0][1] = "3";
    variables[1][0] = "RIPNERFD_KEEP_ALIVE";
    variables[1][1] = "90s";
    snprintf(line, sizeof line, "--data /d --config %s --keep-alive 5m", file);
    ck_assert_int_eq(load(line), RN_OK);
    ck_assert_int_eq(config.threads, 1);        // file
    ck_assert_int_eq(config.training_slots, 3); // environment over file
    ck_assert_int_eq(config.keep_alive_s, 300); // flag over both
    ck_assert_int_eq(config.root_count, 1);
    variables[2][0] = "RIPNERFD_CONFIG";
    variables[2][1] = file;
    ck_assert_int_eq(load("--data=/d --dataset-root / --dataset-root=/usr"), RN_OK);
    ck_assert_int_eq(config.threads, 1);
    ck_assert_int_eq(config.root_count, 2); // a list replaces a list
    ck_assert_str_eq(config.roots[1], "/usr");
}
END_TEST

START_TEST(test_numbers) {
    ck_assert_int_eq(load("--data /d --memory-limit 1.5G"), RN_OK);
    ck_assert_int_eq(config.memory_limit_bytes, 3ll << 29);
    ck_assert_int_eq(load("--data /d --memory-limit 12345"), RN_OK);
    ck_assert_int_eq(config.memory_limit_bytes, 12345);
    ck_assert_int_eq(config.gpu_memory_bytes, 0);
    ck_assert_int_eq(load("--data /d --gpu-memory 20G --gpu-deterministic 1"), RN_OK);
    ck_assert_int_eq(config.gpu_memory_bytes, 20ll << 30);
    ck_assert_int_eq(config.gpu_deterministic, 1);
    static const char *const bad[] = {
        "--threads -1",          "--threads 1.5",      "--threads 1x",      "--threads 99999",
        "--threads nan",         "--training-slots 0", "--memory-limit 5X", "--gpu-memory -1",
        "--gpu-deterministic 2", "--memory-limit 5GG", "--keep-alive 5d",   "--max-upload 0"};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        char line[128];
        snprintf(line, sizeof line, "--data /d %s", bad[i]);
        ck_assert_msg(load(line) == RN_ERROR_INVALID, "%s passes", bad[i]);
    }
}
END_TEST

START_TEST(test_refusals) {
    ck_assert_int_eq(load(""), RN_ERROR_INVALID); // no --data
    ck_assert_int_eq(load("--data"), RN_ERROR_INVALID);
    ck_assert_int_eq(load("--data /d --dat /e"), RN_ERROR_INVALID);
    ck_assert_int_eq(load("--data /d extra"), RN_ERROR_INVALID);
    ck_assert_int_eq(load("--data /d --help=yes"), RN_ERROR_INVALID);
    ck_assert_int_eq(load("--data /d --dataset-root /no/such/folder"), RN_ERROR_NOT_FOUND);
    write_text(file, "threads = 1\nthreats = 2\n");
    char line[256], where[256];
    snprintf(line, sizeof line, "--data /d --config %s", file);
    snprintf(where, sizeof where, "%s:2", file);
    ck_assert_int_eq(load(line), RN_ERROR_INVALID);
    ck_assert_str_eq(err.where, where);
}
END_TEST

START_TEST(test_listen) {
    ck_assert_int_eq(load("--data /d --listen [::1]:0"), RN_OK);
    ck_assert_str_eq(config.address, "::1");
    ck_assert_int_eq(config.port, 0);
    static const char *const bad[] = {
        "localhost",     ":80",        "127.0.0.1:", "127.0.0.1:70000",
        "127.0.0.1:80x", "0.0.0.0:80", "[::]:80"};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        char line[128];
        snprintf(line, sizeof line, "--data /d --listen %s", bad[i]);
        ck_assert_msg(load(line) == RN_ERROR_INVALID, "%s passes", bad[i]);
    }
    char line[256];
    snprintf(line, sizeof line, "--data /d --listen 0.0.0.0:80 --token-file %s", file);
    write_text(file, "0123456789abcdef\nsecond line\n");
    ck_assert_int_eq(chmod(file, 0644), 0);
    ck_assert_int_eq(load(line), RN_ERROR_INVALID); // everyone can read it
    ck_assert_int_eq(chmod(file, 0600), 0);
    ck_assert_int_eq(load(line), RN_OK);
    ck_assert_str_eq(config.token, "0123456789abcdef");
    write_text(file, "short\n");
    ck_assert_int_eq(load(line), RN_ERROR_INVALID);
    write_text(file, "with a space 0123456789\n");
    ck_assert_int_eq(load(line), RN_ERROR_INVALID);
}
END_TEST

START_TEST(test_help) {
    ck_assert_int_eq(load("--help"), RN_OK);
    ck_assert(config.help);
    char *text = rn_config_help();
    ck_assert_ptr_nonnull(strstr(text, "--memory-limit BYTES"));
    free(text);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("config");
    TCase *tcase = tcase_create("config");
    tcase_add_checked_fixture(tcase, enter, leave);
    tcase_add_test(tcase, test_defaults);
    tcase_add_test(tcase, test_precedence);
    tcase_add_test(tcase, test_numbers);
    tcase_add_test(tcase, test_refusals);
    tcase_add_test(tcase, test_listen);
    tcase_add_test(tcase, test_help);
    suite_add_tcase(suite, tcase);
    return run_suite(suite);
}

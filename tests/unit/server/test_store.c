// Records: round trips, transactions, conflicts, lists, migration, damage, the folder's lock.
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/file.h"
#include "server/store/table.h"
#include "tests/support/suite.h"

static char folder[64];
static struct rn_store *store;
static struct rn_error err;

static void enter(void) {
    strcpy(folder, "/tmp/test_store.XXXXXX");
    ck_assert_ptr_nonnull(mkdtemp(folder));
    ck_assert_int_eq(rn_store_open(folder, &store, &err), RN_OK);
}

static void leave(void) {
    rn_store_close(&store);
    ck_assert_int_eq(rn_remove_tree(folder, NULL), RN_OK);
}

static void reopen(void) {
    rn_store_close(&store);
    ck_assert_int_eq(rn_store_open(folder, &store, &err), RN_OK);
}

static struct rn_scene_row make_scene(const char *id, const char *name) {
    struct rn_scene_row scene = {.created_ms = 1234567890123,
                                 .state = RN_SCENE_PAUSED,
                                 .steps = 1ll << 40,
                                 .train_seconds = 1.0 / 3,
                                 .psnr = NAN,
                                 .memory_bytes = 77};
    snprintf(scene.id, sizeof scene.id, "%s", id);
    snprintf(scene.name, sizeof scene.name, "%s", name);
    snprintf(scene.dataset, sizeof scene.dataset, "ds_x");
    snprintf(scene.job, sizeof scene.job, "job_x");
    return scene;
}

START_TEST(test_round_trip) {
    struct rn_scene_row scene = make_scene("sc_a", "lego"), read;
    char record[] = "{\"na\u00efve\":\"'quotes'; DROP TABLE scenes\"}";
    scene.record = record;
    ck_assert_int_eq(rn_store_insert(store, &rn_scenes, &scene, &err), RN_OK);
    ck_assert_int_eq(scene.seq, 1);
    reopen();
    ck_assert_int_eq(rn_store_resolve(store, &rn_scenes, RN_ID_SCENE, "lego", &read, &err), RN_OK);
    ck_assert_str_eq(read.id, "sc_a");
    ck_assert_str_eq(read.dataset, "ds_x");
    ck_assert_int_eq(read.created_ms, 1234567890123);
    ck_assert_int_eq(read.state, RN_SCENE_PAUSED);
    ck_assert_int_eq(read.steps, 1ll << 40);
    ck_assert(read.train_seconds == 1.0 / 3);
    ck_assert(isnan(read.psnr));
    ck_assert_str_eq(read.sha256, "");
    ck_assert_str_eq(read.record, record);
    read.psnr = 31.5;
    free(read.record);
    read.record = NULL;
    ck_assert_int_eq(rn_store_update(store, &rn_scenes, &read, &err), RN_OK);
    ck_assert_int_eq(rn_store_resolve(store, &rn_scenes, RN_ID_SCENE, "sc_a", &read, &err), RN_OK);
    ck_assert(read.psnr == 31.5);
    ck_assert_ptr_null(read.record);
}
END_TEST

START_TEST(test_missing_and_taken) {
    struct rn_scene_row scene = make_scene("sc_a", "lego"), read;
    ck_assert_int_eq(rn_store_update(store, &rn_scenes, &scene, &err), RN_ERROR_NOT_FOUND);
    ck_assert_int_eq(rn_store_resolve(store, &rn_scenes, RN_ID_SCENE, "no", &read, &err),
                     RN_ERROR_NOT_FOUND);
    ck_assert_str_eq(err.text, "there is no scene 'no'");
    ck_assert_int_eq(rn_store_insert(store, &rn_scenes, &scene, &err), RN_OK);
    scene = make_scene("sc_b", "lego");
    ck_assert_int_eq(rn_store_insert(store, &rn_scenes, &scene, &err), RN_ERROR_CONFLICT);
    scene = make_scene("sc_a", "ship");
    ck_assert_int_eq(rn_store_insert(store, &rn_scenes, &scene, &err), RN_ERROR_CONFLICT);
    ck_assert_int_eq(rn_store_delete(store, &rn_scenes, "sc_a", &err), RN_OK);
    ck_assert_int_eq(rn_store_insert(store, &rn_scenes, &scene, &err), RN_OK);
    ck_assert_int_eq(scene.seq, 2); // never used again: cursors stay valid
}
END_TEST

START_TEST(test_transaction) {
    struct rn_scene_row a = make_scene("sc_a", "a"), b = make_scene("sc_b", "b"), read;
    ck_assert_int_eq(rn_store_begin(store, &err), RN_OK);
    ck_assert_int_eq(rn_store_insert(store, &rn_scenes, &a, &err), RN_OK);
    rn_store_rollback(store);
    ck_assert_int_eq(rn_store_find(store, &rn_scenes, "id", "sc_a", &read, &err),
                     RN_ERROR_NOT_FOUND);
    ck_assert_int_eq(rn_store_begin(store, &err), RN_OK);
    ck_assert_int_eq(rn_store_insert(store, &rn_scenes, &a, &err), RN_OK);
    ck_assert_int_eq(rn_store_insert(store, &rn_scenes, &b, &err), RN_OK);
    ck_assert_int_eq(rn_store_commit(store, &err), RN_OK);
    reopen();
    ck_assert_int_eq(rn_store_find(store, &rn_scenes, "id", "sc_a", &read, &err), RN_OK);
    rn_row_finish(&rn_scenes, &read);
}
END_TEST

START_TEST(test_list) {
    for (int i = 0; i < 5; i++) {
        struct rn_job_row job = {.type = i % 2 ? RN_JOB_EVAL : RN_JOB_TRAIN, .attempt = i};
        snprintf(job.id, sizeof job.id, "job_%d", i);
        ck_assert_int_eq(rn_store_insert(store, &rn_jobs_table, &job, &err), RN_OK);
    }
    void *rows;
    size_t count;
    struct rn_query query = {.limit = 2, .before_seq = 5};
    ck_assert_int_eq(rn_store_list(store, &rn_jobs_table, &query, &rows, &count, &err), RN_OK);
    ck_assert_uint_eq(count, 2);
    ck_assert_str_eq(((struct rn_job_row *)rows)[0].id, "job_3");
    ck_assert_str_eq(((struct rn_job_row *)rows)[1].id, "job_2");
    rn_rows_finish(&rn_jobs_table, rows, count);
    query = (struct rn_query){.equal = {{"type", "eval"}, {"state", "queued"}}};
    ck_assert_int_eq(rn_store_list(store, &rn_jobs_table, &query, &rows, &count, &err), RN_OK);
    ck_assert_uint_eq(count, 2);
    ck_assert_int_eq(((struct rn_job_row *)rows)[0].attempt, 3);
    rn_rows_finish(&rn_jobs_table, rows, count);
    query = (struct rn_query){.equal = {{"id", "job_9"}}};
    ck_assert_int_eq(rn_store_list(store, &rn_jobs_table, &query, &rows, &count, &err), RN_OK);
    ck_assert_uint_eq(count, 0);
    ck_assert_ptr_null(rows);
}
END_TEST

START_TEST(test_migration) {
    static const char *const scripts[] = {
        "CREATE TABLE t (a TEXT NOT NULL); INSERT INTO t VALUES ('kept');",
        "ALTER TABLE t ADD COLUMN b INTEGER NOT NULL DEFAULT 7;",
        "CREATE TABLE u (c TEXT); INSERT INTO nowhere VALUES (1);",
    };
    sqlite3 *db;
    sqlite3_stmt *statement;
    ck_assert_int_eq(sqlite3_open(":memory:", &db), SQLITE_OK);
    ck_assert_int_eq(rn_store_migrate(db, scripts, 1, &err), RN_OK);
    ck_assert_int_eq(rn_store_migrate(db, scripts, 2, &err), RN_OK);
    ck_assert_int_eq(rn_store_migrate(db, scripts, 2, &err), RN_OK);
    ck_assert_int_eq(sqlite3_prepare_v2(db, "SELECT a, b FROM t", -1, &statement, NULL), SQLITE_OK);
    ck_assert_int_eq(sqlite3_step(statement), SQLITE_ROW);
    ck_assert_str_eq((const char *)sqlite3_column_text(statement, 0), "kept");
    ck_assert_int_eq(sqlite3_column_int(statement, 1), 7);
    sqlite3_finalize(statement);
    // A script that fails leaves nothing of itself.
    ck_assert_int_ne(rn_store_migrate(db, scripts, 3, &err), RN_OK);
    ck_assert_int_ne(sqlite3_exec(db, "SELECT * FROM u", NULL, NULL, NULL), SQLITE_OK);
    ck_assert_int_eq(rn_store_migrate(db, scripts, 2, &err), RN_OK);
    ck_assert_int_eq(rn_store_migrate(db, scripts, 1, &err), RN_ERROR_UNSUPPORTED);
    ck_assert_ptr_nonnull(strstr(err.text, "newer"));
    sqlite3_close(db);
}
END_TEST

START_TEST(test_lock) {
    struct rn_store *second = NULL;
    ck_assert_int_eq(rn_store_open(folder, &second, &err), RN_ERROR_CONFLICT);
    ck_assert_ptr_null(second);
    ck_assert_ptr_nonnull(strstr(err.text, "another ripnerfd"));
}
END_TEST

static void write_file(const char *name, const char *text) {
    char path[256];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    ck_assert_int_eq(rn_file_write_atomic(path, text, strlen(text), &err), RN_OK);
}

START_TEST(test_damage) {
    char wal[128];
    rn_store_close(&store);
    write_file("ripnerf.db", "this is no database, and long enough to be seen as one of none");
    snprintf(wal, sizeof wal, "%s/ripnerf.db-wal", folder);
    unlink(wal);
    ck_assert_int_eq(rn_store_open(folder, &store, &err), RN_ERROR_CORRUPT);
    ck_assert_ptr_nonnull(strstr(err.text, ".recover"));
    write_file("ripnerf.db", "");
    write_file("layout", "2\n");
    ck_assert_int_eq(rn_store_open(folder, &store, &err), RN_ERROR_UNSUPPORTED);
    write_file("layout", "1\n");
    ck_assert_int_eq(rn_store_open(folder, &store, &err), RN_OK);
}
END_TEST

static bool exists(const char *name) {
    char path[256];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    return access(path, F_OK) == 0;
}

START_TEST(test_sweep) {
    struct rn_scene_row scene = make_scene("sc_a", "lego");
    struct rn_job_row job = {.id = "job_a"}, over = {.id = "job_b", .finished_ms = 5};
    ck_assert_int_eq(rn_store_insert(store, &rn_scenes, &scene, &err), RN_OK);
    ck_assert_int_eq(rn_store_insert(store, &rn_jobs_table, &job, &err), RN_OK);
    ck_assert_int_eq(rn_store_insert(store, &rn_jobs_table, &over, &err), RN_OK);
    static const char *const names[] = {"scenes/sc_a",     "scenes/sc_b",     "spool/job_a.tar",
                                        "spool/job_b.tar", "spool/upload-xy", "jobs/job_b",
                                        "datasets/ds_q"};
    static const bool kept[] = {true, false, true, false, false, true, false};
    for (size_t i = 0; i < 7; i++)
        write_file(names[i], "x");
    ck_assert_int_eq(rn_store_sweep(store, &err), RN_OK);
    for (size_t i = 0; i < 7; i++)
        ck_assert_msg(exists(names[i]) == kept[i], "%s", names[i]);
}
END_TEST

START_TEST(test_ids) {
    char a[RN_ID_MAX], b[RN_ID_MAX];
    ck_assert_int_eq(rn_store_new_id(RN_ID_PATH, a, &err), RN_OK);
    ck_assert_int_eq(rn_store_new_id(RN_ID_PATH, b, &err), RN_OK);
    ck_assert_uint_eq(strlen(a), strlen(RN_ID_PATH) + RN_ID_RANDOM);
    ck_assert_uint_eq(strspn(a + 5, "abcdefghijklmnopqrstuvwxyz234567"), RN_ID_RANDOM);
    ck_assert_str_ne(a, b);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("store");
    TCase *tcase = tcase_create("store");
    tcase_add_checked_fixture(tcase, enter, leave);
    tcase_add_test(tcase, test_round_trip);
    tcase_add_test(tcase, test_missing_and_taken);
    tcase_add_test(tcase, test_transaction);
    tcase_add_test(tcase, test_list);
    tcase_add_test(tcase, test_migration);
    tcase_add_test(tcase, test_lock);
    tcase_add_test(tcase, test_damage);
    tcase_add_test(tcase, test_sweep);
    tcase_add_test(tcase, test_ids);
    suite_add_tcase(suite, tcase);
    return run_suite(suite);
}

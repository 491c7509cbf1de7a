// Records: round trips, transactions, conflicts, lists, migration, damage, the folder's lock.
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/file.h"
#include "common/base/seal.h"
#include "server/store/scrub.h"
#include "server/store/table.h"
#include "tests/support/suite.h"

static char folder[64];
static struct rn_store *store;
static struct rn_error err;

static void enter(void) {
    strcpy(folder, "/tmp/test_store.XXXXXX");
    ck_assert_ptr_nonnull(mkdtemp(folder));
    ck_assert_int_eq(rn_store_open(folder, false, &store, &err), RN_OK);
}

static void leave(void) {
    rn_store_close(&store);
    ck_assert_int_eq(rn_remove_tree(folder, NULL), RN_OK);
}

static void reopen(void) {
    rn_store_close(&store);
    ck_assert_int_eq(rn_store_open(folder, false, &store, &err), RN_OK);
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
    ck_assert_int_eq(rn_store_open(folder, false, &second, &err), RN_ERROR_CONFLICT);
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
    ck_assert_int_eq(rn_store_open(folder, false, &store, &err), RN_ERROR_CORRUPT);
    ck_assert_ptr_nonnull(strstr(err.text, "--rebuild"));
    write_file("ripnerf.db", "");
    write_file("layout", "2\n");
    ck_assert_int_eq(rn_store_open(folder, false, &store, &err), RN_ERROR_UNSUPPORTED);
    write_file("layout", "1\n");
    ck_assert_int_eq(rn_store_open(folder, false, &store, &err), RN_OK);
}
END_TEST

static bool exists(const char *name) {
    char path[256];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    return access(path, F_OK) == 0;
}

// Only what is known to be unwanted goes: content whose record is lost stays.
START_TEST(test_sweep) {
    struct rn_scene_row scene = make_scene("sc_a", "lego"), gone = make_scene("sc_b", "ship");
    struct rn_job_row job = {.id = "job_a"}, over = {.id = "job_b", .finished_ms = 5};
    struct rn_job_row failed = {.id = "job_c",
                                .type = RN_JOB_INGEST,
                                .state = RN_JOB_FAILED,
                                .finished_ms = 5,
                                .dataset = "ds_f"};
    ck_assert_int_eq(rn_store_insert(store, &rn_scenes, &scene, &err), RN_OK);
    ck_assert_int_eq(rn_store_insert(store, &rn_scenes, &gone, &err), RN_OK);
    ck_assert_int_eq(rn_store_delete(store, &rn_scenes, "sc_b", &err), RN_OK);
    ck_assert_int_eq(rn_store_insert(store, &rn_jobs_table, &job, &err), RN_OK);
    ck_assert_int_eq(rn_store_insert(store, &rn_jobs_table, &over, &err), RN_OK);
    ck_assert_int_eq(rn_store_insert(store, &rn_jobs_table, &failed, &err), RN_OK);
    static const struct {
        const char *name;
        bool stays;
    } files[] = {{"scenes/sc_a/x", true},
                 {"scenes/sc_b/x", false},
                 {"scenes/sc_lost/x", true},
                 {"spool/job_a.tar", true},
                 {"spool/job_b.tar", false},
                 {"spool/job_lost.tar", true},
                 {"spool/upload-xy", false},
                 {"spool/job_lost.work", false},
                 {"jobs/job_b/log", true},
                 {"jobs/job_lost/log", true},
                 {"datasets/ds_lost/x", true},
                 {"datasets/ds_f/x", false},
                 {"scenes/sc_a/checkpoints/.fresh.tmp.partial", false},
                 {"scenes/sc_a/checkpoints/step-000000001.safetensors", true},
                 {"scenes/sc_a/marks/.step-000000001.safetensors.77-1.tmp", false},
                 {"scenes/sc_a/.record.json.77-2.tmp", false},
                 {"scenes/sc_a/.tidy", true},
                 {"scenes/sc_lost/checkpoints/.fresh.tmp", true}};
    for (size_t i = 0; i < sizeof files / sizeof files[0]; i++) {
        char parent[256];
        snprintf(parent, sizeof parent, "%s/%s", folder, files[i].name);
        *strrchr(parent, '/') = '\0';
        ck_assert_int_eq(rn_mkdirs(parent, 0700, &err), RN_OK);
        write_file(files[i].name, "x");
    }
    ck_assert_int_eq(rn_store_sweep(store, &err), RN_OK);
    for (size_t i = 0; i < sizeof files / sizeof files[0]; i++)
        ck_assert_msg(exists(files[i].name) == files[i].stays, "%s", files[i].name);
}
END_TEST

// A runner that outlived its daemon holds the lock of its scene, and may be writing.
START_TEST(test_sweep_beside_a_runner) {
    struct rn_scene_row scene = make_scene("sc_a", "lego");
    char path[256];
    ck_assert_int_eq(rn_store_insert(store, &rn_scenes, &scene, &err), RN_OK);
    snprintf(path, sizeof path, "%s/scenes/sc_a/checkpoints", folder);
    ck_assert_int_eq(rn_mkdirs(path, 0700, &err), RN_OK);
    write_file("scenes/sc_a/lock", "");
    write_file("scenes/sc_a/checkpoints/.fresh.tmp", "x");
    snprintf(path, sizeof path, "%s/scenes/sc_a/lock", folder);
    int fd = open(path, O_RDWR | O_CLOEXEC);
    ck_assert_int_eq(flock(fd, LOCK_EX | LOCK_NB), 0);
    ck_assert_int_eq(rn_store_sweep(store, &err), RN_OK);
    ck_assert(exists("scenes/sc_a/checkpoints/.fresh.tmp"));
    close(fd);
    ck_assert_int_eq(rn_store_sweep(store, &err), RN_OK);
    ck_assert(!exists("scenes/sc_a/checkpoints/.fresh.tmp"));
    fd = open(path, O_RDWR | O_CLOEXEC);
    ck_assert_int_eq(flock(fd, LOCK_EX | LOCK_NB), 0); // nor is it kept from the next one
    close(fd);
}
END_TEST

static int deny_removed(void *context, int action, const char *table, const char *column,
                        const char *database, const char *by) {
    return action == SQLITE_READ && strcmp(table, "removed") == 0 ? SQLITE_DENY : SQLITE_OK;
}

// Where it cannot be asked what was deleted, nothing was.
START_TEST(test_sweep_that_cannot_ask) {
    char lost[256];
    snprintf(lost, sizeof lost, "%s/scenes/sc_lost", folder);
    ck_assert_int_eq(rn_mkdirs(lost, 0700, &err), RN_OK);
    write_file("scenes/sc_lost/x", "x");
    sqlite3_set_authorizer(store->db, deny_removed, NULL);
    ck_assert_int_ne(rn_store_sweep(store, &err), RN_OK);
    ck_assert_str_ne(err.text, "");
    ck_assert(exists("scenes/sc_lost/x"));
    sqlite3_set_authorizer(store->db, NULL, NULL);
    ck_assert_int_eq(rn_store_sweep(store, &err), RN_OK);
    ck_assert(exists("scenes/sc_lost/x"));
}
END_TEST

static void allow_descriptors(rlim_t count) {
    struct rlimit limit;
    ck_assert_int_eq(getrlimit(RLIMIT_NOFILE, &limit), 0);
    limit.rlim_cur = count;
    ck_assert_int_eq(setrlimit(RLIMIT_NOFILE, &limit), 0);
}

// However few files can be opened: a copy has everything or there is none, and what was not read is
// told.
START_TEST(test_few_descriptors) {
    struct rn_scene_row scene = make_scene("sc_a", "lego");
    struct rn_scrub_result all, part;
    int failed = 0, done = 0, unread = 0, next = open("/dev/null", O_RDONLY | O_CLOEXEC);
    ck_assert_int_eq(rn_store_insert(store, &rn_scenes, &scene, &err), RN_OK);
    rn_scrub(folder, NULL, NULL, &all);
    ck_assert(all.checked == 1 && all.unread == 0);
    for (rlim_t count = 0; count < 24; count++) {
        char name[64], path[256];
        snprintf(name, sizeof name, "copy-%d/scenes/sc_a/record.json", (int)count);
        snprintf(path, sizeof path, "%s/copy-%d", folder, (int)count);
        allow_descriptors((rlim_t)next + 1 + count);
        enum rn_status status = rn_store_snapshot(store, NULL, path, &err);
        rn_scrub(folder, NULL, NULL, &part);
        allow_descriptors(256);
        ck_assert_msg(status != RN_OK || exists(name), "%d", (int)count);
        ck_assert(part.unread > 0 || part.checked == all.checked);
        failed += status != RN_OK;
        done += status == RN_OK;
        unread += part.unread > 0;
    }
    ck_assert(failed > 0 && done > 0 && unread > 0);
    close(next);
}
END_TEST

static void remove_database(void) {
    static const char *const names[] = {"ripnerf.db", "ripnerf.db-wal", "ripnerf.db-shm"};
    rn_store_close(&store);
    for (int i = 0; i < 3; i++) {
        char path[256];
        snprintf(path, sizeof path, "%s/%s", folder, names[i]);
        unlink(path);
    }
}

// A lost database is refused while there is content, and made anew from the records' copies.
START_TEST(test_rebuild) {
    struct rn_scene_row a = make_scene("sc_a", "lego"), b = make_scene("sc_b", "ship"), read;
    struct rn_camera_path_row path = {.id = "path_a", .name = "orbit", .document = (char *)"{}"};
    a.record = (char *)"{\"na\u00efve\":\"'quotes'\"}";
    ck_assert_int_eq(rn_store_insert(store, &rn_scenes, &a, &err), RN_OK);
    ck_assert_int_eq(rn_store_begin(store, &err), RN_OK);
    ck_assert_int_eq(rn_store_insert(store, &rn_scenes, &b, &err), RN_OK);
    ck_assert_int_eq(rn_store_commit(store, &err), RN_OK);
    ck_assert_int_eq(rn_store_insert(store, &rn_camera_paths, &path, &err), RN_OK);
    b.psnr = 31.25;
    ck_assert_int_eq(rn_store_update(store, &rn_scenes, &b, &err), RN_OK);
    remove_database();
    ck_assert_int_eq(rn_store_open(folder, false, &store, &err), RN_ERROR_CORRUPT);
    ck_assert_ptr_nonnull(strstr(err.text, "--rebuild"));
    ck_assert(exists("scenes/sc_a/record.json") && exists("scenes/sc_b/record.json"));
    ck_assert_int_eq(rn_store_open(folder, true, &store, &err), RN_OK);
    ck_assert_int_eq(rn_store_resolve(store, &rn_scenes, RN_ID_SCENE, "lego", &read, &err), RN_OK);
    ck_assert_str_eq(read.record, a.record);
    ck_assert_int_eq(read.seq, a.seq);
    ck_assert(isnan(read.psnr) && read.steps == a.steps);
    rn_row_finish(&rn_scenes, &read);
    ck_assert_int_eq(rn_store_resolve(store, &rn_scenes, RN_ID_SCENE, "ship", &read, &err), RN_OK);
    ck_assert(read.psnr == 31.25);
    ck_assert_int_eq(rn_store_resolve(store, &rn_camera_paths, RN_ID_PATH, "orbit", &path, &err),
                     RN_OK);
    rn_row_finish(&rn_camera_paths, &path);
    reopen();
}
END_TEST

// A copy that was damaged makes no record, and is not removed for it.
START_TEST(test_rebuild_from_damaged_copy) {
    struct rn_scene_row a = make_scene("sc_a", "lego"), b = make_scene("sc_b", "ship"), read;
    ck_assert_int_eq(rn_store_insert(store, &rn_scenes, &a, &err), RN_OK);
    ck_assert_int_eq(rn_store_insert(store, &rn_scenes, &b, &err), RN_OK);
    char name[256];
    snprintf(name, sizeof name, "%s/scenes/sc_a/record.json", folder);
    int fd = open(name, O_RDWR | O_CLOEXEC);
    ck_assert_int_eq(pwrite(fd, "X", 1, 150), 1);
    close(fd);
    remove_database();
    ck_assert_int_eq(rn_store_open(folder, true, &store, &err), RN_OK);
    ck_assert_int_eq(rn_store_find(store, &rn_scenes, "id", "sc_a", &read, &err),
                     RN_ERROR_NOT_FOUND);
    ck_assert_int_eq(rn_store_find(store, &rn_scenes, "id", "sc_b", &read, &err), RN_OK);
    ck_assert_int_eq(rn_store_sweep(store, &err), RN_OK);
    ck_assert(exists("scenes/sc_a/record.json"));
}
END_TEST

// Puts `to` in place of `from` in a record's copy, and seals it again.
static void forge(const char *id, const char *from, const char *to) {
    char path[256], digest[65], *end;
    uint8_t *text;
    size_t size;
    snprintf(path, sizeof path, "%s/scenes/%s/record.json", folder, id);
    ck_assert_int_eq(rn_file_read(path, 1 << 16, &text, &size, &err), RN_OK);
    char *seal = strstr((char *)text, RN_SEAL_KEY) + sizeof RN_SEAL_KEY - 1;
    memset(seal, '0', 64);
    char *at = strstr((char *)text, from);
    ck_assert_ptr_nonnull(at);
    end = at + strlen(from);
    int fd = open(path, O_RDWR | O_TRUNC | O_CLOEXEC);
    ck_assert_int_eq(dprintf(fd, "%.*s%s%s", (int)(at - (char *)text), text, to, end),
                     (int)(size - strlen(from) + strlen(to)));
    ck_assert_int_eq(rn_seal_close(fd, path, digest, &err), RN_OK);
    close(fd);
    free(text);
}

// A copy that a stranger has written may be sealed and still be no record: none comes of it, and
// what there is can be listed.
static sqlite3_mem_methods usual; // of SQLite's memory
static int until_none;            // allocations until one fails; 0: none does

static void *fail_in_turn(int size) {
    return until_none > 0 && --until_none == 0 ? NULL : usual.xMalloc(size);
}

// Whichever allocation of SQLite fails: a record is made, or it is said that there is no memory; a
// sound copy is never taken for a damaged one.
START_TEST(test_record_without_memory) {
    struct rn_scene_row scene = make_scene("sc_a", "lego");
    bool made = false;
    int tries = 0;
    rn_store_close(&store);
    ck_assert_int_eq(sqlite3_shutdown(), SQLITE_OK);
    ck_assert_int_eq(sqlite3_config(SQLITE_CONFIG_GETMALLOC, &usual), SQLITE_OK);
    sqlite3_mem_methods failing = usual;
    failing.xMalloc = fail_in_turn;
    ck_assert_int_eq(sqlite3_config(SQLITE_CONFIG_MALLOC, &failing), SQLITE_OK);
    ck_assert_int_eq(sqlite3_config(SQLITE_CONFIG_LOOKASIDE, 0, 0), SQLITE_OK);
    reopen();
    scene.record = (char *)"{\"numbers\":[1,2,3]}";
    ck_assert_int_eq(rn_store_insert(store, &rn_scenes, &scene, &err), RN_OK);
    while (!made) {
        ck_assert_int_eq(rn_store_begin(store, &err), RN_OK);
        ck_assert_int_eq(sqlite3_exec(store->db, "DELETE FROM scenes", NULL, NULL, NULL),
                         SQLITE_OK);
        until_none = ++tries;
        enum rn_status status = rn_records_add(store, &rn_scenes, "sc_a", &made, &err);
        until_none = 0;
        ck_assert_msg(made || status == RN_ERROR_NO_MEMORY, "%d: %s", tries, err.text);
        rn_store_rollback(store);
    }
    ck_assert_int_gt(tries, 10);
}
END_TEST

START_TEST(test_rebuild_from_forged_copies) {
    static const struct {
        const char *id, *from, *to;
    } forged[] = {{"sc_a", "\"state\":\"paused\"", "\"state\":\"odd\""},
                  {"sc_b", "\"id\":\"sc_b\"", "\"id\":\"sc_z\""},
                  {"sc_c", "\"record\":\"{}\"", "\"record\":\"{\""},
                  {"sc_d", "\"dataset\":\"", "\"dataset\":\"0123456789012345678901234567890"}};
    struct rn_scene_row good = make_scene("sc_e", "good");
    for (size_t i = 0; i < 4; i++) {
        struct rn_scene_row row = make_scene(forged[i].id, forged[i].id + 3);
        row.record = (char *)"{}";
        ck_assert_int_eq(rn_store_insert(store, &rn_scenes, &row, &err), RN_OK);
    }
    ck_assert_int_eq(rn_store_insert(store, &rn_scenes, &good, &err), RN_OK);
    for (size_t i = 0; i < 4; i++)
        forge(forged[i].id, forged[i].from, forged[i].to);
    remove_database();
    ck_assert_int_eq(rn_store_open(folder, true, &store, &err), RN_OK);
    struct rn_query query = {.limit = 0};
    void *rows;
    size_t count;
    ck_assert_int_eq(rn_store_list(store, &rn_scenes, &query, &rows, &count, &err), RN_OK);
    ck_assert_uint_eq(count, 1);
    ck_assert_str_eq(((struct rn_scene_row *)rows)->name, "good");
    rn_rows_finish(&rn_scenes, rows, count);
}
END_TEST

// Half of its pages are zeros: refused, and kept beside when the records are made anew.
START_TEST(test_half_zeroed) {
    static const char zeros[4096];
    ck_assert_int_eq(rn_store_begin(store, &err), RN_OK);
    for (int i = 0; i < 200; i++) {
        char id[16], name[16];
        snprintf(id, sizeof id, "sc_%d", i);
        snprintf(name, sizeof name, "scene-%d", i);
        struct rn_scene_row scene = make_scene(id, name);
        ck_assert_int_eq(rn_store_insert(store, &rn_scenes, &scene, &err), RN_OK);
    }
    ck_assert_int_eq(rn_store_commit(store, &err), RN_OK);
    reopen(); // which writes all to the database proper
    rn_store_close(&store);
    char path[256];
    struct stat about;
    snprintf(path, sizeof path, "%s/ripnerf.db", folder);
    ck_assert_int_eq(stat(path, &about), 0);
    int fd = open(path, O_RDWR | O_CLOEXEC);
    for (off_t at = about.st_size / 8192 * 4096; at < about.st_size; at += 4096)
        ck_assert_int_eq(pwrite(fd, zeros, sizeof zeros, at), sizeof zeros);
    close(fd);
    ck_assert_int_eq(rn_store_open(folder, false, &store, &err), RN_ERROR_CORRUPT);
    ck_assert_int_eq(rn_store_open(folder, true, &store, &err), RN_OK);
    struct rn_query query = {.limit = 0};
    void *rows;
    size_t count;
    ck_assert_int_eq(rn_store_list(store, &rn_scenes, &query, &rows, &count, &err), RN_OK);
    ck_assert_uint_eq(count, 200);
    rn_rows_finish(&rn_scenes, rows, count);
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
    tcase_add_test(tcase, test_sweep_that_cannot_ask);
    tcase_add_test(tcase, test_sweep_beside_a_runner);
    tcase_add_test(tcase, test_few_descriptors);
    tcase_add_test(tcase, test_rebuild);
    tcase_add_test(tcase, test_rebuild_from_damaged_copy);
    tcase_add_test(tcase, test_record_without_memory);
    tcase_add_test(tcase, test_rebuild_from_forged_copies);
    tcase_add_test(tcase, test_half_zeroed);
    tcase_add_test(tcase, test_ids);
    suite_add_tcase(suite, tcase);
    return run_suite(suite);
}

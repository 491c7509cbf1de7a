// The schema, one script a version. Scripts are never changed once released; new ones follow.
#include <stdio.h>

#include "server/store/table.h"

const char *const rn_store_scripts[] = {
    "CREATE TABLE datasets (seq INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL UNIQUE,"
    " name TEXT NOT NULL UNIQUE, created_ms INTEGER NOT NULL, record TEXT);"
    "CREATE TABLE scenes (seq INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL UNIQUE,"
    " name TEXT NOT NULL UNIQUE, dataset TEXT NOT NULL, job TEXT NOT NULL,"
    " created_ms INTEGER NOT NULL, state TEXT NOT NULL, steps INTEGER NOT NULL,"
    " train_seconds REAL NOT NULL, psnr REAL, sha256 TEXT NOT NULL,"
    " memory_bytes INTEGER NOT NULL, record TEXT);"
    "CREATE INDEX scenes_dataset ON scenes (dataset);"
    "CREATE TABLE jobs (seq INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL UNIQUE,"
    " type TEXT NOT NULL, state TEXT NOT NULL, attempt INTEGER NOT NULL,"
    " stalls INTEGER NOT NULL, created_ms INTEGER NOT NULL, started_ms INTEGER NOT NULL,"
    " finished_ms INTEGER NOT NULL, dataset TEXT NOT NULL, dataset_name TEXT NOT NULL,"
    " scene TEXT NOT NULL, scene_name TEXT NOT NULL, source TEXT, options TEXT, progress TEXT,"
    " result TEXT, problem TEXT);"
    "CREATE INDEX jobs_state ON jobs (state);"
    "CREATE INDEX jobs_scene ON jobs (scene);"
    "CREATE TABLE checkpoints (seq INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL UNIQUE,"
    " scene TEXT NOT NULL, step INTEGER NOT NULL, size_bytes INTEGER NOT NULL,"
    " created_ms INTEGER NOT NULL, sha256 TEXT NOT NULL, path TEXT NOT NULL);"
    "CREATE INDEX checkpoints_scene ON checkpoints (scene);"
    "CREATE TABLE camera_paths (seq INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL UNIQUE,"
    " name TEXT NOT NULL UNIQUE, created_ms INTEGER NOT NULL, document TEXT NOT NULL);"
    "CREATE TABLE keys (seq INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL UNIQUE,"
    " digest TEXT NOT NULL, job TEXT NOT NULL, created_ms INTEGER NOT NULL);",
    "CREATE TABLE metrics (seq INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL UNIQUE,"
    " job TEXT NOT NULL, step INTEGER NOT NULL, train_seconds REAL NOT NULL, psnr REAL);"
    "CREATE INDEX metrics_job ON metrics (job);",
    // What was deleted on purpose: only such content is ever removed from the disk.
    "CREATE TABLE removed (id TEXT PRIMARY KEY) WITHOUT ROWID;"
    "CREATE TRIGGER datasets_removed AFTER DELETE ON datasets"
    " BEGIN INSERT OR IGNORE INTO removed VALUES (old.id); END;"
    "CREATE TRIGGER scenes_removed AFTER DELETE ON scenes"
    " BEGIN INSERT OR IGNORE INTO removed VALUES (old.id); END;"
    "CREATE TRIGGER camera_paths_removed AFTER DELETE ON camera_paths"
    " BEGIN INSERT OR IGNORE INTO removed VALUES (old.id); END;"
    "ALTER TABLE scenes ADD COLUMN digest TEXT NOT NULL DEFAULT '';"
    "ALTER TABLE checkpoints ADD COLUMN digest TEXT NOT NULL DEFAULT '';",
    "CREATE TABLE tokens (seq INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL UNIQUE,"
    " name TEXT NOT NULL UNIQUE, scope TEXT NOT NULL, sha256 TEXT NOT NULL UNIQUE,"
    " scene TEXT NOT NULL, job TEXT NOT NULL, owner TEXT NOT NULL, created_ms INTEGER NOT NULL,"
    " expires_ms INTEGER NOT NULL, max_jobs INTEGER NOT NULL, max_bytes INTEGER NOT NULL);"
    "ALTER TABLE jobs ADD COLUMN owner TEXT NOT NULL DEFAULT '';"
    "ALTER TABLE jobs ADD COLUMN size_bytes INTEGER NOT NULL DEFAULT 0;"
    "CREATE INDEX jobs_owner ON jobs (owner);"
    "ALTER TABLE camera_paths ADD COLUMN owner TEXT NOT NULL DEFAULT '';",
    "ALTER TABLE jobs ADD COLUMN traceparent TEXT NOT NULL DEFAULT '';",
};
const int rn_store_script_count = sizeof rn_store_scripts / sizeof rn_store_scripts[0];
_Static_assert(sizeof rn_store_scripts / sizeof rn_store_scripts[0] == RN_STORE_VERSION,
               "one script a version");

static enum rn_status read_version(sqlite3 *db, int *ret_version, struct rn_error *err) {
    sqlite3_stmt *statement = NULL;
    int code = sqlite3_prepare_v2(db, "PRAGMA user_version", -1, &statement, NULL);
    if (code == SQLITE_OK) code = sqlite3_step(statement);
    if (code == SQLITE_ROW) *ret_version = sqlite3_column_int(statement, 0);
    sqlite3_finalize(statement);
    return code == SQLITE_ROW ? RN_OK : rn_sqlite_error(db, code, "reading the version", err);
}

enum rn_status rn_store_migrate(sqlite3 *db, const char *const *scripts, int count,
                                struct rn_error *err) {
    int version = 0;
    enum rn_status status = read_version(db, &version, err);
    if (status != RN_OK) return status;
    if (version > count)
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, "ripnerf.db",
                            "written by a newer ripnerfd (version %d, this one knows %d); use "
                            "that one, or another --data folder",
                            version, count);
    for (; version < count; version++) {
        char raise[64];
        snprintf(raise, sizeof raise, "PRAGMA user_version = %d; COMMIT", version + 1);
        int code = sqlite3_exec(db, "BEGIN IMMEDIATE", NULL, NULL, NULL);
        if (code == SQLITE_OK) code = sqlite3_exec(db, scripts[version], NULL, NULL, NULL);
        if (code == SQLITE_OK) code = sqlite3_exec(db, raise, NULL, NULL, NULL);
        if (code == SQLITE_OK) continue;
        status = rn_sqlite_error(db, code, "bringing the schema up to date", err);
        sqlite3_exec(db, "ROLLBACK", NULL, NULL, NULL);
        return status;
    }
    return RN_OK;
}

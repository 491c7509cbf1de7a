// Inside of server/store.
#ifndef RN_SERVER_STORE_TABLE_H
#define RN_SERVER_STORE_TABLE_H

#include <pthread.h>
#include <sqlite3.h>

#include "server/store/store.h"

enum rn_column_kind {
    RN_COLUMN_TEXT,     // char[size]
    RN_COLUMN_DOCUMENT, // char *, owned, NULL
    RN_COLUMN_INT,      // int
    RN_COLUMN_INT64,    // int64_t
    RN_COLUMN_REAL,     // double, NAN is NULL
    RN_COLUMN_NAME,     // an enum, stored as its name
};

struct rn_column {
    const char *name;
    enum rn_column_kind kind;
    size_t offset, size;
    const char *const *names;
};

// The first column is always `seq`.
struct rn_store_table {
    const char *name;
    const char *title; // for errors
    size_t row_size;
    const struct rn_column *columns;
    int column_count;
};

struct rn_store {
    char *folder;
    int lock_fd;
    sqlite3 *db;
    pthread_mutex_t lock; // recursive
};

// A statement in an error's terms; `what` says what was being done.
enum rn_status rn_sqlite_error(sqlite3 *db, int code, const char *what, struct rn_error *err);

// Runs the scripts from the database's user_version on, each in a transaction that also raises
// it. RN_ERROR_UNSUPPORTED when the database is newer than the scripts.
enum rn_status rn_store_migrate(sqlite3 *db, const char *const *scripts, int count,
                                struct rn_error *err) RN_MUST_CHECK;

extern const char *const rn_store_scripts[];
extern const int rn_store_script_count;

#endif

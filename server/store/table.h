// Inside of server/store.
#ifndef RN_SERVER_STORE_TABLE_H
#define RN_SERVER_STORE_TABLE_H

#include <pthread.h>
#include <sqlite3.h>
#include <stdbool.h>

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

// The first column is always `seq`, the second `id`: a row begins with an int64_t and a text.
struct rn_store_table {
    const char *name;
    const char *title; // for errors
    size_t row_size;
    const struct rn_column *columns;
    int column_count;
    const char *folder; // of its content, DIR/folder/<id>/, with a copy of the record; NULL: none
};

#define RN_STORE_MAX_CHANGED 16

struct rn_store {
    char *folder;
    int lock_fd;
    sqlite3 *db;
    pthread_mutex_t lock; // recursive
    // Records whose copies are to be written once the transaction is over.
    struct rn_changed_record {
        const struct rn_store_table *table;
        char id[RN_ID_MAX];
    } changed[RN_STORE_MAX_CHANGED];
    int changed_count;
};

// A statement in an error's terms; `what` says what was being done.
enum rn_status rn_sqlite_error(sqlite3 *db, int code, const char *what, struct rn_error *err);

// Runs the scripts from the database's user_version on, each in a transaction that also raises
// it. RN_ERROR_UNSUPPORTED when the database is newer than the scripts.
enum rn_status rn_store_migrate(sqlite3 *db, const char *const *scripts, int count,
                                struct rn_error *err) RN_MUST_CHECK;

// sweep.c: whether content of this id was deleted on purpose since the start; its rest may go.
enum rn_status rn_store_was_removed(struct rn_store *store, const char *id, bool *ret_removed,
                                    struct rn_error *err) RN_MUST_CHECK;

// records.c
extern const struct rn_store_table *const rn_content_tables[]; // those with folders; NULL ends it
// A row of the table was written: its copy follows now, or when the transaction is committed.
void rn_record_changed(struct rn_store *store, const struct rn_store_table *table, const char *id);
void rn_records_write_changed(struct rn_store *store);
// Brings all copies up to date.
enum rn_status rn_records_write_all(struct rn_store *store, struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_record_is_there(struct rn_store *store, const struct rn_store_table *table,
                                  const char *id, bool *ret_there,
                                  struct rn_error *err) RN_MUST_CHECK;
// Makes the record `id` from its copy, unless there is one, within a transaction; none that is not
// sound, which the log tells.
enum rn_status rn_records_add(struct rn_store *store, const struct rn_store_table *table,
                              const char *id, bool *ret_made, struct rn_error *err) RN_MUST_CHECK;
// Makes the records that are missing from the copies.
enum rn_status rn_store_rebuild(struct rn_store *store, struct rn_error *err) RN_MUST_CHECK;
// Closes the database and renames it to ripnerf.db.damaged-*.
enum rn_status rn_store_set_aside(struct rn_store *store, struct rn_error *err) RN_MUST_CHECK;
// Whether there are records at all, and whether there is content.
enum rn_status rn_store_is_empty(struct rn_store *store, bool *ret_empty,
                                 struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_store_has_content(struct rn_store *store, bool *ret_has,
                                    struct rn_error *err) RN_MUST_CHECK;

extern const char *const rn_store_scripts[];
extern const int rn_store_script_count;

#endif

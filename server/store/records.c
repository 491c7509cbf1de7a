// Copies of the records beside their content (<folder>/<id>/record.json, sealed), and records made
// anew from them. The database is the truth; a copy may be behind by what a crash cut off.
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/buf.h"
#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/log.h"
#include "common/base/names.h"
#include "common/base/seal.h"
#include "server/store/table.h"

#define COPY "record.json"
#define MAX_COPY (64u << 20)

const struct rn_store_table *const rn_content_tables[] = {&rn_datasets, &rn_scenes,
                                                          &rn_camera_paths, &rn_jobs_table, NULL};

// ---- writing ----------------------------------------------------------------------------------

// SELECT of the row's copy as JSON text, its seal open.
static void copy_sql(const struct rn_store_table *table, struct rn_buf *sql) {
    rn_buf_init(sql, 8192);
    rn_buf_printf(sql, "SELECT '{" RN_SEAL ",\"table\":\"%s\",\"row\":' || json_object(",
                  table->name);
    for (int i = 0; i < table->column_count; i++) {
        const char *name = table->columns[i].name;
        bool real = table->columns[i].kind == RN_COLUMN_REAL; // with all of its digits
        rn_buf_printf(sql,
                      real ? "%s'%s', json(iif(%s IS NULL, 'null', printf('%%!.17g', %s)))"
                           : "%s'%s', %s",
                      i > 0 ? ", " : "", name, name, name);
    }
    rn_buf_printf(sql, ") || '}' FROM %s WHERE id = ?1", table->name);
}

// Whether the copy that is there says the same, and is sealed: a loss of power may have left it as
// it was before its seal was closed.
static bool is_same(const char *path, const char *text, size_t size) {
    uint8_t *bytes = NULL;
    size_t got = 0;
    char sha256[65];
    const size_t skip = 1 + sizeof RN_SEAL - 1;
    if (rn_file_read(path, MAX_COPY, &bytes, &got, NULL) != RN_OK) return false;
    bool same = got == size && size > skip && memcmp(bytes + skip, text + skip, size - skip) == 0;
    free(bytes);
    return same && rn_seal_check(path, sha256, NULL) == RN_OK;
}

// Written whole or not at all, but not waited for.
static enum rn_status write_copy(const char *path, const char *text, size_t size,
                                 struct rn_error *err) {
    char temporary[4300], sha256[65];
    if (is_same(path, text, size)) return RN_OK;
    snprintf(temporary, sizeof temporary, "%s.tmp", path);
    int fd = open(temporary, O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
    if (fd < 0) return rn_error_from_errno(err, errno, temporary, "create");
    enum rn_status status = RN_OK;
    if (!rn_write_all(fd, text, size)) status = rn_error_from_errno(err, errno, temporary, "write");
    if (status == RN_OK) status = rn_seal_close(fd, temporary, sha256, err);
    if (close(fd) != 0 && status == RN_OK)
        status = rn_error_from_errno(err, errno, temporary, "write");
    if (status == RN_OK && rename(temporary, path) != 0)
        status = rn_error_from_errno(err, errno, path, "rename");
    if (status != RN_OK) unlink(temporary);
    return status;
}

static enum rn_status copy_record(struct rn_store *store, const struct rn_store_table *table,
                                  const char *id, struct rn_error *err) {
    struct rn_buf sql;
    sqlite3_stmt *statement = NULL;
    copy_sql(table, &sql);
    char *folder = rn_store_path(store, "%s/%s", table->folder, id);
    char *path = rn_store_path(store, "%s/%s/" COPY, table->folder, id);
    enum rn_status status = RN_OK;
    if (sql.failed || folder == NULL || path == NULL)
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, COPY, "no memory");
    if (status == RN_OK) status = rn_mkdirs_in(store->folder, folder, 0700, err);
    if (status == RN_OK) {
        int code = sqlite3_prepare_v2(store->db, (char *)sql.data, (int)sql.size, &statement, NULL);
        if (code == SQLITE_OK) code = sqlite3_bind_text(statement, 1, id, -1, SQLITE_STATIC);
        if (code == SQLITE_OK) code = sqlite3_step(statement);
        if (code == SQLITE_ROW)
            status = write_copy(path, (const char *)sqlite3_column_text(statement, 0),
                                (size_t)sqlite3_column_bytes(statement, 0), err);
        else if (code != SQLITE_DONE)
            status = rn_sqlite_error(store->db, code, COPY, err);
        sqlite3_finalize(statement);
    }
    free(folder);
    free(path);
    rn_buf_finish(&sql);
    return status;
}

// The record is in the database: a copy that cannot be written is made at the next start.
static void copy_or_warn(struct rn_store *store, const struct rn_store_table *table,
                         const char *id) {
    struct rn_error err = {0};
    if (copy_record(store, table, id, &err) != RN_OK)
        rn_log(RN_LOG_WARN, "the copy of record %s cannot be written: %s: %s", id, err.where,
               err.text);
}

void rn_record_changed(struct rn_store *store, const struct rn_store_table *table, const char *id) {
    if (table->folder == NULL) return;
    if (sqlite3_get_autocommit(store->db)) {
        copy_or_warn(store, table, id);
    } else if (store->changed_count++ < RN_STORE_MAX_CHANGED) {
        struct rn_changed_record *changed = &store->changed[store->changed_count - 1];
        changed->table = table;
        snprintf(changed->id, sizeof changed->id, "%s", id);
    }
}

void rn_records_write_changed(struct rn_store *store) {
    struct rn_error err = {0};
    bool many = store->changed_count > RN_STORE_MAX_CHANGED;
    if (many && rn_records_write_all(store, &err) != RN_OK)
        rn_log(RN_LOG_WARN, "the records' copies cannot be written: %s", err.text);
    for (int i = 0; !many && i < store->changed_count; i++)
        copy_or_warn(store, store->changed[i].table, store->changed[i].id);
    store->changed_count = 0;
}

enum rn_status rn_records_write_all(struct rn_store *store, struct rn_error *err) {
    for (int t = 0; rn_content_tables[t] != NULL; t++) {
        const struct rn_store_table *table = rn_content_tables[t];
        struct rn_query query = {.limit = 0};
        void *rows = NULL;
        size_t count = 0;
        enum rn_status status = rn_store_list(store, table, &query, &rows, &count, err);
        if (status != RN_OK) return status;
        pthread_mutex_lock(&store->lock);
        for (size_t i = 0; i < count; i++)
            copy_or_warn(store, table, (char *)rows + i * table->row_size + sizeof(int64_t));
        pthread_mutex_unlock(&store->lock);
        rn_rows_finish(table, rows, count);
    }
    return RN_OK;
}

// ---- rebuilding -------------------------------------------------------------------------------

// Calls `visit` for each visible entry of DIR/folder, in the order of their names.
static enum rn_status each_entry(struct rn_store *store, const char *folder,
                                 enum rn_status (*visit)(struct rn_store *store, void *context,
                                                         const char *name, struct rn_error *err),
                                 void *context, struct rn_error *err) {
    struct dirent **entries = NULL;
    char *path = rn_store_path(store, "%s", folder);
    int count = path != NULL ? scandir(path, &entries, NULL, alphasort) : -1;
    enum rn_status status =
        count < 0 ? rn_error_from_errno(err, path == NULL ? ENOMEM : errno, folder, "list") : RN_OK;
    for (int i = 0; i < count; i++) {
        const char *name = entries[i]->d_name;
        if (status == RN_OK && name[0] != '.') status = visit(store, context, name, err);
        free(entries[i]);
    }
    free(entries);
    free(path);
    return status;
}

struct looking {
    const char *folder;
    bool found;
};

static bool is_bare(const char *path) {
    char frames[4300];
    struct dirent *entry;
    DIR *folder = opendir(path);
    bool bare = folder != NULL;
    snprintf(frames, sizeof frames, "%s/frames", path);
    while (bare && (errno = 0, entry = readdir(folder)) != NULL)
        bare = entry->d_name[0] == '.' || (strcmp(entry->d_name, "frames") == 0 && is_bare(frames));
    if (bare) bare = errno == 0;
    if (folder != NULL) closedir(folder);
    return bare;
}

// A folder that a request was about to fill when the daemon ended is none.
static enum rn_status look_for_content(struct rn_store *store, void *context, const char *name,
                                       struct rn_error *err) {
    struct looking *looking = context;
    char *path = rn_store_path(store, "%s/%s", looking->folder, name);
    if (path == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, COPY, "no memory");
    looking->found |= !is_bare(path);
    free(path);
    return RN_OK;
}

enum rn_status rn_store_has_content(struct rn_store *store, bool *ret_has, struct rn_error *err) {
    enum rn_status status = RN_OK;
    struct looking looking = {.found = false};
    for (int i = 0; status == RN_OK && rn_content_tables[i] != NULL; i++) {
        looking.folder = rn_content_tables[i]->folder;
        status = each_entry(store, looking.folder, look_for_content, &looking, err);
    }
    *ret_has = looking.found;
    return status;
}

enum rn_status rn_store_is_empty(struct rn_store *store, bool *ret_empty, struct rn_error *err) {
    *ret_empty = true;
    for (int i = 0; rn_content_tables[i] != NULL; i++) {
        struct rn_query query = {.limit = 1};
        void *rows = NULL;
        size_t count = 0;
        enum rn_status status =
            rn_store_list(store, rn_content_tables[i], &query, &rows, &count, err);
        if (status != RN_OK) return status;
        rn_rows_finish(rn_content_tables[i], rows, count);
        *ret_empty &= count == 0;
    }
    return RN_OK;
}

// A column's value in the copy. One that an older daemon wrote lacks the columns that came later.
static void print_value(struct rn_buf *sql, const struct rn_column *column) {
    static const char *const late[] = {"owner", "size_bytes", "traceparent", NULL};
    if (rn_name_index(late, column->name) < 0)
        rn_buf_printf(sql, ", json_extract(?1, '$.row.%s')", column->name);
    else
        rn_buf_printf(sql, ", ifnull(json_extract(?1, '$.row.%s'), %s)", column->name,
                      column->kind == RN_COLUMN_TEXT ? "''" : "0");
}

// Runs an INSERT whose ?1 is the copy's text; *ret_done: a row came of it.
static enum rn_status insert_from(struct rn_store *store, const struct rn_store_table *table,
                                  const char *text, const char *seq, const char *name,
                                  bool *ret_done, struct rn_error *err) {
    struct rn_buf sql;
    sqlite3_stmt *statement = NULL;
    rn_buf_init(&sql, 8192);
    rn_buf_printf(&sql, "INSERT OR IGNORE INTO %s (seq", table->name);
    for (int i = 1; i < table->column_count; i++)
        rn_buf_printf(&sql, ", %s", table->columns[i].name);
    rn_buf_printf(&sql, ") SELECT %s", seq);
    for (int i = 1; i < table->column_count; i++) {
        if (strcmp(table->columns[i].name, "name") == 0)
            rn_buf_printf(&sql, ", %s", name);
        else
            print_value(&sql, &table->columns[i]);
    }
    int code = sql.failed ? SQLITE_NOMEM
                          : sqlite3_prepare_v2(store->db, (char *)sql.data, (int)sql.size,
                                               &statement, NULL);
    if (code == SQLITE_OK) code = sqlite3_bind_text(statement, 1, text, -1, SQLITE_STATIC);
    if (code == SQLITE_OK) code = sqlite3_step(statement);
    *ret_done = code == SQLITE_DONE && sqlite3_changes(store->db) > 0;
    enum rn_status status =
        code == SQLITE_DONE ? RN_OK : rn_sqlite_error(store->db, code, COPY, err);
    sqlite3_finalize(statement);
    rn_buf_finish(&sql);
    return status;
}

#define SEQ "json_extract(?1, '$.row.seq')"
#define NAME "json_extract(?1, '$.row.name')"
#define OTHER_NAME NAME " || '-' || substr(json_extract(?1, '$.row.id'), -6)"

// In its old place, at the end, or under another name when someone else has taken its own.
static enum rn_status insert_record(struct rn_store *store, const struct rn_store_table *table,
                                    const char *text, bool *ret_done, struct rn_error *err) {
    static const char *const ways[][2] = {{SEQ, NAME}, {"NULL", NAME}, {"NULL", OTHER_NAME}};
    enum rn_status status = RN_OK;
    *ret_done = false;
    for (int i = 0; status == RN_OK && !*ret_done && i < 3; i++)
        status = insert_from(store, table, text, ways[i][0], ways[i][1], ret_done, err);
    return status;
}

struct rebuilding {
    const struct rn_store_table *table;
    const char *scene;
    bool all; // none is passed over but what never had a copy
    int made, left;
};

enum rn_status rn_record_is_there(struct rn_store *store, const struct rn_store_table *table,
                                  const char *id, bool *ret_there, struct rn_error *err) {
    void *rows = NULL;
    size_t count = 0;
    struct rn_query query = {.equal = {{"id", id}}, .limit = 1};
    enum rn_status status = rn_store_list(store, table, &query, &rows, &count, err);
    if (status != RN_OK) return status;
    rn_rows_finish(table, rows, count);
    *ret_there = count > 0;
    return RN_OK;
}

// A checkpoint file of a scene whose record was made anew.
static enum rn_status add_checkpoint(struct rn_store *store, void *context, const char *name,
                                     struct rn_error *err) {
    const char *scene = ((struct rebuilding *)context)->scene;
    long long step;
    int end = 0;
    struct stat about;
    struct rn_checkpoint_row row = {.size_bytes = 0};
    if (sscanf(name, "step-%lld.safetensors%n", &step, &end) != 1 || name[end] != '\0')
        return RN_OK;
    snprintf(row.id, sizeof row.id, "%s/%lld", scene, step);
    bool known = false;
    enum rn_status status = rn_record_is_there(store, &rn_checkpoints, row.id, &known, err);
    if (status != RN_OK || known) return status;
    char *path = rn_store_path(store, "scenes/%s/checkpoints/%s", scene, name);
    char relative[128];
    snprintf(relative, sizeof relative, "checkpoints/%.64s", name);
    if (path != NULL && stat(path, &about) == 0 && rn_seal_read(path, row.digest, err) == RN_OK) {
        row.step = step;
        row.size_bytes = about.st_size;
        row.created_ms = (int64_t)about.st_mtim.tv_sec * 1000 + about.st_mtim.tv_nsec / 1000000;
        row.path = relative;
        snprintf(row.scene, sizeof row.scene, "%s", scene);
        status = rn_store_insert(store, &rn_checkpoints, &row, err);
    }
    free(path);
    return status;
}

static enum rn_status add_checkpoints(struct rn_store *store, const char *scene,
                                      struct rn_error *err) {
    char folder[128];
    struct rebuilding rebuilding = {.scene = scene};
    snprintf(folder, sizeof folder, "scenes/%.64s/checkpoints", scene);
    enum rn_status status = each_entry(store, folder, add_checkpoint, &rebuilding, err);
    return status == RN_ERROR_NOT_FOUND ? RN_OK : status;
}

// RN_ERROR_CORRUPT unless the record that was made reads as one of this folder: the copy may be a
// stranger's.
static enum rn_status check_sound(struct rn_store *store, const struct rn_store_table *table,
                                  const char *id, struct rn_error *err) {
    struct rn_buf sql;
    struct rn_query query = {.equal = {{"id", id}}, .limit = 1};
    sqlite3_stmt *statement = NULL;
    void *rows = NULL;
    size_t count = 0;
    enum rn_status status = rn_store_list(store, table, &query, &rows, &count, err);
    if (status != RN_OK) return status;
    rn_rows_finish(table, rows, count);
    rn_buf_init(&sql, 4096);
    rn_buf_printf(&sql, "SELECT 1 FROM %s WHERE id = ?1", table->name);
    for (int i = 0; i < table->column_count; i++) {
        const char *name = table->columns[i].name;
        if (table->columns[i].kind == RN_COLUMN_DOCUMENT && strcmp(name, "source") != 0)
            rn_buf_printf(&sql, " AND (%s IS NULL OR json(%s) IS NOT NULL)", name, name);
    }
    int code = sql.failed ? SQLITE_NOMEM
                          : sqlite3_prepare_v2(store->db, (char *)sql.data, (int)sql.size,
                                               &statement, NULL);
    if (code == SQLITE_OK) code = sqlite3_bind_text(statement, 1, id, -1, SQLITE_STATIC);
    if (code == SQLITE_OK) code = sqlite3_step(statement);
    sqlite3_finalize(statement);
    rn_buf_finish(&sql);
    if (code == SQLITE_DONE ||
        code == SQLITE_ERROR) // json() tells of memory; json_valid() does not
        return rn_error_set(err, RN_ERROR_CORRUPT, COPY, "it is no record of %s", id);
    return code == SQLITE_ROW ? RN_OK : rn_sqlite_error(store->db, code, COPY, err);
}

// As insert_record; nothing comes of a copy that makes no sound record.
static enum rn_status insert_sound(struct rn_store *store, const struct rn_store_table *table,
                                   const char *id, const char *text, bool *ret_done,
                                   struct rn_error *err) {
    int code = sqlite3_exec(store->db, "SAVEPOINT record", NULL, NULL, NULL);
    if (code != SQLITE_OK) return rn_sqlite_error(store->db, code, COPY, err);
    enum rn_status status = insert_record(store, table, text, ret_done, err);
    if (status == RN_OK)
        status = *ret_done ? check_sound(store, table, id, err)
                           : rn_error_set(err, RN_ERROR_CORRUPT, COPY, "it is no record of %s", id);
    *ret_done &= status == RN_OK;
    if (!*ret_done) code = sqlite3_exec(store->db, "ROLLBACK TO record", NULL, NULL, NULL);
    if (code == SQLITE_OK) code = sqlite3_exec(store->db, "RELEASE record", NULL, NULL, NULL);
    if (code != SQLITE_OK && status == RN_OK) {
        *ret_done = false;
        status = rn_sqlite_error(store->db, code, COPY, err);
    }
    return status;
}

static enum rn_status add_record(struct rn_store *store, void *context, const char *name,
                                 struct rn_error *err) {
    struct rebuilding *rebuilding = context;
    const struct rn_store_table *table = rebuilding->table;
    struct rn_error why = {0};
    uint8_t *text = NULL;
    size_t size;
    char sha256[65];
    bool done = false, known = false;
    enum rn_status status = rn_record_is_there(store, table, name, &known, err);
    if (status != RN_OK || known) return status;
    char *path = rn_store_path(store, "%s/%s/" COPY, table->folder, name);
    status = path == NULL ? rn_error_set(&why, RN_ERROR_NO_MEMORY, COPY, "no memory")
                          : rn_seal_check(path, sha256, &why);
    if (status == RN_OK) status = rn_file_read(path, MAX_COPY, &text, &size, &why);
    if (status == RN_OK) status = insert_sound(store, table, name, (char *)text, &done, &why);
    if (status == RN_OK && done && table == &rn_scenes) status = add_checkpoints(store, name, err);
    rebuilding->made += done;
    rebuilding->left += !done;
    if (!done)
        rn_log(RN_LOG_WARN, "no record can be made of %s/%s, which stays as it is: %s",
               table->folder, name, why.text);
    free(text);
    free(path);
    if (done) return status;
    bool passes = why.status == RN_ERROR_NO_MEMORY || why.status == RN_ERROR_NO_SPACE ||
                  (rebuilding->all && why.status != RN_ERROR_NOT_FOUND);
    if (passes && err != NULL) *err = why;
    return passes ? why.status : RN_OK;
}

enum rn_status rn_records_add(struct rn_store *store, const struct rn_store_table *table,
                              const char *id, bool *ret_made, struct rn_error *err) {
    struct rebuilding rebuilding = {.table = table, .all = true};
    enum rn_status status = add_record(store, &rebuilding, id, err);
    *ret_made = rebuilding.made > 0;
    return status;
}

enum rn_status rn_store_rebuild(struct rn_store *store, struct rn_error *err) {
    enum rn_status status = rn_store_begin(store, err);
    if (status != RN_OK) return status;
    for (int i = 0; status == RN_OK && rn_content_tables[i] != NULL; i++) {
        struct rebuilding rebuilding = {.table = rn_content_tables[i]};
        status = each_entry(store, rebuilding.table->folder, add_record, &rebuilding, err);
        rn_log(RN_LOG_INFO, "rebuild: %d records of %s made anew, %d could not be", rebuilding.made,
               rebuilding.table->name, rebuilding.left);
    }
    if (status == RN_OK) return rn_store_commit(store, err);
    rn_store_rollback(store);
    return status;
}

enum rn_status rn_store_set_aside(struct rn_store *store, struct rn_error *err) {
    static const char *const suffixes[] = {"", "-wal", "-shm"};
    long long now = (long long)rn_clock_wall_ms();
    sqlite3_close(store->db);
    store->db = NULL;
    for (int i = 0; i < 3; i++) {
        char *from = rn_store_path(store, "ripnerf.db%s", suffixes[i]);
        char *to = rn_store_path(store, "ripnerf.db.damaged-%lld%s", now, suffixes[i]);
        enum rn_status status = RN_OK;
        if (from == NULL || to == NULL)
            status = rn_error_set(err, RN_ERROR_NO_MEMORY, "ripnerf.db", "no memory");
        else if (rename(from, to) != 0 && errno != ENOENT)
            status = rn_error_from_errno(err, errno, from, "set it aside");
        free(from);
        free(to);
        if (status != RN_OK) return status;
    }
    rn_log(RN_LOG_WARN, "the damaged database is kept as ripnerf.db.damaged-%lld", now);
    return RN_OK;
}

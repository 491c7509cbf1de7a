// How rows lie in tables.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/buf.h"
#include "server/store/table.h"

#define COUNT(array) ((int)(sizeof(array) / sizeof((array)[0])))
#define SEQ(row)                                                                                   \
    { "seq", RN_COLUMN_INT64, offsetof(struct row, seq), 0, NULL }
#define TEXT(row, field)                                                                           \
    { #field, RN_COLUMN_TEXT, offsetof(struct row, field), sizeof((struct row *)0)->field, NULL }
#define DOCUMENT(row, field)                                                                       \
    { #field, RN_COLUMN_DOCUMENT, offsetof(struct row, field), 0, NULL }
#define INT(row, field)                                                                            \
    { #field, RN_COLUMN_INT, offsetof(struct row, field), 0, NULL }
#define INT64(row, field)                                                                          \
    { #field, RN_COLUMN_INT64, offsetof(struct row, field), 0, NULL }
#define REAL(row, field)                                                                           \
    { #field, RN_COLUMN_REAL, offsetof(struct row, field), 0, NULL }
#define NAME(row, field, names)                                                                    \
    { #field, RN_COLUMN_NAME, offsetof(struct row, field), 0, names }
#define TABLE(sql_name, title, row, columns, folder)                                               \
    { sql_name, title, sizeof(struct row), columns, COUNT(columns), folder }

static const struct rn_column dataset_columns[] = {
    SEQ(rn_dataset_row),
    TEXT(rn_dataset_row, id),
    TEXT(rn_dataset_row, name),
    INT64(rn_dataset_row, created_ms),
    DOCUMENT(rn_dataset_row, record),
};
const struct rn_store_table rn_datasets =
    TABLE("datasets", "dataset", rn_dataset_row, dataset_columns, "datasets");

static const struct rn_column scene_columns[] = {
    SEQ(rn_scene_row),
    TEXT(rn_scene_row, id),
    TEXT(rn_scene_row, name),
    TEXT(rn_scene_row, dataset),
    TEXT(rn_scene_row, job),
    INT64(rn_scene_row, created_ms),
    NAME(rn_scene_row, state, rn_scene_state_names),
    INT64(rn_scene_row, steps),
    REAL(rn_scene_row, train_seconds),
    REAL(rn_scene_row, psnr),
    TEXT(rn_scene_row, sha256),
    TEXT(rn_scene_row, digest),
    INT64(rn_scene_row, memory_bytes),
    DOCUMENT(rn_scene_row, record),
};
const struct rn_store_table rn_scenes =
    TABLE("scenes", "scene", rn_scene_row, scene_columns, "scenes");

static const struct rn_column job_columns[] = {
    SEQ(rn_job_row),
    TEXT(rn_job_row, id),
    NAME(rn_job_row, type, rn_job_type_names),
    NAME(rn_job_row, state, rn_job_state_names),
    INT(rn_job_row, attempt),
    INT(rn_job_row, stalls),
    INT64(rn_job_row, created_ms),
    INT64(rn_job_row, started_ms),
    INT64(rn_job_row, finished_ms),
    TEXT(rn_job_row, dataset),
    TEXT(rn_job_row, dataset_name),
    TEXT(rn_job_row, scene),
    TEXT(rn_job_row, scene_name),
    TEXT(rn_job_row, owner),
    TEXT(rn_job_row, traceparent),
    INT64(rn_job_row, size_bytes),
    DOCUMENT(rn_job_row, source),
    DOCUMENT(rn_job_row, options),
    DOCUMENT(rn_job_row, progress),
    DOCUMENT(rn_job_row, result),
    DOCUMENT(rn_job_row, problem),
};
const struct rn_store_table rn_jobs_table = TABLE("jobs", "job", rn_job_row, job_columns, "jobs");

static const struct rn_column checkpoint_columns[] = {
    SEQ(rn_checkpoint_row),
    TEXT(rn_checkpoint_row, id),
    TEXT(rn_checkpoint_row, scene),
    INT64(rn_checkpoint_row, step),
    INT64(rn_checkpoint_row, size_bytes),
    INT64(rn_checkpoint_row, created_ms),
    TEXT(rn_checkpoint_row, sha256),
    TEXT(rn_checkpoint_row, digest),
    DOCUMENT(rn_checkpoint_row, path),
};
const struct rn_store_table rn_checkpoints =
    TABLE("checkpoints", "checkpoint", rn_checkpoint_row, checkpoint_columns, NULL);

static const struct rn_column camera_path_columns[] = {
    SEQ(rn_camera_path_row),         TEXT(rn_camera_path_row, id),
    TEXT(rn_camera_path_row, name),  INT64(rn_camera_path_row, created_ms),
    TEXT(rn_camera_path_row, owner), DOCUMENT(rn_camera_path_row, document),
};
const struct rn_store_table rn_camera_paths =
    TABLE("camera_paths", "camera path", rn_camera_path_row, camera_path_columns, "camera-paths");

static const struct rn_column metric_columns[] = {
    SEQ(rn_metric_row),
    TEXT(rn_metric_row, id),
    TEXT(rn_metric_row, job),
    INT64(rn_metric_row, step),
    REAL(rn_metric_row, train_seconds),
    REAL(rn_metric_row, psnr),
};
const struct rn_store_table rn_metrics =
    TABLE("metrics", "metric", rn_metric_row, metric_columns, NULL);

static const struct rn_column key_columns[] = {
    SEQ(rn_key_row),       TEXT(rn_key_row, id),          TEXT(rn_key_row, digest),
    TEXT(rn_key_row, job), INT64(rn_key_row, created_ms),
};
const struct rn_store_table rn_keys = TABLE("keys", "key", rn_key_row, key_columns, NULL);

static const struct rn_column token_columns[] = {
    SEQ(rn_token_row),
    TEXT(rn_token_row, id),
    TEXT(rn_token_row, name),
    NAME(rn_token_row, scope, rn_scope_names),
    TEXT(rn_token_row, sha256),
    TEXT(rn_token_row, scene),
    TEXT(rn_token_row, job),
    TEXT(rn_token_row, owner),
    INT64(rn_token_row, created_ms),
    INT64(rn_token_row, expires_ms),
    INT64(rn_token_row, max_jobs),
    INT64(rn_token_row, max_bytes),
};
const struct rn_store_table rn_tokens = TABLE("tokens", "token", rn_token_row, token_columns, NULL);

static int bind(sqlite3_stmt *statement, int place, const struct rn_column *column,
                const void *row) {
    const void *field = (const char *)row + column->offset;
    switch (column->kind) {
    case RN_COLUMN_TEXT:
        return sqlite3_bind_text(statement, place, field, -1, SQLITE_STATIC);
    case RN_COLUMN_DOCUMENT:
        return sqlite3_bind_text(statement, place, *(char *const *)field, -1, SQLITE_STATIC);
    case RN_COLUMN_INT:
        return sqlite3_bind_int(statement, place, *(const int *)field);
    case RN_COLUMN_INT64:
        return sqlite3_bind_int64(statement, place, *(const int64_t *)field);
    case RN_COLUMN_REAL:
        return sqlite3_bind_double(statement, place, *(const double *)field);
    case RN_COLUMN_NAME:
        return sqlite3_bind_text(statement, place, column->names[*(const unsigned *)field], -1,
                                 SQLITE_STATIC);
    }
    return SQLITE_MISUSE;
}

static enum rn_status read_text(sqlite3_stmt *statement, int place, const struct rn_column *column,
                                void *field, struct rn_error *err) {
    const char *text = (const char *)sqlite3_column_text(statement, place);
    if (text != NULL && strlen(text) != (size_t)sqlite3_column_bytes(statement, place))
        return rn_error_set(err, RN_ERROR_CORRUPT, "ripnerf.db", "a %s is damaged", column->name);
    if (column->kind == RN_COLUMN_DOCUMENT) {
        char *copy = text != NULL ? strdup(text) : NULL;
        if (text != NULL && copy == NULL)
            return rn_error_set(err, RN_ERROR_NO_MEMORY, column->name, "no memory for a record");
        *(char **)field = copy;
        return RN_OK;
    }
    if (column->kind == RN_COLUMN_NAME) {
        int value = text != NULL ? rn_name_index(column->names, text) : -1;
        if (value < 0)
            return rn_error_set(err, RN_ERROR_CORRUPT, "ripnerf.db", "unknown %s '%.32s'",
                                column->name, text != NULL ? text : "");
        *(unsigned *)field = (unsigned)value;
        return RN_OK;
    }
    if (text == NULL || strlen(text) >= column->size)
        return rn_error_set(err, RN_ERROR_CORRUPT, "ripnerf.db", "a %s is too long or missing",
                            column->name);
    strcpy(field, text);
    return RN_OK;
}

static enum rn_status read_row(sqlite3_stmt *statement, const struct rn_store_table *table,
                               void *row, struct rn_error *err) {
    memset(row, 0, table->row_size);
    for (int i = 0; i < table->column_count; i++) {
        const struct rn_column *column = &table->columns[i];
        void *field = (char *)row + column->offset;
        enum rn_status status = RN_OK;
        if (column->kind == RN_COLUMN_INT)
            *(int *)field = sqlite3_column_int(statement, i);
        else if (column->kind == RN_COLUMN_INT64)
            *(int64_t *)field = sqlite3_column_int64(statement, i);
        else if (column->kind == RN_COLUMN_REAL)
            *(double *)field = sqlite3_column_type(statement, i) == SQLITE_NULL
                                   ? NAN
                                   : sqlite3_column_double(statement, i);
        else
            status = read_text(statement, i, column, field, err);
        if (status == RN_OK) continue;
        rn_row_finish(table, row);
        return status;
    }
    return RN_OK;
}

void rn_row_finish(const struct rn_store_table *table, void *row) {
    for (int i = 0; i < table->column_count; i++) {
        if (table->columns[i].kind != RN_COLUMN_DOCUMENT) continue;
        char **field = (char **)(void *)((char *)row + table->columns[i].offset);
        free(*field);
        *field = NULL;
    }
}

void rn_rows_finish(const struct rn_store_table *table, void *rows, size_t count) {
    for (size_t i = 0; i < count; i++)
        rn_row_finish(table, (char *)rows + i * table->row_size);
    free(rows);
}

// Prepares the statement in `sql`; the store is locked until finish().
static enum rn_status prepare(struct rn_store *store, const struct rn_buf *sql,
                              sqlite3_stmt **ret_statement, struct rn_error *err) {
    if (sql->failed) return rn_error_set(err, RN_ERROR_NO_MEMORY, "ripnerf.db", "no memory");
    pthread_mutex_lock(&store->lock);
    int code =
        sqlite3_prepare_v2(store->db, (const char *)sql->data, (int)sql->size, ret_statement, NULL);
    if (code == SQLITE_OK) return RN_OK;
    enum rn_status status = rn_sqlite_error(store->db, code, "preparing a statement", err);
    pthread_mutex_unlock(&store->lock);
    return status;
}

static void finish(struct rn_store *store, sqlite3_stmt *statement) {
    sqlite3_finalize(statement);
    pthread_mutex_unlock(&store->lock);
}

static enum rn_status write_row(struct rn_store *store, const struct rn_store_table *table,
                                const struct rn_buf *sql, const void *row, struct rn_error *err) {
    sqlite3_stmt *statement;
    enum rn_status status = rn_store_check_folder(store, err);
    if (status == RN_OK) status = prepare(store, sql, &statement, err);
    if (status != RN_OK) return status;
    int code = SQLITE_OK;
    for (int i = 1; i < table->column_count && code == SQLITE_OK; i++)
        code = bind(statement, i, &table->columns[i], row);
    if (code == SQLITE_OK) code = sqlite3_step(statement);
    if (code != SQLITE_DONE)
        status = rn_sqlite_error(store->db, code, table->name, err);
    else if (sqlite3_changes(store->db) == 0)
        status = rn_error_set(err, RN_ERROR_NOT_FOUND, table->name, "there is no such record");
    finish(store, statement);
    return status;
}

enum rn_status rn_store_insert(struct rn_store *store, const struct rn_store_table *table,
                               void *row, struct rn_error *err) {
    struct rn_buf sql;
    rn_buf_init(&sql, 4096);
    rn_buf_printf(&sql, "INSERT INTO %s (id", table->name);
    for (int i = 2; i < table->column_count; i++)
        rn_buf_printf(&sql, ", %s", table->columns[i].name);
    rn_buf_printf(&sql, ") VALUES (?1");
    for (int i = 2; i < table->column_count; i++)
        rn_buf_printf(&sql, ", ?%d", i);
    rn_buf_printf(&sql, ")");
    pthread_mutex_lock(&store->lock);
    enum rn_status status = write_row(store, table, &sql, row, err);
    if (status == RN_OK) *(int64_t *)row = sqlite3_last_insert_rowid(store->db);
    if (status == RN_OK) rn_record_changed(store, table, (const char *)row + sizeof(int64_t));
    pthread_mutex_unlock(&store->lock);
    rn_buf_finish(&sql);
    return status;
}

enum rn_status rn_store_update(struct rn_store *store, const struct rn_store_table *table,
                               const void *row, struct rn_error *err) {
    struct rn_buf sql;
    rn_buf_init(&sql, 4096);
    rn_buf_printf(&sql, "UPDATE %s SET id = ?1", table->name);
    for (int i = 2; i < table->column_count; i++)
        rn_buf_printf(&sql, ", %s = ?%d", table->columns[i].name, i);
    rn_buf_printf(&sql, " WHERE id = ?1");
    pthread_mutex_lock(&store->lock);
    enum rn_status status = write_row(store, table, &sql, row, err);
    if (status == RN_OK) rn_record_changed(store, table, (const char *)row + sizeof(int64_t));
    pthread_mutex_unlock(&store->lock);
    rn_buf_finish(&sql);
    return status;
}

enum rn_status rn_store_delete(struct rn_store *store, const struct rn_store_table *table,
                               const char *id, struct rn_error *err) {
    struct rn_buf sql;
    sqlite3_stmt *statement;
    rn_buf_init(&sql, 4096);
    rn_buf_printf(&sql, "DELETE FROM %s WHERE id = ?1", table->name);
    enum rn_status status = prepare(store, &sql, &statement, err);
    rn_buf_finish(&sql);
    if (status != RN_OK) return status;
    sqlite3_bind_text(statement, 1, id, -1, SQLITE_STATIC);
    int code = sqlite3_step(statement);
    if (code != SQLITE_DONE) status = rn_sqlite_error(store->db, code, table->name, err);
    finish(store, statement);
    return status;
}

static void select_sql(const struct rn_store_table *table, const struct rn_query *query,
                       struct rn_buf *sql) {
    rn_buf_init(sql, 4096);
    rn_buf_printf(sql, "SELECT seq");
    for (int i = 1; i < table->column_count; i++) {
        const char *name = table->columns[i].name;
        bool wanted = query->without == NULL || strcmp(query->without, name) != 0;
        rn_buf_printf(sql, ", %s", wanted ? name : "NULL");
    }
    rn_buf_printf(sql, " FROM %s WHERE (?1 = 0 OR seq < ?1)", table->name);
    for (int i = 0; i < 3; i++)
        if (query->equal[i].column != NULL)
            rn_buf_printf(sql, " AND %s = ?%d", query->equal[i].column, i + 2);
    rn_buf_printf(sql, " ORDER BY seq DESC LIMIT %d", query->limit > 0 ? query->limit : -1);
}

static enum rn_status read_rows(struct rn_store *store, const struct rn_store_table *table,
                                sqlite3_stmt *statement, struct rn_buf *rows,
                                struct rn_error *err) {
    int code;
    while ((code = sqlite3_step(statement)) == SQLITE_ROW) {
        union {
            struct rn_job_row job;
            struct rn_scene_row scene;
            struct rn_key_row key;
            struct rn_checkpoint_row checkpoint;
            struct rn_camera_path_row camera_path;
            struct rn_dataset_row dataset;
            struct rn_metric_row metric;
            struct rn_token_row token;
        } row;
        enum rn_status status = read_row(statement, table, &row, err);
        if (status != RN_OK) return status;
        rn_buf_append(rows, &row, table->row_size);
        if (!rows->failed) continue;
        rn_row_finish(table, &row);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, table->name, "no memory for the records");
    }
    return code == SQLITE_DONE ? RN_OK : rn_sqlite_error(store->db, code, table->name, err);
}

enum rn_status rn_store_list(struct rn_store *store, const struct rn_store_table *table,
                             const struct rn_query *query, void **ret_rows, size_t *ret_count,
                             struct rn_error *err) {
    struct rn_buf sql, rows;
    sqlite3_stmt *statement;
    rn_buf_init(&rows, 256u << 20);
    select_sql(table, query, &sql);
    enum rn_status status = prepare(store, &sql, &statement, err);
    rn_buf_finish(&sql);
    if (status != RN_OK) return status;
    sqlite3_bind_int64(statement, 1, query->before_seq);
    for (int i = 0; i < 3; i++)
        if (query->equal[i].column != NULL)
            sqlite3_bind_text(statement, i + 2, query->equal[i].text, -1, SQLITE_STATIC);
    status = read_rows(store, table, statement, &rows, err);
    finish(store, statement);
    size_t count = rows.size / table->row_size;
    if (status != RN_OK) {
        for (size_t i = 0; i < count; i++)
            rn_row_finish(table, rows.data + i * table->row_size);
        rn_buf_finish(&rows);
        return status;
    }
    size_t size;
    *ret_rows = rn_buf_take(&rows, &size);
    *ret_count = count;
    return RN_OK;
}

enum rn_status rn_store_find(struct rn_store *store, const struct rn_store_table *table,
                             const char *column, const char *text, void *row,
                             struct rn_error *err) {
    void *rows;
    size_t count;
    struct rn_query query = {.equal = {{column, text}}, .limit = 1};
    enum rn_status status = rn_store_list(store, table, &query, &rows, &count, err);
    if (status != RN_OK) return status;
    if (count == 0) {
        free(rows);
        return rn_error_set(err, RN_ERROR_NOT_FOUND, "", "no %s '%.64s' in %s", column, text,
                            table->name);
    }
    memcpy(row, rows, table->row_size);
    free(rows);
    return RN_OK;
}

static bool has_names(const struct rn_store_table *table) {
    for (int i = 0; i < table->column_count; i++)
        if (strcmp(table->columns[i].name, "name") == 0) return true;
    return false;
}

// What else has this name: a dataset may be taken for its scene. NULL: nothing.
static const char *other_of_name(struct rn_store *store, const struct rn_store_table *table,
                                 const char *name) {
    const struct rn_store_table *const others[] = {&rn_datasets, &rn_scenes, &rn_camera_paths};
    union {
        struct rn_dataset_row dataset;
        struct rn_scene_row scene;
        struct rn_camera_path_row path;
    } row;
    for (size_t i = 0; i < sizeof others / sizeof *others; i++) {
        if (others[i] == table ||
            rn_store_find(store, others[i], "name", name, &row, NULL) != RN_OK)
            continue;
        rn_row_finish(others[i], &row);
        return others[i]->title;
    }
    return NULL;
}

enum rn_status rn_store_resolve(struct rn_store *store, const struct rn_store_table *table,
                                const char *prefix, const char *reference, void *row,
                                struct rn_error *err) {
    bool is_id = strncmp(reference, prefix, strlen(prefix)) == 0 || !has_names(table);
    enum rn_status status = rn_store_find(store, table, is_id ? "id" : "name", reference, row, err);
    if (status != RN_ERROR_NOT_FOUND || err == NULL) return status;
    const char *other = is_id ? NULL : other_of_name(store, table, reference);
    return rn_error_set(err, status, "", "there is no %s '%.64s'%s%s%s", table->title, reference,
                        other != NULL ? ", but a " : "", other != NULL ? other : "",
                        other != NULL ? " of that name" : "");
}

size_t rn_store_row_size(const struct rn_store_table *table) {
    return table->row_size;
}

enum rn_status rn_store_owned_bytes(struct rn_store *store, const char *owner, int64_t *ret_bytes,
                                    struct rn_error *err) {
    static const char sql[] =
        "SELECT (SELECT ifnull(sum(json_extract(d.record, '$.size_bytes')), 0) FROM datasets d"
        " WHERE d.id IN (SELECT dataset FROM jobs WHERE owner = ?1 AND type = 'ingest'))"
        " + (SELECT ifnull(sum(c.size_bytes), 0) FROM checkpoints c WHERE c.scene IN"
        " (SELECT scene FROM jobs WHERE owner = ?1 AND type IN ('train', 'ingest')))"
        " + (SELECT ifnull(sum(size_bytes), 0) FROM jobs WHERE owner = ?1)";
    struct rn_buf text;
    sqlite3_stmt *statement;
    rn_buf_init(&text, sizeof sql);
    rn_buf_printf(&text, "%s", sql);
    enum rn_status status = prepare(store, &text, &statement, err);
    rn_buf_finish(&text);
    if (status != RN_OK) return status;
    sqlite3_bind_text(statement, 1, owner, -1, SQLITE_STATIC);
    int code = sqlite3_step(statement);
    if (code == SQLITE_ROW)
        *ret_bytes = sqlite3_column_int64(statement, 0);
    else
        status = rn_sqlite_error(store->db, code, "adding up a token's bytes", err);
    finish(store, statement);
    return status;
}

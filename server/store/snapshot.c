// A copy of all that is stored, as of one moment, while the daemon goes on: the records copied by
// SQLite, their content as hard links, for what is named is never written again.
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/file.h"
#include "server/store/table.h"

#define MAX_DEPTH 16

// Of the records, by a connection of its own: nobody waits for it.
static enum rn_status copy_records(struct rn_store *store, const char *target,
                                   struct rn_error *err) {
    char *path = rn_store_path(store, "ripnerf.db");
    sqlite3 *db = NULL;
    sqlite3_stmt *statement = NULL;
    if (path == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "ripnerf.db", "no memory");
    int code = sqlite3_open_v2(path, &db, SQLITE_OPEN_READONLY, NULL);
    free(path);
    if (code == SQLITE_OK) code = sqlite3_prepare_v2(db, "VACUUM INTO ?1", -1, &statement, NULL);
    if (code == SQLITE_OK) code = sqlite3_bind_text(statement, 1, target, -1, SQLITE_STATIC);
    if (code == SQLITE_OK) code = sqlite3_step(statement);
    enum rn_status status =
        code == SQLITE_DONE ? RN_OK : rn_sqlite_error(db, code, "copying the records", err);
    sqlite3_finalize(statement);
    sqlite3_close(db);
    return status;
}

// What is being written has no name of its own yet.
static bool is_kept(const char *name) {
    size_t size = strlen(name);
    return name[0] != '.' && strcmp(name, "lock") != 0 &&
           (size < 4 || strcmp(name + size - 4, ".tmp") != 0);
}

static enum rn_status link_tree(int from, int to, int depth, struct rn_error *err);

static enum rn_status link_entry(int from, int to, const char *name, int depth,
                                 struct rn_error *err) {
    struct stat about;
    if (fstatat(from, name, &about, AT_SYMLINK_NOFOLLOW) != 0)
        return errno == ENOENT ? RN_OK : rn_error_from_errno(err, errno, name, "look at it");
    if (S_ISREG(about.st_mode)) {
        if (linkat(from, name, to, name, 0) == 0 || errno == ENOENT) return RN_OK;
        return rn_error_from_errno(err, errno, name, "link it");
    }
    if (!S_ISDIR(about.st_mode)) return RN_OK;
    if (depth == MAX_DEPTH)
        return rn_error_set(err, RN_ERROR_LIMIT, name, "folders are nested too deep");
    if (mkdirat(to, name, 0700) != 0) return rn_error_from_errno(err, errno, name, "create it");
    int inner = openat(from, name, O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC);
    if (inner < 0 && errno == ENOENT) return RN_OK; // deleted meanwhile
    int copy = inner < 0 ? -1 : openat(to, name, O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC);
    enum rn_status status = copy < 0 ? rn_error_from_errno(err, errno, name, "open it") : RN_OK;
    if (status == RN_OK) status = link_tree(inner, copy, depth + 1, err);
    if (inner >= 0) close(inner);
    if (copy >= 0) close(copy);
    return status;
}

static enum rn_status link_tree(int from, int to, int depth, struct rn_error *err) {
    enum rn_status status = RN_OK;
    struct dirent *entry;
    int listed = openat(from, ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    DIR *folder = listed >= 0 ? fdopendir(listed) : NULL;
    if (folder == NULL) {
        status = rn_error_from_errno(err, errno, "a folder of content", "list it");
        if (listed >= 0) close(listed);
        return status;
    }
    while (status == RN_OK && (errno = 0, entry = readdir(folder)) != NULL)
        if (is_kept(entry->d_name)) status = link_entry(from, to, entry->d_name, depth, err);
    if (status == RN_OK && errno != 0)
        status = rn_error_from_errno(err, errno, "a folder of content", "list it");
    closedir(folder);
    return status;
}

static enum rn_status link_layout(struct rn_store *store, const char *target,
                                  struct rn_error *err) {
    char copy[4300];
    char *layout = rn_store_path(store, "layout");
    if (layout == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "layout", "no memory");
    snprintf(copy, sizeof copy, "%s/layout", target);
    enum rn_status status =
        link(layout, copy) == 0 ? RN_OK : rn_error_from_errno(err, errno, "layout", "link it");
    free(layout);
    return status;
}

// Of one scene: what it was made of and by, and nothing that tells of others.
static enum rn_status keep_scene(sqlite3 *db, const char *scene, struct rn_error *err) {
    static const char *const statements[] = {
        "DELETE FROM scenes WHERE id != ?1",
        "DELETE FROM datasets WHERE id NOT IN (SELECT dataset FROM scenes)",
        "DELETE FROM jobs WHERE scene != ?1 AND"
        " (type != 'ingest' OR dataset NOT IN (SELECT id FROM datasets))",
        "UPDATE jobs SET owner = '', traceparent = ''",
        "DELETE FROM checkpoints WHERE scene != ?1",
        "DELETE FROM metrics WHERE job NOT IN (SELECT id FROM jobs)",
        "DELETE FROM camera_paths",
        "DELETE FROM tokens",
        "DELETE FROM keys",
        "DELETE FROM removed",
        "VACUUM", // what was deleted is in the file until then
    };
    int code = SQLITE_DONE;
    for (size_t i = 0; code == SQLITE_DONE && i < sizeof statements / sizeof statements[0]; i++) {
        sqlite3_stmt *statement = NULL;
        code = sqlite3_prepare_v2(db, statements[i], -1, &statement, NULL);
        if (code == SQLITE_OK && sqlite3_bind_parameter_count(statement) > 0)
            code = sqlite3_bind_text(statement, 1, scene, -1, SQLITE_STATIC);
        if (code == SQLITE_OK) code = sqlite3_step(statement);
        sqlite3_finalize(statement);
    }
    return code == SQLITE_DONE ? RN_OK : rn_sqlite_error(db, code, "copying the records", err);
}

static enum rn_status link_one(const char *from, const char *to, const char *table, const char *id,
                               struct rn_error *err) {
    char source[4300], target[4300];
    snprintf(source, sizeof source, "%s/%s", from, table);
    snprintf(target, sizeof target, "%s/%s", to, table);
    enum rn_status status = rn_mkdirs(target, 0700, err);
    if (status != RN_OK) return status;
    int inner = open(source, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    int copy = open(target, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (inner < 0 || copy < 0) status = rn_error_from_errno(err, errno, target, "open it");
    if (status == RN_OK) status = link_entry(inner, copy, id, 1, err);
    if (inner >= 0) close(inner);
    if (copy >= 0) close(copy);
    return status;
}

// The content of the records that are left in the copy, and no other: an import that failed may
// have left a part of a dataset, with which nothing could be restored.
static enum rn_status link_recorded(struct rn_store *store, sqlite3 *db, const char *target,
                                    struct rn_error *err) {
    sqlite3_stmt *statement = NULL;
    enum rn_status status = RN_OK;
    int code = sqlite3_prepare_v2(db,
                                  "SELECT 'datasets', id FROM datasets UNION ALL "
                                  "SELECT 'scenes', id FROM scenes UNION ALL "
                                  "SELECT 'camera-paths', id FROM camera_paths UNION ALL "
                                  "SELECT 'jobs', id FROM jobs",
                                  -1, &statement, NULL);
    while (code == SQLITE_OK && status == RN_OK && (code = sqlite3_step(statement)) == SQLITE_ROW) {
        const char *table = (const char *)sqlite3_column_text(statement, 0);
        const char *id = (const char *)sqlite3_column_text(statement, 1);
        code = table != NULL && id != NULL ? SQLITE_OK : SQLITE_NOMEM;
        if (code == SQLITE_OK) status = link_one(store->folder, target, table, id, err);
    }
    if (code != SQLITE_DONE && status == RN_OK)
        status = rn_sqlite_error(db, code, "copying the records", err);
    sqlite3_finalize(statement);
    return status;
}

// What was deleted between the copy of its record and the link to its content is in neither.
static enum rn_status drop_lost(sqlite3 *db, const char *target, const char *table,
                                struct rn_error *err) {
    char sql[128], folder[4300];
    sqlite3_stmt *statement = NULL;
    snprintf(sql, sizeof sql, "SELECT id FROM %s", table);
    int code = sqlite3_prepare_v2(db, sql, -1, &statement, NULL);
    enum rn_status status = RN_OK;
    while (code == SQLITE_OK && status == RN_OK && (code = sqlite3_step(statement)) == SQLITE_ROW) {
        const char *id = (const char *)sqlite3_column_text(statement, 0);
        snprintf(folder, sizeof folder, "%s/%s/%s", target, table, id != NULL ? id : "");
        snprintf(sql, sizeof sql, "DELETE FROM %s WHERE id = '%.32s'", table, id != NULL ? id : "");
        code = id != NULL ? SQLITE_OK : SQLITE_NOMEM;
        if (code != SQLITE_OK || access(folder, F_OK) == 0) continue;
        if (errno == ENOENT)
            code = sqlite3_exec(db, sql, NULL, NULL, NULL);
        else
            status = rn_error_from_errno(err, errno, folder, "look for it");
    }
    if (code != SQLITE_DONE && status == RN_OK)
        status = rn_sqlite_error(db, code, "copying the records", err);
    sqlite3_finalize(statement);
    return status;
}

enum rn_status rn_store_snapshot(struct rn_store *store, const char *scene, const char *target,
                                 struct rn_error *err) {
    char records[4300];
    sqlite3 *db = NULL;
    snprintf(records, sizeof records, "%s/ripnerf.db", target);
    enum rn_status status = rn_mkdirs(target, 0700, err);
    if (status == RN_OK) status = copy_records(store, records, err);
    if (status == RN_OK) status = link_layout(store, target, err);
    if (status == RN_OK) {
        int code = sqlite3_open_v2(records, &db, SQLITE_OPEN_READWRITE, NULL);
        if (code != SQLITE_OK) status = rn_sqlite_error(db, code, "copying the records", err);
    }
    if (status == RN_OK && scene != NULL) status = keep_scene(db, scene, err);
    if (status == RN_OK) status = link_recorded(store, db, target, err);
    if (status == RN_OK) status = drop_lost(db, target, "datasets", err);
    if (status == RN_OK) status = drop_lost(db, target, "scenes", err);
    sqlite3_close(db);
    return status;
}

#include "server/store/store.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/file.h"
#include "common/base/log.h"
#include "server/store/table.h"

#define LAYOUT "1\n"

enum rn_status rn_sqlite_error(sqlite3 *db, int code, const char *what, struct rn_error *err) {
    int errnum = sqlite3_system_errno(db);
    enum rn_status status = RN_ERROR_IO;
    switch (code & 0xff) {
    case SQLITE_FULL:
        status = RN_ERROR_NO_SPACE;
        break;
    case SQLITE_CONSTRAINT:
        status = RN_ERROR_CONFLICT;
        break;
    case SQLITE_NOMEM:
        status = RN_ERROR_NO_MEMORY;
        break;
    case SQLITE_CORRUPT:
    case SQLITE_NOTADB:
        status = RN_ERROR_CORRUPT;
        break;
    case SQLITE_IOERR:
    case SQLITE_CANTOPEN:
        if (errnum == ENOSPC || errnum == EDQUOT) status = RN_ERROR_NO_SPACE;
        break;
    default:
        break;
    }
    if (status == RN_ERROR_NO_SPACE)
        return rn_error_set(err, status, "ripnerf.db", "the disk is full (%s); make room", what);
    if (status == RN_ERROR_CORRUPT)
        return rn_error_set(err, status, "ripnerf.db",
                            "the records are damaged; put a good copy back, or start once with "
                            "--rebuild, which makes them anew from what lies on disk");
    return rn_error_set(err, status, "ripnerf.db", "%s: %s", what, sqlite3_errmsg(db));
}

static enum rn_status take_lock(struct rn_store *store, struct rn_error *err) {
    char *path = rn_store_path(store, "lock");
    if (path == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "lock", "no memory");
    enum rn_status status = RN_OK;
    store->lock_fd = open(path, O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    if (store->lock_fd < 0)
        status = rn_error_from_errno(err, errno, path, "open");
    else if (flock(store->lock_fd, LOCK_EX | LOCK_NB) != 0)
        status = errno != EWOULDBLOCK
                     ? rn_error_from_errno(err, errno, path, "lock")
                     : rn_error_set(err, RN_ERROR_CONFLICT, store->folder,
                                    "another ripnerfd uses this folder; stop it or use another "
                                    "--data");
    free(path);
    return status;
}

static enum rn_status check_layout(struct rn_store *store, struct rn_error *err) {
    char *path = rn_store_path(store, "layout");
    if (path == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "layout", "no memory");
    uint8_t *bytes = NULL;
    size_t size;
    enum rn_status status = rn_file_read(path, 64, &bytes, &size, err);
    if (status == RN_ERROR_NOT_FOUND)
        status = rn_file_write_atomic(path, LAYOUT, sizeof LAYOUT - 1, err);
    else if (status == RN_OK && strcmp((char *)bytes, LAYOUT) != 0)
        status = rn_error_set(err, RN_ERROR_UNSUPPORTED, path,
                              "the folder's layout is '%.20s', this ripnerfd knows '1'; use the "
                              "one that wrote it, or another --data folder",
                              (char *)bytes);
    free(bytes);
    free(path);
    return status;
}

static enum rn_status make_folders(struct rn_store *store, struct rn_error *err) {
    static const char *const names[] = {"",      "/datasets", "/scenes", "/camera-paths",
                                        "/jobs", "/spool"};
    for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) {
        char path[4200];
        snprintf(path, sizeof path, "%s%s", store->folder, names[i]);
        enum rn_status status = rn_mkdirs(path, 0700, err);
        if (status != RN_OK) return status;
    }
    return RN_OK;
}

// Every page, every index: a file that lost some of its bytes may look well at first.
static enum rn_status check_pages(struct rn_store *store, struct rn_error *err) {
    sqlite3_stmt *statement = NULL;
    int code = sqlite3_prepare_v2(store->db, "PRAGMA integrity_check(1)", -1, &statement, NULL);
    if (code == SQLITE_OK) code = sqlite3_step(statement);
    const char *text = code == SQLITE_ROW ? (const char *)sqlite3_column_text(statement, 0) : NULL;
    bool good = text != NULL && strcmp(text, "ok") == 0;
    if (text != NULL && !good) {
        rn_log(RN_LOG_ERROR, "ripnerf.db: %s", text);
        code = SQLITE_CORRUPT;
    }
    sqlite3_finalize(statement);
    return good ? RN_OK : rn_sqlite_error(store->db, code, "checking the records", err);
}

static enum rn_status open_database(struct rn_store *store, struct rn_error *err) {
    char *path = rn_store_path(store, "ripnerf.db");
    if (path == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "ripnerf.db", "no memory");
    int code = sqlite3_open_v2(
        path, &store->db, SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE | SQLITE_OPEN_FULLMUTEX, NULL);
    free(path);
    if (store->db == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "ripnerf.db", "no memory");
    sqlite3_extended_result_codes(store->db, 1);
    sqlite3_busy_timeout(store->db, 2000);
    if (code == SQLITE_OK)
        code = sqlite3_exec(store->db,
                            "PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL;"
                            "PRAGMA foreign_keys = ON; PRAGMA journal_size_limit = 4194304;",
                            NULL, NULL, NULL);
    if (code != SQLITE_OK) return rn_sqlite_error(store->db, code, "opening", err);
    enum rn_status status = check_pages(store, err);
    if (status != RN_OK) return status;
    return rn_store_migrate(store->db, rn_store_scripts, rn_store_script_count, err);
}

// Content without a single record: the database was lost, not made.
static enum rn_status check_content(struct rn_store *store, struct rn_error *err) {
    bool empty, has_content;
    enum rn_status status = rn_store_is_empty(store, &empty, err);
    if (status == RN_OK) status = rn_store_has_content(store, &has_content, err);
    if (status != RN_OK || !empty || !has_content) return status;
    return rn_error_set(err, RN_ERROR_CORRUPT, "ripnerf.db",
                        "the records are missing, but their content is there; put a copy of "
                        "ripnerf.db back, or start once with --rebuild, which makes them anew from "
                        "what lies on disk");
}

static enum rn_status open_records(struct rn_store *store, bool rebuild, struct rn_error *err) {
    enum rn_status status = open_database(store, err);
    if (rebuild && status == RN_ERROR_CORRUPT) {
        status = rn_store_set_aside(store, err);
        if (status == RN_OK) status = open_database(store, err);
    }
    if (status != RN_OK) return status;
    return rebuild ? rn_store_rebuild(store, err) : check_content(store, err);
}

enum rn_status rn_store_open(const char *folder, bool rebuild, struct rn_store **ret_store,
                             struct rn_error *err) {
    if (strlen(folder) > 4000)
        return rn_error_set(err, RN_ERROR_LIMIT, "data", "the folder's path is too long");
    struct rn_store *store = calloc(1, sizeof *store);
    if (store == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "store", "no memory");
    store->lock_fd = -1;
    pthread_mutexattr_t recursive;
    pthread_mutexattr_init(&recursive);
    pthread_mutexattr_settype(&recursive, PTHREAD_MUTEX_RECURSIVE);
    pthread_mutex_init(&store->lock, &recursive);
    pthread_mutexattr_destroy(&recursive);
    store->folder = strdup(folder);
    enum rn_status status = store->folder == NULL
                                ? rn_error_set(err, RN_ERROR_NO_MEMORY, "store", "no memory")
                                : make_folders(store, err);
    if (status == RN_OK) status = take_lock(store, err);
    if (status == RN_OK) status = check_layout(store, err);
    if (status == RN_OK) status = open_records(store, rebuild, err);
    if (status == RN_OK)
        *ret_store = store;
    else
        rn_store_close(&store);
    return status;
}

void rn_store_close(struct rn_store **store_pointer) {
    struct rn_store *store = *store_pointer;
    *store_pointer = NULL;
    if (store == NULL) return;
    sqlite3_close(store->db);
    if (store->lock_fd >= 0) close(store->lock_fd);
    pthread_mutex_destroy(&store->lock);
    free(store->folder);
    free(store);
}

const char *rn_store_folder(const struct rn_store *store) {
    return store->folder;
}

char *rn_store_path(const struct rn_store *store, const char *fmt, ...) {
    char *rest = NULL, *path = NULL;
    va_list args;
    va_start(args, fmt);
    if (vasprintf(&rest, fmt, args) < 0) rest = NULL;
    va_end(args);
    if (rest != NULL && asprintf(&path, "%s/%s", store->folder, rest) < 0) path = NULL;
    free(rest);
    return path;
}

enum rn_status rn_store_check_folder(struct rn_store *store, struct rn_error *err) {
    struct stat held, there;
    char path[PATH_MAX];
    if (fstat(store->lock_fd, &held) != 0)
        return rn_error_from_errno(err, errno, store->folder, "look at it");
    snprintf(path, sizeof path, "%s/lock", store->folder);
    if (stat(path, &there) == 0 ? there.st_ino == held.st_ino && there.st_dev == held.st_dev
                                : held.st_nlink > 0 && errno != ENOENT && errno != ENOTDIR)
        return RN_OK;
    return rn_error_set(err, RN_ERROR_IO, store->folder,
                        "the data folder was moved or removed under the daemon: nothing is kept "
                        "any more; put it back, or stop the daemon");
}

static enum rn_status run(struct rn_store *store, const char *sql, struct rn_error *err) {
    int code = sqlite3_exec(store->db, sql, NULL, NULL, NULL);
    return code == SQLITE_OK ? RN_OK : rn_sqlite_error(store->db, code, sql, err);
}

enum rn_status rn_store_begin(struct rn_store *store, struct rn_error *err) {
    pthread_mutex_lock(&store->lock);
    enum rn_status status = rn_store_check_folder(store, err);
    if (status == RN_OK) status = run(store, "BEGIN IMMEDIATE", err);
    if (status != RN_OK) pthread_mutex_unlock(&store->lock);
    return status;
}

enum rn_status rn_store_commit(struct rn_store *store, struct rn_error *err) {
    enum rn_status status = run(store, "COMMIT", err);
    if (status != RN_OK && !sqlite3_get_autocommit(store->db)) (void)run(store, "ROLLBACK", NULL);
    if (status == RN_OK)
        rn_records_write_changed(store);
    else
        store->changed_count = 0;
    pthread_mutex_unlock(&store->lock);
    return status;
}

void rn_store_rollback(struct rn_store *store) {
    store->changed_count = 0;
    if (!sqlite3_get_autocommit(store->db)) (void)run(store, "ROLLBACK", NULL);
    pthread_mutex_unlock(&store->lock);
}

enum rn_status rn_store_new_id(const char *prefix, char ret_id[RN_ID_MAX], struct rn_error *err) {
    static const char digits[] = "abcdefghijklmnopqrstuvwxyz234567";
    uint8_t random[RN_ID_RANDOM];
    if (getrandom(random, sizeof random, 0) != (ssize_t)sizeof random)
        return rn_error_from_errno(err, errno, "getrandom", "make an id");
    size_t size = (size_t)snprintf(ret_id, RN_ID_MAX, "%s", prefix);
    for (int i = 0; i < RN_ID_RANDOM; i++)
        ret_id[size++] = digits[random[i] & 31];
    ret_id[size] = '\0';
    return RN_OK;
}

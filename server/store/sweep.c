// What of the content goes. Only what is known to be unwanted: a database that lost rows must not
// cost their content.
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/log.h"
#include "server/store/table.h"

#define KEY_AGE_MS (7 * 86400000ll) // how long an Idempotency-Key is remembered
#define UPLOAD_AGE_MS 86400000ll    // how long an upload waits for its next part

#define REMOVED "SELECT 1 FROM removed WHERE id = ?1"

enum fate { STAYS, GOES, ORPHAN };

struct sweep {
    struct rn_store *store;
    struct rn_error *err;
    enum rn_status status; // once it is not RN_OK, what is there is not known and nothing goes
    int orphans;
};

// Whether `sql`, with the text bound, has a row.
static bool is_there(struct sweep *sweep, const char *sql, const char *text) {
    sqlite3 *db = sweep->store->db;
    sqlite3_stmt *statement = NULL;
    if (sweep->status != RN_OK) return true;
    pthread_mutex_lock(&sweep->store->lock);
    int code = sqlite3_prepare_v2(db, sql, -1, &statement, NULL);
    if (code == SQLITE_OK) code = sqlite3_bind_text(statement, 1, text, -1, SQLITE_STATIC);
    if (code == SQLITE_OK) code = sqlite3_step(statement);
    if (code != SQLITE_ROW && code != SQLITE_DONE)
        sweep->status = rn_sqlite_error(db, code, "sweeping", sweep->err);
    sqlite3_finalize(statement);
    pthread_mutex_unlock(&sweep->store->lock);
    return code != SQLITE_DONE;
}

enum rn_status rn_store_was_removed(struct rn_store *store, const char *id, bool *ret_removed,
                                    struct rn_error *err) {
    struct sweep sweep = {.store = store, .err = err, .status = RN_OK};
    bool removed = is_there(&sweep, REMOVED, id);
    if (sweep.status == RN_OK) *ret_removed = removed;
    return sweep.status;
}

static enum fate fate_of_content(struct sweep *sweep, const struct rn_store_table *table,
                                 const char *name) {
    char sql[128];
    snprintf(sql, sizeof sql, "SELECT 1 FROM %s WHERE id = ?1", table->name);
    if (is_there(sweep, sql, name)) return STAYS;
    if (is_there(sweep, REMOVED, name)) return GOES;
    if (table != &rn_datasets && table != &rn_scenes) return ORPHAN;
    const char *column = table == &rn_datasets ? "dataset" : "scene";
    snprintf(sql, sizeof sql, "SELECT 1 FROM jobs WHERE %s = ?1 AND finished_ms = 0%s", column,
             table == &rn_scenes ? " AND type = 'ingest'" : "");
    if (is_there(sweep, sql, name)) return STAYS;
    snprintf(sql, sizeof sql,
             "SELECT 1 FROM jobs WHERE %s = ?1 AND type = 'ingest' AND state IN"
             " ('failed', 'cancelled')",
             column);
    return is_there(sweep, sql, name) ? GOES : ORPHAN;
}

bool rn_store_upload_is_over(const struct stat *about) {
    struct timespec up = {0};
    int64_t age_ms = rn_clock_since_ms(1000ll * about->st_mtime);
    // What the machine had not flushed when it ended may be missing in the midst.
    bool before_start = clock_gettime(CLOCK_BOOTTIME, &up) == 0 && age_ms > 1000ll * up.tv_sec;
    return before_start || age_ms > UPLOAD_AGE_MS;
}

// Whether an upload in parts may still be gone on with.
static enum fate fate_of_parts(struct sweep *sweep, const char *name) {
    struct stat about;
    char *path = rn_store_path(sweep->store, "spool/%s", name);
    bool known = path != NULL && stat(path, &about) == 0;
    if (!known)
        sweep->status = rn_error_from_errno(sweep->err, path ? errno : ENOMEM, name, "sweep");
    free(path);
    return known && rn_store_upload_is_over(&about) ? GOES : STAYS;
}

// Uploads: up_* comes in parts, <job>.tar is what a client sent, <job>.work what is made of it,
// upload-* was never answered.
static enum fate fate_of_upload(struct sweep *sweep, const char *name) {
    char id[RN_ID_MAX];
    if (strncmp(name, RN_ID_UPLOAD, strlen(RN_ID_UPLOAD)) == 0) return fate_of_parts(sweep, name);
    snprintf(id, sizeof id, "%.*s", (int)strcspn(name, "."), name);
    if (strncmp(name, RN_ID_JOB, strlen(RN_ID_JOB)) != 0) return GOES;
    if (!is_there(sweep, "SELECT 1 FROM jobs WHERE id = ?1", id))
        return strstr(name, ".work") != NULL ? GOES : ORPHAN;
    bool open = is_there(sweep, "SELECT 1 FROM jobs WHERE id = ?1 AND finished_ms = 0", id);
    return open ? STAYS : GOES;
}

// A folder that a request was about to fill when the daemon ended holds nothing but folders.
static bool remove_empty(const char *path) {
    char frames[4200];
    snprintf(frames, sizeof frames, "%s/frames", path);
    (void)rmdir(frames);
    return rmdir(path) == 0;
}

static void sweep_entry(struct sweep *sweep, const char *folder, const char *name, enum fate fate) {
    if (fate == STAYS) return;
    char *path = rn_store_path(sweep->store, "%s/%s", folder, name);
    if (path == NULL) {
        sweep->status = rn_error_set(sweep->err, RN_ERROR_NO_MEMORY, folder, "no memory");
    } else if (fate == GOES) {
        rn_log(RN_LOG_INFO, "removing %s/%s: it was deleted or never finished", folder, name);
        sweep->status = rn_remove_tree(path, sweep->err);
    } else if (!remove_empty(path)) {
        rn_log(RN_LOG_WARN, "%s/%s has no record; it is left as it is", folder, name);
        sweep->orphans++;
    }
    free(path);
}

// What a runner was writing when it was killed; removes it where it is to go. Whether there was
// any.
static bool find_rests(const char *path, bool go) {
    bool found = false;
    struct dirent *entry;
    DIR *folder = opendir(path);
    if (folder == NULL) return false;
    while ((go || !found) && (entry = readdir(folder)) != NULL) {
        if (*entry->d_name != '.' || strstr(entry->d_name, ".tmp") == NULL) continue;
        if (go && unlinkat(dirfd(folder), entry->d_name, 0) != 0)
            rn_log(RN_LOG_WARN, "%s/%s cannot be removed: %s", path, entry->d_name,
                   strerror(errno));
        found = true;
    }
    closedir(folder);
    return found;
}

// A runner that outlived its daemon may be writing: while it holds the scene nothing of it goes.
static void clear_scene(struct sweep *sweep, const char *id) {
    static const char *const folders[] = {"", "/checkpoints", "/marks"};
    char *lock = rn_store_path(sweep->store, "scenes/%s/lock", id);
    bool cleared = false;
    for (size_t i = 0; lock != NULL && i < sizeof folders / sizeof folders[0]; i++) {
        char *path = rn_store_path(sweep->store, "scenes/%s%s", id, folders[i]);
        if (path != NULL && find_rests(path, false)) {
            int fd = open(lock, O_RDWR | O_CLOEXEC);
            if (fd < 0 ? errno == ENOENT : flock(fd, LOCK_EX | LOCK_NB) == 0)
                cleared |= find_rests(path, true);
            if (fd >= 0) close(fd);
        }
        free(path);
    }
    if (cleared)
        rn_log(RN_LOG_INFO, "removing what a killed runner left half written of scenes/%s", id);
    free(lock);
}

static void sweep_folder(struct sweep *sweep, const char *name,
                         const struct rn_store_table *table) {
    char *folder = rn_store_path(sweep->store, "%s", name);
    DIR *dir = folder != NULL ? opendir(folder) : NULL;
    struct dirent *entry = NULL;
    int errnum = folder == NULL ? ENOMEM : dir == NULL ? errno : 0;
    while (dir != NULL && sweep->status == RN_OK && (errno = 0, entry = readdir(dir)) != NULL) {
        if (entry->d_name[0] == '.') continue;
        enum fate fate = table != NULL ? fate_of_content(sweep, table, entry->d_name)
                                       : fate_of_upload(sweep, entry->d_name);
        if (sweep->status == RN_OK) sweep_entry(sweep, name, entry->d_name, fate);
        if (fate == STAYS && table == &rn_scenes) clear_scene(sweep, entry->d_name);
    }
    if (dir != NULL && sweep->status == RN_OK) errnum = errno;
    if (errnum != 0) sweep->status = rn_error_from_errno(sweep->err, errnum, name, "sweep");
    if (dir != NULL) closedir(dir);
    free(folder);
}

// What was removed stays so, whatever happens to the disk, before it is forgotten that it was to
// be.
static enum rn_status flush(struct rn_store *store, struct rn_error *err) {
    enum rn_status status = RN_OK;
    for (int i = 0; status == RN_OK && rn_content_tables[i] != NULL; i++) {
        char *folder = rn_store_path(store, "%s", rn_content_tables[i]->folder);
        status = folder != NULL ? rn_folder_flush(folder, err)
                                : rn_error_set(err, RN_ERROR_NO_MEMORY, "sweep", "no memory");
        free(folder);
    }
    return status;
}

static enum rn_status forget(struct rn_store *store, struct rn_error *err) {
    char sql[160];
    snprintf(sql, sizeof sql, "DELETE FROM keys WHERE created_ms < %lld; DELETE FROM removed",
             (long long)(rn_clock_wall_ms() - KEY_AGE_MS));
    pthread_mutex_lock(&store->lock);
    int code = sqlite3_exec(store->db, sql, NULL, NULL, NULL);
    enum rn_status status =
        code == SQLITE_OK ? RN_OK : rn_sqlite_error(store->db, code, "sweeping", err);
    pthread_mutex_unlock(&store->lock);
    return status;
}

enum rn_status rn_store_sweep(struct rn_store *store, struct rn_error *err) {
    struct sweep sweep = {.store = store, .err = err, .status = RN_OK};
    for (int i = 0; sweep.status == RN_OK && rn_content_tables[i] != NULL; i++)
        sweep_folder(&sweep, rn_content_tables[i]->folder, rn_content_tables[i]);
    if (sweep.status == RN_OK) sweep_folder(&sweep, "spool", NULL);
    if (sweep.status == RN_OK) sweep.status = flush(store, err);
    if (sweep.status == RN_OK) sweep.status = forget(store, err);
    if (sweep.orphans > 0)
        rn_log(RN_LOG_WARN,
               "%d folders or files of content have no record: records are lost; start once with "
               "--rebuild to make them anew, or remove what is not wanted by hand",
               sweep.orphans);
    return sweep.status == RN_OK ? rn_records_write_all(store, err) : sweep.status;
}

// A backup joins what is stored, while the daemon goes on: its content by renaming, its records
// from the copies beside the content.
#include <dirent.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/base/file.h"
#include "common/base/seal.h"
#include "server/store/scrub.h"
#include "server/store/table.h"

// Datasets first: a scene that is there has what it was made of.
static const struct rn_store_table *const tables[] = {&rn_datasets, &rn_jobs_table, &rn_scenes,
                                                      &rn_camera_paths};
#define TABLES (sizeof tables / sizeof tables[0])

struct entries {
    struct dirent **items[TABLES];
    int counts[TABLES];
};

static enum rn_status list(const char *backup, struct entries *entries, struct rn_error *err) {
    char path[4400];
    for (size_t t = 0; t < TABLES; t++) {
        snprintf(path, sizeof path, "%s/%s", backup, tables[t]->folder);
        int count = scandir(path, &entries->items[t], NULL, alphasort), kept = 0;
        if (count < 0 && errno != ENOENT) return rn_error_from_errno(err, errno, path, "list it");
        for (int i = 0; i < count; i++) {
            struct dirent *item = entries->items[t][i];
            if (rn_path_is_safe_name(item->d_name))
                entries->items[t][kept++] = item;
            else
                free(item); // "." and ".."
        }
        entries->counts[t] = kept;
    }
    return RN_OK;
}

static void finish(struct entries *entries) {
    for (size_t t = 0; t < TABLES; t++) {
        for (int i = 0; i < entries->counts[t]; i++)
            free(entries->items[t][i]);
        free(entries->items[t]);
    }
}

// What is there under its id already is the same, and stays; but not the rest of what was deleted.
static enum rn_status make_room(struct rn_store *store, const struct rn_store_table *table,
                                const char *id, const char *to, struct rn_error *err) {
    char copy[4700], sha256[65];
    bool known = false, removed = false;
    if (access(to, F_OK) != 0) return RN_OK;
    enum rn_status status = rn_record_is_there(store, table, id, &known, err);
    if (status != RN_OK || known) return status;
    status = rn_store_was_removed(store, id, &removed, err);
    if (status == RN_OK && removed) return rn_remove_tree(to, err);
    snprintf(copy, sizeof copy, "%s/record.json", to);
    if (status == RN_OK) status = rn_seal_check(copy, sha256, err);
    if (status != RN_ERROR_CORRUPT && status != RN_ERROR_NOT_FOUND) return status;
    return rn_error_set(err, RN_ERROR_CONFLICT, "backup",
                        "%s/%s is in the data folder, and no record can be made of it; move it "
                        "away and send the backup once more",
                        table->folder, id);
}

static enum rn_status move(struct rn_store *store, const char *backup,
                           const struct rn_store_table *table, struct dirent *const *items,
                           int count, struct rn_error *err) {
    enum rn_status status = RN_OK;
    const char *folder = table->folder;
    char from[4700];
    for (int i = 0; status == RN_OK && i < count; i++) {
        char *to = rn_store_path(store, "%s/%s", folder, items[i]->d_name);
        snprintf(from, sizeof from, "%s/%s/%s", backup, folder, items[i]->d_name);
        if (to == NULL)
            status = rn_error_set(err, RN_ERROR_NO_MEMORY, folder, "no memory");
        else
            status = make_room(store, table, items[i]->d_name, to, err);
        if (status == RN_OK && access(to, F_OK) != 0 && rename(from, to) != 0)
            status = rn_error_from_errno(err, errno, to, "move it");
        free(to);
    }
    char *flushed = rn_store_path(store, "%s", folder);
    if (status == RN_OK && flushed == NULL)
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, folder, "no memory");
    if (status == RN_OK) status = rn_folder_flush(flushed, err);
    free(flushed);
    return status;
}

static enum rn_status add(struct rn_store *store, const struct entries *entries,
                          int64_t counts[TABLES], struct rn_error *err) {
    enum rn_status status = rn_store_begin(store, err);
    if (status != RN_OK) return status;
    for (size_t t = 0; t < TABLES; t++)
        for (int i = 0; status == RN_OK && i < entries->counts[t]; i++) {
            bool made = false;
            status = rn_records_add(store, tables[t], entries->items[t][i]->d_name, &made, err);
            counts[t] += made;
        }
    if (status == RN_OK) return rn_store_commit(store, err);
    rn_store_rollback(store);
    return status;
}

enum rn_status rn_store_adopt(struct rn_store *store, const char *backup,
                              bool (*keep_going)(void *context), void *context,
                              struct rn_adopted *ret_adopted, struct rn_error *err) {
    struct rn_scrub_result result;
    struct entries entries = {0};
    int64_t counts[TABLES] = {0};
    rn_scrub(backup, keep_going, context, &result);
    if (keep_going != NULL && !keep_going(context))
        return rn_error_set(err, RN_ERROR_CANCELLED, "backup", "cancelled");
    if (result.damaged > 0)
        return rn_error_set(err, RN_ERROR_CORRUPT, "backup",
                            "of what it holds, %llu parts are not as they were written",
                            (unsigned long long)result.damaged);
    if (result.unread > 0)
        return rn_error_set(err, RN_ERROR_IO, "backup",
                            "of what it holds, %llu parts cannot be read; the log says which",
                            (unsigned long long)result.unread);
    enum rn_status status = list(backup, &entries, err);
    for (size_t t = 0; t < TABLES && status == RN_OK; t++)
        status = move(store, backup, tables[t], entries.items[t], entries.counts[t], err);
    if (status == RN_OK) status = add(store, &entries, counts, err);
    finish(&entries);
    if (status == RN_OK)
        *ret_adopted = (struct rn_adopted){.datasets = counts[0],
                                           .jobs = counts[1],
                                           .scenes = counts[2],
                                           .camera_paths = counts[3]};
    return status;
}

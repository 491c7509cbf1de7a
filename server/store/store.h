// The daemon's records (SQLite) and the folders of its content.
//
// A write that returned RN_OK is on disk (WAL, synchronous=FULL). On a full disk writes fail with
// RN_ERROR_NO_SPACE and reads go on. Content lies beside the records:
//   DIR/ripnerf.db  DIR/layout  DIR/lock  DIR/spool/
//   DIR/datasets/<id>/  DIR/scenes/<id>/{checkpoints/,marks/}  DIR/jobs/<id>/{log,frames/}
//   DIR/camera-paths/<id>/
// and with it, in <id>/record.json, a sealed copy of its record, from which --rebuild makes a lost
// database anew. Content is removed only after its record was: what has none is left alone.
#ifndef RN_SERVER_STORE_STORE_H
#define RN_SERVER_STORE_STORE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/stat.h>

#include "common/base/status.h"
#include "common/base/trace.h"
#include "proto/names.h"

// Thread-safety: any thread. Owner: whoever opened it.
struct rn_store;

#define RN_STORE_VERSION 5

// Opens or creates DIR, brings an older schema up to date and takes DIR/lock.
// RN_ERROR_CONFLICT when another daemon has it, RN_ERROR_UNSUPPORTED when a newer one wrote it,
// RN_ERROR_CORRUPT when the records are damaged, or missing while their content is there; with
// `rebuild` they are made anew then (a damaged database is kept beside as ripnerf.db.damaged-*),
// and records that are missing are added.
enum rn_status rn_store_open(const char *folder, bool rebuild, struct rn_store **ret_store,
                             struct rn_error *err) RN_MUST_CHECK;
void rn_store_close(struct rn_store **store);
const char *rn_store_folder(const struct rn_store *store);

// ---- rows -------------------------------------------------------------------------------------
// Every row has `seq` (its place in the order of creation, set by insert) and a unique `id`.
// Pointers are owned by the row (malloc, may be NULL); documents are JSON text that the store
// does not look into.

struct rn_dataset_row {
    int64_t seq;
    char id[RN_ID_MAX];
    char name[RN_NAME_MAX]; // unique
    int64_t created_ms;
    char *record; // what the ingest runner reported
};

struct rn_scene_row {
    int64_t seq;
    char id[RN_ID_MAX];
    char name[RN_NAME_MAX]; // unique
    char dataset[RN_ID_MAX];
    char job[RN_ID_MAX]; // the training one
    int64_t created_ms;
    enum rn_scene_state state;
    int64_t steps;
    double train_seconds;
    double psnr;     // NAN: not known
    char sha256[65]; // of the last checkpoint's parameters, empty before
    char digest[65]; // of its bytes
    int64_t memory_bytes;
    char *record; // what the runner reported when it opened the scene
};

struct rn_job_row {
    int64_t seq;
    char id[RN_ID_MAX];
    enum rn_job_type type;
    enum rn_job_state state;
    int attempt; // counts from 1
    int stalls;  // attempts in a row that brought no progress
    int64_t created_ms;
    int64_t started_ms;  // 0: not yet
    int64_t finished_ms; // 0: not yet
    char dataset[RN_ID_MAX];
    char dataset_name[RN_NAME_MAX];
    char scene[RN_ID_MAX];
    char scene_name[RN_NAME_MAX];
    char owner[RN_ID_MAX];          // the token that asked for it; "": the daemon's own
    char traceparent[RN_TRACE_MAX]; // of its span; "": none
    int64_t size_bytes;             // path: of its frames, once it is over
    char *source;  // ingest: a folder or a spooled tar; path: the camera path document
    char *options; // documents
    char *progress;
    char *result;
    char *problem;
};

struct rn_checkpoint_row {
    int64_t seq;
    char id[48]; // scene id and step
    char scene[RN_ID_MAX];
    int64_t step;
    int64_t size_bytes;
    int64_t created_ms;
    char sha256[65]; // of the parameters
    char digest[65]; // of the file
    char *path;      // relative to the scene's folder
};

struct rn_camera_path_row {
    int64_t seq;
    char id[RN_ID_MAX];
    char name[RN_NAME_MAX]; // unique
    int64_t created_ms;
    char owner[RN_ID_MAX];
    char *document;
};

struct rn_token_row { // the secret is kept as its digest alone
    int64_t seq;
    char id[RN_ID_MAX];
    char name[RN_NAME_MAX]; // unique
    enum rn_scope scope;
    char sha256[65];
    char scene[RN_ID_MAX]; // a link's: that scene
    char job[RN_ID_MAX];   // or the frames and film of that job; "" both: all there is
    char owner[RN_ID_MAX]; // the token that made it
    int64_t created_ms;
    int64_t expires_ms;          // 0: never
    int64_t max_jobs, max_bytes; // quotas; 0: none
};

struct rn_metric_row { // a held-out figure of a training job
    int64_t seq;
    char id[48]; // job id and step
    char job[RN_ID_MAX];
    int64_t step;
    double train_seconds;
    double psnr; // NAN: there is nothing to compare with
};

#define RN_KEY_MAX 160
struct rn_key_row { // of what is submitted once, however often it is asked for
    int64_t seq;
    char id[RN_KEY_MAX];
    char digest[65];
    char job[RN_ID_MAX];
    int64_t created_ms;
};

// A table's columns and how they lie in its row. See rows.c.
struct rn_store_table;
extern const struct rn_store_table rn_datasets, rn_scenes, rn_jobs_table, rn_checkpoints,
    rn_camera_paths, rn_metrics, rn_keys, rn_tokens;

// ---- access -----------------------------------------------------------------------------------

// Several writes as one: all or none. Holds the store's lock until commit or rollback; calls from
// the same thread in between belong to it. A failed commit has rolled back.
enum rn_status rn_store_begin(struct rn_store *store, struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_store_commit(struct rn_store *store, struct rn_error *err) RN_MUST_CHECK;
void rn_store_rollback(struct rn_store *store);

// RN_ERROR_CONFLICT when the id or a unique name is taken. Writes row->seq.
enum rn_status rn_store_insert(struct rn_store *store, const struct rn_store_table *table,
                               void *row, struct rn_error *err) RN_MUST_CHECK;
// Replaces the row with this id. RN_ERROR_NOT_FOUND when there is none.
enum rn_status rn_store_update(struct rn_store *store, const struct rn_store_table *table,
                               const void *row, struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_store_delete(struct rn_store *store, const struct rn_store_table *table,
                               const char *id, struct rn_error *err) RN_MUST_CHECK;
// The row whose `column` has this text. `row` is written on success only; rn_row_finish frees it.
enum rn_status rn_store_find(struct rn_store *store, const struct rn_store_table *table,
                             const char *column, const char *text, void *row,
                             struct rn_error *err) RN_MUST_CHECK;

// The row with this id, or with this name when `reference` does not begin with `prefix` (jobs have
// no names).
// RN_ERROR_NOT_FOUND names it: "there is no scene 'x'".
enum rn_status rn_store_resolve(struct rn_store *store, const struct rn_store_table *table,
                                const char *prefix, const char *reference, void *row,
                                struct rn_error *err) RN_MUST_CHECK;

struct rn_query {
    struct {
        const char *column; // NULL: no such condition
        const char *text;
    } equal[3];
    int64_t before_seq;  // rows older than this one; 0: all
    int limit;           // 0: all
    const char *without; // a document that is not wanted, read as NULL; NULL: all are
};
// Rows, newest first; malloc, rn_rows_finish frees them.
enum rn_status rn_store_list(struct rn_store *store, const struct rn_store_table *table,
                             const struct rn_query *query, void **ret_rows, size_t *ret_count,
                             struct rn_error *err) RN_MUST_CHECK;
size_t rn_store_row_size(const struct rn_store_table *table);
void rn_row_finish(const struct rn_store_table *table, void *row);
void rn_rows_finish(const struct rn_store_table *table, void *rows, size_t count);

// Bytes of the datasets, checkpoints and frames that a token's jobs have made.
enum rn_status rn_store_owned_bytes(struct rn_store *store, const char *owner, int64_t *ret_bytes,
                                    struct rn_error *err) RN_MUST_CHECK;

// A fresh id: prefix and RN_ID_RANDOM random base32 characters.
enum rn_status rn_store_new_id(const char *prefix, char ret_id[RN_ID_MAX],
                               struct rn_error *err) RN_MUST_CHECK;

// ---- content ----------------------------------------------------------------------------------

// "DIR/" and the formatted rest; malloc. NULL when memory is short.
char *rn_store_path(const struct rn_store *store, const char *fmt, ...) RN_PRINTF(2, 3);
// Whether what is written still has a place: RN_ERROR_IO when the folder was moved or removed.
enum rn_status rn_store_check_folder(struct rn_store *store, struct rn_error *err) RN_MUST_CHECK;
// Copies the records and links the content into a new folder `target` of the same disk, as of now;
// other threads go on meanwhile. With `scene`, an id, not NULL: that scene, its dataset and the
// jobs of both, and nothing else.
enum rn_status rn_store_snapshot(struct rn_store *store, const char *scene, const char *target,
                                 struct rn_error *err) RN_MUST_CHECK;
// Records that came of it.
struct rn_adopted {
    int64_t datasets, scenes, camera_paths, jobs;
};
// Takes in the folder `backup` of the same disk, an unpacked snapshot: what has its id here already
// is the same and stays, a name that is taken gets a suffix. RN_ERROR_CORRUPT, and nothing is
// taken, when something in it is not as it was written; RN_ERROR_CANCELLED: `keep_going` (may be
// NULL) said no before anything was. After a crash in between, the same again completes it. adopt.c
enum rn_status rn_store_adopt(struct rn_store *store, const char *backup,
                              bool (*keep_going)(void *context), void *context,
                              struct rn_adopted *ret_adopted, struct rn_error *err) RN_MUST_CHECK;
// Removes content that was deleted, what failed imports have left, uploads that no unfinished job
// needs, and idempotency keys older than a week. Other content without a record stays, and is
// counted in the log. Brings the records' copies up to date.
// Whether an upload in parts (spool/up_*) is given up: nobody went on with it for a day, or the
// machine has ended since.
bool rn_store_upload_is_over(const struct stat *about);
enum rn_status rn_store_sweep(struct rn_store *store, struct rn_error *err) RN_MUST_CHECK;

#endif

#include "server/runner/ingest/cameras.h"

#include <sqlite3.h>
#include <stdlib.h>
#include <string.h>

#define RADIAL_NUMBERS 4 // of a SIMPLE_RADIAL camera: f, cx, cy, k
#define OPENCV_NUMBERS 8 // fx, fy, cx, cy, k1, k2, p1, p2
#define OPENCV "4"       // COLMAP's number of that kind

// A camera of COLMAP's that photographs share.
struct shared {
    sqlite3_int64 id; // 0: none yet
    size_t count;
};

struct statements {
    sqlite3_stmt *find, *take, *read, *widen;
};

static bool prepare(sqlite3 *db, const char *text, sqlite3_stmt **ret) {
    return sqlite3_prepare_v2(db, text, -1, ret, NULL) == SQLITE_OK;
}

static bool step(sqlite3_stmt *query, int expected) {
    return sqlite3_step(query) == expected;
}

// The photograph has the camera of the first of its number from now on.
static bool share(const struct statements *s, const char *name, struct shared *camera) {
    bool done = true;
    sqlite3_bind_text(camera->id ? s->take : s->find, 1, name, -1, SQLITE_STATIC);
    if (camera->id) {
        sqlite3_bind_int64(s->take, 2, camera->id);
        done = step(s->take, SQLITE_DONE);
        sqlite3_reset(s->take);
    } else {
        done = step(s->find, SQLITE_ROW) && (camera->id = sqlite3_column_int64(s->find, 0)) > 0;
        sqlite3_reset(s->find);
    }
    camera->count++;
    return done;
}

// Gives a camera the parameters of a lens that many photographs settle; its focal length stays.
static bool widen(const struct statements *s, const struct shared *camera) {
    double from[RADIAL_NUMBERS], to[OPENCV_NUMBERS] = {0};
    sqlite3_bind_int64(s->read, 1, camera->id);
    bool done = step(s->read, SQLITE_ROW) && sqlite3_column_bytes(s->read, 0) == (int)sizeof from;
    if (done) memcpy(from, sqlite3_column_blob(s->read, 0), sizeof from);
    sqlite3_reset(s->read);
    if (!done) return false;
    to[0] = to[1] = from[0];
    to[2] = from[1];
    to[3] = from[2];
    sqlite3_bind_blob(s->widen, 1, to, sizeof to, SQLITE_TRANSIENT);
    sqlite3_bind_int64(s->widen, 2, camera->id);
    done = step(s->widen, SQLITE_DONE);
    sqlite3_reset(s->widen);
    return done;
}

static bool share_all(sqlite3 *db, const struct statements *s, const struct rn_photos *photos,
                      struct shared *cameras) {
    for (size_t i = 0; i < photos->count; i++)
        if (!share(s, photos->items[i].name, &cameras[photos->items[i].camera])) return false;
    for (int i = 0; i < photos->cameras; i++)
        if (cameras[i].count >= RN_CAMERAS_SETTLED && !widen(s, &cameras[i])) return false;
    return sqlite3_exec(db,
                        "DELETE FROM cameras WHERE camera_id NOT IN (SELECT camera_id FROM images)",
                        NULL, NULL, NULL) == SQLITE_OK;
}

enum rn_status rn_cameras_share(const struct rn_photos *photos, const char *database,
                                struct rn_error *err) {
    sqlite3 *db = NULL;
    struct statements s = {NULL, NULL, NULL, NULL};
    struct shared *cameras = calloc((size_t)photos->cameras + 1, sizeof *cameras);
    enum rn_status status = RN_OK;
    if (!cameras) return rn_error_set(err, RN_ERROR_NO_MEMORY, database, "out of memory");
    if (sqlite3_open_v2(database, &db, SQLITE_OPEN_READWRITE, NULL) != SQLITE_OK ||
        sqlite3_exec(db, "BEGIN", NULL, NULL, NULL) != SQLITE_OK ||
        !prepare(db, "SELECT camera_id FROM images WHERE name = ?", &s.find) ||
        !prepare(db, "UPDATE images SET camera_id = ?2 WHERE name = ?1", &s.take) ||
        !prepare(db, "SELECT params FROM cameras WHERE camera_id = ?", &s.read) ||
        !prepare(db, "UPDATE cameras SET model = " OPENCV ", params = ? WHERE camera_id = ?",
                 &s.widen) ||
        !share_all(db, &s, photos, cameras) ||
        sqlite3_exec(db, "COMMIT", NULL, NULL, NULL) != SQLITE_OK)
        status = rn_error_set(err, RN_ERROR_CORRUPT, database,
                              "COLMAP's database cannot be used: its cameras are not as expected "
                              "(%s)",
                              sqlite3_errmsg(db));
    sqlite3_finalize(s.find);
    sqlite3_finalize(s.take);
    sqlite3_finalize(s.read);
    sqlite3_finalize(s.widen);
    sqlite3_close(db);
    free(cameras);
    return status;
}

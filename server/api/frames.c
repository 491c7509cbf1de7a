// The pictures of a path job.
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/buf.h"
#include "common/base/manifest.h"
#include "common/base/tar.h"
#include "proto/event.h"
#include "proto/export.h"
#include "server/api/app.h"

#define BLOCK RN_TAR_BLOCK

// The extensions that a frame may have, each once.
static const char *const extensions[] = {"png", "jpg", "exr", NULL};

static void frame_name(int index, int extension, char ret_name[16]) {
    snprintf(ret_name, 16, "%05d.%s", index, extensions[extension]);
}

// What a file of that name is sent as.
static const char *type_of(int extension) {
    int format = rn_name_index(rn_picture_format_extensions, extensions[extension]);
    return rn_picture_format_types[format];
}

static int by_value(const void *a, const void *b) {
    return *(const int *)a - *(const int *)b;
}

// The numbers of the frames that are there, ascending; malloc.
static enum rn_status list_frames(int folder, int **ret_frames, size_t *ret_count,
                                  struct rn_error *err) {
    struct rn_buf frames;
    struct dirent *entry;
    size_t size;
    int copy = openat(folder, ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    DIR *dir = copy >= 0 ? fdopendir(copy) : NULL;
    if (dir == NULL && copy >= 0) close(copy);
    rn_buf_init(&frames, 1u << 20);
    while (dir != NULL && (entry = readdir(dir)) != NULL) {
        int index = rn_frame_index(entry->d_name);
        if (index >= 0) rn_buf_append(&frames, &index, sizeof index);
    }
    if (dir != NULL) closedir(dir);
    enum rn_status status = rn_buf_status(&frames, "the list of frames", err);
    *ret_count = frames.size / sizeof(int);
    *ret_frames = status == RN_OK ? (void *)rn_buf_take(&frames, &size) : NULL;
    rn_buf_finish(&frames);
    if (*ret_count > 0 && status == RN_OK) qsort(*ret_frames, *ret_count, sizeof(int), by_value);
    return status;
}

// While a runner works on the job, its frames are lent to the scene; between two looks they may
// have come back.
static int open_folder(struct rn_app *app, const struct rn_job_row *row) {
    char *lent = rn_store_path(app->store, "scenes/%s/frames/%s", row->scene, row->id);
    char *kept = rn_store_path(app->store, "jobs/%s/frames", row->id);
    const char *const places[] = {lent, kept, lent};
    int folder = -1;
    for (int i = 0; i < 3 && folder < 0; i++)
        if (places[i] != NULL) folder = open(places[i], O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    free(lent);
    free(kept);
    return folder;
}

// The folder of a job of that type, to be closed. -1: replied with an error.
static int find_folder_of(struct rn_app *app, struct rn_request *request, enum rn_job_type type,
                          const char *content, char id[RN_ID_MAX], struct rn_reply *reply) {
    struct rn_error err = {0};
    struct rn_job_row row;
    enum rn_status status = rn_store_resolve(app->store, &rn_jobs_table, RN_ID_JOB,
                                             rn_request_param(request, 0), &row, &err);
    if (rn_api_failed(status, &err, reply)) return -1;
    int folder = -1;
    if (row.type != type)
        rn_reply_problem(reply, RN_PROBLEM_NOT_FOUND, "a %s job has no %s",
                         rn_job_type_names[row.type], content);
    else if ((folder = open_folder(app, &row)) < 0)
        rn_reply_problem(reply, RN_PROBLEM_INTERNAL, "the %s of job %s cannot be opened: %s",
                         content, row.id, strerror(errno));
    snprintf(id, RN_ID_MAX, "%s", row.id);
    rn_row_finish(&rn_jobs_table, &row);
    return folder;
}

static int find_folder(struct rn_app *app, struct rn_request *request, char id[RN_ID_MAX],
                       struct rn_reply *reply) {
    return find_folder_of(app, request, RN_JOB_PATH, "frames", id, reply);
}

static enum rn_status encode_frame(const char *job, int index, char **ret_json,
                                   struct rn_error *err) {
    struct rn_frame_event frame = {.index = index};
    snprintf(frame.url, sizeof frame.url, "/v1/jobs/%s/frames/%d", job, index);
    return rn_encode(&rn_frame_event_table, &frame, ret_json, NULL, err);
}

// The cursor is the number of the page's last frame plus one.
static void reply_page(struct rn_request *request, const char *job, const int *frames, size_t count,
                       struct rn_reply *reply) {
    struct rn_error err = {0};
    char *items[200], *json = NULL, next[32];
    size_t done = 0, i = 0;
    int limit = 0;
    int64_t cursor = 0;
    enum rn_status status = rn_api_page(request, &limit, &cursor, &err);
    while (i < count && frames[i] < cursor)
        i++;
    for (; status == RN_OK && i < count && done < (size_t)limit; i++)
        if ((status = encode_frame(job, frames[i], &items[done], &err)) == RN_OK) done++;
    if (status == RN_OK && done > 0) snprintf(next, sizeof next, "%d", frames[i - 1] + 1);
    if (status == RN_OK)
        status = rn_encode_list((const char *const *)items, done, i < count ? next : NULL, &json,
                                NULL, &err);
    while (done > 0)
        free(items[--done]);
    if (!rn_api_failed(status, &err, reply)) rn_api_json(reply, 200, json);
}

void rn_list_frames(void *context, struct rn_request *request, struct rn_reply *reply) {
    static const char *const known[] = {"limit", "cursor", NULL};
    struct rn_error err = {0};
    char id[RN_ID_MAX];
    int *frames = NULL;
    size_t count = 0;
    if (rn_api_failed(rn_request_check_query(request, known, &err), &err, reply)) return;
    int folder = find_folder(context, request, id, reply);
    if (folder < 0) return;
    if (!rn_api_failed(list_frames(folder, &frames, &count, &err), &err, reply))
        reply_page(request, id, frames, count, reply);
    free(frames);
    close(folder);
}

// Sends a file of the job's folder; false: it is not there, and nothing is replied.
static bool reply_stored(int folder, const char *name, const char *type, struct rn_reply *reply) {
    struct rn_error err = {0};
    char place[32], path[64];
    snprintf(place, sizeof place, "/proc/self/fd/%d", folder);
    snprintf(path, sizeof path, "%s/%s", place, name);
    enum rn_status status = rn_manifest_check_file(place, name, &err);
    if (status != RN_ERROR_NOT_FOUND && rn_api_failed(status, &err, reply)) return true;
    rn_reply_file(reply, type, path);
    if (reply->body == RN_BODY_FILE) return true;
    rn_reply_finish(reply);
    return false;
}

void rn_get_frame(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_error err = {0};
    char id[RN_ID_MAX], name[16];
    int64_t index;
    enum rn_status status =
        rn_api_number(rn_request_param(request, 1), 0, 99999, "index", &index, &err);
    if (rn_api_failed(status, &err, reply)) return;
    int folder = find_folder(context, request, id, reply);
    if (folder < 0) return;
    bool found = false;
    for (int i = 0; extensions[i] && !found; i++) {
        frame_name((int)index, i, name);
        found = reply_stored(folder, name, type_of(i), reply);
    }
    if (!found)
        rn_reply_problem(reply, RN_PROBLEM_NOT_FOUND, "there is no frame %d (yet)", (int)index);
    close(folder);
}

// ---- film -------------------------------------------------------------------------------------

void rn_get_film(void *context, struct rn_request *request, struct rn_reply *reply) {
    static const char *const films[][2] = {
        {"film.mp4", "video/mp4"}, {"film.webm", "video/webm"}, {"film.gif", "image/gif"}};
    char id[RN_ID_MAX];
    bool found = false;
    int folder = find_folder(context, request, id, reply);
    if (folder < 0) return;
    for (int i = 0; i < 3 && !found; i++) {
        found = reply_stored(folder, films[i][0], films[i][1], reply);
        if (found && reply->body == RN_BODY_FILE)
            rn_reply_header(reply, "Content-Disposition", "inline; filename=\"%s%s\"", id,
                            strrchr(films[i][0], '.'));
    }
    if (!found) rn_reply_problem(reply, RN_PROBLEM_NOT_FOUND, "the job has no film (yet)");
    close(folder);
}

// ---- export -----------------------------------------------------------------------------------

// What an export job wrote into its folder, which is closed.
static void reply_export(int folder, const char *id, struct rn_reply *reply) {
    static const char *const files[][2] = {{"mesh.ply", "application/octet-stream"},
                                           {"mesh.obj", "model/obj"},
                                           {RN_EXPORT_SCENE_FILE, "application/octet-stream"}};
    bool found = false;
    for (size_t i = 0; i < sizeof files / sizeof *files && !found; i++) {
        found = reply_stored(folder, files[i][0], files[i][1], reply);
        if (found && reply->body == RN_BODY_FILE)
            rn_reply_header(reply, "Content-Disposition", "attachment; filename=\"%s%s\"", id,
                            strrchr(files[i][0], '.'));
    }
    if (!found) rn_reply_problem(reply, RN_PROBLEM_NOT_FOUND, "the job has written nothing (yet)");
    close(folder);
}

void rn_get_export(void *context, struct rn_request *request, struct rn_reply *reply) {
    char id[RN_ID_MAX];
    int folder = find_folder_of(context, request, RN_JOB_EXPORT, "export", id, reply);
    if (folder >= 0) reply_export(folder, id, reply);
}

// The newest one of a scene.
void rn_get_scene_export(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_error err = {0};
    struct rn_scene_row scene;
    void *rows = NULL;
    size_t count = 0;
    enum rn_status status = rn_store_resolve(app->store, &rn_scenes, RN_ID_SCENE,
                                             rn_request_param(request, 0), &scene, &err);
    if (rn_api_failed(status, &err, reply)) return;
    const struct rn_query query = {.equal = {{"scene", scene.id},
                                             {"type", rn_job_type_names[RN_JOB_EXPORT]},
                                             {"state", rn_job_state_names[RN_JOB_SUCCEEDED]}},
                                   .limit = 1,
                                   .without = "source"};
    status = rn_store_list(app->store, &rn_jobs_table, &query, &rows, &count, &err);
    if (status == RN_OK && count == 0)
        status = rn_error_set(&err, RN_ERROR_NOT_FOUND, "",
                              "scene '%s' was not exported yet: a job of type export does that",
                              scene.name);
    int folder = status == RN_OK ? open_folder(app, rows) : -1;
    if (!rn_api_failed(status, &err, reply) && folder < 0)
        rn_reply_problem(reply, RN_PROBLEM_INTERNAL, "the export cannot be opened: %s",
                         strerror(errno));
    if (folder >= 0) reply_export(folder, scene.name, reply);
    rn_rows_finish(&rn_jobs_table, rows, count);
    rn_row_finish(&rn_scenes, &scene);
}

// ---- tar --------------------------------------------------------------------------------------

// An archive being sent: for each frame a header block, the file and padding; two zero blocks. Not
// an rn_tar, nor libarchive's: this thread must not wait, and rn_tar looks at every file before the
// first byte (frames may be 100,000), while libarchive pushes what the connection pulls.
struct archive {
    int folder;
    int *frames;
    size_t count, next;
    int fd; // of the frame being sent, -1 between frames
    int64_t left, padding;
    int end_blocks;
};

// The next header, or an end block. False: an error.
static bool next_block(struct archive *archive, uint8_t block[BLOCK]) {
    struct stat info;
    char name[16];
    if (archive->next == archive->count) {
        memset(block, 0, BLOCK);
        archive->end_blocks++;
        return true;
    }
    int index = archive->frames[archive->next++];
    archive->fd = -1;
    for (int i = 0; extensions[i] && archive->fd < 0; i++) {
        frame_name(index, i, name);
        archive->fd = openat(archive->folder, name, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
    }
    if (archive->fd < 0 || fstat(archive->fd, &info) != 0) return false;
    archive->left = info.st_size;
    archive->padding = (BLOCK - info.st_size % BLOCK) % BLOCK;
    rn_tar_header(name, (uint64_t)info.st_size, info.st_mtime, (char *)block);
    return true;
}

static ssize_t read_file(struct archive *archive, uint8_t *bytes, size_t capacity) {
    if (archive->left > 0) {
        size_t wanted = capacity < (size_t)archive->left ? capacity : (size_t)archive->left;
        ssize_t size = read(archive->fd, bytes, wanted);
        if (size <= 0) return -1; // a frame never shrinks
        archive->left -= size;
        return size;
    }
    size_t size = (size_t)archive->padding;
    memset(bytes, 0, size);
    close(archive->fd);
    archive->fd = -1;
    return (ssize_t)size;
}

static ssize_t read_archive(void *context, uint8_t *bytes, size_t capacity) {
    struct archive *archive = context;
    if (capacity < BLOCK) return -1;
    if (archive->fd >= 0) {
        ssize_t size = read_file(archive, bytes, capacity);
        if (size != 0) return size;
    }
    if (archive->end_blocks == 2) return 0;
    return next_block(archive, bytes) ? BLOCK : -1;
}

static void close_archive(void *context) {
    struct archive *archive = context;
    if (archive->fd >= 0) close(archive->fd);
    free(archive->frames);
    close(archive->folder);
    free(archive);
}

void rn_get_frames_tar(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_error err = {0};
    char id[RN_ID_MAX];
    int folder = find_folder(context, request, id, reply);
    if (folder < 0) return;
    struct archive *archive = calloc(1, sizeof *archive);
    if (archive == NULL) {
        close(folder);
        rn_reply_problem(reply, RN_PROBLEM_INTERNAL, "no memory");
        return;
    }
    archive->folder = folder;
    archive->fd = -1;
    if (rn_api_failed(list_frames(folder, &archive->frames, &archive->count, &err), &err, reply)) {
        close_archive(archive);
        return;
    }
    rn_reply_stream(
        reply, "application/x-tar",
        (struct rn_stream){.read = read_archive, .close = close_archive, .context = archive});
    rn_reply_header(reply, "Content-Disposition", "attachment; filename=\"%s.tar\"", id);
}

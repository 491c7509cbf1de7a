// The pictures of a path job.
#include <dirent.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/buf.h"
#include "proto/event.h"
#include "server/api/app.h"

#define BLOCK 512

static int by_value(const void *a, const void *b) {
    return *(const int *)a - *(const int *)b;
}

// The numbers of the frames that are there, ascending; malloc.
static enum rn_status list_frames(const char *folder, int **ret_frames, size_t *ret_count,
                                  struct rn_error *err) {
    struct rn_buf frames;
    struct dirent *entry;
    size_t size;
    DIR *dir = opendir(folder);
    rn_buf_init(&frames, 1u << 20);
    while (dir != NULL && (entry = readdir(dir)) != NULL) {
        int index, end = 0;
        if (sscanf(entry->d_name, "%5d.png%n", &index, &end) == 1 && end == 9 &&
            entry->d_name[end] == '\0')
            rn_buf_append(&frames, &index, sizeof index);
    }
    if (dir != NULL) closedir(dir);
    enum rn_status status = rn_buf_status(&frames, "the list of frames", err);
    *ret_count = frames.size / sizeof(int);
    *ret_frames = status == RN_OK ? (void *)rn_buf_take(&frames, &size) : NULL;
    rn_buf_finish(&frames);
    if (*ret_count > 0 && status == RN_OK) qsort(*ret_frames, *ret_count, sizeof(int), by_value);
    return status;
}

// The job's folder of frames; malloc. NULL: replied with an error.
static char *find_folder(struct rn_app *app, struct rn_request *request, char id[RN_ID_MAX],
                         struct rn_reply *reply) {
    struct rn_error err = {0};
    struct rn_job_row row;
    enum rn_status status = rn_store_resolve(app->store, &rn_jobs_table, RN_ID_JOB,
                                             rn_request_param(request, 0), &row, &err);
    if (rn_api_failed(status, &err, reply)) return NULL;
    char *folder = NULL;
    if (row.type != RN_JOB_PATH)
        rn_reply_problem(reply, RN_PROBLEM_NOT_FOUND, "a %s job has no frames",
                         rn_job_type_names[row.type]);
    else if ((folder = rn_store_path(app->store, "jobs/%s/frames", row.id)) == NULL)
        rn_reply_problem(reply, RN_PROBLEM_INTERNAL, "no memory");
    snprintf(id, RN_ID_MAX, "%s", row.id);
    rn_row_finish(&rn_jobs_table, &row);
    return folder;
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
    char *folder = find_folder(context, request, id, reply);
    if (folder == NULL) return;
    if (!rn_api_failed(list_frames(folder, &frames, &count, &err), &err, reply))
        reply_page(request, id, frames, count, reply);
    free(frames);
    free(folder);
}

void rn_get_frame(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_error err = {0};
    char id[RN_ID_MAX], *path = NULL;
    int64_t index;
    enum rn_status status =
        rn_api_number(rn_request_param(request, 1), 0, 99999, "index", &index, &err);
    if (rn_api_failed(status, &err, reply)) return;
    char *folder = find_folder(context, request, id, reply);
    if (folder == NULL) return;
    if (asprintf(&path, "%s/%05d.png", folder, (int)index) < 0) {
        rn_reply_problem(reply, RN_PROBLEM_INTERNAL, "no memory");
    } else {
        rn_reply_file(reply, "image/png", path);
        if (reply->body != RN_BODY_FILE) {
            rn_reply_finish(reply);
            rn_reply_problem(reply, RN_PROBLEM_NOT_FOUND, "there is no frame %d (yet)", (int)index);
        }
        free(path);
    }
    free(folder);
}

// ---- tar --------------------------------------------------------------------------------------

// An archive being sent: for each frame a header block, the file and padding; two zero blocks.
struct archive {
    char *folder;
    int *frames;
    size_t count, next;
    int fd; // of the frame being sent, -1 between frames
    int64_t left, padding;
    int end_blocks;
};

static void put_octal(char *field, size_t size, long long value) {
    snprintf(field, size, "%0*llo", (int)size - 1, value);
}

// POSIX ustar header of a regular file.
static void make_header(uint8_t block[BLOCK], int index, const struct stat *info) {
    char *header = (char *)block;
    unsigned sum = 0;
    memset(block, 0, BLOCK);
    snprintf(header, 100, "%05d.png", index);
    put_octal(header + 100, 8, 0644);
    put_octal(header + 108, 8, 0);
    put_octal(header + 116, 8, 0);
    put_octal(header + 124, 12, (long long)info->st_size);
    put_octal(header + 136, 12, (long long)info->st_mtime);
    memset(header + 148, ' ', 8);
    header[156] = '0';
    memcpy(header + 257, "ustar\00000", 8);
    for (int i = 0; i < BLOCK; i++)
        sum += block[i];
    snprintf(header + 148, 8, "%06o", sum);
}

// The next header, or an end block. False: an error.
static bool next_block(struct archive *archive, uint8_t block[BLOCK]) {
    struct stat info;
    char *path = NULL;
    if (archive->next == archive->count) {
        memset(block, 0, BLOCK);
        archive->end_blocks++;
        return true;
    }
    int index = archive->frames[archive->next++];
    if (asprintf(&path, "%s/%05d.png", archive->folder, index) < 0) return false;
    archive->fd = open(path, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
    free(path);
    if (archive->fd < 0 || fstat(archive->fd, &info) != 0) return false;
    archive->left = info.st_size;
    archive->padding = (BLOCK - info.st_size % BLOCK) % BLOCK;
    make_header(block, index, &info);
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
    free(archive->folder);
    free(archive);
}

void rn_get_frames_tar(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_error err = {0};
    char id[RN_ID_MAX];
    char *folder = find_folder(context, request, id, reply);
    if (folder == NULL) return;
    struct archive *archive = calloc(1, sizeof *archive);
    if (archive == NULL) {
        free(folder);
        rn_reply_problem(reply, RN_PROBLEM_INTERNAL, "no memory");
        return;
    }
    archive->folder = folder;
    archive->fd = -1;
    if (rn_api_failed(list_frames(folder, &archive->frames, &archive->count, &err), &err, reply)) {
        close_archive(archive);
        return;
    }
    rn_reply_stream(reply, "application/x-tar",
                    (struct rn_stream){read_archive, close_archive, archive});
    rn_reply_header(reply, "Content-Disposition", "attachment; filename=\"%s.tar\"", id);
}

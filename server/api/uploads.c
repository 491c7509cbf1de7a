// Uploads that outlive their connections: a tar of a known size that comes in parts, each going on
// where the one before ended. It is spool/up_ID-SIZE, and its size says how much is there.
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include "common/base/file.h"
#include "proto/dataset.h"
#include "server/api/app.h"

#define PART_TYPE "application/offset+octet-stream"
#define MAX_OPEN 64 // uploads that are not whole or not used yet

// What the spool holds of uploads.
struct shelf {
    unsigned count;
    uint64_t missing_bytes; // still to come
};

static bool read_name(const char *name, struct rn_upload_record *ret_upload) {
    size_t size = strcspn(name, "-");
    char *end = NULL;
    if (strncmp(name, RN_ID_UPLOAD, strlen(RN_ID_UPLOAD)) != 0 || size >= RN_ID_MAX ||
        name[size] != '-')
        return false;
    snprintf(ret_upload->id, sizeof ret_upload->id, "%.*s", (int)size, name);
    ret_upload->size_bytes = strtoll(name + size + 1, &end, 10);
    return *end == '\0';
}

// The upload `id` of the spool, if it is there; removes what nobody has gone on with for a day.
static bool look(struct rn_app *app, const char *id, struct rn_upload_record *ret_upload,
                 struct shelf *ret_shelf) {
    struct dirent *entry;
    struct stat about;
    bool found = false;
    char *spool = rn_store_path(app->store, "spool");
    DIR *dir = spool != NULL ? opendir(spool) : NULL;
    *ret_shelf = (struct shelf){0};
    while (dir != NULL && (entry = readdir(dir)) != NULL) {
        struct rn_upload_record upload;
        if (!read_name(entry->d_name, &upload) ||
            fstatat(dirfd(dir), entry->d_name, &about, AT_SYMLINK_NOFOLLOW) != 0)
            continue;
        if (rn_store_upload_is_over(&about)) {
            unlinkat(dirfd(dir), entry->d_name, 0);
            continue;
        }
        upload.offset = about.st_size;
        ret_shelf->count++;
        ret_shelf->missing_bytes += (uint64_t)(upload.size_bytes - upload.offset);
        if (id == NULL || strcmp(id, upload.id) != 0) continue;
        *ret_upload = upload;
        found = true;
    }
    if (dir != NULL) closedir(dir);
    free(spool);
    return found;
}

char *rn_api_upload_path(struct rn_app *app, const struct rn_upload_record *upload) {
    return rn_store_path(app->store, "spool/%s-%lld", upload->id, (long long)upload->size_bytes);
}

bool rn_api_find_upload(struct rn_app *app, const char *id, struct rn_upload_record *ret_upload) {
    struct shelf shelf;
    return look(app, id, ret_upload, &shelf);
}

static bool find(struct rn_app *app, struct rn_request *request,
                 struct rn_upload_record *ret_upload, struct rn_reply *reply) {
    if (rn_api_find_upload(app, rn_request_param(request, 0), ret_upload)) return true;
    rn_reply_problem(reply, RN_PROBLEM_NOT_FOUND,
                     "there is no upload '%.100s'; one that nobody goes on with for a day, or that "
                     "the machine's end cut off, is removed",
                     rn_request_param(request, 0));
    return false;
}

static void tell_offset(const struct rn_upload_record *upload, struct rn_reply *reply) {
    rn_reply_header(reply, "Upload-Offset", "%lld", (long long)upload->offset);
    rn_reply_header(reply, "Cache-Control", "no-store");
}

static void reply_upload(int code, const struct rn_upload_record *upload, struct rn_reply *reply) {
    struct rn_error err = {0};
    char *json = NULL;
    enum rn_status status = rn_encode(&rn_upload_table, upload, &json, NULL, &err);
    if (rn_api_failed(status, &err, reply)) return;
    rn_api_json(reply, code, json);
    tell_offset(upload, reply);
}

// Room for so much more beside what other uploads will still send.
static enum rn_status check_room(struct rn_app *app, uint64_t bytes, struct rn_error *err) {
    struct rn_upload_record none;
    struct shelf shelf;
    struct statvfs disk;
    (void)look(app, NULL, &none, &shelf);
    if (shelf.count >= MAX_OPEN)
        return rn_error_set(err, RN_ERROR_BUSY, "",
                            "%u uploads are open, the limit; finish or delete one", shelf.count);
    char *spool = rn_store_path(app->store, "spool");
    bool known = spool != NULL && statvfs(spool, &disk) == 0;
    free(spool);
    uint64_t room = known ? (uint64_t)disk.f_bavail * disk.f_frsize : UINT64_MAX;
    if (bytes + shelf.missing_bytes <= room) return RN_OK;
    return rn_error_set(err, RN_ERROR_NO_SPACE, "#/size_bytes",
                        "this upload and what is missing of others are %llu bytes; the disk has "
                        "%llu",
                        (unsigned long long)(bytes + shelf.missing_bytes),
                        (unsigned long long)room);
}

static enum rn_status check_wanted(struct rn_app *app, struct rn_request *request,
                                   const struct rn_upload_request *wanted, struct rn_error *err) {
    uint64_t most = 0;
    enum rn_status status = RN_OK;
    if (*wanted->name) status = rn_api_check_free_name(app, wanted->name, err);
    if (status == RN_OK) status = rn_api_most_upload(app, rn_request_caller(request), &most, err);
    if (status == RN_OK && (uint64_t)wanted->size_bytes > most)
        status = rn_error_set(err, RN_ERROR_LIMIT, "#/size_bytes",
                              "is larger than the limit of %llu bytes", (unsigned long long)most);
    return status ? status : check_room(app, (uint64_t)wanted->size_bytes, err);
}

void rn_create_upload(void *context, struct rn_request *request, struct rn_reply *reply) {
    static const char *const known[] = {NULL};
    struct rn_app *app = context;
    struct rn_error err = {0};
    struct rn_field_errors errors = {0};
    struct rn_upload_request wanted;
    struct rn_upload_record upload = {.offset = 0};
    size_t size;
    const char *body = (const char *)rn_request_body(request, &size);
    if (rn_api_failed(rn_request_check_query(request, known, &err), &err, reply)) return;
    if (rn_decode(&rn_upload_request_table, body, size, &wanted, &errors, &err) != RN_OK) {
        rn_reply_invalid(reply, &errors, &err);
        return;
    }
    enum rn_status status = check_wanted(app, request, &wanted, &err);
    if (status == RN_OK) status = rn_store_new_id(RN_ID_UPLOAD, upload.id, &err);
    upload.size_bytes = wanted.size_bytes;
    char *path = status == RN_OK ? rn_api_upload_path(app, &upload) : NULL;
    int fd = path != NULL ? open(path, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600) : -1;
    if (status == RN_OK && fd < 0)
        status =
            rn_error_from_errno(&err, path == NULL ? ENOMEM : errno, "spool", "begin an upload");
    if (status == RN_ERROR_NOT_FOUND) status = rn_api_no_spool(app, &err);
    if (fd >= 0) close(fd);
    free(path);
    if (rn_api_failed(status, &err, reply)) return;
    reply_upload(201, &upload, reply);
    rn_reply_header(reply, "Location", "/v1/uploads/%s", upload.id);
}

void rn_get_upload(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_upload_record upload;
    if (find(context, request, &upload, reply)) reply_upload(200, &upload, reply);
}

void rn_delete_upload(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_upload_record upload;
    if (!find(context, request, &upload, reply)) return;
    char *path = rn_api_upload_path(context, &upload);
    if (path != NULL) unlink(path);
    free(path);
    rn_reply_empty(reply, 204);
}

// Where the part begins: not behind what is there. Bytes that are there already, of a connection
// that was given up, may come again.
static bool read_offset(struct rn_request *request, const struct rn_upload_record *upload,
                        int64_t *ret_offset, struct rn_reply *reply) {
    struct rn_error err = {0};
    const char *text = rn_request_header(request, "Upload-Offset");
    enum rn_status status = rn_api_number(text != NULL ? text : "", 0, upload->size_bytes,
                                          "Upload-Offset", ret_offset, &err);
    if (rn_api_failed(status, &err, reply)) return false;
    if (*ret_offset <= upload->offset) return true;
    rn_reply_problem(reply, RN_PROBLEM_CONFLICT, "the upload goes on at byte %lld, not %lld",
                     (long long)upload->offset, (long long)*ret_offset);
    tell_offset(upload, reply);
    return false;
}

void rn_begin_upload_part(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_error err = {0};
    struct rn_upload_record upload;
    int64_t offset;
    if (!rn_request_has_type(request, PART_TYPE)) {
        rn_reply_problem(reply, RN_PROBLEM_MEDIA_TYPE, "send a part as Content-Type: " PART_TYPE);
        return;
    }
    if (!find(context, request, &upload, reply) || !read_offset(request, &upload, &offset, reply))
        return;
    char *path = rn_api_upload_path(context, &upload);
    enum rn_status status =
        path != NULL ? rn_request_append(request, path, (uint64_t)offset,
                                         (uint64_t)(upload.size_bytes - offset), &err)
                     : rn_error_set(&err, RN_ERROR_NO_MEMORY, "", "no memory for an upload");
    free(path);
    (void)rn_api_failed(status, &err, reply);
}

void rn_take_upload_part(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_upload_record upload;
    if (!find(context, request, &upload, reply)) return;
    rn_reply_empty(reply, 204);
    tell_offset(&upload, reply);
}

// Between a runner that shares no folder with this machine and the daemon's control: passes their
// messages on, and carries the files that they speak of.
//
// A thread for each such runner. The control sees a runner that reads and writes its scene's folder
// as all do; it is the porter that does, by the link that is the runner's own (place.c).
#include "server/slurm/porter.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/log.h"
#include "common/base/manifest.h"
#include "proto/carry.h"

#define LOOK_NS (2 * 1000000000ll) // between looks for what other runners have made
#define TICK_MS 1000

struct rn_porter {
    pthread_t thread;
    int inner, outer;       // to the control, and to the runner
    char *scene, *log;      // the scene's folder by the runner's link
    char *dataset;          // NULL before it is opened
    int64_t sent, received; // bytes of files
    struct rn_carry out;    // to the runner
    struct rn_wire_reader reader;
    struct rn_wire_writer writer;
    bool helps;          // it makes parts of a job, and needs none of the others
    char job[RN_ID_MAX]; // whose frames the runner knows:
    char (*frames)[24];
    size_t frame_count, frame_room;
    int64_t looked_ns;
};

static enum rn_status no_memory(struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_NO_MEMORY, "porter", "no memory");
}

// ---- telling of files -----------------------------------------------------------------------

static enum rn_status tell(struct rn_porter *porter, const char *root, const char *name,
                           const char *sha256, struct rn_error *err) {
    struct rn_wire_file file = {.size = 0};
    if (strlen(name) >= sizeof file.path)
        return rn_error_set(err, RN_ERROR_LIMIT, name, "the name is too long to be carried");
    snprintf(file.root, sizeof file.root, "%s", root);
    snprintf(file.path, sizeof file.path, "%s", name);
    snprintf(file.sha256, sizeof file.sha256, "%s", sha256);
    return rn_carry_post(&porter->out, RN_WIRE_HAVE, &file, err);
}

static enum rn_status tell_file(struct rn_porter *porter, const char *root, const char *folder,
                                const char *name, struct rn_error *err) {
    char path[PATH_MAX], sha256[65];
    if (snprintf(path, sizeof path, "%s/%s", folder, name) >= (int)sizeof path)
        return rn_error_set(err, RN_ERROR_LIMIT, folder, "the path is too long");
    enum rn_status status = rn_manifest_digest(path, sha256, err);
    if (status == RN_ERROR_NOT_FOUND) return RN_OK; // it has gone meanwhile
    return status ? status : tell(porter, root, name, sha256, err);
}

struct telling {
    struct rn_porter *porter;
    const char *root;
};

static enum rn_status tell_line(void *context, const char *sha256, const char *name,
                                struct rn_error *err) {
    const struct telling *telling = context;
    return tell(telling->porter, telling->root, name, sha256, err);
}

static bool has_ending(const char *name, const char *ending) {
    size_t size = strlen(name), ends = strlen(ending);
    return size > ends && strcmp(name + size - ends, ending) == 0;
}

// The files of FOLDER/inner/ ("" or "x/"), and with `below` those of the folders in it; frames are
// told of by themselves, for their job.
static enum rn_status tell_folder(struct rn_porter *porter, const char *root, const char *folder,
                                  const char *inner, int below, struct rn_error *err) {
    char path[PATH_MAX], name[PATH_MAX];
    struct stat about;
    struct dirent *entry;
    enum rn_status status = RN_OK;
    snprintf(path, sizeof path, "%s/%s", folder, inner);
    DIR *listed = opendir(path);
    if (listed == NULL) return RN_OK;
    while (status == RN_OK && (entry = readdir(listed)) != NULL) {
        if (!rn_path_is_safe_name(entry->d_name) || strcmp(entry->d_name, "lock") == 0 ||
            has_ending(entry->d_name, ".damaged") ||
            fstatat(dirfd(listed), entry->d_name, &about, AT_SYMLINK_NOFOLLOW) != 0)
            continue;
        bool goes_down =
            S_ISDIR(about.st_mode) && below > 0 && strcmp(entry->d_name, "frames") != 0;
        snprintf(name, sizeof name, "%s%s%s", inner, entry->d_name, goes_down ? "/" : "");
        if (goes_down) status = tell_folder(porter, root, folder, name, below - 1, err);
        if (S_ISREG(about.st_mode)) status = tell_file(porter, root, folder, name, err);
    }
    closedir(listed);
    return status;
}

static enum rn_status tell_dataset(struct rn_porter *porter, struct rn_error *err) {
    struct telling telling = {.porter = porter, .root = RN_CARRY_DATASET};
    enum rn_status status = rn_manifest_read(porter->dataset, tell_line, &telling, err);
    if (status == RN_ERROR_NOT_FOUND) // imported before there were lists
        return tell_folder(porter, RN_CARRY_DATASET, porter->dataset, "", 3, err);
    return status ? status
                  : tell_file(porter, RN_CARRY_DATASET, porter->dataset, "SHA256SUMS", err);
}

// ---- frames of a job ------------------------------------------------------------------------

static bool knows_frame(const struct rn_porter *porter, const char *name) {
    for (size_t i = porter->frame_count; i-- > 0;)
        if (strcmp(porter->frames[i], name) == 0) return true;
    return false;
}

static enum rn_status know_frame(struct rn_porter *porter, const char *name, struct rn_error *err) {
    if (porter->frame_count == porter->frame_room) {
        size_t room = 2 * porter->frame_room + 64;
        void *grown = realloc(porter->frames, room * sizeof *porter->frames);
        if (grown == NULL) return no_memory(err);
        porter->frames = grown;
        porter->frame_room = room;
    }
    snprintf(porter->frames[porter->frame_count++], sizeof *porter->frames, "%s", name);
    return RN_OK;
}

// Tells of what the runner has not made itself and does not know yet.
static enum rn_status tell_frames(struct rn_porter *porter, struct rn_error *err) {
    char path[PATH_MAX], name[PATH_MAX];
    struct dirent *entry;
    enum rn_status status = RN_OK;
    porter->looked_ns = rn_clock_ns();
    snprintf(path, sizeof path, "%s/frames/%s", porter->scene, porter->job);
    DIR *listed = opendir(path);
    if (listed == NULL) return RN_OK;
    while (status == RN_OK && (entry = readdir(listed)) != NULL) {
        const char *file = entry->d_name;
        bool is_one = strcmp(file, ".step") == 0 || (!porter->helps && rn_path_is_safe_name(file));
        if (!is_one || strlen(file) >= sizeof *porter->frames || knows_frame(porter, file))
            continue;
        snprintf(name, sizeof name, "frames/%s/%s", porter->job, file);
        status = tell_file(porter, RN_CARRY_SCENE, porter->scene, name, err);
        if (status == RN_OK) status = know_frame(porter, file, err);
    }
    closedir(listed);
    return status;
}

// ---- from the control -----------------------------------------------------------------------

static enum rn_status tell_scene(struct rn_porter *porter, const struct rn_wire_message *message,
                                 struct rn_error *err) {
    struct rn_wire_open open;
    enum rn_status status = rn_wire_take(message, &open, err);
    if (status != RN_OK) return status;
    free(porter->dataset);
    porter->dataset = strdup(open.dataset_folder);
    porter->helps = open.helps;
    rn_message_finish(rn_wire_table(RN_WIRE_OPEN), &open);
    if (porter->dataset == NULL) return no_memory(err);
    if (*porter->dataset) status = tell_dataset(porter, err); // "": the scene has none here
    return status ? status : tell_folder(porter, RN_CARRY_SCENE, porter->scene, "", 1, err);
}

static enum rn_status tell_job(struct rn_porter *porter, const char *job, struct rn_error *err) {
    if (strcmp(porter->job, job) != 0) porter->frame_count = 0;
    snprintf(porter->job, sizeof porter->job, "%s", job);
    return tell_frames(porter, err);
}

static enum rn_status tell_parts(struct rn_porter *porter, const struct rn_wire_message *message,
                                 struct rn_error *err) {
    union {
        struct rn_wire_path path;
        struct rn_wire_eval eval;
        struct rn_wire_export export;
    } any;
    char job[RN_ID_MAX];
    enum rn_status status = rn_wire_take(message, &any, err);
    if (status != RN_OK) return status;
    const char *id = any.path.job;
    if (message->type == RN_WIRE_EVAL) id = any.eval.job;
    if (message->type == RN_WIRE_EXPORT) id = any.export.job;
    snprintf(job, sizeof job, "%s", id);
    rn_message_finish(rn_wire_table(message->type), &any);
    return tell_job(porter, job, err);
}

static enum rn_status pass_out(struct rn_porter *porter, const struct rn_wire_message *message,
                               struct rn_error *err) {
    enum rn_status status = RN_OK;
    if (message->type == RN_WIRE_OPEN) status = tell_scene(porter, message, err);
    if (message->type == RN_WIRE_PATH || message->type == RN_WIRE_EVAL ||
        message->type == RN_WIRE_EXPORT)
        status = tell_parts(porter, message, err);
    return status ? status : rn_carry_pass(&porter->out, message, err);
}

// ---- from the runner ------------------------------------------------------------------------

static enum rn_status place_of(const struct rn_porter *porter, const struct rn_wire_file *file,
                               bool to_write, char ret_path[PATH_MAX], struct rn_error *err) {
    bool scene = strcmp(file->root, RN_CARRY_SCENE) == 0;
    const char *root = scene ? porter->scene : porter->dataset;
    if (root == NULL || (!scene && to_write) || !rn_carry_is_name(file->path) ||
        strcmp(file->path, "lock") == 0)
        return rn_error_set(err, RN_ERROR_INVALID, "carry", "%s: not a file of the runner's scene",
                            file->path);
    if (snprintf(ret_path, PATH_MAX, "%s/%s", root, file->path) >= PATH_MAX)
        return rn_error_set(err, RN_ERROR_LIMIT, root, "the path is too long");
    return RN_OK;
}

// The folder above it is there, or may be made: the scene itself is not, once it is fenced.
static enum rn_status make_folder(const struct rn_porter *porter, const char *path,
                                  struct rn_error *err) {
    char folder[PATH_MAX];
    struct stat about;
    if (stat(porter->scene, &about) != 0)
        return rn_error_from_errno(err, errno, porter->scene, "the runner was given up: open");
    snprintf(folder, sizeof folder, "%s", path);
    *strrchr(folder, '/') = '\0';
    return stat(folder, &about) == 0 ? RN_OK : rn_mkdirs_in(porter->scene, folder, 0700, err);
}

static enum rn_status take_piece(struct rn_porter *porter, const struct rn_wire_file *file,
                                 const struct rn_wire_message *message, struct rn_error *err) {
    char path[PATH_MAX], prefix[64];
    bool whole = false;
    enum rn_status status = place_of(porter, file, true, path, err);
    if (status == RN_OK && file->offset == 0) status = make_folder(porter, path, err);
    if (status == RN_OK) status = rn_carry_take(&porter->out, file, message, path, &whole, err);
    porter->received += (int64_t)message->blob_size;
    int size = snprintf(prefix, sizeof prefix, "frames/%s/", porter->job);
    if (whole && strncmp(file->path, prefix, (size_t)size) == 0 &&
        strlen(file->path + size) < sizeof *porter->frames)
        status = know_frame(porter, file->path + size, err);
    return status;
}

static void append_log(const struct rn_porter *porter, const struct rn_wire_message *message) {
    if (porter->log == NULL || message->blob_size == 0) return;
    int fd = open(porter->log, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
    if (fd < 0 || write(fd, message->blob, message->blob_size) < 0)
        rn_log(RN_LOG_WARN, "%s: %s", porter->log, strerror(errno));
    if (fd >= 0) close(fd);
}

static enum rn_status send_wanted(struct rn_porter *porter, const struct rn_wire_file *file,
                                  const char *path, struct rn_error *err) {
    struct stat about;
    if (stat(path, &about) == 0) porter->sent += about.st_size;
    return rn_carry_send(&porter->out, file->root, file->path, path, err);
}

static enum rn_status serve_file(struct rn_porter *porter, const struct rn_wire_message *message,
                                 struct rn_error *err) {
    struct rn_wire_file file;
    char path[PATH_MAX];
    enum rn_status status = rn_wire_take(message, &file, err);
    if (status != RN_OK) return status;
    if (message->type == RN_WIRE_PIECE) return take_piece(porter, &file, message, err);
    status = place_of(porter, &file, message->type == RN_WIRE_GONE, path, err);
    if (status == RN_OK && message->type == RN_WIRE_WANT)
        status = send_wanted(porter, &file, path, err);
    else if (status == RN_OK && unlink(path) != 0 && errno != ENOENT)
        status = rn_error_from_errno(err, errno, path, "remove the file");
    return status;
}

static enum rn_status pass_in(struct rn_porter *porter, const struct rn_wire_message *message,
                              struct rn_error *err) {
    switch (message->type) {
    case RN_WIRE_WANT:
    case RN_WIRE_PIECE:
    case RN_WIRE_GONE:
        return serve_file(porter, message, err);
    case RN_WIRE_SAID:
        append_log(porter, message);
        return RN_OK;
    default:
        break;
    }
    enum rn_status status =
        rn_wire_queue(&porter->writer, message->type, message->json, message->json_size,
                      message->blob, message->blob_size, err);
    bool due = rn_clock_ns() - porter->looked_ns > LOOK_NS;
    if (status == RN_OK && message->type == RN_WIRE_FRAME && due && !porter->helps)
        status = tell_frames(porter, err);
    return status;
}

// ---- the loop -------------------------------------------------------------------------------

static enum rn_status read_all(struct rn_porter *porter, struct rn_wire_reader *reader,
                               enum rn_status (*pass)(struct rn_porter *porter,
                                                      const struct rn_wire_message *message,
                                                      struct rn_error *err),
                               struct rn_error *err) {
    struct rn_wire_message message;
    bool ready = true;
    enum rn_status status = RN_OK;
    while (status == RN_OK && ready) {
        status = rn_wire_read(reader, &ready, &message, err);
        if (status != RN_OK || !ready) break;
        status = pass(porter, &message, err);
        rn_wire_message_finish(&message);
    }
    return status;
}

static enum rn_status serve_once(struct rn_porter *porter, struct rn_error *err) {
    bool idle = porter->writer.sent == porter->writer.pending.size;
    bool empty = rn_carry_is_empty(&porter->out);
    struct pollfd polls[2] = {
        {.fd = porter->inner, .events = (short)(POLLIN | (idle ? 0 : POLLOUT))},
        {.fd = porter->outer, .events = (short)(POLLIN | (empty ? 0 : POLLOUT))}};
    if (poll(polls, 2, TICK_MS) < 0 && errno != EINTR)
        return rn_error_from_errno(err, errno, "porter", "wait");
    enum rn_status status = read_all(porter, &porter->out.reader, pass_in, err);
    // What the runner said last is handed over, whatever has become of it.
    struct rn_error unsaid;
    if (rn_wire_flush(&porter->writer, &idle, status ? &unsaid : err) != RN_OK && !status)
        status = RN_ERROR_UNAVAILABLE;
    if (status == RN_OK) status = read_all(porter, &porter->reader, pass_out, err);
    return status ? status : rn_carry_flush(&porter->out, err);
}

static void *serve(void *context) {
    struct rn_porter *porter = context;
    struct rn_error err = {0};
    while (serve_once(porter, &err) == RN_OK)
        continue;
    if (err.status != RN_ERROR_UNAVAILABLE)
        rn_log(RN_LOG_ERROR, "a runner's files: %s: %s", err.where, err.text);
    rn_log(RN_LOG_INFO, "files carried: %lld bytes to a runner, %lld from it",
           (long long)porter->sent, (long long)porter->received);
    (void)!rn_wire_drain(&porter->writer, &err);
    shutdown(porter->inner, SHUT_RDWR);
    shutdown(porter->outer, SHUT_RDWR);
    return NULL;
}

static void free_porter(struct rn_porter *porter) {
    rn_carry_finish(&porter->out);
    rn_wire_reader_finish(&porter->reader);
    rn_wire_writer_finish(&porter->writer);
    if (porter->inner >= 0) close(porter->inner);
    if (porter->outer >= 0) close(porter->outer);
    free(porter->scene);
    free(porter->log);
    free(porter->dataset);
    free(porter->frames);
    free(porter);
}

enum rn_status rn_porter_start(int fd, const char *scene, const char *log, int *ret_fd,
                               struct rn_porter **ret_porter, struct rn_error *err) {
    struct rn_porter *porter = calloc(1, sizeof *porter);
    int pair[2];
    if (porter == NULL) return no_memory(err);
    porter->inner = porter->outer = -1;
    porter->scene = strdup(scene);
    porter->log = log != NULL ? strdup(log) : NULL;
    rn_carry_init(&porter->out, fd, true);
    if (porter->scene == NULL || (log != NULL && porter->log == NULL)) {
        free_porter(porter);
        return no_memory(err);
    }
    if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0, pair) != 0) {
        free_porter(porter);
        return rn_error_from_errno(err, errno, "porter", "open a socket pair");
    }
    porter->inner = pair[0];
    rn_wire_reader_init(&porter->reader, pair[0]);
    rn_wire_writer_init(&porter->writer, pair[0], 0);
    porter->outer = fd;
    if (pthread_create(&porter->thread, NULL, serve, porter) != 0) {
        porter->outer = -1; // still the caller's
        close(pair[1]);
        free_porter(porter);
        return rn_error_set(err, RN_ERROR_IO, "porter", "a thread cannot be started");
    }
    *ret_fd = pair[1];
    *ret_porter = porter;
    return RN_OK;
}

void rn_porter_stop(struct rn_porter **porter) {
    if (*porter == NULL) return;
    shutdown((*porter)->inner, SHUT_RDWR);
    shutdown((*porter)->outer, SHUT_RDWR);
    pthread_join((*porter)->thread, NULL);
    free_porter(*porter);
    *porter = NULL;
}

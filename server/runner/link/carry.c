#include "server/runner/link/carry.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/log.h"
#include "common/base/manifest.h"
#include "proto/carry.h"
#include "proto/join.h"
#include "server/runner/link/cache.h"
#include "server/runner/link/join.h"

#define FIELD_FD 3
#define MOST_WANTED 16  // files that are asked for at once
#define MOST_WAITING 64 // messages and files to be sent, until the field waits
#define TICK_MS 500
#define WORDS_BYTES 4096

// A file of the scene or dataset that the daemon has, too.
struct known {
    char name[256]; // "scene/...", "dataset/..."
    char sha256[65];
    off_t size; // and the rest: as it is here; 0 while it is not
    struct timespec changed;
    ino_t inode;
    bool wanted, asked, seen;
};

// A message of the daemon's that waits for the files before it.
struct held {
    struct held *next;
    struct rn_wire_message message;
};

struct carrier {
    struct rn_cache cache;
    char work[PATH_MAX]; // with scene/ and dataset/
    bool sandbox;
    struct rn_carry up; // to the daemon
    int up_fd, lock;
    pid_t field;
    int field_fd, words_fd; // -1: it does not run
    struct rn_wire_reader reader;
    struct rn_wire_writer writer;
    struct known *known;
    size_t known_count, known_room, wanted, asked;
    struct held *first, *last;
    char *scene, *dataset; // as the daemon names them; NULL before they are opened
    bool told, up_closed;
    int64_t said_ns;
};

static volatile sig_atomic_t is_ending;

static void note_end(int signal_number) {
    is_ending = 1;
}

static enum rn_status no_memory(struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_NO_MEMORY, "carry", "no memory");
}

// ---- what is known -------------------------------------------------------------------------

static enum rn_status local_path(const struct carrier *c, const char *name, char ret_path[PATH_MAX],
                                 struct rn_error *err) {
    if (snprintf(ret_path, PATH_MAX, "%s/%s", c->work, name) >= PATH_MAX)
        return rn_error_set(err, RN_ERROR_LIMIT, name, "the path is too long");
    return RN_OK;
}

static struct known *find_known(struct carrier *c, const char *name) {
    for (size_t i = c->known_count; i-- > 0;)
        if (strcmp(c->known[i].name, name) == 0) return &c->known[i];
    return NULL;
}

static struct known *add_known(struct carrier *c, const char *name) {
    if (strlen(name) >= sizeof c->known->name) return NULL;
    if (c->known_count == c->known_room) {
        size_t room = 2 * c->known_room + 256;
        struct known *grown = realloc(c->known, room * sizeof *grown);
        if (!grown) return NULL;
        c->known = grown;
        c->known_room = room;
    }
    struct known *known = &c->known[c->known_count++];
    *known = (struct known){.size = 0};
    snprintf(known->name, sizeof known->name, "%s", name);
    return known;
}

static void note_as_is(struct known *known, const struct stat *about) {
    known->size = about->st_size;
    known->changed = about->st_mtim;
    known->inode = about->st_ino;
}

static bool is_as_noted(const struct known *known, const struct stat *about) {
    return known->inode == about->st_ino && known->size == about->st_size &&
           known->changed.tv_sec == about->st_mtim.tv_sec &&
           known->changed.tv_nsec == about->st_mtim.tv_nsec;
}

// ---- fetching ------------------------------------------------------------------------------

static enum rn_status make_parent(const char *path, struct rn_error *err) {
    char folder[PATH_MAX];
    snprintf(folder, sizeof folder, "%s", path);
    *strrchr(folder, '/') = '\0';
    return rn_mkdirs(folder, 0700, err);
}

static enum rn_status full_name(const struct rn_wire_file *file, char ret_name[300],
                                struct rn_error *err) {
    bool scene = strcmp(file->root, RN_CARRY_SCENE) == 0;
    if ((!scene && strcmp(file->root, RN_CARRY_DATASET) != 0) || !rn_carry_is_name(file->path))
        return rn_error_set(err, RN_ERROR_CORRUPT, "carry", "%.200s is not a file's name",
                            file->path);
    snprintf(ret_name, 300, "%s/%s", file->root, file->path);
    return RN_OK;
}

static enum rn_status take_have(struct carrier *c, const struct rn_wire_file *file,
                                struct rn_error *err) {
    char name[300], path[PATH_MAX];
    struct stat about;
    enum rn_status status = full_name(file, name, err);
    if (!status) status = local_path(c, name, path, err);
    if (status) return status;
    struct known *known = find_known(c, name);
    if (known && strcmp(known->sha256, file->sha256) == 0) return RN_OK;
    if (!known && !(known = add_known(c, name))) return no_memory(err);
    snprintf(known->sha256, sizeof known->sha256, "%s", file->sha256);
    status = make_parent(path, err);
    if (status) return status;
    if (rn_cache_take(&c->cache, file->sha256, path) && stat(path, &about) == 0) {
        note_as_is(known, &about);
    } else if (!known->wanted) {
        known->wanted = true;
        c->wanted++;
    }
    return RN_OK;
}

// Asks for some of what is wanted.
static enum rn_status ask(struct carrier *c, struct rn_error *err) {
    enum rn_status status = RN_OK;
    for (size_t i = 0; i < c->known_count && c->wanted && c->asked < MOST_WANTED && !status; i++) {
        struct known *known = &c->known[i];
        struct rn_wire_file file = {.size = 0};
        if (!known->wanted || known->asked) continue;
        const char *slash = strchr(known->name, '/');
        snprintf(file.root, sizeof file.root, "%.*s", (int)(slash - known->name), known->name);
        snprintf(file.path, sizeof file.path, "%.255s", slash + 1);
        status = rn_carry_post(&c->up, RN_WIRE_WANT, &file, err);
        known->asked = true;
        c->asked++;
    }
    return status;
}

static enum rn_status take_piece(struct carrier *c, const struct rn_wire_file *file,
                                 const struct rn_wire_message *message, struct rn_error *err) {
    char name[300], path[PATH_MAX];
    struct stat about;
    bool whole = false;
    enum rn_status status = full_name(file, name, err);
    if (!status) status = local_path(c, name, path, err);
    struct known *known = status ? NULL : find_known(c, name);
    if (!status && (!known || !known->asked))
        status = rn_error_set(err, RN_ERROR_CORRUPT, name, "nobody asked for it");
    if (!status) status = rn_carry_take(&c->up, file, message, path, &whole, err);
    if (status || !whole) return status;
    known->wanted = known->asked = false;
    c->wanted--;
    c->asked--;
    snprintf(known->sha256, sizeof known->sha256, "%s", file->sha256);
    rn_cache_keep(&c->cache, file->sha256, path);
    if (stat(path, &about) == 0) note_as_is(known, &about);
    if (c->wanted == 0) rn_cache_trim(&c->cache);
    return RN_OK;
}

// ---- sending -------------------------------------------------------------------------------

static enum rn_status send_file(struct carrier *c, const char *name, const char *path,
                                const struct stat *about, struct rn_error *err) {
    struct known *known = find_known(c, name);
    if (!known && !(known = add_known(c, name))) return no_memory(err);
    const char *slash = strchr(name, '/');
    enum rn_status status = rn_carry_send(&c->up, RN_CARRY_SCENE, slash + 1, path, err);
    if (status == RN_ERROR_NOT_FOUND) return RN_OK; // it has gone meanwhile
    known->sha256[0] = '\0';
    known->seen = true;
    note_as_is(known, about);
    // Another runner of this node may load it.
    if (!status && strncmp(slash, "/checkpoints/", 13) == 0 &&
        rn_manifest_digest(path, known->sha256, err) == RN_OK) {
        rn_cache_keep(&c->cache, known->sha256, path);
        rn_cache_trim(&c->cache);
    }
    return status;
}

static enum rn_status look_at(struct carrier *c, const char *name, struct rn_error *err) {
    char path[PATH_MAX];
    struct stat about;
    enum rn_status status = local_path(c, name, path, err);
    if (status || stat(path, &about) != 0 || !S_ISREG(about.st_mode)) return status;
    struct known *known = find_known(c, name);
    if (known && (known->wanted || is_as_noted(known, &about))) {
        known->seen = true;
        return RN_OK;
    }
    return send_file(c, name, path, &about, err);
}

static enum rn_status look_through(struct carrier *c, const char *folder, int below,
                                   struct rn_error *err) {
    char path[PATH_MAX], name[PATH_MAX];
    struct stat about;
    struct dirent *entry;
    enum rn_status status = local_path(c, folder, path, err);
    DIR *listed = status ? NULL : opendir(path);
    if (!listed) return status;
    while (!status && (entry = readdir(listed)) != NULL) {
        bool is_one = rn_path_is_safe_name(entry->d_name) || strcmp(entry->d_name, ".step") == 0;
        if (!is_one || (below == 2 && strcmp(entry->d_name, "lock") == 0) ||
            fstatat(dirfd(listed), entry->d_name, &about, AT_SYMLINK_NOFOLLOW) != 0)
            continue;
        snprintf(name, sizeof name, "%.3000s/%.1000s", folder, entry->d_name);
        if (S_ISDIR(about.st_mode) && below > 0) status = look_through(c, name, below - 1, err);
        if (S_ISREG(about.st_mode)) status = look_at(c, name, err);
    }
    closedir(listed);
    return status;
}

static enum rn_status send_gone(struct carrier *c, struct rn_error *err) {
    size_t kept = 0;
    enum rn_status status = RN_OK;
    for (size_t i = 0; i < c->known_count; i++) {
        struct known *known = &c->known[i];
        bool gone = strncmp(known->name, "scene/", 6) == 0 && !known->seen && !known->wanted;
        struct rn_wire_file file = {.root = RN_CARRY_SCENE};
        snprintf(file.path, sizeof file.path, "%s", known->name + 6);
        if (gone && !status) status = rn_carry_post(&c->up, RN_WIRE_GONE, &file, err);
        if (!gone) c->known[kept++] = *known;
    }
    c->known_count = kept;
    return status;
}

// All that the field has changed in its scene's folder.
static enum rn_status send_changes(struct carrier *c, struct rn_error *err) {
    for (size_t i = 0; i < c->known_count; i++)
        c->known[i].seen = false;
    enum rn_status status = look_through(c, RN_CARRY_SCENE, 2, err);
    return status ? status : send_gone(c, err);
}

static enum rn_status look_at_part(struct carrier *c, const struct rn_wire_frame *frame,
                                   const char *ending, struct rn_error *err) {
    char name[200];
    snprintf(name, sizeof name, RN_CARRY_SCENE "/frames/%s/%05lld.%s", frame->job,
             (long long)frame->index, ending);
    return look_at(c, name, err);
}

// Of a path or an evaluation: what the message speaks of, and of which step it is.
static enum rn_status send_frame(struct carrier *c, const struct rn_wire_message *message,
                                 struct rn_error *err) {
    struct rn_wire_frame frame;
    char name[200];
    enum rn_status status = rn_wire_take(message, &frame, err);
    if (status) return status;
    snprintf(name, sizeof name, RN_CARRY_SCENE "/frames/%s/.step", frame.job);
    status = look_at(c, name, err);
    if (!status) status = look_at_part(c, &frame, "json", err);
    for (int i = 0; rn_picture_format_extensions[i] && !status; i++)
        status = look_at_part(c, &frame, rn_picture_format_extensions[i], err);
    return status;
}

// ---- the field -----------------------------------------------------------------------------

static void become_field(int fd, int words, bool sandbox) {
    char *const argv[] = {
        "ripnerf-runner", "--mode", "field", "--fd", "3", sandbox ? "--sandbox" : NULL, NULL};
    int nothing = open("/dev/null", O_RDONLY);
    signal(SIGTERM, SIG_IGN); // it learns of the end by its connection, and saves
    if (nothing < 0 || dup2(nothing, 0) < 0 || dup2(words, 1) < 0 || dup2(words, 2) < 0 ||
        dup2(fd, FIELD_FD) < 0)
        _exit(126);
    execv("/proc/self/exe", argv);
    _exit(127);
}

static enum rn_status start_field(struct carrier *c, struct rn_error *err) {
    int pair[2], words[2];
    if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair) != 0)
        return rn_error_from_errno(err, errno, "field", "open a socket pair");
    if (pipe2(words, O_CLOEXEC | O_NONBLOCK) != 0) {
        close(pair[0]);
        close(pair[1]);
        return rn_error_from_errno(err, errno, "field", "open a pipe");
    }
    // The child's ends must not be FIELD_FD itself: dup2 to the same number keeps close-on-exec.
    int child = fcntl(pair[1], F_DUPFD_CLOEXEC, FIELD_FD + 1);
    c->field = child < 0 ? -1 : fork();
    if (c->field == 0) become_field(child, words[1], c->sandbox);
    int errnum = errno;
    close(pair[1]);
    close(words[1]);
    if (child >= 0) close(child);
    if (c->field < 0) {
        close(pair[0]);
        close(words[0]);
        return rn_error_from_errno(err, errnum, "field", "start it");
    }
    c->field_fd = pair[0];
    c->words_fd = words[0];
    rn_wire_reader_init(&c->reader, pair[0]);
    rn_wire_writer_init(&c->writer, pair[0], 0);
    return RN_OK;
}

static enum rn_status open_scene(struct carrier *c, const struct rn_wire_message *message,
                                 struct rn_error *err) {
    struct rn_wire_open open;
    enum rn_status status = rn_wire_take(message, &open, err);
    if (status) return status;
    free(c->scene);
    free(c->dataset);
    c->scene = strdup(open.scene_folder);
    c->dataset = strdup(open.dataset_folder);
    rn_message_finish(rn_wire_table(RN_WIRE_OPEN), &open);
    if (!c->scene || !c->dataset) return no_memory(err);
    return c->field_fd < 0 ? start_field(c, err) : RN_OK;
}

// Hands a message of the daemon's to the field, with the folders that it has here.
static enum rn_status pass_down(struct carrier *c, struct rn_wire_message *message,
                                struct rn_error *err) {
    char scene[PATH_MAX], dataset[PATH_MAX];
    enum rn_status status = local_path(c, RN_CARRY_SCENE, scene, err);
    if (!status) status = local_path(c, RN_CARRY_DATASET, dataset, err);
    if (!status && message->type == RN_WIRE_OPEN) status = open_scene(c, message, err);
    if (message->type == RN_WIRE_SHUTDOWN) c->told = true;
    if (status || c->field_fd < 0) return status;
    bool moves = message->type == RN_WIRE_OPEN || message->type == RN_WIRE_PATH ||
                 message->type == RN_WIRE_EVAL || message->type == RN_WIRE_EXPORT;
    if (moves) status = rn_carry_move(message, c->scene, scene, err);
    if (moves && !status && *c->dataset) status = rn_carry_move(message, c->dataset, dataset, err);
    if (status) return status;
    return rn_wire_queue(&c->writer, message->type, message->json, message->json_size,
                         message->blob, message->blob_size, err);
}

// ---- both ways -----------------------------------------------------------------------------

static enum rn_status hold(struct carrier *c, struct rn_wire_message *message,
                           struct rn_error *err) {
    struct held *held = calloc(1, sizeof *held);
    if (!held) return no_memory(err);
    held->message = *message;
    *message = (struct rn_wire_message){.json = NULL};
    if (c->first)
        c->last->next = held;
    else
        c->first = held;
    c->last = held;
    return RN_OK;
}

static enum rn_status release_held(struct carrier *c, struct rn_error *err) {
    enum rn_status status = RN_OK;
    while (c->first && c->wanted == 0 && !status) {
        struct held *held = c->first;
        c->first = held->next;
        status = pass_down(c, &held->message, err);
        rn_wire_message_finish(&held->message);
        free(held);
    }
    return status;
}

static enum rn_status take_from_daemon(struct carrier *c, struct rn_wire_message *message,
                                       struct rn_error *err) {
    struct rn_wire_file file;
    if (message->type != RN_WIRE_HAVE && message->type != RN_WIRE_PIECE)
        return hold(c, message, err);
    enum rn_status status = rn_wire_take(message, &file, err);
    if (status) return status;
    return message->type == RN_WIRE_HAVE ? take_have(c, &file, err)
                                         : take_piece(c, &file, message, err);
}

static enum rn_status take_from_field(struct carrier *c, struct rn_wire_message *message,
                                      struct rn_error *err) {
    enum rn_status status = RN_OK;
    if (c->up_closed) return RN_OK;
    switch (message->type) {
    case RN_WIRE_HELLO: // was said for it
        return RN_OK;
    case RN_WIRE_FRAME:
        status = send_frame(c, message, err);
        break;
    case RN_WIRE_STATE:
    case RN_WIRE_CHECKPOINT:
    case RN_WIRE_INCIDENT:
    case RN_WIRE_DONE:
    case RN_WIRE_FAILED:
        status = send_changes(c, err);
        break;
    default:
        break;
    }
    c->said_ns = rn_clock_ns();
    return status ? status : rn_carry_pass(&c->up, message, err);
}

static enum rn_status read_all(struct carrier *c, struct rn_wire_reader *reader,
                               enum rn_status (*take)(struct carrier *c,
                                                      struct rn_wire_message *message,
                                                      struct rn_error *err),
                               struct rn_error *err) {
    struct rn_wire_message message;
    bool ready = true;
    enum rn_status status = RN_OK;
    while (!status && ready) {
        status = rn_wire_read(reader, &ready, &message, err);
        if (status || !ready) break;
        status = take(c, &message, err);
        rn_wire_message_finish(&message);
    }
    return status;
}

static enum rn_status pass_words(struct carrier *c, struct rn_error *err) {
    uint8_t words[WORDS_BYTES];
    char nothing[] = "{}";
    enum rn_status status = RN_OK;
    ssize_t size;
    while (!status && c->words_fd >= 0 && (size = read(c->words_fd, words, sizeof words)) > 0) {
        const struct rn_wire_message message = {.type = RN_WIRE_SAID,
                                                .json = nothing,
                                                .json_size = 2,
                                                .blob = words,
                                                .blob_size = (size_t)size};
        status = rn_carry_pass(&c->up, &message, err);
    }
    return status;
}

// While files arrive, the field says nothing yet.
static enum rn_status say_alive(struct carrier *c, struct rn_error *err) {
    char nothing[] = "{}";
    int64_t now_ns = rn_clock_ns();
    if (c->field_fd >= 0 || now_ns - c->said_ns < RN_WIRE_ALIVE_S * 1000000000ll) return RN_OK;
    c->said_ns = now_ns;
    struct rn_wire_message message = {.type = RN_WIRE_ALIVE, .json = nothing, .json_size = 2};
    return rn_carry_pass(&c->up, &message, err);
}

static enum rn_status say_hello(struct carrier *c, struct rn_error *err) {
    struct rn_wire_hello hello = {
        .version = RIPNERF_VERSION, .protocol = RN_WIRE_PROTOCOL, .mode = "field", .pid = getpid()};
    return rn_wire_post(&c->up.writer, RN_WIRE_HELLO, &hello, NULL, 0, err);
}

// The daemon's side; what is wrong there ends the field, which saves.
static enum rn_status serve_daemon(struct carrier *c, struct rn_error *err) {
    enum rn_status status = read_all(c, &c->up.reader, take_from_daemon, err);
    if (!status) status = ask(c, err);
    if (!status) status = release_held(c, err);
    if (!status) status = say_alive(c, err);
    if (!status) status = rn_carry_flush(&c->up, err);
    return status;
}

static bool hears_field(const struct carrier *c) {
    return c->field_fd >= 0 && (c->up.waiting < MOST_WAITING || c->up_closed);
}

// The field's side; RN_ERROR_UNAVAILABLE: it has ended.
static enum rn_status serve_field(struct carrier *c, struct rn_error *err) {
    bool empty;
    struct rn_error unsaid;
    if (!hears_field(c)) return RN_OK;
    enum rn_status status = pass_words(c, err);
    if (!status) status = read_all(c, &c->reader, take_from_field, err);
    if (!status && rn_wire_flush(&c->writer, &empty, &unsaid) != RN_OK)
        status = read_all(c, &c->reader, take_from_field, err); // its end is still to be read
    return status;
}

static enum rn_status wait_for_news(struct carrier *c, struct rn_error *err) {
    bool waits = c->field_fd >= 0 && c->writer.sent < c->writer.pending.size;
    struct pollfd polls[3] = {
        {.fd = c->up_closed ? -1 : c->up_fd,
         .events = (short)(POLLIN | (rn_carry_is_empty(&c->up) ? 0 : POLLOUT))},
        {.fd = hears_field(c) ? c->field_fd : -1,
         .events = (short)(POLLIN | (waits ? POLLOUT : 0))},
        {.fd = hears_field(c) ? c->words_fd : -1, .events = POLLIN}};
    if (poll(polls, 3, TICK_MS) < 0 && errno != EINTR)
        return rn_error_from_errno(err, errno, "carry", "wait");
    if (polls[2].revents & POLLHUP && !(polls[2].revents & POLLIN)) {
        close(c->words_fd);
        c->words_fd = -1;
    }
    return RN_OK;
}

// No more is said to the field: it saves and ends.
static void end_field(struct carrier *c) {
    if (c->field_fd >= 0) shutdown(c->field_fd, SHUT_WR);
}

static enum rn_status run(struct carrier *c, struct rn_error *err) {
    bool asked_to_end = false;
    enum rn_status status = say_hello(c, err);
    while (!status) {
        if (is_ending && !asked_to_end) {
            asked_to_end = true;
            end_field(c);
            if (c->field_fd < 0) return RN_OK;
        }
        status = wait_for_news(c, err);
        struct rn_error gone = {0};
        if (!status && !c->up_closed && serve_daemon(c, &gone) != RN_OK) {
            if (gone.status != RN_ERROR_UNAVAILABLE)
                rn_log(RN_LOG_ERROR, "%s: %s", gone.where, gone.text);
            c->up_closed = true;
            end_field(c);
            if (c->field_fd < 0) return RN_OK;
        }
        if (!status) status = serve_field(c, err);
    }
    return status;
}

// What the field has left behind is sent, even if it could not say so any more.
static void send_rest(struct carrier *c) {
    struct rn_error err = {0};
    enum rn_status status = pass_words(c, &err);
    if (!status && c->scene) status = send_changes(c, &err);
    while (!status && !rn_carry_is_empty(&c->up)) {
        struct pollfd polled = {.fd = c->up_fd, .events = POLLOUT};
        if (poll(&polled, 1, -1) < 0 && errno != EINTR) break;
        status = rn_carry_flush(&c->up, &err);
    }
    if (status) rn_log(RN_LOG_ERROR, "%s: %s", err.where, err.text);
}

static int end_code(struct carrier *c) {
    int ended = 0;
    if (c->field_fd >= 0) close(c->field_fd);
    if (c->field > 0 && waitpid(c->field, &ended, 0) < 0) return RN_JOIN_EXIT_LOST;
    if (c->told) return 0;
    if (WIFSIGNALED(ended)) return 128 + WTERMSIG(ended);
    return WEXITSTATUS(ended) ? WEXITSTATUS(ended) : RN_JOIN_EXIT_LOST;
}

static void finish(struct carrier *c) {
    while (c->first) {
        struct held *held = c->first;
        c->first = held->next;
        rn_wire_message_finish(&held->message);
        free(held);
    }
    rn_carry_finish(&c->up);
    rn_wire_reader_finish(&c->reader);
    rn_wire_writer_finish(&c->writer);
    if (c->words_fd >= 0) close(c->words_fd);
    close(c->up_fd);
    if (rn_remove_tree(c->work, NULL) != RN_OK) rn_log(RN_LOG_WARN, "%s stays", c->work);
    close(c->lock);
    free(c->known);
    free(c->scene);
    free(c->dataset);
}

static enum rn_status make_folders(struct carrier *c, struct rn_error *err) {
    static const char *const names[] = {RN_CARRY_SCENE, RN_CARRY_DATASET};
    char path[PATH_MAX];
    enum rn_status status = RN_OK;
    for (int i = 0; i < 2 && !status; i++) {
        status = local_path(c, names[i], path, err);
        if (!status) status = rn_mkdirs(path, 0700, err);
    }
    return status;
}

int rn_runner_carry(const struct rn_carry_options *options) {
    struct carrier c = {.sandbox = options->sandbox, .field_fd = -1, .words_fd = -1};
    struct rn_error err = {0};
    struct sigaction action = {.sa_handler = note_end};
    enum rn_status status = rn_cache_open(options->cache, options->cache_bytes, &c.cache, &err);
    if (!status) status = rn_cache_work(&c.cache, options->name, c.work, &c.lock, &err);
    if (!status) status = make_folders(&c, &err);
    if (status) {
        rn_log(RN_LOG_ERROR, "%s: %s", err.where, err.text);
        return RN_JOIN_EXIT_NO_CACHE;
    }
    status = rn_join_daemon_by(STDIN_FILENO, options->name, &c.up_fd, &err);
    if (status) {
        rn_log(RN_LOG_ERROR, "%s: %s", err.where, err.text);
        (void)!rn_remove_tree(c.work, NULL);
        close(c.lock);
        return RN_JOIN_EXIT_ALONE;
    }
    sigaction(SIGTERM, &action, NULL);
    rn_carry_init(&c.up, c.up_fd, false);
    c.said_ns = rn_clock_ns();
    status = run(&c, &err);
    if (status && status != RN_ERROR_UNAVAILABLE)
        rn_log(RN_LOG_ERROR, "%s: %s", err.where, err.text);
    if (!c.up_closed) send_rest(&c);
    int code = end_code(&c);
    finish(&c);
    return code;
}

#include "proto/carry.h"

#include <errno.h>
#include <fcntl.h>
#include <libgen.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/file.h"
#include "proto/json_text.h"

#define PIECE_BYTES (1 << 20)
#define MOST_COMPONENTS 4

struct rn_cargo {
    struct rn_cargo *next;
    struct rn_wire_message message; // where fd is -1
    int fd;                         // of a file
    struct rn_wire_file file;       // offset: sent so far
    struct rn_sha256 hash;
};

static enum rn_status no_memory(struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_NO_MEMORY, "carry", "no memory");
}

void rn_carry_init(struct rn_carry *carry, int fd, bool durable) {
    *carry = (struct rn_carry){.durable = durable, .fd = -1};
    rn_wire_reader_init(&carry->reader, fd);
    rn_wire_writer_init(&carry->writer, fd, 0);
}

static void free_cargo(struct rn_cargo *cargo) {
    if (cargo->fd >= 0) close(cargo->fd);
    rn_wire_message_finish(&cargo->message);
    free(cargo);
}

static void give_up_file(struct rn_carry *carry) {
    if (carry->fd < 0) return;
    close(carry->fd);
    unlink(carry->own);
    carry->fd = -1;
}

void rn_carry_finish(struct rn_carry *carry) {
    while (carry->first) {
        struct rn_cargo *cargo = carry->first;
        carry->first = cargo->next;
        free_cargo(cargo);
    }
    give_up_file(carry);
    rn_wire_reader_finish(&carry->reader);
    rn_wire_writer_finish(&carry->writer);
}

// ---- sending -------------------------------------------------------------------------------

static struct rn_cargo *append(struct rn_carry *carry) {
    struct rn_cargo *cargo = calloc(1, sizeof *cargo);
    if (!cargo) return NULL;
    cargo->fd = -1;
    if (carry->first)
        carry->last->next = cargo;
    else
        carry->first = cargo;
    carry->last = cargo;
    carry->waiting++;
    return cargo;
}

// Takes json and blob over.
static enum rn_status append_message(struct rn_carry *carry, struct rn_wire_message message,
                                     struct rn_error *err) {
    struct rn_cargo *cargo = append(carry);
    if (!cargo) {
        rn_wire_message_finish(&message);
        return no_memory(err);
    }
    cargo->message = message;
    return RN_OK;
}

enum rn_status rn_carry_pass(struct rn_carry *carry, const struct rn_wire_message *message,
                             struct rn_error *err) {
    struct rn_wire_message copy = {.type = message->type,
                                   .json_size = message->json_size,
                                   .blob_size = message->blob_size,
                                   .json = malloc(message->json_size + 1),
                                   .blob = message->blob_size ? malloc(message->blob_size) : NULL};
    if (!copy.json || (message->blob_size && !copy.blob)) {
        rn_wire_message_finish(&copy);
        return no_memory(err);
    }
    memcpy(copy.json, message->json, message->json_size + 1);
    if (copy.blob) memcpy(copy.blob, message->blob, message->blob_size);
    return append_message(carry, copy, err);
}

enum rn_status rn_carry_post(struct rn_carry *carry, enum rn_wire_type type,
                             const struct rn_wire_file *file, struct rn_error *err) {
    struct rn_wire_message message = {.type = (int)type};
    enum rn_status status =
        rn_encode(rn_wire_table((int)type), file, &message.json, &message.json_size, err);
    return status ? status : append_message(carry, message, err);
}

enum rn_status rn_carry_send(struct rn_carry *carry, const char *root, const char *name,
                             const char *path, struct rn_error *err) {
    struct stat about;
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
    if (fd < 0) return rn_error_from_errno(err, errno, path, "open the file");
    struct rn_cargo *cargo = fstat(fd, &about) == 0 ? append(carry) : NULL;
    if (!cargo) {
        close(fd);
        return no_memory(err);
    }
    cargo->fd = fd;
    cargo->file = (struct rn_wire_file){.size = about.st_size};
    snprintf(cargo->file.root, sizeof cargo->file.root, "%s", root);
    snprintf(cargo->file.path, sizeof cargo->file.path, "%s", name);
    rn_sha256_init(&cargo->hash);
    return RN_OK;
}

bool rn_carry_is_empty(const struct rn_carry *carry) {
    return !carry->first && carry->writer.sent == carry->writer.pending.size;
}

// The next piece of a file; the last one has its digest.
static enum rn_status queue_piece(struct rn_carry *carry, struct rn_cargo *cargo, uint8_t *bytes,
                                  bool *ret_last, struct rn_error *err) {
    struct rn_wire_file *file = &cargo->file;
    int64_t left = file->size - file->offset;
    size_t size = left < PIECE_BYTES ? (size_t)left : PIECE_BYTES, got = 0;
    while (got < size) {
        ssize_t part = read(cargo->fd, bytes + got, size - got);
        if (part < 0 && errno == EINTR) continue;
        if (part <= 0)
            return rn_error_set(err, RN_ERROR_IO, file->path, "became shorter while it was sent");
        got += (size_t)part;
    }
    rn_sha256_update(&cargo->hash, bytes, size);
    *ret_last = (int64_t)size == left;
    struct rn_sha256 hash = cargo->hash;
    if (*ret_last) rn_sha256_final_hex(&hash, file->sha256);
    enum rn_status status = rn_wire_post(&carry->writer, RN_WIRE_PIECE, file, bytes, size, err);
    file->offset += (int64_t)size;
    return status;
}

static enum rn_status queue_next(struct rn_carry *carry, uint8_t *bytes, struct rn_error *err) {
    struct rn_cargo *cargo = carry->first;
    const struct rn_wire_message *message = &cargo->message;
    bool last = true;
    enum rn_status status =
        cargo->fd >= 0 ? queue_piece(carry, cargo, bytes, &last, err)
                       : rn_wire_queue(&carry->writer, message->type, message->json,
                                       message->json_size, message->blob, message->blob_size, err);
    if (!last) return status;
    carry->first = cargo->next;
    carry->waiting--;
    free_cargo(cargo);
    return status;
}

enum rn_status rn_carry_flush(struct rn_carry *carry, struct rn_error *err) {
    if (rn_carry_is_empty(carry)) return RN_OK;
    uint8_t *bytes = malloc(PIECE_BYTES);
    bool empty = false;
    enum rn_status status = bytes ? rn_wire_flush(&carry->writer, &empty, err) : no_memory(err);
    while (!status && empty && carry->first) {
        status = queue_next(carry, bytes, err);
        if (!status) status = rn_wire_flush(&carry->writer, &empty, err);
    }
    free(bytes);
    return status;
}

// ---- receiving -----------------------------------------------------------------------------

static enum rn_status begin_file(struct rn_carry *carry, const struct rn_wire_file *piece,
                                 const char *path, struct rn_error *err) {
    char folder[PATH_MAX];
    give_up_file(carry);
    snprintf(carry->path, sizeof carry->path, "%s", path);
    snprintf(folder, sizeof folder, "%s", path);
    if (snprintf(carry->own, sizeof carry->own, "%s/.in-%d-%d", dirname(folder), (int)getpid(),
                 carry->reader.fd) >= (int)sizeof carry->own)
        return rn_error_set(err, RN_ERROR_LIMIT, path, "the path is too long");
    carry->file = *piece;
    carry->have = 0;
    rn_sha256_init(&carry->hash);
    carry->fd = open(carry->own, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC | O_NOFOLLOW, 0600);
    return carry->fd < 0 ? rn_error_from_errno(err, errno, carry->own, "make the file") : RN_OK;
}

static enum rn_status write_piece(struct rn_carry *carry, const uint8_t *bytes, size_t size,
                                  struct rn_error *err) {
    if (!rn_write_all(carry->fd, bytes, size))
        return rn_error_from_errno(err, errno, carry->own, "write the file");
    rn_sha256_update(&carry->hash, bytes, size);
    carry->have += (int64_t)size;
    return RN_OK;
}

static enum rn_status sync_folder(const char *path, struct rn_error *err) {
    char folder[PATH_MAX];
    snprintf(folder, sizeof folder, "%s", path);
    int fd = open(dirname(folder), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    bool synced = fd >= 0 && fsync(fd) == 0;
    int errnum = errno;
    if (fd >= 0) close(fd);
    return synced ? RN_OK : rn_error_from_errno(err, errnum, path, "sync its folder");
}

static enum rn_status end_file(struct rn_carry *carry, const struct rn_wire_file *piece,
                               struct rn_error *err) {
    char sha256[65];
    rn_sha256_final_hex(&carry->hash, sha256);
    if (strcmp(sha256, piece->sha256) != 0)
        return rn_error_set(err, RN_ERROR_CORRUPT, carry->path,
                            "did not arrive as it was sent: its bytes do not have their digest");
    if (carry->durable && fsync(carry->fd) != 0)
        return rn_error_from_errno(err, errno, carry->own, "sync the file");
    if (rename(carry->own, carry->path) != 0)
        return rn_error_from_errno(err, errno, carry->path, "put the file in place");
    close(carry->fd);
    carry->fd = -1;
    return carry->durable ? sync_folder(carry->path, err) : RN_OK;
}

enum rn_status rn_carry_take(struct rn_carry *carry, const struct rn_wire_file *piece,
                             const struct rn_wire_message *message, const char *path,
                             bool *ret_whole, struct rn_error *err) {
    enum rn_status status = piece->offset == 0 ? begin_file(carry, piece, path, err) : RN_OK;
    *ret_whole = false;
    if (!status && (carry->fd < 0 || piece->offset != carry->have ||
                    strcmp(carry->path, path) != 0 || piece->size != carry->file.size ||
                    carry->have + (int64_t)message->blob_size > piece->size))
        status = rn_error_set(err, RN_ERROR_CORRUPT, path, "arrives in the wrong order");
    if (!status) status = write_piece(carry, message->blob, message->blob_size, err);
    if (!status && carry->have == piece->size) {
        status = end_file(carry, piece, err);
        *ret_whole = status == RN_OK;
    }
    if (status) give_up_file(carry);
    return status;
}

// ---- names ---------------------------------------------------------------------------------

bool rn_carry_is_name(const char *name) {
    char copy[sizeof((struct rn_wire_file *)0)->path], *rest = copy, *part;
    int count = 0;
    if (snprintf(copy, sizeof copy, "%s", name) >= (int)sizeof copy) return false;
    while ((part = strsep(&rest, "/")) != NULL) {
        bool step = rest == NULL && strcmp(part, ".step") == 0;
        if (++count > MOST_COMPONENTS || (!step && !rn_path_is_safe_name(part))) return false;
    }
    return count > 0;
}

static enum rn_status move_member(json_t *object, const char *key, const char *from, const char *to,
                                  struct rn_error *err) {
    const char *text = json_string_value(json_object_get(object, key));
    size_t size = strlen(from);
    char *moved = NULL;
    if (!text || strncmp(text, from, size) != 0 || (text[size] != '/' && text[size] != '\0'))
        return RN_OK;
    if (asprintf(&moved, "%s%s", to, text + size) < 0) return no_memory(err);
    int failed = json_object_set_new(object, key, json_string(moved));
    free(moved);
    return failed ? no_memory(err) : RN_OK;
}

enum rn_status rn_carry_move(struct rn_wire_message *message, const char *from, const char *to,
                             struct rn_error *err) {
    static const char *const keys[] = {"scene_folder", "dataset_folder", "folder"};
    json_t *object = json_loadb(message->json, message->json_size, 0, NULL);
    struct rn_buf text;
    if (!object) return rn_error_set(err, RN_ERROR_CORRUPT, "carry", "a message is no JSON");
    enum rn_status status = RN_OK;
    for (size_t i = 0; i < sizeof keys / sizeof *keys && !status; i++)
        status = move_member(object, keys[i], from, to, err);
    rn_buf_init(&text, RN_WIRE_MAX_JSON);
    if (!status) rn_json_put_value(&text, object);
    if (!status) status = rn_buf_status(&text, "carry", err);
    json_decref(object);
    if (status) {
        rn_buf_finish(&text);
        return status;
    }
    free(message->json);
    message->json_size = text.size;
    message->json = (char *)text.data;
    return RN_OK;
}

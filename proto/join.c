#include "proto/join.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <string.h>
#include <sys/random.h>
#include <unistd.h>

#include "common/base/file.h"

#define FILE_NAME "join"
#define FILE_MAX 1024

static enum rn_status make_secret(char ret_hex[RN_JOIN_SECRET_MAX], struct rn_error *err) {
    unsigned char bytes[(RN_JOIN_SECRET_MAX - 1) / 2];
    if (getrandom(bytes, sizeof bytes, 0) != (ssize_t)sizeof bytes)
        return rn_error_from_errno(err, errno, "secret", "take random bytes");
    for (size_t i = 0; i < sizeof bytes; i++)
        snprintf(ret_hex + 2 * i, 3, "%02x", bytes[i]);
    return RN_OK;
}

enum rn_status rn_join_make(struct rn_join *join, struct rn_error *err) {
    enum rn_status status = make_secret(join->said, err);
    return status == RN_OK ? make_secret(join->heard, err) : status;
}

void rn_join_print(const struct rn_join *join, struct rn_buf *text) {
    rn_buf_printf(text, "%s %u\n%s\n%s\n", join->host, join->port, join->said, join->heard);
}

enum rn_status rn_join_leave(const char *folder, const struct rn_join *join, struct rn_error *err) {
    char path[PATH_MAX];
    struct rn_buf text;
    if (snprintf(path, sizeof path, "%s/" FILE_NAME, folder) >= (int)sizeof path)
        return rn_error_set(err, RN_ERROR_LIMIT, folder, "the path is too long");
    rn_buf_init(&text, FILE_MAX);
    rn_join_print(join, &text);
    enum rn_status status = rn_buf_status(&text, folder, err);
    if (status == RN_OK) status = rn_file_write_atomic(path, text.data, text.size, err);
    if (text.data) explicit_bzero(text.data, text.size);
    rn_buf_finish(&text);
    return status;
}

static enum rn_status parse(const char *text, const char *where, struct rn_join *ret_join,
                            struct rn_error *err) {
    struct rn_join join = {.port = 0};
    unsigned port = 0;
    if (sscanf(text, "%255s %u %64[0-9a-f] %64[0-9a-f]", join.host, &port, join.said, join.heard) !=
            4 ||
        port == 0 || port > 65535)
        return rn_error_set(err, RN_ERROR_CORRUPT, where, "is not what a daemon writes");
    join.port = (uint16_t)port;
    *ret_join = join;
    return RN_OK;
}

enum rn_status rn_join_read(int fd, struct rn_join *ret_join, struct rn_error *err) {
    char text[FILE_MAX];
    size_t have = 0;
    ssize_t got;
    while ((got = read(fd, text + have, sizeof text - 1 - have)) > 0)
        have += (size_t)got;
    if (got < 0) return rn_error_from_errno(err, errno, "join", "read the secret");
    text[have] = '\0';
    enum rn_status status = parse(text, "join", ret_join, err);
    explicit_bzero(text, sizeof text);
    return status;
}

// Opening the folder makes a network file system look for what is new in it.
enum rn_status rn_join_take(const char *folder, struct rn_join *ret_join, struct rn_error *err) {
    char text[FILE_MAX];
    int at = open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (at < 0) return rn_error_from_errno(err, errno, folder, "open the folder");
    int fd = openat(at, FILE_NAME, O_RDONLY | O_CLOEXEC);
    ssize_t size = fd < 0 ? -1 : read(fd, text, sizeof text - 1);
    int errnum = errno;
    if (fd >= 0) close(fd);
    if (fd >= 0 && unlinkat(at, FILE_NAME, 0) != 0) errnum = errno;
    close(at);
    if (fd < 0 && errnum == ENOENT)
        return rn_error_set(err, RN_ERROR_BUSY, folder, "the daemon has left no secret here");
    if (size < 0) return rn_error_from_errno(err, errnum, folder, "read the secret");
    text[size] = '\0';
    return parse(text, folder, ret_join, err);
}

void rn_join_write_greeting(char bytes[RN_JOIN_GREETING], const struct rn_greeting *greeting) {
    memset(bytes, 0, RN_JOIN_GREETING);
    snprintf(bytes, RN_JOIN_GREETING, "RNJ1 %s %s %s", greeting->name, greeting->said,
             greeting->machine);
}

bool rn_join_read_greeting(const char bytes[RN_JOIN_GREETING], struct rn_greeting *ret_greeting) {
    char text[RN_JOIN_GREETING + 1];
    memcpy(text, bytes, RN_JOIN_GREETING);
    text[RN_JOIN_GREETING] = '\0';
    return sscanf(text, "RNJ1 %31[0-9a-z] %64[0-9a-f] %63[0-9A-Za-z._-]", ret_greeting->name,
                  ret_greeting->said, ret_greeting->machine) == 3;
}

bool rn_join_is(const char *secret, const char *other) {
    size_t size = strlen(secret);
    unsigned char differ = 0;
    if (size == 0 || size != strlen(other)) return false;
    for (size_t i = 0; i < size; i++)
        differ |= (unsigned char)(secret[i] ^ other[i]);
    return differ == 0;
}

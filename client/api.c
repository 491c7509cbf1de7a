#include "client/api.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "client/interrupt.h"
#include "common/base/file.h"
#include "proto/problem.h"

#define ANSWER_IDLE_S 120 // seconds without a byte before an answer is given up

static enum rn_exit exit_of_http(int64_t status) {
    switch (status) {
    case 400:
    case 422:
        return RN_EXIT_INVALID;
    case 401:
    case 403:
        return RN_EXIT_UNAUTHORISED;
    case 404:
        return RN_EXIT_NOT_FOUND;
    default:
        return status / 100 == 2 ? RN_EXIT_OK : RN_EXIT_FAILED;
    }
}

static enum rn_exit exit_of_status(enum rn_status status) {
    switch (status) {
    case RN_OK:
        return RN_EXIT_OK;
    case RN_ERROR_INVALID:
        return RN_EXIT_INVALID;
    case RN_ERROR_NOT_FOUND:
        return RN_EXIT_NOT_FOUND;
    case RN_ERROR_CANCELLED:
        return RN_EXIT_CANCELLED;
    case RN_ERROR_UNAVAILABLE:
        return RN_EXIT_UNREACHABLE;
    case RN_ERROR_UNAUTHORISED:
        return RN_EXIT_UNAUTHORISED;
    default:
        return RN_EXIT_FAILED;
    }
}

void rn_client_print(FILE *out, const char *text) {
    for (; *text; text++)
        fputc((unsigned char)*text < ' ' || *text == 0x7f ? '?' : *text, out);
}

static bool errors_are_json;             // set once, before the verb runs
static const struct rn_verb *asked_verb; // as is this; NULL: none

void rn_client_errors_of(const struct rn_verb *verb) {
    asked_verb = verb;
}

void rn_client_errors_as_json(void) {
    errors_are_json = true;
}

struct told_error {
    char *where, *detail; // borrowed
    int64_t exit_code;
};
static const struct rn_field_spec told_fields[] = {
    RN_F_STRING(struct told_error, where, RN_REQUIRED, 4096),
    RN_F_STRING(struct told_error, detail, RN_REQUIRED, 4096),
    RN_F_INT(struct told_error, exit_code, RN_REQUIRED, 0, 255)};
static const struct rn_table told_table = RN_TABLE(struct told_error, "error", told_fields);

void rn_client_error_json(const char *json) {
    fprintf(stderr, "{\"error\":%s}\n", json);
}

// {"error": {"where", "detail", "exit_code"}}; false: no memory.
static bool print_json_error(const char *where, const char *text, enum rn_exit code) {
    struct told_error error = {(char *)where, (char *)text, code};
    char *json = NULL;
    if (rn_encode(&told_table, &error, &json, NULL, NULL) != RN_OK) return false;
    rn_client_error_json(json);
    free(json);
    return true;
}

// "ripnerf: where: text"
static void print_error(const char *where, const char *text, enum rn_exit code) {
    if (errors_are_json && print_json_error(where, text, code)) return;
    fputs("ripnerf: ", stderr);
    rn_client_print(stderr, where);
    if (*where) fputs(": ", stderr);
    rn_client_print(stderr, text);
    fputc('\n', stderr);
}

enum rn_exit rn_client_fail(const struct rn_error *err) {
    print_error(err->where, err->text, exit_of_status(err->status));
    return exit_of_status(err->status);
}

enum rn_exit rn_client_error(enum rn_exit code, const char *where, const char *fmt, ...) {
    char text[512];
    va_list args;
    va_start(args, fmt);
    vsnprintf(text, sizeof text, fmt, args);
    va_end(args);
    print_error(where, text, code);
    return code;
}

enum rn_exit rn_client_not_written(const struct rn_error *err) {
    return rn_client_error(RN_EXIT_FAILED, err->where, "%s", err->text);
}

enum rn_exit rn_client_check_target(const char *file, bool overwrite) {
    struct rn_error err = {0};
    struct stat about;
    const char *slash = strrchr(file, '/');
    if (stat(file, &about) == 0) {
        if (S_ISDIR(about.st_mode)) return rn_client_usage(file, "is a folder; name a file in it");
        if (!overwrite) return rn_client_usage(file, "is there already; --overwrite replaces it");
        if (!S_ISREG(about.st_mode)) return RN_EXIT_OK;
    }
    char *folder = slash ? strndup(file, (size_t)(slash + 1 - file)) : strdup(".");
    int errnum = !folder ? ENOMEM : access(folder, W_OK | X_OK) != 0 ? errno : 0;
    free(folder);
    if (errnum == 0) return RN_EXIT_OK;
    rn_error_from_errno(&err, errnum, file, "create");
    return rn_client_not_written(&err);
}

enum rn_exit rn_client_check_source(const char *path) {
    struct rn_error err = {0};
    struct stat about;
    if (stat(path, &about) == 0 || (errno != ENOENT && errno != ENOTDIR)) return RN_EXIT_OK;
    rn_error_set(&err, RN_ERROR_NOT_FOUND, path, "there is no such file or folder");
    return rn_client_fail(&err);
}

struct made_file {
    char *file; // borrowed
    int64_t bytes;
};
static const struct rn_field_spec made_fields[] = {
    RN_F_STRING(struct made_file, file, RN_REQUIRED, 4096),
    RN_F_INT(struct made_file, bytes, RN_REQUIRED, 0, INT64_MAX)};
static const struct rn_table made_table = RN_TABLE(struct made_file, "file", made_fields);

enum rn_exit rn_client_print_file(const char *file, int64_t bytes) {
    struct made_file made = {(char *)file, bytes};
    char *json = rn_api_encode(&made_table, &made);
    if (json) puts(json);
    free(json);
    return json ? RN_EXIT_OK : RN_EXIT_FAILED;
}

void rn_client_note(const char *fmt, ...) {
    char text[512];
    va_list args;
    if (errors_are_json) return;
    va_start(args, fmt);
    vsnprintf(text, sizeof text, fmt, args);
    va_end(args);
    rn_client_print(stderr, text);
    fputc('\n', stderr);
}

void rn_api_exchange(struct rn_client *client, const struct rn_http_request *request,
                     struct rn_api_reply *ret_reply) {
    struct rn_http_request asked = *request;
    asked.interrupt_fd = rn_interrupt_fd();
    memset(ret_reply, 0, sizeof *ret_reply);
    enum rn_status status =
        rn_http_perform(client->http, &asked, &ret_reply->http, &ret_reply->err);
    ret_reply->code =
        status == RN_OK ? exit_of_http(ret_reply->http.status) : exit_of_status(status);
}

void rn_api_send(struct rn_client *client, const char *method, const char *path, const char *body,
                 struct rn_api_reply *ret_reply) {
    struct rn_http_request request = {.method = method,
                                      .path = path,
                                      .content_type = body ? "application/json" : NULL,
                                      .body = body,
                                      .body_size = body ? strlen(body) : 0,
                                      .idle_s = ANSWER_IDLE_S};
    rn_api_exchange(client, &request, ret_reply);
}

void rn_api_reply_finish(struct rn_api_reply *reply) {
    rn_http_reply_finish(&reply->http);
}

// "#/options/last" is --frames to who typed a command line; a pointer that is of no option stays.
static const char *place_of(const char *pointer, char text[64]) {
    bool known = asked_verb && rn_options_find_member(asked_verb->table, pointer, text, 64);
    return known ? text : pointer;
}

// Of one fault, the detail is its text, with or without its place before it.
static bool is_of_one(const struct rn_api_problem *problem) {
    if (problem->error_count != 1) return false;
    const char *detail = problem->detail, *pointer = problem->errors[0].pointer;
    size_t length = strlen(pointer);
    if (strncmp(detail, pointer, length) == 0 && strncmp(detail + length, ": ", 2) == 0)
        detail += length + 2;
    return strcmp(detail, problem->errors[0].detail) == 0;
}

static void print_problem(const struct rn_api_problem *problem, enum rn_exit code) {
    char place[64];
    if (is_of_one(problem)) { // place and text are said once
        print_error(place_of(problem->errors[0].pointer, place), problem->errors[0].detail, code);
        return;
    }
    print_error(problem->title, problem->detail, code);
    for (size_t i = 0; i < problem->error_count; i++) {
        const char *pointer = problem->errors[i].pointer, *detail = problem->errors[i].detail;
        if (strstr(problem->detail, pointer) && strstr(problem->detail, detail))
            continue; // is said
        fputs("  ", stderr);
        rn_client_print(stderr, place_of(pointer, place));
        fputs(": ", stderr);
        rn_client_print(stderr, detail);
        fputc('\n', stderr);
    }
}

enum rn_exit rn_api_print_problem(const char *json) {
    struct rn_api_problem problem;
    struct rn_error err = {0};
    if (rn_decode(&rn_api_problem_table, json, strlen(json), &problem, NULL, &err) != RN_OK)
        return rn_client_error(RN_EXIT_FAILED, "", "an answer that is no problem document: %.200s",
                               json);
    bool unsupported = strcmp(problem.type, "/problems/unsupported") == 0; // shares 422
    enum rn_exit code = unsupported ? RN_EXIT_FAILED : exit_of_http(problem.status);
    if (errors_are_json)
        rn_client_error_json(json);
    else
        print_problem(&problem, code);
    rn_message_finish(&rn_api_problem_table, &problem);
    return code;
}

enum rn_exit rn_api_complain(const struct rn_api_reply *reply) {
    const char *body = reply->http.body.data ? (const char *)reply->http.body.data : "";
    if (reply->err.status != RN_OK) return rn_client_fail(&reply->err);
    enum rn_exit code = reply->code;
    if (strncmp(reply->http.content_type, "application/problem+json", 24) == 0)
        code = rn_api_print_problem(body);
    else
        rn_client_error(code, "", "HTTP %d: %.200s", reply->http.status, body);
    if (reply->http.status == 401)
        rn_client_note("  a token is given with --token-file FILE or RIPNERF_TOKEN");
    if (reply->http.retry_after_s) rn_client_note("  try again in %d s", reply->http.retry_after_s);
    return code;
}

struct download {
    int fd, errnum; // of the first write that failed; 0: none
};

static bool write_part(void *context, const char *bytes, size_t size) {
    struct download *to = context;
    if (!rn_write_all(to->fd, bytes, size)) to->errnum = errno;
    return to->errnum == 0;
}

enum rn_exit rn_api_download(struct rn_client *client, const char *path, int idle_s, int fd,
                             const char *file) {
    struct download to = {.fd = fd};
    struct rn_error err = {0};
    struct rn_api_reply reply;
    struct rn_http_request request = {
        .method = "GET", .path = path, .receive = write_part, .context = &to, .idle_s = idle_s};
    rn_api_exchange(client, &request, &reply);
    enum rn_exit code = reply.code == RN_EXIT_OK ? RN_EXIT_OK : rn_api_complain(&reply);
    rn_api_reply_finish(&reply);
    if (code != RN_EXIT_OK || to.errnum == 0) return code;
    rn_error_from_errno(&err, to.errnum, file, "write");
    return rn_client_fail(&err);
}

enum rn_exit rn_api_save(struct rn_client *client, const char *path, const char *file) {
    struct rn_error err = {0};
    struct rn_api_reply reply;
    rn_api_send(client, "GET", path, NULL, &reply);
    enum rn_exit code = reply.code == RN_EXIT_OK ? RN_EXIT_OK : rn_api_complain(&reply);
    if (code == RN_EXIT_OK &&
        rn_file_write_atomic(file, reply.http.body.data, reply.http.body.size, &err) != RN_OK)
        code = rn_client_not_written(&err);
    rn_api_reply_finish(&reply);
    return code;
}

enum rn_exit rn_api_decode(const struct rn_api_reply *reply, const struct rn_table *table,
                           void *ret_message) {
    struct rn_error err = {0};
    const struct rn_buf *body = &reply->http.body;
    if (rn_decode(table, body->data ? (const char *)body->data : "", body->size, ret_message, NULL,
                  &err) == RN_OK)
        return RN_EXIT_OK;
    return rn_client_error(RN_EXIT_FAILED, "",
                           "an answer that this client does not understand: %s: %s", err.where,
                           err.text);
}

char *rn_api_encode(const struct rn_table *table, const void *message) {
    struct rn_error err = {0};
    char *json = NULL;
    if (rn_encode(table, message, &json, NULL, &err) != RN_OK) rn_client_fail(&err);
    return json;
}

char *rn_api_path(const char *kind, const char *reference, const char *tail) {
    struct rn_buf path;
    rn_buf_init(&path, SIZE_MAX); // as long as what was typed
    rn_buf_printf(&path, "/v1/%s/", kind);
    rn_http_escape(&path, reference);
    rn_buf_printf(&path, "%s", tail);
    return (char *)rn_buf_take(&path, &(size_t){0});
}

static const struct {
    enum rn_kind kind;
    const char *prefix, *collection, *word;
} kind_table[] = {{RN_KIND_SCENE, RN_ID_SCENE, "scenes", "scene"},
                  {RN_KIND_DATASET, RN_ID_DATASET, "datasets", "dataset"},
                  {RN_KIND_PATH, RN_ID_PATH, "camera-paths", "camera path"},
                  {RN_KIND_JOB, RN_ID_JOB, "jobs", "job"},
                  {RN_KIND_TOKEN, RN_ID_TOKEN, "tokens", "token"}};
#define KIND_COUNT (sizeof kind_table / sizeof *kind_table)

const char *rn_api_collection(enum rn_kind kind) {
    for (size_t i = 0; i < KIND_COUNT; i++)
        if (kind_table[i].kind == kind) return kind_table[i].collection;
    return "";
}

static bool has_prefix(const char *text, const char *prefix) {
    return strncmp(text, prefix, strlen(prefix)) == 0;
}

// The kinds that a reference can be of: one for an id, all that have names for a name.
static unsigned kinds_of(const char *reference) {
    for (size_t i = 0; i < KIND_COUNT; i++)
        if (has_prefix(reference, kind_table[i].prefix)) return kind_table[i].kind;
    return RN_KIND_DATASET | RN_KIND_SCENE | RN_KIND_PATH;
}

static void get_thing(struct rn_client *client, const char *collection, const char *reference,
                      struct rn_api_reply *ret_reply) {
    char *path = rn_api_path(collection, reference, "");
    memset(ret_reply, 0, sizeof *ret_reply);
    if (path) {
        rn_api_send(client, "GET", path, NULL, ret_reply);
    } else {
        rn_error_set(&ret_reply->err, RN_ERROR_NO_MEMORY, reference, "memory ran out");
        ret_reply->code = RN_EXIT_FAILED;
    }
    free(path);
}

// "scene, dataset or job"
static void list_kinds(unsigned kinds, char *ret_text, size_t capacity) {
    snprintf(ret_text, capacity, "%s", "");
    for (size_t i = 0; i < KIND_COUNT; i++) {
        if (!(kinds & kind_table[i].kind)) continue;
        kinds &= ~(unsigned)kind_table[i].kind;
        size_t used = strlen(ret_text);
        snprintf(ret_text + used, capacity - used, "%s%s",
                 !used   ? ""
                 : kinds ? ", "
                         : " or ",
                 kind_table[i].word);
    }
}

// Adds "scene sc_..." to what a name may mean.
static void add_match(const char *word, const struct rn_api_reply *reply, char *matches,
                      size_t capacity) {
    char id[RN_ID_MAX] = "?";
    struct rn_error err = {0};
    size_t used = strlen(matches);
    if (rn_decode_peek((const char *)reply->http.body.data, reply->http.body.size, "id", RN_ID_MAX,
                       id, NULL, &err) != RN_OK)
        snprintf(id, sizeof id, "?");
    snprintf(matches + used, capacity - used, "%s%s %s", used ? ", " : "", word, id);
}

enum rn_exit rn_api_find(struct rn_client *client, unsigned kinds, const char *reference,
                         enum rn_kind *ret_kind, struct rn_api_reply *ret_reply) {
    size_t found = 0;
    unsigned candidates = kinds & kinds_of(reference);
    char wanted[80], matches[160] = "";
    for (size_t i = 0; i < KIND_COUNT; i++) {
        if (!(candidates & kind_table[i].kind)) continue;
        struct rn_api_reply reply;
        get_thing(client, kind_table[i].collection, reference, &reply);
        if (reply.code == RN_EXIT_OK)
            add_match(kind_table[i].word, &reply, matches, sizeof matches);
        if (reply.code == RN_EXIT_OK && found++ == 0) {
            *ret_kind = kind_table[i].kind;
            *ret_reply = reply;
        } else if (reply.code != RN_EXIT_OK && reply.code != RN_EXIT_NOT_FOUND) {
            rn_api_complain(&reply);
            rn_api_reply_finish(&reply);
            if (found) rn_api_reply_finish(ret_reply);
            return reply.code;
        } else {
            rn_api_reply_finish(&reply);
        }
    }
    if (found == 1) return RN_EXIT_OK;
    if (found) {
        rn_api_reply_finish(ret_reply);
        return rn_client_usage(reference, "is ambiguous; give the id: %s", matches);
    }
    list_kinds(kinds, wanted, sizeof wanted);
    return rn_client_error(RN_EXIT_NOT_FOUND, reference, "there is no %s of that name or id",
                           wanted);
}

// The members of a Scene or Job that lead to a job.
static enum rn_exit job_of(enum rn_kind kind, const struct rn_api_reply *reply,
                           char ret_id[RN_ID_MAX]) {
    struct rn_error err = {0};
    const struct rn_buf *body = &reply->http.body;
    enum rn_status status =
        rn_decode_peek((const char *)body->data, body->size, kind == RN_KIND_JOB ? "id" : "job",
                       RN_ID_MAX, ret_id, NULL, &err);
    return status == RN_OK ? RN_EXIT_OK : rn_client_fail(&err);
}

enum rn_exit rn_api_find_job(struct rn_client *client, const char *reference,
                             char ret_id[RN_ID_MAX]) {
    struct rn_api_reply reply;
    enum rn_kind kind;
    enum rn_exit code = rn_api_find(client, RN_KIND_JOB | RN_KIND_SCENE, reference, &kind, &reply);
    if (code != RN_EXIT_OK) return code;
    code = job_of(kind, &reply, ret_id);
    rn_api_reply_finish(&reply);
    return code;
}

enum rn_exit rn_api_get(struct rn_client *client, const char *kind, const char *reference,
                        const char *tail, const struct rn_table *table, void *ret_message) {
    struct rn_api_reply reply;
    char *path = rn_api_path(kind, reference, tail);
    if (!path) return RN_EXIT_FAILED;
    rn_api_send(client, "GET", path, NULL, &reply);
    free(path);
    enum rn_exit code = reply.code == RN_EXIT_OK ? rn_api_decode(&reply, table, ret_message)
                                                 : rn_api_complain(&reply);
    rn_api_reply_finish(&reply);
    return code;
}

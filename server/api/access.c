#include "server/api/access.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/random.h>

#include "common/base/clock.h"
#include "common/base/sha256.h"
#include "server/api/app.h"

#define MAX_TOKENS 1000
#define BURST_S 2 // seconds' worth of requests that may come at once
#define SECRET_PREFIX "rnt_"

struct known {
    char sha256[65];
    struct rn_caller caller;
    bool limited;     // by the rate
    double allowance; // requests that it may send now
    int64_t since_ns; // of the allowance
};

struct rn_access {
    struct rn_access_options options;
    struct rn_store *store;
    struct known *known;
    size_t count;
};

static void digest(const char *secret, char ret_hex[65]) {
    struct rn_sha256 hash;
    rn_sha256_init(&hash);
    rn_sha256_update(&hash, secret, strlen(secret));
    rn_sha256_final_hex(&hash, ret_hex);
}

// The place for one more.
static enum rn_status reserve(struct rn_access *access, struct rn_error *err) {
    if (access->count >= MAX_TOKENS)
        return rn_error_set(err, RN_ERROR_LIMIT, "",
                            "there are %d tokens, the limit; revoke some that are not used",
                            MAX_TOKENS);
    struct known *more = realloc(access->known, (access->count + 1) * sizeof *more);
    if (more == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "no memory for a token");
    access->known = more;
    return RN_OK;
}

static void add(struct rn_access *access, const struct rn_token_row *row) {
    const struct rn_access_options *options = &access->options;
    struct known *known = &access->known[access->count++];
    *known = (struct known){.limited = options->max_rate > 0, .since_ns = rn_clock_ns()};
    known->allowance = (double)options->max_rate * BURST_S;
    memcpy(known->sha256, row->sha256, sizeof known->sha256);
    struct rn_caller *caller = &known->caller;
    memcpy(caller->id, row->id, sizeof caller->id);
    memcpy(caller->name, row->name, sizeof caller->name);
    memcpy(caller->scene, row->scene, sizeof caller->scene);
    memcpy(caller->job, row->job, sizeof caller->job);
    caller->scope = row->scope;
    caller->created_ms = row->created_ms;
    caller->expires_ms = row->expires_ms;
    caller->max_jobs = row->max_jobs > 0 ? row->max_jobs : options->quota_jobs;
    caller->max_bytes = row->max_bytes > 0 ? row->max_bytes : options->quota_bytes;
}

static enum rn_status add_own(struct rn_access *access, struct rn_error *err) {
    struct rn_token_row own = {.name = "owner", .scope = RN_SCOPE_ADMIN};
    if (access->options.own_token == NULL) return RN_OK;
    enum rn_status status = reserve(access, err);
    if (status != RN_OK) return status;
    digest(access->options.own_token, own.sha256);
    add(access, &own);
    struct known *known = &access->known[access->count - 1];
    known->limited = false;
    known->caller.max_jobs = known->caller.max_bytes = 0;
    return RN_OK;
}

enum rn_status rn_access_create(const struct rn_access_options *options, struct rn_store *store,
                                struct rn_access **ret_access, struct rn_error *err) {
    struct rn_access *access = calloc(1, sizeof *access);
    struct rn_query query = {0};
    void *rows = NULL;
    size_t count = 0;
    if (access == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "tokens", "no memory");
    access->options = *options;
    access->store = store;
    enum rn_status status = add_own(access, err);
    if (status == RN_OK) status = rn_store_list(store, &rn_tokens, &query, &rows, &count, err);
    const struct rn_token_row *row = rows;
    for (size_t i = 0; status == RN_OK && i < count; i++) {
        status = reserve(access, err);
        if (status == RN_OK) add(access, &row[i]);
    }
    rn_rows_finish(&rn_tokens, rows, count);
    if (status == RN_OK)
        *ret_access = access;
    else
        rn_access_destroy(&access);
    return status;
}

void rn_access_destroy(struct rn_access **access) {
    if (*access != NULL) free((*access)->known);
    free(*access);
    *access = NULL;
}

// 160 random bits.
static enum rn_status make_secret(char secret[RN_SECRET_MAX], struct rn_error *err) {
    static const char digits[] = "abcdefghijklmnopqrstuvwxyz234567";
    uint8_t random[32];
    if (getrandom(random, sizeof random, 0) != (ssize_t)sizeof random)
        return rn_error_from_errno(err, errno, "getrandom", "make a token");
    size_t size = (size_t)snprintf(secret, RN_SECRET_MAX, SECRET_PREFIX);
    for (size_t i = 0; i < sizeof random; i++)
        secret[size++] = digits[random[i] & 31];
    secret[size] = '\0';
    return RN_OK;
}

enum rn_status rn_access_make(struct rn_access *access, struct rn_token_row *row,
                              char ret_secret[RN_SECRET_MAX], struct rn_error *err) {
    enum rn_status status = reserve(access, err);
    if (status == RN_OK) status = rn_store_new_id(RN_ID_TOKEN, row->id, err);
    if (status == RN_OK) status = make_secret(ret_secret, err);
    if (status != RN_OK) return status;
    digest(ret_secret, row->sha256);
    status = rn_store_insert(access->store, &rn_tokens, row, err);
    if (status == RN_ERROR_CONFLICT)
        return rn_error_set(err, status, "#/name", "there is a token '%s'; revoke it first",
                            row->name);
    if (status == RN_OK) add(access, row);
    return status;
}

enum rn_status rn_access_revoke(struct rn_access *access, const char *id, struct rn_error *err) {
    enum rn_status status = rn_store_delete(access->store, &rn_tokens, id, err);
    for (size_t i = 0; status == RN_OK && i < access->count; i++)
        if (strcmp(access->known[i].caller.id, id) == 0)
            access->known[i] = access->known[--access->count];
    return status;
}

// ---- a request --------------------------------------------------------------------------------

// Digests are compared: how long that takes tells nothing of the secrets.
static struct known *find(struct rn_access *access, const char *token) {
    char sha256[65];
    digest(token, sha256);
    for (size_t i = 0; i < access->count; i++)
        if (memcmp(access->known[i].sha256, sha256, sizeof sha256) == 0) return &access->known[i];
    return NULL;
}

static bool take_turn(const struct rn_access *access, struct known *known) {
    if (!known->limited) return true;
    double rate = (double)access->options.max_rate;
    int64_t now_ns = rn_clock_ns();
    known->allowance += (double)(now_ns - known->since_ns) * 1e-9 * rate;
    if (known->allowance > rate * BURST_S) known->allowance = rate * BURST_S;
    known->since_ns = now_ns;
    if (known->allowance < 1) return false;
    known->allowance--;
    return true;
}

static bool is_scene(struct rn_app *app, const char *reference, const char *id) {
    struct rn_scene_row row;
    if (strcmp(reference, id) == 0) return true;
    if (rn_store_resolve(app->store, &rn_scenes, RN_ID_SCENE, reference, &row, NULL) != RN_OK)
        return false;
    rn_row_finish(&rn_scenes, &row);
    return strcmp(row.id, id) == 0;
}

static bool is_linked(struct rn_app *app, struct rn_request *request,
                      const struct rn_caller *caller) {
    unsigned flags = rn_request_flags(request);
    const char *reference = rn_request_param(request, 0);
    if (flags & RN_ROUTE_OF_SCENE)
        return caller->scene[0] != '\0' && is_scene(app, reference, caller->scene);
    if (flags & RN_ROUTE_OF_JOB)
        return caller->job[0] != '\0' && strcmp(reference, caller->job) == 0;
    return (flags & RN_ROUTE_OF_NONE) != 0;
}

static enum rn_scope needed_scope(unsigned flags) {
    return flags & RN_ROUTE_ADMIN    ? RN_SCOPE_ADMIN
           : flags & RN_ROUTE_TRAIN  ? RN_SCOPE_TRAIN
           : flags & RN_ROUTE_RENDER ? RN_SCOPE_RENDER
                                     : RN_SCOPE_READ;
}

bool rn_api_may(const struct rn_caller *caller, enum rn_scope scope, struct rn_reply *reply) {
    if (caller->scope >= scope) return true;
    rn_reply_problem(reply, RN_PROBLEM_FORBIDDEN,
                     "token '%s' has the scope %s; this needs one with the scope %s", caller->name,
                     rn_scope_names[caller->scope], rn_scope_names[scope]);
    return false;
}

bool rn_access_authorise(void *context, struct rn_request *request, const char *token,
                         struct rn_caller *ret_caller, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct known *known = find(app->access, token);
    if (known == NULL) return false;
    const struct rn_caller *caller = &known->caller;
    *ret_caller = *caller;
    if (caller->expires_ms > 0 && rn_clock_wall_ms() >= caller->expires_ms) {
        rn_reply_problem(reply, RN_PROBLEM_UNAUTHORISED, "token '%s' has expired", caller->name);
        rn_reply_header(reply, "WWW-Authenticate", "Bearer");
    } else if (!take_turn(app->access, known)) {
        rn_reply_problem(reply, RN_PROBLEM_TOO_MANY_REQUESTS,
                         "token '%s' sends more than %lld requests a second, --max-rate",
                         caller->name, (long long)app->access->options.max_rate);
    } else if (rn_caller_is_link(caller)) {
        if (!is_linked(app, request, caller))
            rn_reply_problem(reply, RN_PROBLEM_FORBIDDEN, "this link shows one %s and nothing else",
                             caller->scene[0] != '\0' ? "scene" : "job's pictures");
    } else {
        (void)rn_api_may(caller, needed_scope(rn_request_flags(request)), reply);
    }
    return true;
}

bool rn_access_stays(void *context, const struct rn_caller *caller) {
    const struct rn_access *access = ((struct rn_app *)context)->access;
    if (caller->id[0] == '\0') return true; // the owner, who has no record
    if (caller->expires_ms > 0 && rn_clock_wall_ms() >= caller->expires_ms) return false;
    for (size_t i = 0; i < access->count; i++)
        if (strcmp(access->known[i].caller.id, caller->id) == 0) return true;
    return false;
}

// ---- whose it is ------------------------------------------------------------------------------

// Of the newest job whose `column` has this text, of a type unless that is NULL.
static void find_owner(struct rn_app *app, const char *column, const char *id, const char *type,
                       char owner[RN_ID_MAX]) {
    struct rn_query query = {.equal = {{column, id}, {type != NULL ? "type" : NULL, type}},
                             .limit = 1,
                             .without = "source"};
    void *rows = NULL;
    size_t count = 0;
    if (rn_store_list(app->store, &rn_jobs_table, &query, &rows, &count, NULL) != RN_OK) return;
    if (count > 0) memcpy(owner, ((struct rn_job_row *)rows)->owner, RN_ID_MAX);
    rn_rows_finish(&rn_jobs_table, rows, count);
}

static enum rn_status read_owner(struct rn_app *app, const struct rn_store_table *table,
                                 const char *reference, char owner[RN_ID_MAX],
                                 struct rn_error *err) {
    static const struct {
        const struct rn_store_table *table;
        const char *prefix;
    } kinds[] = {{&rn_datasets, RN_ID_DATASET},
                 {&rn_scenes, RN_ID_SCENE},
                 {&rn_jobs_table, RN_ID_JOB},
                 {&rn_camera_paths, RN_ID_PATH},
                 {&rn_tokens, RN_ID_TOKEN}};
    union {
        struct rn_dataset_row dataset;
        struct rn_scene_row scene;
        struct rn_job_row job;
        struct rn_camera_path_row path;
        struct rn_token_row token;
    } row;
    size_t i = 0;
    while (kinds[i].table != table)
        i++;
    enum rn_status status =
        rn_store_resolve(app->store, table, kinds[i].prefix, reference, &row, err);
    if (status != RN_OK) return status;
    owner[0] = '\0';
    if (table == &rn_datasets)
        find_owner(app, "dataset", row.dataset.id, rn_job_type_names[RN_JOB_INGEST], owner);
    else if (table == &rn_scenes)
        find_owner(app, "id", row.scene.job, NULL, owner); // that trained it, or took it in
    else
        memcpy(owner,
               table == &rn_jobs_table     ? row.job.owner
               : table == &rn_camera_paths ? row.path.owner
                                           : row.token.owner,
               RN_ID_MAX);
    rn_row_finish(table, &row);
    return RN_OK;
}

bool rn_api_may_change(struct rn_app *app, struct rn_request *request,
                       const struct rn_store_table *table, struct rn_reply *reply) {
    struct rn_error err = {0};
    const struct rn_caller *caller = rn_request_caller(request);
    char owner[RN_ID_MAX];
    if (caller->scope == RN_SCOPE_ADMIN) return true;
    enum rn_status status = read_owner(app, table, rn_request_param(request, 0), owner, &err);
    if (rn_api_failed(status, &err, reply)) return false;
    if (strcmp(owner, caller->id) == 0) return true;
    rn_reply_problem(reply, RN_PROBLEM_FORBIDDEN,
                     "token '%s' did not make it; this needs one with the scope admin",
                     caller->name);
    return false;
}

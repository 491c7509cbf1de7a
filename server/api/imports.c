// POST /v1/datasets: a directory of this machine, a tar in the body, or one that was uploaded in
// parts.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/checks.h"
#include "proto/dataset.h"
#include "server/api/app.h"

#define TAR_TYPE "application/x-tar"

// A text of the query into its field, where it is given and `check` finds nothing wrong.
static enum rn_status read_text(struct rn_request *request, const char *key,
                                const char *(*check)(const char *), char *field, size_t capacity,
                                struct rn_error *err) {
    const char *text = rn_request_query(request, key);
    if (text == NULL) return RN_OK;
    const char *wrong = strlen(text) >= capacity ? "is too long" : check(text);
    if (wrong != NULL) return rn_error_set(err, RN_ERROR_INVALID, key, "%s", wrong);
    snprintf(field, capacity, "%s", text);
    return RN_OK;
}

static enum rn_status read_number(struct rn_request *request, const char *key, int64_t min,
                                  int64_t max, int64_t *field, struct rn_error *err) {
    const char *text = rn_request_query(request, key);
    return text == NULL ? RN_OK : rn_api_number(text, min, max, key, field, err);
}

static enum rn_status read_choice(struct rn_request *request, const char *key,
                                  const char *const *names, int *field, struct rn_error *err) {
    const char *text = rn_request_query(request, key);
    if (text == NULL) return RN_OK;
    *field = rn_name_index(names, text);
    if (*field >= 0) return RN_OK;
    return rn_error_set(err, RN_ERROR_INVALID, key, "must be one of %s, %s%s%s", names[0], names[1],
                        names[2] ? ", " : "", names[2] ? names[2] : "");
}

// Name and options of an upload stand in the query.
static enum rn_status read_query(struct rn_request *request, const char **ret_name,
                                 struct rn_ingest_options *options, struct rn_error *err) {
    static const char *const known[] = {"name",   "max_size", "scales", "alpha",  "split",
                                        "bounds", "up",       "crop",   "format", "masks",
                                        "poses",  "backdrop", NULL};
    const char *name = rn_request_query(request, "name");
    char checked[RN_NAME_MAX];
    enum rn_status status;
    rn_message_init(&rn_ingest_options_table, options);
#define TEXT(field, check)                                                                         \
    read_text(request, #field, check, options->field, sizeof options->field, err)
    if ((status = rn_request_check_query(request, known, err))) return status;
    if (name == NULL)
        return rn_error_set(err, RN_ERROR_INVALID, "name", "the query must name the dataset");
    if ((status = read_text(request, "name", rn_check_name, checked, sizeof checked, err)) ||
        (status = read_number(request, "max_size", 0, 16384, &options->max_size, err)) ||
        (status = read_number(request, "scales", 1, 8, &options->scales, err)) ||
        (status = read_choice(request, "alpha", rn_downscale_names, &options->alpha, err)) ||
        (status = read_choice(request, "poses", rn_poses_names, &options->poses, err)) ||
        (status = read_choice(request, "backdrop", rn_backdrop_names, &options->backdrop, err)) ||
        (status = TEXT(split, rn_check_split_spec)) || (status = TEXT(bounds, rn_check_bounds)) ||
        (status = TEXT(up, rn_check_up)) || (status = TEXT(crop, rn_check_crop)) ||
        (status = TEXT(format, rn_check_format)) || (status = TEXT(masks, rn_check_inner_path)))
        return status;
#undef TEXT
    *ret_name = name;
    return RN_OK;
}

enum rn_status rn_api_most_upload(struct rn_app *app, const struct rn_caller *caller,
                                  uint64_t *ret_bytes, struct rn_error *err) {
    int64_t jobs, bytes = 0, most = app->max_upload_bytes;
    enum rn_status status = RN_OK;
    if (caller->max_bytes > 0)
        status = rn_control_usage(app->control, caller->id, &jobs, &bytes, err);
    if (status == RN_OK && caller->max_bytes > 0 && bytes >= caller->max_bytes)
        return rn_error_set(err, RN_ERROR_LIMIT, "",
                            "what token '%s' has made holds %lld bytes, its quota is %lld; delete "
                            "something",
                            caller->name, (long long)bytes, (long long)caller->max_bytes);
    if (caller->max_bytes > 0 && caller->max_bytes - bytes < most) most = caller->max_bytes - bytes;
    *ret_bytes = (uint64_t)most;
    return status;
}

enum rn_status rn_api_no_spool(struct rn_app *app, struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_IO, rn_store_folder(app->store),
                        "the data folder was moved or removed under the daemon: nothing can be "
                        "sent to it any more; put it back, or stop the daemon");
}

enum rn_status rn_api_spool(struct rn_app *app, struct rn_request *request, struct rn_error *err) {
    uint64_t most = 0;
    char *spool = rn_store_path(app->store, "spool");
    enum rn_status status =
        spool == NULL ? rn_error_set(err, RN_ERROR_NO_MEMORY, "", "no memory for an upload")
                      : rn_api_most_upload(app, rn_request_caller(request), &most, err);
    if (status == RN_OK) status = rn_request_spool(request, spool, most, err);
    if (status == RN_ERROR_NOT_FOUND) status = rn_api_no_spool(app, err);
    free(spool);
    return status;
}

enum rn_status rn_api_check_free_name(struct rn_app *app, const char *name, struct rn_error *err) {
    struct rn_dataset_row row;
    if (rn_store_find(app->store, &rn_datasets, "name", name, &row, NULL) != RN_OK) return RN_OK;
    rn_row_finish(&rn_datasets, &row);
    return rn_error_set(err, RN_ERROR_CONFLICT, "#/name",
                        "there is a dataset '%s'; choose another name or delete that one", name);
}

void rn_begin_dataset(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_error err = {0};
    struct rn_ingest_options options;
    const char *name = NULL;
    if (!rn_request_has_type(request, TAR_TYPE)) return;
    enum rn_status status = read_query(request, &name, &options, &err);
    if (status == RN_OK) status = rn_api_check_free_name(app, name, &err);
    if (rn_api_failed(status, &err, reply)) return;
    status = rn_api_spool(app, request, &err);
    (void)rn_api_failed(status, &err, reply);
}

static bool is_under(const char *path, const char *root) {
    size_t size = strlen(root);
    while (size > 0 && root[size - 1] == '/')
        size--;
    return strncmp(path, root, size) == 0 && (path[size] == '/' || path[size] == '\0');
}

// The directory's canonical path, when it lies under a root. Replies otherwise.
static char *find_directory(struct rn_app *app, const char *directory, struct rn_reply *reply) {
    if (app->root_count == 0) {
        rn_reply_problem(reply, RN_PROBLEM_FORBIDDEN,
                         "no directory may be imported: start ripnerfd with --dataset-root DIR, "
                         "or upload the dataset");
        return NULL;
    }
    char *path = realpath(directory, NULL);
    for (size_t i = 0; i < app->root_count; i++) {
        if (path != NULL && is_under(path, app->roots[i])) return path;
        if (path == NULL && is_under(directory, app->roots[i]) && strstr(directory, "..") == NULL) {
            rn_reply_problem(reply, RN_PROBLEM_NOT_FOUND, "there is no directory '%.300s'",
                             directory);
            return NULL;
        }
    }
    free(path);
    rn_reply_problem(reply, RN_PROBLEM_FORBIDDEN, "'%.300s' is not under a --dataset-root",
                     directory);
    return NULL;
}

void rn_api_submit(struct rn_app *app, const struct rn_submission *wanted,
                   struct rn_request *request, struct rn_reply *reply) {
    struct rn_error err = {0};
    char id[RN_ID_MAX], *json = NULL;
    enum rn_status status = rn_control_submit(app->control, wanted, id, &json, &err);
    if (status == RN_ERROR_BUSY) {
        rn_reply_problem(reply, RN_PROBLEM_QUEUE_FULL, "%s", err.text);
    } else if (!rn_api_failed(status, &err, reply)) {
        if (wanted->spooled != NULL) rn_request_take_spooled(request);
        rn_api_json(reply, 202, json);
        rn_reply_header(reply, "Location", "/v1/jobs/%s", id);
    }
}

static void submit(struct rn_app *app, struct rn_request *request, struct rn_submission *wanted,
                   const struct rn_ingest_options *options, struct rn_reply *reply) {
    struct rn_error err = {0};
    char *options_json = NULL;
    enum rn_status status = rn_encode(&rn_ingest_options_table, options, &options_json, NULL, &err);
    if (rn_api_failed(status, &err, reply)) return;
    wanted->type = RN_JOB_INGEST;
    wanted->caller = rn_request_caller(request);
    wanted->traceparent = rn_request_traceparent(request);
    wanted->options = options_json;
    rn_api_submit(app, wanted, request, reply);
    free(options_json);
}

void rn_api_own_key(const struct rn_caller *caller, char kind, const char *key,
                    char ret_key[RN_KEY_MAX]) {
    snprintf(ret_key, RN_KEY_MAX, "%s%c%s", caller->id, kind, key);
}

// The same request once more, whose answer was lost: the upload is the job's by now.
static bool reply_earlier(struct rn_app *app, const char *own_key,
                          const struct rn_dataset_request *wanted, struct rn_reply *reply) {
    struct rn_key_row key;
    struct rn_error err = {0};
    char *json = NULL;
    if (rn_store_find(app->store, &rn_keys, "id", own_key, &key, NULL) != RN_OK ||
        strcmp(key.digest, wanted->name) != 0)
        return false;
    enum rn_status status = rn_control_job_json(app->control, key.job, &json, &err);
    if (rn_api_failed(status, &err, reply)) return true;
    rn_api_json(reply, 202, json);
    rn_reply_header(reply, "Location", "/v1/jobs/%s", key.job);
    return true;
}

static void import_upload(struct rn_app *app, struct rn_request *request,
                          const struct rn_dataset_request *wanted, struct rn_reply *reply) {
    struct rn_upload_record upload;
    char key[RN_KEY_MAX];
    rn_api_own_key(rn_request_caller(request), '/', wanted->upload, key);
    if (reply_earlier(app, key, wanted, reply)) return;
    if (!rn_api_find_upload(app, wanted->upload, &upload)) {
        rn_reply_problem(reply, RN_PROBLEM_NOT_FOUND, "there is no upload '%s'", wanted->upload);
        return;
    }
    if (upload.offset < upload.size_bytes) {
        rn_reply_problem(reply, RN_PROBLEM_CONFLICT, "of the upload %lld of %lld bytes are there",
                         (long long)upload.offset, (long long)upload.size_bytes);
        return;
    }
    char *path = rn_api_upload_path(app, &upload);
    struct rn_submission submission = {.dataset = wanted->name,
                                       .spooled = path,
                                       .upload_bytes = upload.size_bytes,
                                       .key = key,
                                       .digest = wanted->name};
    if (path == NULL)
        rn_reply_no_memory(reply);
    else
        submit(app, request, &submission, &wanted->options, reply);
    free(path);
}

static void import_directory(struct rn_app *app, struct rn_request *request,
                             const struct rn_dataset_request *wanted, struct rn_reply *reply) {
    char *source = find_directory(app, wanted->directory, reply);
    struct rn_submission submission = {.dataset = wanted->name, .source = source};
    if (source != NULL) submit(app, request, &submission, &wanted->options, reply);
    free(source);
}

static void import_named(struct rn_app *app, struct rn_request *request, struct rn_reply *reply) {
    static const char *const known[] = {NULL};
    struct rn_error err = {0};
    struct rn_field_errors errors = {0};
    struct rn_dataset_request wanted;
    size_t size;
    const char *body = (const char *)rn_request_body(request, &size);
    if (rn_api_failed(rn_request_check_query(request, known, &err), &err, reply)) return;
    if (rn_decode(&rn_dataset_request_table, body, size, &wanted, &errors, &err) != RN_OK) {
        rn_reply_invalid(reply, &errors, &err);
        return;
    }
    if (!wanted.directory == !*wanted.upload) {
        rn_field_errors_add(&errors, "#/directory", "exactly one of directory and upload is given");
        (void)rn_error_set(&err, RN_ERROR_INVALID, "#/directory",
                           "exactly one of directory and upload is given");
        rn_reply_invalid(reply, &errors, &err);
    } else if (wanted.directory) {
        import_directory(app, request, &wanted, reply);
    } else {
        import_upload(app, request, &wanted, reply);
    }
    rn_message_finish(&rn_dataset_request_table, &wanted);
}

void rn_create_dataset(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_error err = {0};
    struct rn_ingest_options options;
    const char *name = NULL;
    uint64_t size;
    const char *spooled = rn_request_spooled(request, &size);
    if (spooled == NULL) {
        import_named(app, request, reply);
        return;
    }
    enum rn_status status = read_query(request, &name, &options, &err);
    struct rn_submission submission = {
        .dataset = name, .spooled = spooled, .upload_bytes = (int64_t)size};
    if (!rn_api_failed(status, &err, reply)) submit(app, request, &submission, &options, reply);
}

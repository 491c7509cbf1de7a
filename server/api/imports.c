// POST /v1/datasets: a directory of this machine, or an uploaded tar.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "proto/checks.h"
#include "proto/dataset.h"
#include "server/api/app.h"

#define TAR_TYPE "application/x-tar"

static bool is_tar(const struct rn_request *request) {
    const char *type = rn_request_header(request, "Content-Type");
    size_t size = sizeof TAR_TYPE - 1;
    return type != NULL && strncasecmp(type, TAR_TYPE, size) == 0 &&
           (type[size] == '\0' || type[size] == ';');
}

static enum rn_status check_text(const char *text, const char *where,
                                 const char *(*check)(const char *), struct rn_error *err) {
    const char *wrong = check(text);
    return wrong == NULL ? RN_OK : rn_error_set(err, RN_ERROR_INVALID, where, "%s", wrong);
}

// Name and options of an upload stand in the query.
static enum rn_status read_query(struct rn_request *request, const char **ret_name,
                                 struct rn_ingest_options *options, struct rn_error *err) {
    static const char *const known[] = {"name",  "max_size", "scales", "alpha",
                                        "split", "bounds",   NULL};
    const char *name = rn_request_query(request, "name");
    const char *max_size = rn_request_query(request, "max_size");
    const char *scales = rn_request_query(request, "scales");
    const char *alpha = rn_request_query(request, "alpha");
    const char *split = rn_request_query(request, "split");
    const char *bounds = rn_request_query(request, "bounds");
    rn_message_init(&rn_ingest_options_table, options);
    enum rn_status status = rn_request_check_query(request, known, err);
    if (status == RN_OK && name == NULL)
        status = rn_error_set(err, RN_ERROR_INVALID, "name", "the query must name the dataset");
    if (status == RN_OK) status = check_text(name, "name", rn_check_name, err);
    if (status == RN_OK && max_size != NULL)
        status = rn_api_number(max_size, 0, 16384, "max_size", &options->max_size, err);
    if (status == RN_OK && scales != NULL)
        status = rn_api_number(scales, 1, 8, "scales", &options->scales, err);
    if (status == RN_OK && alpha != NULL) {
        options->alpha = rn_name_index(rn_alpha_mode_names, alpha);
        if (options->alpha < 0)
            status =
                rn_error_set(err, RN_ERROR_INVALID, "alpha", "must be premultiplied or straight");
    }
    if (status == RN_OK && split != NULL) {
        status = check_text(split, "split", rn_check_split_spec, err);
        if (status == RN_OK) snprintf(options->split, sizeof options->split, "%s", split);
    }
    if (status == RN_OK && bounds != NULL) {
        status = check_text(bounds, "bounds", rn_check_bounds, err);
        if (status == RN_OK && strlen(bounds) >= sizeof options->bounds)
            status = rn_error_set(err, RN_ERROR_INVALID, "bounds", "is too long");
        if (status == RN_OK) snprintf(options->bounds, sizeof options->bounds, "%s", bounds);
    }
    if (status == RN_OK) *ret_name = name;
    return status;
}

void rn_begin_dataset(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_error err = {0};
    struct rn_ingest_options options;
    struct rn_dataset_row row;
    const char *name = NULL;
    if (!is_tar(request)) return;
    enum rn_status status = read_query(request, &name, &options, &err);
    if (rn_api_failed(status, &err, reply)) return;
    if (rn_store_find(app->store, &rn_datasets, "name", name, &row, NULL) == RN_OK) {
        rn_row_finish(&rn_datasets, &row);
        status =
            rn_error_set(&err, RN_ERROR_CONFLICT, "#/name",
                         "there is a dataset '%s'; choose another name or delete that one", name);
        (void)rn_api_failed(status, &err, reply);
        return;
    }
    char *spool = rn_store_path(app->store, "spool");
    if (spool == NULL)
        status = rn_error_set(&err, RN_ERROR_NO_MEMORY, "", "no memory for an upload");
    else
        status = rn_request_spool(request, spool, (uint64_t)app->max_upload_bytes, &err);
    free(spool);
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

static void submit(struct rn_app *app, struct rn_request *request, const char *name,
                   const struct rn_ingest_options *options, const char *source, const char *spooled,
                   struct rn_reply *reply) {
    struct rn_error err = {0};
    char id[RN_ID_MAX], *json = NULL, *options_json = NULL;
    enum rn_status status = rn_encode(&rn_ingest_options_table, options, &options_json, NULL, &err);
    if (status == RN_OK) {
        struct rn_submission wanted = {.type = RN_JOB_INGEST,
                                       .dataset = name,
                                       .source = source,
                                       .spooled = spooled,
                                       .options = options_json};
        status = rn_control_submit(app->control, &wanted, id, &json, &err);
    }
    free(options_json);
    if (status == RN_ERROR_BUSY) {
        rn_reply_problem(reply, RN_PROBLEM_QUEUE_FULL, "%s", err.text);
    } else if (!rn_api_failed(status, &err, reply)) {
        if (spooled != NULL) rn_request_take_spooled(request);
        rn_api_json(reply, 202, json);
        rn_reply_header(reply, "Location", "/v1/jobs/%s", id);
    }
}

static void import_directory(struct rn_app *app, struct rn_request *request,
                             struct rn_reply *reply) {
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
    char *source = find_directory(app, wanted.directory, reply);
    if (source != NULL) submit(app, request, wanted.name, &wanted.options, source, NULL, reply);
    free(source);
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
        import_directory(app, request, reply);
        return;
    }
    enum rn_status status = read_query(request, &name, &options, &err);
    if (!rn_api_failed(status, &err, reply))
        submit(app, request, name, &options, NULL, spooled, reply);
}

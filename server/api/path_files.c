// Camera paths of other programs: read and written by the readers that the client has.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/path/formats/formats.h"
#include "proto/path_file.h"
#include "server/api/app.h"

// Where coordinates lie, as the request says; *ret_given is false when it says nothing.
static enum rn_status find_space(const struct rn_path_file_request *wanted,
                                 const struct rn_path_format *format,
                                 struct rn_path_space *ret_space, bool *ret_given,
                                 struct rn_error *err) {
    struct rn_path_text space = {.text = wanted->space, .where = "#/space"},
                        dataset = {.text = wanted->dataset, .where = "#/dataset"};
    if (space.text) space.size = strlen(space.text);
    if (dataset.text) dataset.size = strlen(dataset.text);
    return rn_path_space_find(format, &space, &dataset, ret_space, ret_given, err);
}

static enum rn_status check_space(const struct rn_path_file_request *wanted,
                                  const struct rn_path_format *format, struct rn_error *err) {
    if (!format->needs_space || wanted->space) return RN_OK;
    return rn_error_set(
        err, RN_ERROR_INVALID, "#/space",
        "coordinates of %s are those of one training, which moved and scaled the "
        "dataset: give its dataparser_transforms.json, or \"dataset\" where they are "
        "the dataset's own",
        format->title);
}

static enum rn_status find_format(const char *name, const char *pointer,
                                  const struct rn_path_format **ret_format, struct rn_error *err) {
    char names[200];
    *ret_format = *name ? rn_path_format_find(name) : NULL;
    if (*ret_format || !*name) return RN_OK;
    rn_path_format_names(", ", names, sizeof names);
    return rn_error_set(err, RN_ERROR_INVALID, pointer, "must be one of %s", names);
}

static enum rn_status import_file(const struct rn_path_file_request *wanted,
                                  struct rn_path_file *answer, struct rn_error *err) {
    const struct rn_path_format *format;
    struct rn_path_space space;
    struct rn_path_choices choices = {0};
    struct rn_path *path = NULL;
    struct rn_path_text in = {.text = wanted->file,
                              .size = strlen(wanted->file),
                              .beside = wanted->beside,
                              .beside_size = wanted->beside ? strlen(wanted->beside) : 0,
                              .where = "#/file"};
    bool given;
    enum rn_status status = find_format(wanted->from, "#/from", &format, err);
    if (status == RN_OK && !format) status = rn_path_recognise(&in, &format, err);
    if (status == RN_OK) status = check_space(wanted, format, err);
    if (status == RN_OK) status = find_space(wanted, format, &space, &given, err);
    if (status != RN_OK) return status;
    if (given) choices.space = &space;
    status = rn_path_import(&in, format, &choices, &path, &format, err);
    if (status != RN_OK) return status;
    snprintf(answer->format, sizeof answer->format, "%s", format->name);
    status = rn_path_object_text(path, &answer->path.json, err);
    rn_path_destroy(&path);
    return status;
}

static enum rn_status export_file(const struct rn_path_file_request *wanted,
                                  struct rn_path_file *answer, struct rn_error *err) {
    const struct rn_path_format *format;
    struct rn_path_space space;
    bool given;
    enum rn_status status = find_format(wanted->to, "#/to", &format, err);
    if (status == RN_OK && !format)
        status = rn_error_set(err, RN_ERROR_INVALID, "#/to", "says which format is written");
    if (status == RN_OK) status = find_space(wanted, format, &space, &given, err);
    if (status != RN_OK) return status;
    snprintf(answer->format, sizeof answer->format, "%s", format->name);
    if (format->beside)
        snprintf(answer->beside_name, sizeof answer->beside_name, "%s", format->beside);
    return rn_path_export(wanted->path.path, format, given ? &space : NULL, &answer->file,
                          &answer->beside, err);
}

static enum rn_status convert(const struct rn_path_file_request *wanted,
                              struct rn_path_file *answer, struct rn_error *err) {
    if (!wanted->file == !wanted->path.json)
        return rn_error_set(err, RN_ERROR_INVALID, "#/file",
                            "exactly one of file and path must be given");
    return wanted->file ? import_file(wanted, answer, err) : export_file(wanted, answer, err);
}

// A place within the file goes to the sentence: the request's member is what an error points at.
static void tell_place(struct rn_error *err) {
    struct rn_error told = {.status = err->status};
    // What is wrong with another program's file, its sender can mend.
    if (err->status == RN_ERROR_UNSUPPORTED) told.status = err->status = RN_ERROR_INVALID;
    if (strncmp(err->where, "#/file", 6) != 0) return;
    snprintf(told.where, sizeof told.where, "#/file");
    if (err->where[6])
        snprintf(told.text, sizeof told.text, "%.200s: %.300s", err->where + 6, err->text);
    else
        snprintf(told.text, sizeof told.text, "%s", err->text);
    *err = told;
}

void rn_convert_camera_path(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_error err = {0};
    struct rn_field_errors errors = {0};
    struct rn_path_file_request wanted;
    struct rn_path_file answer;
    char *json = NULL;
    size_t size;
    const char *body = (const char *)rn_request_body(request, &size);
    (void)context;
    if (rn_decode(&rn_path_file_request_table, body, size, &wanted, &errors, &err) != RN_OK) {
        rn_reply_invalid(reply, &errors, &err);
        return;
    }
    rn_message_init(&rn_path_file_table, &answer);
    enum rn_status status = convert(&wanted, &answer, &err);
    if (status == RN_OK) status = rn_encode(&rn_path_file_table, &answer, &json, NULL, &err);
    rn_message_finish(&rn_path_file_table, &answer);
    rn_message_finish(&rn_path_file_request_table, &wanted);
    if (status != RN_OK) tell_place(&err);
    if (!rn_api_failed(status, &err, reply)) rn_api_json(reply, 200, json);
}

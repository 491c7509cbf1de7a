// The report of a ladder, also of one that is still at work.
#include <stdlib.h>
#include <string.h>

#include "server/api/app.h"
#include "server/report/report.h"

#define MAX_REPORT (16u << 20)

static enum rn_status find_ladder(struct rn_app *app, const char *id,
                                  struct rn_ladder_record *ret_record, struct rn_error *err) {
    struct rn_job_row job;
    enum rn_status status = rn_store_resolve(app->store, &rn_jobs_table, RN_ID_JOB, id, &job, err);
    if (status != RN_OK) return status;
    bool ladder = job.type == RN_JOB_LADDER;
    char *folder = rn_store_path(app->store, "jobs/%s", job.id);
    rn_row_finish(&rn_jobs_table, &job);
    if (!ladder)
        status = rn_error_set(err, RN_ERROR_NOT_FOUND, "", "only a ladder has a report");
    else if (folder == NULL)
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, "", "no memory");
    else
        status = rn_ladder_read(folder, ret_record, err);
    free(folder);
    if (ladder && status == RN_ERROR_NOT_FOUND)
        return rn_error_set(err, status, "", "the ladder has not begun yet");
    return status;
}

// Fills the reply in the format asked for.
static enum rn_status write_report(struct rn_ladder_report *report, const char *format,
                                   struct rn_reply *reply, struct rn_error *err) {
    struct rn_buf out;
    char *json = NULL;
    size_t size;
    bool html = strcmp(format, "html") == 0;
    enum rn_status status = rn_encode(&rn_ladder_report_table, report, &json, NULL, err);
    if (status != RN_OK) return status;
    if (strcmp(format, "json") == 0) {
        rn_api_json(reply, 200, json);
        return RN_OK;
    }
    rn_buf_init(&out, MAX_REPORT);
    if (html)
        rn_report_html(report, json, &out);
    else
        rn_report_csv(report, &out);
    free(json);
    status = rn_buf_status(&out, "the report", err);
    if (status != RN_OK) {
        rn_buf_finish(&out);
        return status;
    }
    uint8_t *bytes = rn_buf_take(&out, &size);
    rn_reply_bytes(reply, 200, html ? "text/html; charset=utf-8" : "text/csv; charset=utf-8", bytes,
                   size);
    return RN_OK;
}

void rn_get_report(void *context, struct rn_request *request, struct rn_reply *reply) {
    static const char *const known[] = {"format", NULL};
    static const char *const formats[] = {"html", "csv", "json", NULL};
    struct rn_app *app = context;
    struct rn_error err = {0};
    struct rn_ladder_record record;
    struct rn_ladder_report report;
    const char *format = rn_request_query(request, "format");
    if (format == NULL) format = "html";
    enum rn_status status = rn_request_check_query(request, known, &err);
    if (status == RN_OK && rn_name_index(formats, format) < 0)
        status = rn_error_set(&err, RN_ERROR_INVALID, "format", "must be html, csv or json");
    if (status == RN_OK) status = find_ladder(app, rn_request_param(request, 0), &record, &err);
    if (status == RN_OK) status = rn_report_make(&record, &report, &err);
    if (rn_api_failed(status, &err, reply)) return;
    status = write_report(&report, format, reply, &err);
    rn_message_finish(&rn_ladder_report_table, &report);
    if (rn_api_failed(status, &err, reply)) return;
    if (strcmp(format, "html") == 0)
        rn_reply_header(reply, "Content-Security-Policy",
                        "default-src 'none'; style-src 'unsafe-inline'");
    else
        rn_reply_header(reply, "Content-Disposition", "attachment; filename=\"ladder.%s\"", format);
}

// What the handlers share, and the helpers that keep them short: parse, call, encode.
#ifndef RN_SERVER_API_APP_H
#define RN_SERVER_API_APP_H

#include "common/dataset/dataset.h"
#include "proto/dataset.h"
#include "proto/token.h"
#include "server/http/router.h"
#include "server/api/access.h"
#include "server/http/server.h"
#include "server/jobs/control.h"

#define RN_MAX_BODY (9u << 20)                   // a camera path has at most 8 MiB
#define RN_MAX_RENDER_PIXELS ((int64_t)32 << 20) // of one picture, e.g. 8192 x 4096

// Everything here is used on the HTTP thread alone and outlives the server.
struct rn_app {
    struct rn_store *store;
    struct rn_control *control;
    struct rn_http *http;         // for its statistics
    struct rn_scrubber *scrubber; // likewise
    const char *web;              // folder of the page
    const char *const *roots;
    size_t root_count;
    int64_t memory_limit_bytes, max_upload_bytes, max_upload_entries;
    int64_t training_slots, max_queued, max_loaded;
    unsigned max_streams; // of events
    int64_t start_ns;
    struct rn_access *access;
    struct rn_backup *backup;     // NULL before the first one
    struct rn_adoption *adoption; // likewise
    // The dataset whose cameras or images were asked for last.
    char dataset_id[RN_ID_MAX];
    struct rn_dataset *dataset;
};

extern const struct rn_route rn_api_routes[];
void rn_app_finish(struct rn_app *app);
// Before the server goes: waits for a backup that is being prepared, and ends the taking in of one.
// backup.c, adopt.c
void rn_backup_settle(struct rn_app *app);
void rn_adoption_stop(struct rn_app *app);
// The server is gone, the store still there. backup.c
void rn_backup_stop(struct rn_app *app);

// Replies with JSON text, taken.
void rn_api_json(struct rn_reply *reply, int status, char *json);
// Replies with a problem when `status` is an error; true when it was.
bool rn_api_failed(enum rn_status status, const struct rn_error *err, struct rn_reply *reply);

// One page of a table's rows, newest first: the query's limit and cursor, `query` with its
// conditions set. `encode` makes an item's JSON of a row.
void rn_api_list(struct rn_app *app, struct rn_request *request, const struct rn_store_table *table,
                 struct rn_query *query,
                 enum rn_status (*encode)(struct rn_app *app, void *row, char **ret_json,
                                          struct rn_error *err),
                 struct rn_reply *reply);
// The query's limit (1..200, default 50) and cursor (0 without one).
enum rn_status rn_api_page(const struct rn_request *request, int *ret_limit, int64_t *ret_cursor,
                           struct rn_error *err) RN_MUST_CHECK;
// A whole decimal number in [min, max]; `where` names it in the error.
enum rn_status rn_api_number(const char *text, int64_t min, int64_t max, const char *where,
                             int64_t *ret_value, struct rn_error *err) RN_MUST_CHECK;

// RN_ERROR_LIMIT when a picture of this size would have more than RN_MAX_RENDER_PIXELS. render.c
enum rn_status rn_api_check_pixels(int64_t width, int64_t height, const char *pointer,
                                   struct rn_error *err) RN_MUST_CHECK;

// Something that is measured of a scene and kept in its folder.
struct rn_measured {
    const char *what, *does; // "the curve" of a scene, and what it does behind its name, or ""
    const char *verb;        // of the client, which measures it
    const struct rn_table *table;
    enum rn_status (*read)(const char *scene_folder, void *ret_record, struct rn_error *err);
    // Adds what is known only now; NULL: nothing.
    void (*complete)(struct rn_app *app, const struct rn_scene_row *scene, void *record);
};
// Replies with the request's scene's, read into `record`, its table's struct. measured.c
void rn_api_get_measured(struct rn_app *app, struct rn_request *request,
                         const struct rn_measured *kind, void *record, struct rn_reply *reply);
// Submits a job that measures something of the request's scene: options of that table, decoded into
// `wanted`, its struct. measured.c
void rn_api_measure(struct rn_app *app, struct rn_request *request, enum rn_job_type type,
                    const struct rn_table *table, void *wanted, struct rn_reply *reply);

// Has the body of a request written to a file, up to the daemon's limit or what is left of the
// caller's quota. imports.c
enum rn_status rn_api_spool(struct rn_app *app, struct rn_request *request,
                            struct rn_error *err) RN_MUST_CHECK;
// Sets the error of a spool that is not there: RN_ERROR_IO, as nothing that was asked for is
// missing.
enum rn_status rn_api_no_spool(struct rn_app *app, struct rn_error *err) RN_MUST_CHECK;
// Answers with the job that was submitted, 202 with its place, or with why not. imports.c
void rn_api_submit(struct rn_app *app, const struct rn_submission *wanted,
                   struct rn_request *request, struct rn_reply *reply);
// What may be sent: the daemon's limit, or what is left of the caller's quota. imports.c
enum rn_status rn_api_most_upload(struct rn_app *app, const struct rn_caller *caller,
                                  uint64_t *ret_bytes, struct rn_error *err) RN_MUST_CHECK;
// RN_ERROR_CONFLICT when there is a dataset of that name. imports.c
enum rn_status rn_api_check_free_name(struct rn_app *app, const char *name,
                                      struct rn_error *err) RN_MUST_CHECK;
// What a request is known by if it comes once more: a token has keys of its own. The kinds are ':',
// an Idempotency-Key, and '/', an upload; no token's id has either. imports.c
void rn_api_own_key(const struct rn_caller *caller, char kind, const char *key,
                    char ret_key[RN_KEY_MAX]);
// An upload that is there; where its bytes are (malloc, NULL without memory). uploads.c
bool rn_api_find_upload(struct rn_app *app, const char *id, struct rn_upload_record *ret_upload);
char *rn_api_upload_path(struct rn_app *app, const struct rn_upload_record *upload);

// Whether the caller has this scope, or made what the request's first parameter names (admins may
// change all): replies with a problem otherwise. access.c
bool rn_api_may(const struct rn_caller *caller, enum rn_scope scope, struct rn_reply *reply);
bool rn_api_may_change(struct rn_app *app, struct rn_request *request,
                       const struct rn_store_table *table, struct rn_reply *reply);
// What the API tells of who asks. tokens.c
void rn_api_describe_caller(struct rn_app *app, const struct rn_caller *caller,
                            struct rn_token_record *ret_record);

// Handlers, by file.
#define RN_HANDLER(name)                                                                           \
    void name(void *context, struct rn_request *request, struct rn_reply *reply)
RN_HANDLER(rn_get_health); // service.c
RN_HANDLER(rn_get_ready);
RN_HANDLER(rn_get_info);
RN_HANDLER(rn_get_openapi);
RN_HANDLER(rn_get_formats);
RN_HANDLER(rn_get_metrics); // metrics.c
RN_HANDLER(rn_get_page);    // page.c
RN_HANDLER(rn_get_page_file);
RN_HANDLER(rn_list_datasets); // datasets.c
RN_HANDLER(rn_get_dataset);
RN_HANDLER(rn_delete_dataset);
RN_HANDLER(rn_create_dataset); // imports.c
RN_HANDLER(rn_begin_dataset);
RN_HANDLER(rn_create_upload); // uploads.c
RN_HANDLER(rn_get_upload);
RN_HANDLER(rn_delete_upload);
RN_HANDLER(rn_begin_upload_part);
RN_HANDLER(rn_take_upload_part);
RN_HANDLER(rn_list_cameras); // views.c
RN_HANDLER(rn_list_points);
RN_HANDLER(rn_get_start);
RN_HANDLER(rn_get_image);
RN_HANDLER(rn_get_model);
RN_HANDLER(rn_list_scenes); // scenes.c
RN_HANDLER(rn_get_scene);
RN_HANDLER(rn_delete_scene);
RN_HANDLER(rn_list_evaluations);
RN_HANDLER(rn_get_checkpoint);
RN_HANDLER(rn_create_scene); // scene_file.c
RN_HANDLER(rn_begin_scene);
RN_HANDLER(rn_get_curve); // curve.c
RN_HANDLER(rn_measure_curve);
RN_HANDLER(rn_list_incidents); // incidents.c
RN_HANDLER(rn_get_effects);    // effects.c
RN_HANDLER(rn_measure_effects);
RN_HANDLER(rn_get_export); // frames.c
RN_HANDLER(rn_get_scene_export);
RN_HANDLER(rn_render_scene); // render.c
RN_HANDLER(rn_list_jobs);    // jobs.c
RN_HANDLER(rn_create_job);
RN_HANDLER(rn_get_job);
RN_HANDLER(rn_list_metrics);
RN_HANDLER(rn_pause_job);
RN_HANDLER(rn_resume_job);
RN_HANDLER(rn_finish_job);
RN_HANDLER(rn_cancel_job);
RN_HANDLER(rn_list_frames); // frames.c
RN_HANDLER(rn_get_frame);
RN_HANDLER(rn_get_frames_tar);
RN_HANDLER(rn_get_film);
RN_HANDLER(rn_get_job_path);
RN_HANDLER(rn_get_report); // report.c
RN_HANDLER(rn_follow_job); // events.c
RN_HANDLER(rn_follow_all);
RN_HANDLER(rn_get_backup);     // backup.c
RN_HANDLER(rn_begin_adoption); // adopt.c
RN_HANDLER(rn_adopt_backup);
RN_HANDLER(rn_list_tokens); // tokens.c
RN_HANDLER(rn_create_token);
RN_HANDLER(rn_delete_token);
RN_HANDLER(rn_list_camera_paths); // camera_paths.c
RN_HANDLER(rn_create_camera_path);
RN_HANDLER(rn_get_camera_path);
RN_HANDLER(rn_delete_camera_path);
RN_HANDLER(rn_convert_camera_path); // path_files.c

#endif

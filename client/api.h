// The daemon's resources as the verbs use them: one exchange at a time, problems explained.
#ifndef RN_CLIENT_API_H
#define RN_CLIENT_API_H

#include "client/client.h"
#include "client/table.h"
#include "proto/codec.h"
#include "proto/names.h"

// One exchange's outcome. Owner: the caller; rn_api_reply_finish.
struct rn_api_reply {
    enum rn_exit code; // RN_EXIT_OK for a 2xx answer
    struct rn_http_reply http;
    struct rn_error err; // when no answer came
};

// Sends a JSON body (NULL: none) and takes the answer whole. Prints nothing.
void rn_api_send(struct rn_client *client, const char *method, const char *path, const char *body,
                 struct rn_api_reply *ret_reply);
// As rn_api_send, for a request of any shape.
void rn_api_exchange(struct rn_client *client, const struct rn_http_request *request,
                     struct rn_api_reply *ret_reply);
// GETs a path into an open file as it comes; `file` is its name, for errors. Complains, also where
// no byte came for idle_s seconds.
enum rn_exit rn_api_download(struct rn_client *client, const char *path, int idle_s, int fd,
                             const char *file);
// GETs a path into a file, which is there whole or not at all. Complains.
enum rn_exit rn_api_save(struct rn_client *client, const char *path, const char *file);
// Prints why a reply is not what was asked for: the problem's title, detail and pointers, or why
// the daemon did not answer. Returns its code, as do the next ones.
enum rn_exit rn_api_complain(const struct rn_api_reply *reply);
void rn_api_reply_finish(struct rn_api_reply *reply);

// Decodes a reply's body, complaining when that fails. The message is the caller's to finish.
enum rn_exit rn_api_decode(const struct rn_api_reply *reply, const struct rn_table *table,
                           void *ret_message);
// Encodes a message; NULL and a complaint when that fails. malloc'd, the caller's to free.
char *rn_api_encode(const struct rn_table *table, const void *message);
// Prints a problem's JSON, as of a failed job; the exit code is that of its HTTP status.
enum rn_exit rn_api_print_problem(const char *json);

// GETs what rn_api_path names and decodes it; complains. The message is the caller's to finish.
enum rn_exit rn_api_get(struct rn_client *client, const char *kind, const char *reference,
                        const char *tail, const struct rn_table *table, void *ret_message);

// "/v1/KIND/REFERENCE" and `tail`, the reference escaped. malloc'd; NULL when memory is out.
char *rn_api_path(const char *kind, const char *reference, const char *tail);

// What a name or an id may mean.
enum rn_kind {
    RN_KIND_DATASET = 1,
    RN_KIND_SCENE = 2,
    RN_KIND_JOB = 4,
    RN_KIND_PATH = 8,
    RN_KIND_TOKEN = 16,
};
// Finds the one thing of the wanted kinds (a set) that goes by `reference`; the reply holds its
// JSON and is the caller's to finish when RN_EXIT_OK is returned. Complains otherwise: not found,
// or a usage error when the name is ambiguous.
enum rn_exit rn_api_find(struct rn_client *client, unsigned kinds, const char *reference,
                         enum rn_kind *ret_kind, struct rn_api_reply *ret_reply);
// "datasets", "scenes", "jobs", "camera-paths", "tokens"
const char *rn_api_collection(enum rn_kind kind);
// The id of a job by its own id, or of the job that trains a scene.
enum rn_exit rn_api_find_job(struct rn_client *client, const char *reference,
                             char ret_id[RN_ID_MAX]);

// Lists a collection, all its pages: a table with `row` adding one line for each decoded item, or
// with client->json {"items": [...], "next_cursor": null}. Complains when a page fails.
struct rn_api_list {
    enum rn_kind kind;
    const struct rn_table *table; // of an item
    const char *heading;          // as rn_text_table_init's
    void (*row)(struct rn_text_table *table, const void *message);
    const char *query; // "&state=running"; NULL: of all
};
enum rn_exit rn_api_print_list(struct rn_client *client, const struct rn_api_list *list);

#endif

// The training steps of a scene that were not finite: records that its runner has kept.
#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/file.h"
#include "proto/incident.h"
#include "server/api/app.h"

#define MOST_BYTES (1u << 20) // of a record

static int is_record(const struct dirent *entry) {
    char file[64];
    int size = snprintf(file, sizeof file, "incidents/%s", entry->d_name);
    return size < (int)sizeof file && rn_check_incident_file(file) == NULL;
}

static enum rn_status read_record(const char *folder, const char *name,
                                  struct rn_incident_entry *ret_entry, struct rn_error *err) {
    char path[4096];
    uint8_t *bytes;
    size_t size;
    snprintf(path, sizeof path, "%s/%s", folder, name);
    snprintf(ret_entry->file, sizeof ret_entry->file, "incidents/%.50s", name);
    enum rn_status status = rn_file_read(path, MOST_BYTES, &bytes, &size, err);
    if (status != RN_OK) return status;
    status = rn_decode(&rn_incident_table, (char *)bytes, size, &ret_entry->incident, NULL, err);
    free(bytes);
    return status;
}

// Names sort by step. What cannot be read is counted and not listed.
static enum rn_status read_all(const char *folder, struct rn_incident_list *list,
                               struct rn_error *err) {
    struct dirent **entries;
    int count = scandir(folder, &entries, is_record, alphasort);
    if (count < 0) return RN_OK; // nothing has happened
    list->count = count;
    list->items = calloc(RN_INCIDENTS_LISTED, sizeof *list->items);
    while (count-- > 0) {
        bool room = list->items != NULL && list->item_count < RN_INCIDENTS_LISTED;
        struct rn_incident_entry *item = room ? &list->items[list->item_count] : NULL;
        if (room && read_record(folder, entries[count]->d_name, item, NULL) == RN_OK)
            list->item_count++;
        free(entries[count]);
    }
    free(entries);
    return list->items != NULL ? RN_OK : rn_error_set(err, RN_ERROR_NO_MEMORY, "", "no memory");
}

void rn_list_incidents(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_error err = {0};
    struct rn_scene_row scene;
    struct rn_incident_list list = {.count = 0};
    char *json = NULL;
    enum rn_status status = rn_store_resolve(app->store, &rn_scenes, RN_ID_SCENE,
                                             rn_request_param(request, 0), &scene, &err);
    if (rn_api_failed(status, &err, reply)) return;
    char *folder = rn_store_path(app->store, "scenes/%s/incidents", scene.id);
    rn_row_finish(&rn_scenes, &scene);
    status = folder != NULL ? read_all(folder, &list, &err)
                            : rn_error_set(&err, RN_ERROR_NO_MEMORY, "", "no memory");
    free(folder);
    if (status == RN_OK) status = rn_encode(&rn_incident_list_table, &list, &json, NULL, &err);
    rn_message_finish(&rn_incident_list_table, &list);
    if (!rn_api_failed(status, &err, reply)) rn_api_json(reply, 200, json);
}

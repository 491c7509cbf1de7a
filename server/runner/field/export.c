// Exports of a scene as a file that other programs read, in the job's folder; those for viewing are
// in export_scene.c.
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/file.h"
#include "common/base/manifest.h"
#include "server/runner/field/work.h"

#define CELLS 256
#define LEVEL 0.5

// The only unit is all of it.
struct export_work {
    struct rn_work work;
    struct rn_wire_export request;
    struct rn_export_result made;
};

static enum rn_status prepare(struct rn_work *work, struct rn_field *field, struct rn_error *err) {
    struct export_work *export = (struct export_work *)work;
    (void)field;
    work->total = 1;
    return rn_mkdirs_in(work->host->place.scene_folder, export->request.folder, 0777, err);
}

static struct rn_mesh_options mesh_options(const struct rn_export_options *wanted) {
    struct rn_mesh_options options = {.cells = (int)rn_int_or(wanted->cells, CELLS),
                                      .level = isnan(wanted->level) ? LEVEL : wanted->level};
    memcpy(options.box, wanted->crop, sizeof options.box);
    return options;
}

static enum rn_status write_mesh(struct export_work *export, const struct rn_mesh *mesh,
                                 struct rn_error *err) {
    char path[PATH_MAX];
    struct rn_export_result *made = &export->made;
    int format = rn_name_or(export->request.options.format, RN_EXPORT_PLY);
    uint8_t *bytes = NULL;
    size_t size = 0;
    rn_message_init(&rn_export_result_table, made);
    made->vertices = (int64_t)mesh->vertex_count;
    made->triangles = (int64_t)mesh->triangle_count;
    snprintf(made->file, sizeof made->file, "mesh.%s", rn_export_format_names[format]);
    if (snprintf(path, sizeof path, "%s/%s", export->request.folder, made->file) >=
        (int)sizeof path)
        return rn_error_set(err, RN_ERROR_LIMIT, "export", "the path is too long");
    enum rn_status status = (format == RN_EXPORT_OBJ ? rn_mesh_encode_obj : rn_mesh_encode_ply)(
        mesh, &bytes, &size, err);
    if (!status) status = rn_file_write_atomic(path, bytes, size, err);
    if (!status) status = rn_manifest_write(export->request.folder, err);
    made->bytes = (int64_t)size;
    free(bytes);
    return status;
}

static enum rn_status unit(struct rn_work *work, struct rn_field *field,
                           const struct rn_field_info *info, struct rn_error *err) {
    struct export_work *export = (struct export_work *)work;
    struct rn_mesh_options options = mesh_options(&export->request.options);
    struct rn_mesh mesh;
    (void)info;
    enum rn_status status =
        rn_field_mesh(work->host->engine, field, &options, rn_work_keep_going, work, &mesh, err);
    if (status) return status;
    status = write_mesh(export, &mesh, err);
    rn_mesh_finish(&mesh);
    return status;
}

static enum rn_status result(struct rn_work *work, struct rn_field *field, char **ret_json,
                             struct rn_error *err) {
    (void)field;
    return rn_encode(&rn_export_result_table, &((struct export_work *)work)->made, ret_json, NULL,
                     err);
}

static void release(struct rn_work *work) {
    rn_message_finish(rn_wire_table(RN_WIRE_EXPORT), &((struct export_work *)work)->request);
}

static const struct rn_work_kind kind = {.size = sizeof(struct export_work),
                                         .prepare = prepare,
                                         .unit = unit,
                                         .result = result,
                                         .release = release};

void rn_work_add_export(struct rn_host *host, struct rn_wire_export *request) {
    if (request->options.as == RN_EXPORT_SCENE) {
        rn_work_add_scene_export(host, request);
        return;
    }
    struct rn_work *work = rn_work_append(host, &kind, request->job);
    if (!work) return;
    ((struct export_work *)work)->request = *request;
    rn_message_init(rn_wire_table(RN_WIRE_EXPORT), request);
}

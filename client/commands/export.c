// export: a point cloud out of what the scene's cameras see of it, its surface as triangles, or the
// scene itself for viewing elsewhere.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "client/api.h"
#include "client/commands/export_job.h"
#include "client/commands/submit.h"
#include "common/base/file.h"
#include "common/image/cloud.h"
#include "proto/dataset.h"
#include "proto/doctor.h"
#include "proto/render.h"
#include "proto/scene.h"

#define VIEWS 24     // cameras that are looked through
#define MAX_SIZE 400 // pixels, of the longer side of what they see

struct export_options {
    const char *out, *as, *crop, *max_loss;
    int64_t views, max_size, cells;
    double level, max_bytes;
    bool overwrite;
};
static const char *const export_names[] = {"points", "mesh", "scene", NULL};
#define EXPORT(m) .offset = offsetof(struct export_options, m)
static const struct rn_option export_table[] = {
    {.name = "as",
     .kind = RN_OPTION_CHOICE,
     EXPORT(as),
     .choices = export_names,
     .help = "what is written (points): a point cloud with colours, .ply;\ntriangles with "
             "colours at their corners, .ply or .obj; or the\nscene without its optimiser, which "
             "ripnerf import takes"},
    {.name = "views",
     .kind = RN_OPTION_INTEGER,
     EXPORT(views),
     .value = "N",
     .min = 1,
     .max = 1000,
     .help = "points: cameras of the dataset that are looked through, evenly spaced (24)"},
    {.name = "max-size",
     .kind = RN_OPTION_INTEGER,
     EXPORT(max_size),
     .value = "PX",
     .min = 8,
     .max = 4096,
     .help = "points: longest side of what they see; a point a pixel (400)"},
    {.name = "crop",
     .kind = RN_OPTION_TEXT,
     EXPORT(crop),
     .value = "X0,Y0,Z0,X1,Y1,Z1",
     .help = "only what lies within this box, dataset units"},
    {.name = "cells",
     .kind = RN_OPTION_INTEGER,
     EXPORT(cells),
     .value = "N",
     .min = 8,
     .max = 1024,
     .help = "mesh: cells along the longest side of the box, else of the\nscene's ball (256)"},
    {.name = "level",
     .kind = RN_OPTION_NUMBER,
     EXPORT(level),
     .value = "A",
     .min = 0.01,
     .max = 0.99,
     .help = "mesh: where the surface lies, as the opacity of a hundredth of\nthe scene's radius "
             "of such matter (0.5)"},
    {.name = "max-bytes",
     .kind = RN_OPTION_BYTES,
     EXPORT(max_bytes),
     .value = "N",
     .min = 1,
     .max = 1e15,
     .help = "scene: size of the file; its planes are kept as finely as fits"},
    {.name = "max-loss",
     .kind = RN_OPTION_TEXT,
     EXPORT(max_loss),
     .value = "DB",
     .help = "scene: what it may lose, measured on held-out views, such as\n0.05dB (0.05dB, or "
             "whatever --max-bytes costs)"},
    {.name = "out",
     .letter = 'o',
     .kind = RN_OPTION_TEXT,
     EXPORT(out),
     .value = "FILE",
     .help = "the file: .ply, or .obj of a mesh; .ripscene of a scene"},
    {.name = "overwrite",
     .kind = RN_OPTION_FLAG,
     EXPORT(overwrite),
     .help = "replace FILE where it is there"},
    {0}};

// A picture of the scene through a camera, as a PNG; the reply is the caller's to finish.
static enum rn_exit render(struct rn_client *client, const char *scene,
                           const struct rn_camera *camera, int output,
                           struct rn_api_reply *ret_reply) {
    struct rn_render_request request;
    rn_message_init(&rn_render_request_table, &request);
    request.camera = *camera;
    request.output = output;
    request.format = RN_FORMAT_PNG;
    char *body = rn_api_encode(&rn_render_request_table, &request);
    char *path = body ? rn_api_path("scenes", scene, "/render") : NULL;
    rn_message_finish(&rn_render_request_table, &request);
    if (path) rn_api_send(client, "POST", path, body, ret_reply);
    enum rn_exit code = !path                           ? RN_EXIT_FAILED
                        : ret_reply->code == RN_EXIT_OK ? RN_EXIT_OK
                                                        : rn_api_complain(ret_reply);
    if (path && code != RN_EXIT_OK) rn_api_reply_finish(ret_reply);
    free(path);
    free(body);
    return code;
}

static enum rn_exit render_image(struct rn_client *client, const char *scene,
                                 const struct rn_camera *camera, int output,
                                 struct rn_image *ret_image) {
    struct rn_error err = {0};
    struct rn_api_reply reply;
    enum rn_exit code = render(client, scene, camera, output, &reply);
    if (code != RN_EXIT_OK) return code;
    if (rn_image_decode(reply.http.body.data, reply.http.body.size, "picture",
                        &rn_image_default_limits, ret_image, &err) != RN_OK)
        code = rn_client_fail(&err);
    rn_api_reply_finish(&reply);
    return code;
}

static enum rn_exit render_depth(struct rn_client *client, const char *scene,
                                 const struct rn_camera *camera, struct rn_picture *ret_depth) {
    struct rn_error err = {0};
    struct rn_api_reply reply;
    enum rn_exit code = render(client, scene, camera, RN_OUTPUT_KIND_DEPTH, &reply);
    if (code != RN_EXIT_OK) return code;
    if (rn_picture_decode_depth_png(reply.http.body.data, reply.http.body.size, ret_depth, &err) !=
        RN_OK)
        code = rn_client_fail(&err);
    rn_api_reply_finish(&reply);
    return code;
}

static enum rn_exit add_view(struct rn_client *client, const char *scene,
                             const struct rn_camera *taken, int64_t max_size,
                             const double box[2][3], struct rn_cloud *cloud) {
    struct rn_error err = {0};
    struct rn_image rgb = {0}, opacity = {0};
    struct rn_picture depth = {0};
    struct rn_camera camera = rn_camera_without_lens(taken);
    double longest = fmax(camera.width, camera.height),
           shrink = fmin(1, (double)max_size / longest);
    camera = rn_camera_resized(&camera, (int)fmax(1, round(camera.width * shrink)),
                               (int)fmax(1, round(camera.height * shrink)));
    enum rn_exit code = render_depth(client, scene, &camera, &depth);
    if (code == RN_EXIT_OK) code = render_image(client, scene, &camera, RN_OUTPUT_KIND_RGB, &rgb);
    if (code == RN_EXIT_OK)
        code = render_image(client, scene, &camera, RN_OUTPUT_KIND_ALPHA, &opacity);
    if (code == RN_EXIT_OK &&
        rn_cloud_add(cloud, &camera, &rgb, &depth, &opacity, box, &err) != RN_OK)
        code = rn_client_fail(&err);
    rn_picture_finish(&depth);
    rn_image_finish(&rgb);
    rn_image_finish(&opacity);
    return code;
}

static enum rn_exit write_cloud(const struct rn_cloud *cloud, const char *file) {
    struct rn_error err = {0};
    uint8_t *bytes;
    size_t size;
    if (rn_cloud_encode_ply(cloud, &bytes, &size, &err) != RN_OK) return rn_client_fail(&err);
    enum rn_status status = rn_file_write_atomic(file, bytes, size, &err);
    free(bytes);
    return status == RN_OK ? RN_EXIT_OK : rn_client_not_written(&err);
}

// What is printed in the end.
struct summary {
    char *file;
    int64_t points, views;
};
static const struct rn_field_spec summary_fields[] = {
    RN_F_STRING(struct summary, file, RN_REQUIRED, 4096),
    RN_F_INT(struct summary, points, RN_REQUIRED, 0, INT64_MAX),
    RN_F_INT(struct summary, views, RN_REQUIRED, 0, INT64_MAX)};
static const struct rn_table summary_table = RN_TABLE(struct summary, "summary", summary_fields);

static void print_summary(const struct rn_client *client, const struct summary *summary) {
    char *json = client->json ? rn_api_encode(&summary_table, summary) : NULL;
    if (json) puts(json);
    if (!client->json)
        printf("%s: %lld points out of %lld view%s\n", summary->file, (long long)summary->points,
               (long long)summary->views, summary->views == 1 ? "" : "s");
    free(json);
}

static enum rn_exit export_points(struct rn_client *client, const struct export_options *options,
                                  const char *scene, const double box[2][3],
                                  const struct rn_camera_list_record *cameras) {
    struct rn_cloud cloud = {0};
    size_t count = cameras->item_count;
    size_t views = options->views == RN_OPTION_ABSENT ? VIEWS : (size_t)options->views;
    int64_t size = options->max_size == RN_OPTION_ABSENT ? MAX_SIZE : options->max_size;
    enum rn_exit code = RN_EXIT_OK;
    if (views > count) views = count;
    for (size_t i = 0; i < views && code == RN_EXIT_OK; i++)
        code =
            add_view(client, scene, &cameras->items[i * count / views].camera, size, box, &cloud);
    if (code == RN_EXIT_OK) code = write_cloud(&cloud, options->out);
    if (code == RN_EXIT_OK)
        print_summary(
            client, &(struct summary){(char *)options->out, (int64_t)cloud.count, (int64_t)views});
    rn_cloud_finish(&cloud);
    return code;
}

static bool ends_in(const char *text, const char *end) {
    size_t length = strlen(text), tail = strlen(end);
    return length >= tail && strcmp(text + length - tail, end) == 0;
}

static enum rn_exit export_surface(struct rn_client *client, const struct export_options *options,
                                   const char *scene, const double box[2][3]) {
    struct rn_export_options wanted;
    rn_message_init(&rn_export_options_table, &wanted);
    wanted.as = RN_EXPORT_MESH;
    wanted.format = ends_in(options->out, ".obj") ? RN_EXPORT_OBJ : RN_EXPORT_PLY;
    if (options->cells != RN_OPTION_ABSENT) wanted.cells = options->cells;
    wanted.level = options->level;
    if (box) memcpy(wanted.crop, box, sizeof wanted.crop);
    return rn_export_by_job(client, scene, &wanted, options->out);
}

static bool parse_loss(const char *text, double *ret_loss) {
    int end = 0;
    return sscanf(text, "%lf%n", ret_loss, &end) == 1 &&
           (text[end] == '\0' || strcmp(text + end, "dB") == 0) && *ret_loss >= 0 &&
           *ret_loss <= 100;
}

static enum rn_exit export_scene(struct rn_client *client, const struct export_options *options,
                                 const char *scene) {
    struct rn_export_options wanted;
    rn_message_init(&rn_export_options_table, &wanted);
    wanted.as = RN_EXPORT_SCENE;
    if (options->max_loss && !parse_loss(options->max_loss, &wanted.max_loss))
        return rn_client_usage("--max-loss", "must be dB from 0 to 100, such as 0.05dB; it is '%s'",
                               options->max_loss);
    if (!isnan(options->max_bytes)) wanted.max_bytes = (int64_t)options->max_bytes;
    return rn_export_by_job(client, scene, &wanted, options->out);
}

// An option that is not of what is written; NULL: there is none.
static const char *stray(const struct export_options *o) {
    bool points = !o->as || strcmp(o->as, "points") == 0, mesh = !points && *o->as == 'm';
    if (!points && (o->views != RN_OPTION_ABSENT || o->max_size != RN_OPTION_ABSENT))
        return "--views, --max-size";
    if (!mesh && (o->cells != RN_OPTION_ABSENT || !isnan(o->level))) return "--cells, --level";
    if ((points || mesh) && (o->max_loss || !isnan(o->max_bytes))) return "--max-bytes, --max-loss";
    return !points && !mesh && o->crop ? "--crop" : NULL;
}

static enum rn_exit check_out(const struct export_options *o) {
    bool scene = o->as && strcmp(o->as, "scene") == 0, mesh = o->as && strcmp(o->as, "mesh") == 0;
    if (scene && !ends_in(o->out, ".ripscene"))
        return rn_client_usage(o->out, "is no file of a scene; use .ripscene");
    if (mesh && !ends_in(o->out, ".obj") && !ends_in(o->out, ".ply"))
        return rn_client_usage(o->out, "is no file of a mesh; use .ply or .obj");
    if (!scene && !mesh && !ends_in(o->out, ".ply"))
        return rn_client_usage(o->out, "is no file of points; use .ply");
    return rn_client_check_target(o->out, o->overwrite);
}

static enum rn_exit export_of_job(struct rn_client *client, const struct export_options *o,
                                  const char *job) {
    if (o->as || o->crop || o->max_loss || !isnan(o->max_bytes) || !isnan(o->level) ||
        o->cells != RN_OPTION_ABSENT || o->views != RN_OPTION_ABSENT ||
        o->max_size != RN_OPTION_ABSENT)
        return rn_client_usage(job, "is a job, which was told what to export; it takes -o and "
                                    "--overwrite alone");
    enum rn_exit code = rn_client_check_target(o->out, o->overwrite);
    return code == RN_EXIT_OK ? rn_export_of_job(client, job, o->out) : code;
}

static enum rn_exit run_export(struct rn_client *client, const void *context, const char **args) {
    const struct export_options *options = context;
    struct rn_scene scene;
    struct rn_camera_list_record cameras;
    double crop[6] = {0}, box[2][3];
    if (!options->out) return rn_client_usage("export", "needs -o FILE.ply");
    if (strncmp(args[0], RN_ID_JOB, strlen(RN_ID_JOB)) == 0)
        return export_of_job(client, options, args[0]);
    if (!rn_crop_option(options->crop, crop)) return RN_EXIT_USAGE;
    memcpy(box, crop, sizeof box);
    if (stray(options))
        return rn_client_usage(stray(options), "is not of --as %s",
                               options->as ? options->as : "points");
    enum rn_exit code = check_out(options);
    if (code != RN_EXIT_OK) return code;
    if (options->as && strcmp(options->as, "scene") == 0)
        return export_scene(client, options, args[0]);
    if (options->as && strcmp(options->as, "mesh") == 0)
        return export_surface(client, options, args[0],
                              options->crop ? (const double(*)[3])box : NULL);
    code = rn_api_get(client, "scenes", args[0], "", &rn_scene_table, &scene);
    if (code != RN_EXIT_OK) return code;
    if (!*scene.dataset) {
        rn_message_finish(&rn_scene_table, &scene);
        return rn_client_usage(args[0], "was imported without a dataset, whose cameras are looked "
                                        "through; import it again with --dataset, or --as mesh");
    }
    code =
        rn_api_get(client, "datasets", scene.dataset, "/cameras", &rn_camera_list_table, &cameras);
    if (code == RN_EXIT_OK) {
        code = export_points(client, options, args[0],
                             options->crop ? (const double(*)[3])box : NULL, &cameras);
        rn_message_finish(&rn_camera_list_table, &cameras);
    }
    rn_message_finish(&rn_scene_table, &scene);
    return code;
}

const struct rn_verb rn_verbs_export[] = {
    {.name = "export",
     .arguments = "SCENE|JOB -o FILE",
     .summary = "a scene for viewing elsewhere, its surface as a mesh, or as points",
     .details =
         "Looks at the scene through cameras of its dataset and writes a point for each pixel "
         "that is opaque and no edge: where it lies, in the dataset's coordinates, and its "
         "colour. What lies farther than depth pictures reach is left out. With --as mesh a job "
         "lays triangles where the density crosses a level, with a colour at each corner, within "
         "--crop or the scene's ball (unbounded scenes: its inner half). With --as scene it writes "
         "the "
         "scene without its optimiser, its planes in half or in 4 to 8 bits a value by blocks: the "
         "smallest file that loses no more than --max-loss, or the best one within --max-bytes. "
         "What "
         "it lost was measured on held-out views and stands in the file, which ripnerf import "
         "takes, "
         "here or elsewhere: the scene renders as any other, and is trained no further. With the "
         "id of such a job it brings what that makes or made, where Ctrl-C ended the waiting.",
     .args_min = 1,
     .args_max = 1,
     .table = export_table,
     .options_size = sizeof(struct export_options),
     .run = run_export},
    {0}};

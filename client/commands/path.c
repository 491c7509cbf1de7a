// path, paths, turntable.

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "client/commands/gather.h"
#include "client/commands/submit.h"
#include "client/commands/turn.h"
#include "common/base/file.h"
#include "common/path/formats/formats.h"
#include "proto/render.h"

// ---- path and turntable ----

struct path_options {
    const char *out, *codec, *output, *format, *crop;
    struct rn_option_pair size, frames;
    double fps, seconds, elevation, distance, fov;
    int64_t video_quality, jpeg_quality;
    bool overwrite, resume, whole;
    struct rn_optics_request optics;
    union rn_setting_value settings[RN_RENDER_SETTINGS];
};
static const char *const mp4_codec_names[] = {"h264", "av1", NULL}; // of rn_film_names
#define PATH(m) .offset = offsetof(struct path_options, m)
#define SIZE_OPTION                                                                                \
    {                                                                                              \
        .name = "size", .kind = RN_OPTION_SIZE, PATH(size), .value = "WxH",                        \
        .members = "width|height", .min = 1, .max = 16384,                                         \
        .help = "pixels of a frame; else as the path says"                                         \
    }
#define FPS_OPTION                                                                                 \
    {                                                                                              \
        .name = "fps", .kind = RN_OPTION_NUMBER, PATH(fps), .value = "N", .min = 0.001,            \
        .max = 1000, .help = "frames a second; else as the path says"                              \
    }
#define FRAMES_OPTION                                                                              \
    {                                                                                              \
        .name = "frames", .kind = RN_OPTION_RANGE, PATH(frames), .value = "A-B",                   \
        .members = "first|last", .min = 0, .max = RN_PATH_MAX_FRAMES - 1,                          \
        .help = "only the frames A to B, both included"                                            \
    }
// Of the frames and what is made of them, for both verbs.
#define PICTURE_OPTIONS                                                                            \
    FRAMES_OPTION,                                                                                 \
        {.name = "", .kind = RN_OPTION_SETTINGS, PATH(settings), .settings = &rn_render_settings}, \
        {.name = "", .kind = RN_OPTION_SETTINGS, PATH(optics), .settings = &rn_optics_settings},   \
        {.name = "format",                                                                         \
         .kind = RN_OPTION_CHOICE,                                                                 \
         PATH(format),                                                                             \
         .choices = rn_picture_format_names,                                                       \
         .help =                                                                                   \
             "of frames (png); png16: 16 bits a channel; exr: linear colour,\nalpha, depth and "   \
             "normals in one file"},                                                               \
        {.name = "jpeg-quality",                                                                   \
         .kind = RN_OPTION_INTEGER,                                                                \
         PATH(jpeg_quality),                                                                       \
         .value = "Q",                                                                             \
         .min = 1,                                                                                 \
         .max = 100,                                                                               \
         .help = "of jpeg frames (90)"},                                                           \
        {.name = "crop",                                                                           \
         .kind = RN_OPTION_TEXT,                                                                   \
         PATH(crop),                                                                               \
         .value = "BOX",                                                                           \
         .help = "only what lies in the box X0,Y0,Z0,X1,Y1,Z1, dataset units"},                    \
        {.name = "output",                                                                         \
         .kind = RN_OPTION_CHOICE,                                                                 \
         PATH(output),                                                                             \
         .choices = rn_output_kind_names,                                                          \
         .help = "what the frames show (rgb)"},                                                    \
        {.name = "codec",                                                                          \
         .kind = RN_OPTION_CHOICE,                                                                 \
         PATH(codec),                                                                              \
         .choices = mp4_codec_names,                                                               \
         .help = "of an .mp4 (h264)"},                                                             \
        {.name = "video-quality",                                                                  \
         .kind = RN_OPTION_INTEGER,                                                                \
         PATH(video_quality),                                                                      \
         .value = "Q",                                                                             \
         .min = 0,                                                                                 \
         .max = 100,                                                                               \
         .help = "of a film: 0 smallest, 100 best (75)"},                                          \
    {                                                                                              \
        .name = "resume", .kind = RN_OPTION_FLAG, PATH(resume),                                    \
        .help = "go on with what an earlier call began in OUT"                                     \
    }
#define OUT_OPTIONS                                                                                \
    {.name = "out",                                                                                \
     .letter = 'o',                                                                                \
     .kind = RN_OPTION_TEXT,                                                                       \
     PATH(out),                                                                                    \
     .value = "OUT",                                                                               \
     .members = "film",                                                                            \
     .help = "a folder for 00000.png, ..., or a film: .mp4, .webm, .gif"},                         \
    {                                                                                              \
        .name = "overwrite", .kind = RN_OPTION_FLAG, PATH(overwrite),                              \
        .help = "replace what OUT holds"                                                           \
    }
static const struct rn_option picture_table[] = {PICTURE_OPTIONS, {0}};
static const struct rn_option path_table[] = {
    SIZE_OPTION, FPS_OPTION, OUT_OPTIONS, PICTURE_OPTIONS, {0}};
static const struct rn_option turntable_table[] = {
    {.name = "seconds",
     .kind = RN_OPTION_SECONDS,
     PATH(seconds),
     .value = "T",
     .min = 0.1,
     .max = 3600,
     .help = "of the whole turn (6s)"},
    {.name = "elevation",
     .kind = RN_OPTION_NUMBER,
     PATH(elevation),
     .value = "DEG",
     .min = -89,
     .max = 89,
     .help = "of the camera over the ground; else as the cameras stand"},
    {.name = "distance",
     .kind = RN_OPTION_NUMBER,
     PATH(distance),
     .value = "D",
     .min = 1e-6,
     .max = 1e6,
     .help = "from the middle, in the dataset's units; else as they stand"},
    {.name = "fov",
     .kind = RN_OPTION_NUMBER,
     PATH(fov),
     .value = "DEG",
     .min = 1,
     .max = 170,
     .help = "from top to bottom; else as the first camera's"},
    {.name = "whole",
     .kind = RN_OPTION_FLAG,
     PATH(whole),
     .help = "a whole turn, where photographs cover only a part too"},
    SIZE_OPTION,
    FPS_OPTION,
    OUT_OPTIONS,
    PICTURE_OPTIONS,
    {0}};

struct path_request {
    int type;
    char *scene, *path; // only read
    struct rn_path_document camera_path;
    struct rn_path_options options;
};
static const struct rn_field_spec path_request_fields[] = {
    RN_F_NAME(struct path_request, type, RN_REQUIRED, rn_job_type_names),
    RN_F_STRING(struct path_request, scene, RN_REQUIRED, 4096),
    RN_F_STRING(struct path_request, path, 0, 4096), RN_F_PATH(struct path_request, camera_path, 0),
    RN_F_OBJECT(struct path_request, options, 0, &rn_path_options_table)};
static const struct rn_table path_request_table =
    RN_TABLE(struct path_request, "path request", path_request_fields);

// A file of any format whose coordinates are the dataset's. The text is malloc'd.
static enum rn_exit load_path(const char *file, char **ret_json) {
    struct rn_error err = {0};
    struct rn_path *path = NULL;
    struct rn_path_choices none = {.width = 0};
    struct rn_path_text in = {.where = file};
    uint8_t *bytes = NULL;
    enum rn_status status = rn_file_read(file, RN_PATH_MAX_IMPORT, &bytes, &in.size, &err);
    in.text = (char *)bytes;
    if (status == RN_OK) status = rn_path_import(&in, NULL, &none, &path, NULL, &err);
    if (status == RN_ERROR_UNSUPPORTED)
        rn_client_note("ripnerf: such a path is converted first: ripnerf help paths");
    if (status == RN_OK) status = rn_path_object_text(path, ret_json, &err);
    free(bytes);
    rn_path_destroy(&path);
    return status == RN_OK ? RN_EXIT_OK : rn_client_fail(&err);
}

// enum rn_picture_format; -1: not said.
static int format_of(const struct path_options *options) {
    return options->format ? rn_name_index(rn_picture_format_names, options->format) : -1;
}

static bool fill_options(const struct path_options *options, struct rn_path_options *wanted) {
    wanted->width = options->size.first;
    wanted->height = options->size.second;
    wanted->first = options->frames.first;
    wanted->last = options->frames.second;
    wanted->fps = options->fps;
    wanted->optics = options->optics;
    wanted->film = rn_target_film(options->out, options->codec);
    wanted->format = format_of(options);
    wanted->jpeg_quality = options->jpeg_quality;
    wanted->output = options->output ? rn_name_index(rn_output_kind_names, options->output) : -1;
    wanted->video_quality = options->video_quality;
    memcpy(wanted->settings, options->settings, sizeof options->settings);
    return rn_crop_option(options->crop, wanted->crop);
}

// `json`: the path's object; else `name` is a camera path of the daemon's.
static enum rn_exit encode_request(const struct path_options *options, const char *scene,
                                   const char *name, const char *json, char **ret_body) {
    struct path_request request;
    rn_message_init(&path_request_table, &request);
    request.type = RN_JOB_PATH;
    request.scene = (char *)scene;
    request.path = (char *)name;
    request.camera_path.json = (char *)json;
    if (!fill_options(options, &request.options)) return RN_EXIT_USAGE;
    *ret_body = rn_api_encode(&path_request_table, &request);
    return *ret_body ? RN_EXIT_OK : RN_EXIT_FAILED;
}

// FILE is a path file, or where there is no such file a camera path of the daemon's.
static enum rn_exit path_body(const struct path_options *options, const char **args,
                              char **ret_body) {
    char *json = NULL;
    bool is_file = access(args[1], F_OK) == 0 || strpbrk(args[1], "/.");
    enum rn_exit code = is_file ? load_path(args[1], &json) : RN_EXIT_OK;
    if (code == RN_EXIT_OK)
        code = encode_request(options, args[0], is_file ? NULL : args[1], json, ret_body);
    free(json);
    return code;
}

// Submits the body, or goes on with an earlier call's job, and brings what comes of it.
static enum rn_exit submit_and_gather(struct rn_client *client, const struct path_options *options,
                                      const struct rn_target *target, const char *body) {
    char job[RN_ID_MAX], *answer = NULL;
    snprintf(job, sizeof job, "%s", target->job);
    enum rn_exit code = *job ? rn_take_up(client, job) : rn_submit(client, body, job, &answer);
    free(answer);
    if (code != RN_EXIT_OK) return code;
    return rn_gather(client, target, job, rn_int_or(options->frames.first, 0));
}

// What is asked of a film, or of frames, that OUT is not.
static enum rn_exit check_kind(const struct path_options *options) {
    int film = rn_target_film(options->out, NULL);
    if (film >= 0 && format_of(options) > RN_FORMAT_PNG)
        return rn_client_usage("--format", "is of frames in a folder; a film is made of png");
    if (options->jpeg_quality != RN_OPTION_ABSENT && format_of(options) != RN_FORMAT_JPEG)
        return rn_client_usage("--jpeg-quality", "is of --format jpeg");
    if (options->codec && (film < 0 || rn_name_index(mp4_codec_names, rn_film_names[film]) < 0))
        return rn_client_usage("--codec", "is of an .mp4; OUT is %s", options->out);
    if (options->video_quality != RN_OPTION_ABSENT && film < 0)
        return rn_client_usage("--video-quality", "is of a film; OUT is %s", options->out);
    return RN_EXIT_OK;
}

static enum rn_exit open_target(const struct path_options *options, struct rn_target *ret_target) {
    enum rn_exit code = check_kind(options);
    if (code == RN_EXIT_OK)
        code = rn_target_open(options->out, options->overwrite, options->resume, ret_target);
    ret_target->extension =
        rn_picture_format_extensions[rn_name_or(format_of(options), RN_FORMAT_PNG)];
    return code;
}

static enum rn_exit run_path(struct rn_client *client, const void *context, const char **args) {
    const struct path_options *options = context;
    struct rn_target target = {.job = ""};
    char *body = NULL;
    if (!options->out) return rn_client_usage("path", "needs -o DIR or -o film.mp4");
    enum rn_exit code = rn_check_budget(options->settings);
    if (code == RN_EXIT_OK) code = open_target(options, &target);
    if (code == RN_EXIT_OK && !*target.job) code = path_body(options, args, &body);
    if (code == RN_EXIT_OK) code = submit_and_gather(client, options, &target, body);
    rn_target_close(&target);
    free(body);
    return code;
}

static bool is_path_file(const char *out) {
    size_t size = strlen(out);
    return size > 5 && strcmp(out + size - 5, ".json") == 0;
}

static enum rn_exit write_path(const char *file, const char *json, int64_t *ret_bytes) {
    struct rn_error err = {0};
    struct rn_buf text;
    rn_buf_init(&text, RN_PATH_MAX_BYTES);
    rn_buf_printf(&text, "{\"path\":%s}\n", json);
    enum rn_status status = rn_buf_status(&text, file, &err);
    if (status == RN_OK) status = rn_file_write_atomic(file, text.data, text.size, &err);
    *ret_bytes = (int64_t)text.size;
    rn_buf_finish(&text);
    if (status == RN_OK) return RN_EXIT_OK;
    return rn_client_not_written(&err);
}

// OUT is to be a camera path's file.
static enum rn_exit check_path_file(const struct path_options *options) {
    char given[64];
    if (rn_options_given(picture_table, options, given, sizeof given))
        return rn_client_usage(given, "is of pictures; %s is a camera path", options->out);
    return rn_client_check_target(options->out, options->overwrite);
}

static enum rn_exit save_path(const struct rn_client *client, const struct path_options *options,
                              const struct rn_turn *turn, const char *scene, const char *json) {
    int64_t bytes;
    enum rn_exit code = write_path(options->out, json, &bytes);
    if (code != RN_EXIT_OK) return code;
    if (client->json) return rn_client_print_file(options->out, bytes);
    printf("%s: a camera path of %g s, %g frames a second; ripnerf path %s %s -o OUT renders it\n",
           options->out, turn->seconds, turn->fps, scene, options->out);
    return RN_EXIT_OK;
}

static enum rn_exit run_turntable(struct rn_client *client, const void *context,
                                  const char **args) {
    const struct path_options *options = context;
    struct rn_target target = {.job = ""};
    char *json = NULL, *body = NULL;
    struct rn_turn turn = {.seconds = rn_number_or(options->seconds, 6),
                           .fps = rn_number_or(options->fps, 30),
                           .elevation_deg = options->elevation,
                           .distance = options->distance,
                           .fov_deg = options->fov,
                           .width = rn_int_or(options->size.first, 0),
                           .height = rn_int_or(options->size.second, 0),
                           .whole = options->whole};
    double covered_deg = 360;
    if (!options->out) return rn_client_usage("turntable", "needs -o OUT");
    bool is_path = is_path_file(options->out);
    enum rn_exit code = rn_check_budget(options->settings);
    if (code == RN_EXIT_OK)
        code = is_path ? check_path_file(options) : open_target(options, &target);
    if (code == RN_EXIT_OK && !*target.job)
        code = rn_turn_path(client, args[0], &turn, &json, &covered_deg);
    if (code == RN_EXIT_OK && covered_deg < 360 && !options->whole)
        rn_client_note("ripnerf: the photographs cover %.0f of 360 degrees: a swing over them; "
                       "--whole for a whole turn",
                       covered_deg);
    if (code == RN_EXIT_OK && is_path) {
        code = save_path(client, options, &turn, args[0], json);
    } else if (code == RN_EXIT_OK) {
        if (json) code = encode_request(options, args[0], NULL, json, &body);
        if (code == RN_EXIT_OK) code = submit_and_gather(client, options, &target, body);
    }
    rn_target_close(&target);
    free(json);
    free(body);
    return code;
}

// ---- paths ----

struct paths_options {
    const char *from, *to, *space, *dataset;
    struct rn_option_pair size;
    double fps, seconds, fov;
    bool overwrite;
};
#define PATHS(m) .offset = offsetof(struct paths_options, m)
static void list_formats(char *text, size_t capacity) {
    rn_path_format_names("|", text, capacity);
}

static const struct rn_option paths_table[] = {
    {.name = "from",
     .kind = RN_OPTION_CHOICE,
     PATHS(from),
     .list = list_formats,
     .help = "IN is this; else it is recognised"},
    {.name = "to",
     .kind = RN_OPTION_CHOICE,
     PATHS(to),
     .list = list_formats,
     .help = "OUT becomes this (ripnerf)"},
    {.name = "space",
     .kind = RN_OPTION_TEXT,
     PATHS(space),
     .value = "FILE",
     .help = "the dataparser_transforms.json of the training that\nnerfstudio's coordinates are "
             "of; or the word dataset"},
    {.name = "dataset",
     .kind = RN_OPTION_TEXT,
     PATHS(dataset),
     .value = "FILE",
     .help = "the dataset's transforms.json, where it moves coordinates"},
    {.name = "size",
     .kind = RN_OPTION_SIZE,
     PATHS(size),
     .value = "WxH",
     .min = 1,
     .max = 16384,
     .help = "pixels of a frame; else as IN says"},
    {.name = "fps",
     .kind = RN_OPTION_NUMBER,
     PATHS(fps),
     .value = "N",
     .min = 0.001,
     .max = 1000,
     .help = "frames a second; else as IN says"},
    {.name = "seconds",
     .kind = RN_OPTION_NUMBER,
     PATHS(seconds),
     .value = "T",
     .min = 0.001,
     .max = 3600,
     .help = "between keys that have no times (1)"},
    {.name = "fov",
     .kind = RN_OPTION_NUMBER,
     PATHS(fov),
     .value = "DEG",
     .min = 1,
     .max = 170,
     .help = "of cameras without a field of view"},
    {.name = "overwrite", .kind = RN_OPTION_FLAG, PATHS(overwrite), .help = "replace OUT"},
    {0}};

static enum rn_status read_text(const char *file, uint8_t **ret_bytes, size_t *ret_size,
                                struct rn_error *err) {
    return rn_file_read(file, RN_PATH_MAX_IMPORT, ret_bytes, ret_size, err);
}

// The text of a file that an option names, malloc'd; none where `file` is NULL.
static enum rn_status read_named(const char *file, struct rn_path_text *ret_text,
                                 struct rn_error *err) {
    uint8_t *text = NULL;
    *ret_text = (struct rn_path_text){.where = file};
    enum rn_status status = file ? read_text(file, &text, &ret_text->size, err) : RN_OK;
    ret_text->text = (char *)text;
    return status;
}

// Where the foreign file's coordinates lie; *ret_given is false when nothing was said of that.
static enum rn_status find_space(const struct paths_options *options,
                                 const struct rn_path_format *format, struct rn_path_space *space,
                                 bool *ret_given, struct rn_error *err) {
    struct rn_path_text said = {.text = "dataset", .size = 7}, dataset = {0};
    bool is_word = options->space && strcmp(options->space, said.text) == 0;
    if (options->dataset && format->needs_space && !options->space)
        return rn_error_set(err, RN_ERROR_INVALID, "--dataset",
                            "needs --space too for nerfstudio's paths");
    enum rn_status status = is_word ? RN_OK : read_named(options->space, &said, err);
    if (status == RN_OK) status = read_named(options->dataset, &dataset, err);
    if (status == RN_OK)
        status = rn_path_space_find(format, &said, &dataset, space, ret_given, err);
    if (!is_word) free((char *)said.text);
    free((char *)dataset.text);
    return status;
}

// The file that a format has beside its own: of this name in the same folder. malloc'd.
static char *beside_of(const char *file, const char *name) {
    char *path = NULL;
    const char *slash = strrchr(file, '/');
    if (asprintf(&path, "%.*s%s", slash ? (int)(slash + 1 - file) : 0, file, name) < 0) return NULL;
    return path;
}

static enum rn_status import_file(const struct paths_options *options, const char *file,
                                  struct rn_path **ret_path,
                                  const struct rn_path_format **ret_format, struct rn_error *err) {
    const struct rn_path_format *from = options->from ? rn_path_format_find(options->from) : NULL;
    struct rn_path_space space;
    struct rn_path_choices choices = {.width = (int)rn_int_or(options->size.first, 0),
                                      .height = (int)rn_int_or(options->size.second, 0),
                                      .fps = rn_number_or(options->fps, 0),
                                      .seconds = rn_number_or(options->seconds, 0),
                                      .fov_y_deg = rn_number_or(options->fov, 0)};
    struct rn_path_text in = {.where = file};
    uint8_t *text = NULL, *beside = NULL;
    bool given = false;
    enum rn_status status = read_text(file, &text, &in.size, err);
    in.text = (char *)text;
    if (status == RN_OK && !from) status = rn_path_recognise(&in, &from, err);
    if (status == RN_OK && from != rn_path_formats[0])
        status = find_space(options, from, &space, &given, err);
    if (status == RN_OK && from->beside) {
        char *path = beside_of(file, from->beside);
        if (path && access(path, F_OK) == 0)
            status = read_text(path, &beside, &in.beside_size, err);
        in.beside = (char *)beside;
        free(path);
    }
    if (given) choices.space = &space;
    if (status == RN_OK) status = rn_path_import(&in, from, &choices, ret_path, ret_format, err);
    free(text);
    free(beside);
    return status;
}

static enum rn_exit write_texts(const char *file, const struct rn_path_format *format,
                                const char *text, const char *beside) {
    struct rn_error err = {0};
    enum rn_status status = rn_file_write_atomic(file, text, strlen(text), &err);
    char *path = status == RN_OK && beside ? beside_of(file, format->beside) : NULL;
    if (path)
        status = rn_file_write_atomic(path, beside, strlen(beside), &err);
    else if (status == RN_OK && beside)
        status = rn_error_set(&err, RN_ERROR_NO_MEMORY, file, "no memory");
    free(path);
    if (status == RN_OK) return RN_EXIT_OK;
    return rn_client_not_written(&err);
}

static enum rn_exit convert(struct rn_client *client, const struct paths_options *options,
                            const char *in, const char *out) {
    struct rn_error err = {0};
    struct rn_path *path = NULL;
    const struct rn_path_format *from = NULL,
                                *to = rn_path_format_find(options->to ? options->to : "ripnerf");
    struct rn_path_space space;
    char *text = NULL, *beside = NULL;
    bool given = false;
    if (!in || !out) return rn_client_usage("paths", "convert needs IN and OUT");
    enum rn_exit code = rn_client_check_target(out, options->overwrite);
    if (code != RN_EXIT_OK) return code;
    enum rn_status status = import_file(options, in, &path, &from, &err);
    bool ours = status == RN_OK && from == rn_path_formats[0]; // --space and --dataset are of OUT's
    if (ours) status = find_space(options, to, &space, &given, &err);
    if (status == RN_OK)
        status = rn_path_export(path, to, given ? &space : NULL, &text, &beside, &err);
    code = status == RN_OK ? write_texts(out, to, text, beside) : rn_client_fail(&err);
    if (code == RN_EXIT_OK && client->json)
        code = rn_client_print_file(out, (int64_t)strlen(text));
    else if (code == RN_EXIT_OK)
        printf("%s: %zu keys, %zu frames of %dx%d at %g a second, from %s to %s\n", out,
               path->key_count, rn_path_frame_count(path), path->width, path->height, path->fps,
               from->name, to->name);
    free(text);
    free(beside);
    rn_path_destroy(&path);
    return code;
}

static void path_row(struct rn_text_table *table, const void *message) {
    const struct rn_camera_path_summary *path = message;
    rn_text_table_row(table, "%s|%s|%s", path->name, path->id, path->created_at);
}

static enum rn_exit list_paths(struct rn_client *client) {
    static const struct rn_api_list list = {.kind = RN_KIND_PATH,
                                            .table = &rn_camera_path_summary_table,
                                            .heading = "NAME|ID|CREATED",
                                            .row = path_row};
    return rn_api_print_list(client, &list);
}

static enum rn_exit remove_path(struct rn_client *client, const char *name) {
    struct rn_api_reply reply;
    if (!name) return rn_client_usage("paths", "rm needs a camera path's name or id");
    char *path = rn_api_path("camera-paths", name, "");
    if (!path) return RN_EXIT_FAILED;
    rn_api_send(client, "DELETE", path, NULL, &reply);
    free(path);
    enum rn_exit code = reply.code == RN_EXIT_OK ? RN_EXIT_OK : rn_api_complain(&reply);
    if (code == RN_EXIT_OK && !client->json) printf("removed %s\n", name);
    rn_api_reply_finish(&reply);
    return code;
}

static enum rn_exit run_paths(struct rn_client *client, const void *context, const char **args) {
    const char *word = args[0] ? args[0] : "ls";
    char given[64];
    if (strcmp(word, "convert") == 0)
        return convert(client, context, args[1], args[1] ? args[2] : NULL);
    if (rn_options_given(paths_table, context, given, sizeof given))
        return rn_client_usage(given, "is of paths convert");
    if (args[0] && args[1] && args[2]) return rn_client_usage(args[2], "is one argument too many");
    if (strcmp(word, "rm") == 0) return remove_path(client, args[1]);
    if (strcmp(word, "ls") == 0 && (!args[0] || !args[1])) return list_paths(client);
    return rn_client_usage(word, "must be ls, rm NAME or convert IN OUT");
}

const struct rn_verb rn_verbs_path[] = {
    {.name = "path",
     .arguments = "SCENE FILE -o OUT",
     .summary = "the frames of a camera path, or a film of them",
     .details = "FILE is a camera path, or the name of one that the daemon keeps. What OUT\n"
                "holds is never replaced unasked. A call that was interrupted, and a job that\n"
                "failed or was cancelled, leave a note there, with which --resume goes on.",
     .args_min = 2,
     .args_max = 2,
     .table = path_table,
     .options_size = sizeof(struct path_options),
     .run = run_path},
    {.name = "turntable",
     .arguments = "SCENE -o OUT",
     .summary = "a turn around a scene",
     .details = "Where the photographs leave a gap of more than 90 degrees, it swings to and fro\n"
                "over what they cover. OUT is a folder, a film, or a camera path's .json, which\n"
                "path takes.",
     .args_min = 1,
     .args_max = 1,
     .table = turntable_table,
     .options_size = sizeof(struct path_options),
     .run = run_turntable},
    {.name = "paths",
     .arguments = "[ls|rm|convert] ...",
     .summary = "camera paths that the daemon keeps, and other programs' files",
     .details =
         "paths ls, rm NAME, convert IN OUT. convert reads and writes camera paths of other "
         "programs; coordinates end up in\n"
         "the dataset's own. nerfstudio's are those of one training: give --space. COLMAP's\n"
         "images.txt takes the cameras.txt beside it.",
     .args_min = 0,
     .args_max = 3,
     .table = paths_table,
     .options_size = sizeof(struct paths_options),
     .run = run_paths},
    {0}};

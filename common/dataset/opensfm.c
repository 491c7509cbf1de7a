// OpenSfM's reconstruction.json, which OpenDroneMap leaves in opensfm/: models of cameras, shots
// and points by name, and tracks.csv beside it, which says what photograph sees a point where.
//
// Poses are world-to-camera, a rotation vector and a translation, axes right, down and forwards.
// Lengths in a picture are shares of its longer side, from its middle.
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/dataset/intrinsics.h"
#include "common/dataset/points.h"
#include "common/math/rotation.h"

#define DOCUMENT "reconstruction.json"
#define TRACKS "tracks.csv"
#define MAX_MODELS 100000
#define HUGE_FOCAL 1e4

// Where it lies.
static const char *const places[] = {"", "opensfm/", NULL};

struct model {
    struct rn_reader *reader;
    const char *place;
    struct rn_json cameras, shots;
    json_t *photos;              // by name: which it is
    json_t *points;              // by track: which it is
    double (*middle_to_edge)[2]; // of each photograph: its longer side, in widths and in heights
    size_t sighting_capacity;
};

static enum rn_status no_memory(const struct model *model, struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_NO_MEMORY, model->reader->folder, "out of memory");
}

static struct rn_json member(const struct rn_json *object, const char *key) {
    return (struct rn_json){json_object_get(object->value, key), object->file, object, key, 0};
}

// ---- cameras ----

static const struct {
    const char *name;
    enum rn_lens lens;
} kinds[] = {{"perspective", RN_LENS_OPENCV},
             {"simple_radial", RN_LENS_OPENCV},
             {"radial", RN_LENS_OPENCV},
             {"brown", RN_LENS_OPENCV},
             {"fisheye", RN_LENS_FISHEYE},
             {"fisheye_opencv", RN_LENS_FISHEYE},
             {"spherical", RN_LENS_EQUIRECTANGULAR},
             {"equirectangular", RN_LENS_EQUIRECTANGULAR}};

static enum rn_status read_kind(const struct rn_json *at, enum rn_lens *ret_lens,
                                struct rn_error *err) {
    const char *name = "perspective";
    struct rn_json kind = *at;
    enum rn_status status = RN_OK;
    if (rn_json_find(at, "projection_type", &kind))
        status = rn_json_text(at, "projection_type", 64, &name, err);
    if (status) return status;
    for (size_t i = 0; i < sizeof kinds / sizeof *kinds; i++)
        if (strcmp(kinds[i].name, name) == 0) {
            *ret_lens = kinds[i].lens;
            return RN_OK;
        }
    return rn_json_error(&kind, RN_ERROR_INVALID, err,
                         "is \"%s\", a lens that is not known here: undistort the photographs, or "
                         "reconstruct them with another one (brown, fisheye_opencv)",
                         name);
}

static enum rn_status optional(const struct rn_json *at, const char *key, double most,
                               double *ret_value, struct rn_error *err) {
    struct rn_json ignored;
    return rn_json_find(at, key, &ignored) ? rn_json_number(at, key, -most, most, ret_value, err)
                                           : RN_OK;
}

static enum rn_status read_lens(const struct rn_json *at, enum rn_lens lens,
                                struct rn_camera *camera, struct rn_error *err) {
    const struct rn_lens_model *model = &rn_lens_models[lens];
    bool bends = lens == RN_LENS_FISHEYE;
    enum rn_status status = RN_OK;
    memset(camera->lens_k, 0, sizeof camera->lens_k);
    for (int i = 0; i < model->count && status == RN_OK; i++) {
        status = optional(at, model->parameters[i], model->most, &camera->lens_k[i], err);
        bends = bends || camera->lens_k[i] != 0;
    }
    camera->lens = bends ? lens : RN_LENS_PINHOLE;
    return status;
}

static enum rn_status read_focal(const struct rn_json *at, double size, double focal[2],
                                 struct rn_error *err) {
    struct rn_json ignored;
    bool one = rn_json_find(at, "focal", &ignored);
    enum rn_status status =
        rn_json_number(at, one ? "focal" : "focal_x", 1e-6, HUGE_FOCAL, &focal[0], err);
    focal[1] = focal[0];
    if (status == RN_OK && !one)
        status = rn_json_number(at, "focal_y", 1e-6, HUGE_FOCAL, &focal[1], err);
    focal[0] *= size;
    focal[1] *= size;
    return status;
}

// `where`: the photograph's place in the document.
static enum rn_status read_camera(struct rn_reader *reader, const struct rn_json *at,
                                  const char *where, struct rn_frame *frame, struct rn_error *err) {
    static const char *const known[] = {"projection_type",
                                        "width",
                                        "height",
                                        "focal",
                                        "focal_x",
                                        "focal_y",
                                        "c_x",
                                        "c_y",
                                        "k1",
                                        "k2",
                                        "k3",
                                        "k4",
                                        "p1",
                                        "p2",
                                        NULL};
    struct rn_camera *camera = &frame->camera;
    enum rn_lens lens = RN_LENS_PINHOLE;
    int width, height;
    double focal[2], middle[2] = {0, 0};
    enum rn_status status;
    rn_reader_warn_unknown(reader, at, known);
    if ((status = read_kind(at, &lens, err)) ||
        (status = rn_json_integer(at, "width", 1, RN_CAMERA_MAX_SIZE, &width, err)) ||
        (status = rn_json_integer(at, "height", 1, RN_CAMERA_MAX_SIZE, &height, err)))
        return status;
    if (lens == RN_LENS_EQUIRECTANGULAR) {
        rn_intrinsics_set_sphere(camera);
        return RN_OK;
    }
    double size = width > height ? width : height;
    if ((status = read_lens(at, lens, camera, err)) ||
        (status = read_focal(at, size, focal, err)) ||
        (status = optional(at, "c_x", 10, &middle[0], err)) ||
        (status = optional(at, "c_y", 10, &middle[1], err)))
        return status;
    camera->fx = focal[0];
    camera->fy = focal[1];
    camera->cx = 0.5 * width + middle[0] * size;
    camera->cy = 0.5 * height + middle[1] * size;
    return rn_reader_fit(reader, where, width, height, frame, err);
}

// ---- shots ----

// World-to-camera, a turn about `v` by its length and then `t`.
static void set_pose(const double v[3], const double t[3], double pose[3][4]) {
    double view[3][4] = {{0, 0, 0, t[0]}, {0, 0, 0, t[1]}, {0, 0, 0, t[2]}};
    rn_rotation_from_vector(v, view);
    rn_pose_invert((const double(*)[4])view, pose);
}

static enum rn_status read_shot(struct model *model, const struct rn_json *shot,
                                struct rn_frame *frame, struct rn_error *err) {
    const char *name;
    char file[RN_FILE_NAME_MAX + 8], where[256];
    double turn[3], shift[3];
    enum rn_status status = rn_json_text(shot, "camera", RN_FILE_NAME_MAX, &name, err);
    rn_json_where(shot, where);
    bool outside = shot->key[0] == '/' || strstr(shot->key, "..");
    snprintf(file, sizeof file, "%s%s", outside ? "" : "images/", shot->key);
    if (status || (status = rn_reader_photo(model->reader, where, file, "", frame, err)))
        return status;
    struct rn_json camera = member(&model->cameras, name), at = member(shot, "camera");
    if (!camera.value)
        return rn_json_error(&at, RN_ERROR_INVALID, err,
                             "is \"%.100s\", which is not among the model's cameras", name);
    if ((status = read_camera(model->reader, &camera, where, frame, err)) ||
        (status = rn_json_matrix(shot, "rotation", 0, 3, turn, err)) ||
        (status = rn_json_matrix(shot, "translation", 0, 3, shift, err)))
        return status;
    set_pose(turn, shift, frame->camera.world_from_camera);
    return rn_reader_check_camera(shot, "rotation", &frame->camera, err);
}

static int compare_names(const void *a, const void *b) {
    return strcmp(*(const char *const *)a, *(const char *const *)b);
}

static enum rn_status read_shots(struct model *model, const char *const *names, size_t count,
                                 struct rn_error *err) {
    for (size_t i = 0; i < count; i++) {
        struct rn_json shot = member(&model->shots, names[i]);
        struct rn_frame frame = {.index = (int)i, .photo = (int)i, .loss_weight = 1};
        struct rn_error why;
        enum rn_status status = read_shot(model, &shot, &frame, &why);
        if (status == RN_OK) {
            double width = frame.camera.width, height = frame.camera.height;
            double size = width > height ? width : height;
            model->middle_to_edge[i][0] = size / width;
            model->middle_to_edge[i][1] = size / height;
            if (json_object_set_new(model->photos, names[i], json_integer((json_int_t)i)))
                status = no_memory(model, &why);
        }
        if ((status = rn_reader_add(model->reader, &frame, status, &why))) {
            if (err) *err = why;
            return status;
        }
    }
    return RN_OK;
}

static enum rn_status read_sorted_shots(struct model *model, struct rn_error *err) {
    size_t count = json_object_size(model->shots.value), i = 0;
    const char *key;
    json_t *value;
    if (count == 0 || count > RN_DATASET_MAX_FRAMES)
        return rn_json_error(&model->shots, count ? RN_ERROR_LIMIT : RN_ERROR_INVALID, err,
                             "has %zu photographs: none was placed, or more than %d", count,
                             RN_DATASET_MAX_FRAMES);
    const char **names = malloc(count * sizeof *names);
    model->middle_to_edge = calloc(count, sizeof *model->middle_to_edge);
    if (!names || !model->middle_to_edge) {
        free(names);
        return no_memory(model, err);
    }
    json_object_foreach((json_t *)model->shots.value, key, value) names[i++] = key;
    qsort(names, count, sizeof *names, compare_names);
    enum rn_status status = read_shots(model, names, count, err);
    free(names);
    return status;
}

// ---- points ----

static enum rn_status read_points(struct model *model, const struct rn_json *of,
                                  struct rn_error *err) {
    struct rn_points *points = &model->reader->dataset->points;
    size_t count = json_object_size(of->value), left_out = 0;
    const char *track;
    json_t *value;
    if (!count) return RN_OK;
    points->items = calloc(count, sizeof *points->items);
    if (!points->items) return no_memory(model, err);
    json_object_foreach((json_t *)of->value, track, value) {
        struct rn_json at = member(of, track), ignored;
        struct rn_point *point = &points->items[points->count];
        double colour[3] = {128, 128, 128};
        bool sound = points->count < RN_POINTS_MAX &&
                     rn_json_matrix(&at, "coordinates", 0, 3, point->position, NULL) == RN_OK &&
                     rn_points_take(point->position);
        if (rn_json_find(&at, "color", &ignored))
            sound = sound && rn_json_matrix(&at, "color", 0, 3, colour, NULL) == RN_OK;
        left_out += !sound;
        if (!sound) continue;
        for (int c = 0; c < 3; c++)
            point->colour[c] = (uint8_t)fmin(fmax(colour[c], 0), 255);
        point->error = -1;
        if (json_object_set_new(model->points, track, json_integer((json_int_t)points->count++)))
            return no_memory(model, err);
    }
    char where[256];
    rn_json_where(of, where);
    if (left_out)
        rn_problems_add(model->reader->problems, RN_SEVERITY_WARNING, where,
                        "%zu of its %zu points have no coordinates or ones beyond 1e12, or are too "
                        "many; they are left out",
                        left_out, count);
    return RN_OK;
}

static enum rn_status see(struct model *model, size_t photo, size_t point, const double at[2],
                          struct rn_error *err) {
    struct rn_points *points = &model->reader->dataset->points;
    if (points->sighting_count == RN_SIGHTINGS_MAX) return RN_OK;
    if (points->sighting_count == model->sighting_capacity) {
        size_t capacity = model->sighting_capacity ? 2 * model->sighting_capacity : 1024;
        struct rn_sighting *grown = realloc(points->sightings, capacity * sizeof *grown);
        if (!grown) return no_memory(model, err);
        points->sightings = grown;
        model->sighting_capacity = capacity;
    }
    const double *reach = model->middle_to_edge[photo];
    points->sightings[points->sighting_count++] =
        (struct rn_sighting){.point = (uint32_t)point,
                             .photo = (uint32_t)photo,
                             .x = (float)(0.5 + at[0] * reach[0]),
                             .y = (float)(0.5 + at[1] * reach[1])};
    return RN_OK;
}

// PHOTOGRAPH, TRACK, FEATURE, X and Y, and more that is not needed, between tabs.
static enum rn_status read_track(struct model *model, const char *path, size_t number, char *line,
                                 struct rn_error *err) {
    char *fields[5], *end;
    double at[2] = {0, 0};
    bool sound = strchr(line, '\n') != NULL; // else the file ends within it
    for (int i = 0; i < 5; i++)
        sound = (fields[i] = strsep(&line, "\t\n")) != NULL && sound;
    for (int i = 0; i < 2 && sound; i++) {
        at[i] = strtod(fields[3 + i], &end);
        sound = end != fields[3 + i] && *end == '\0' && fabs(at[i]) <= 1;
    }
    if (!sound)
        return rn_error_set(err, RN_ERROR_INVALID, path,
                            "line %zu is no track (photograph, track, feature, x, y, ... between "
                            "tabs): copy it again, or go without it",
                            number);
    const json_t *photo = json_object_get(model->photos, fields[0]);
    const json_t *point = json_object_get(model->points, fields[1]);
    if (!photo || !point) return RN_OK; // was not placed
    return see(model, (size_t)json_integer_value(photo), (size_t)json_integer_value(point), at,
               err);
}

static enum rn_status read_lines(struct model *model, const char *path, FILE *file,
                                 struct rn_error *err) {
    char *line = NULL;
    size_t capacity = 0, number = 0;
    enum rn_status status = RN_OK;
    while (status == RN_OK && getline(&line, &capacity, file) > 0) {
        number++;
        if (number == 1 && strncmp(line, "OPENSFM_TRACKS_VERSION", 22) == 0) continue;
        status = read_track(model, path, number, line, err);
    }
    if (status == RN_OK && ferror(file)) status = rn_error_from_errno(err, errno, path, "read");
    free(line);
    return status;
}

// Without the file points say where the scene is all the same.
static enum rn_status read_tracks(struct model *model, struct rn_error *err) {
    char name[64], *path;
    snprintf(name, sizeof name, "%s" TRACKS, model->place);
    if (!model->reader->dataset->points.count || !rn_reader_has(model->reader, name)) return RN_OK;
    enum rn_status status = rn_reader_document(model->reader, name, &path, err);
    if (status) return status;
    FILE *file = fopen(path, "re");
    status =
        file ? read_lines(model, path, file, err) : rn_error_from_errno(err, errno, path, "open");
    if (file) (void)fclose(file);
    free(path);
    return status;
}

// ---- the document ----

// The largest of the list's models; that there are others is told.
static struct rn_json choose(const struct model *model, const struct rn_json *models) {
    size_t count = json_array_size(models->value), best = 0, most = 0;
    for (size_t i = 0; i < count; i++) {
        size_t shots = json_object_size(json_object_get(json_array_get(models->value, i), "shots"));
        if (shots > most) best = i;
        if (shots > most) most = shots;
    }
    if (count > 1)
        rn_problems_add(model->reader->problems, RN_SEVERITY_WARNING, models->file,
                        "has %zu models, which share no coordinates; the largest is read, of %zu "
                        "photographs",
                        count, most);
    return rn_json_element(models, best);
}

static enum rn_status read_document(struct rn_reader *reader, const struct rn_json *root,
                                    void *context, struct rn_error *err) {
    struct model *model = context;
    model->reader = reader;
    struct rn_json models, chosen, points;
    enum rn_status status = rn_json_array(root, NULL, 1, MAX_MODELS, &models, err);
    if (status) return status;
    chosen = choose(model, &models);
    if ((status = rn_json_member(&chosen, "cameras", &model->cameras, err)) ||
        (status = rn_json_member(&chosen, "shots", &model->shots, err)))
        return status;
    model->photos = json_object();
    model->points = json_object();
    status = model->photos && model->points ? read_sorted_shots(model, err) : no_memory(model, err);
    if (status == RN_OK && rn_json_find(&chosen, "points", &points))
        status = read_points(model, &points, err);
    if (status == RN_OK) status = read_tracks(model, err);
    json_decref(model->photos);
    json_decref(model->points);
    free(model->middle_to_edge);
    return status;
}

static enum rn_status read_opensfm(struct rn_reader *reader, struct rn_error *err) {
    struct model model = {.place = places[0]};
    char name[64];
    for (const char *const *place = places; *place; place++) {
        snprintf(name, sizeof name, "%s" DOCUMENT, *place);
        model.place = *place;
        if (rn_reader_has(reader, name)) break;
    }
    return rn_reader_json(reader, name, false, read_document, &model, err);
}

const struct rn_format rn_format_opensfm = {
    .name = "opensfm",
    .title = "OpenSfM",
    .signs = (const struct rn_sign[]){{DOCUMENT, NULL}, {"opensfm/" DOCUMENT, NULL}, {NULL, NULL}},
    .documents = (const char *const[]){DOCUMENT, TRACKS, "opensfm/" DOCUMENT, "opensfm/" TRACKS,
                                       "masks/*", NULL},
    .photo_folders = (const char *const[]){"images", NULL},
    .read = read_opensfm};

// COLMAP's sparse models (Schoenberger and Frahm 2016): cameras, images and points3D, binary or
// text. Poses are world-to-camera, pixels from the image's corner, as here.
//
// rigs and frames, which newer versions write as well, are not needed: images have whole poses.
#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/dataset/colmap_files.h"
#include "common/dataset/points.h"
#include "common/math/rotation.h"

#define MAX_MODELS 32
#define MAX_CAMERAS 1000000

// Where models lie, in the order in which they are looked for.
static const char *const places[] = {"sparse/0/",        "sparse/1/", "sparse/",
                                     "colmap/sparse/0/", "",          NULL};
#define NUMBERED 2 // so many of them are of a folder of models

// A registered photograph.
struct entry {
    uint32_t id, camera;
    double rotation[4], translation[3];
    char *name; // owned
};

// What an identifier of the model's stands for.
struct key {
    uint64_t id;
    uint32_t index;
};

struct model {
    struct rn_reader *reader;
    char place[64];
    struct rn_colmap_camera *cameras; // by id
    size_t camera_count;
    struct entry *images; // by name
    size_t image_count;
    char *images_path;
    const char *photo_folder; // "images/" or the like
    struct key *photos;       // of usable images, by id
    size_t photo_count;
    struct key *points; // of kept points, by id
    size_t point_count;
    size_t sighting_capacity;
    uint64_t orphans, first_orphan; // sightings of points that are not there, and its point
    bool thinned;                   // points were left out
};

static enum rn_status no_memory(const struct model *model, struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_NO_MEMORY, model->reader->folder, "out of memory");
}

// One more element at the end of an array; NULL when memory is out.
static void *grow(void *array, size_t count, size_t *capacity, size_t size) {
    if (count < *capacity) return array;
    size_t more = *capacity ? 2 * *capacity : 64;
    void *grown = realloc(array, more * size);
    if (grown) *capacity = more;
    return grown;
}

// ---- which model ----

static bool is_there(const struct rn_reader *reader, const char *place, const char *name) {
    char file[256];
    snprintf(file, sizeof file, "%s%s", place, name);
    char *path = rn_reader_path(reader, file);
    bool there = path && access(path, F_OK) == 0;
    free(path);
    return there;
}

static FILE *open_images(const struct rn_reader *reader, const char *place, const char *name) {
    char file[256];
    snprintf(file, sizeof file, "%s%s", place, name);
    char *path = rn_reader_path(reader, file);
    FILE *images = path ? fopen(path, "rbe") : NULL;
    free(path);
    return images;
}

// Two lines an image, the second of which may be empty.
static uint64_t count_images(FILE *text) {
    char *line = NULL;
    size_t capacity = 0;
    uint64_t lines = 0;
    while (getline(&line, &capacity, text) >= 0)
        lines += line[0] != '#';
    free(line);
    return (lines + 1) / 2;
}

// How many photographs the model there has registered; 0 without one.
static uint64_t registered(const struct rn_reader *reader, const char *place) {
    uint64_t count = 0;
    FILE *images = open_images(reader, place, "images.bin");
    if (images && fread(&count, 8, 1, images) != 1) count = 0;
    if (!images && (images = open_images(reader, place, "images.txt")))
        count = count_images(images);
    if (images) fclose(images);
    return count;
}

// Of sparse/0, sparse/1 and so on the one with the most photographs: each has coordinates of its
// own.
static void choose_largest(struct model *model) {
    uint64_t most = registered(model->reader, model->place);
    for (int i = 1; i < MAX_MODELS; i++) {
        char place[32], *path = NULL;
        snprintf(place, sizeof place, "sparse/%d/", i);
        if (strcmp(place, model->place) == 0) continue;
        uint64_t count = registered(model->reader, place);
        if (count == 0) continue;
        bool larger = count > most;
        if (!(path = rn_reader_path(model->reader, place))) return;
        rn_problems_add(model->reader->problems, RN_SEVERITY_WARNING, path,
                        "is another model, of %" PRIu64 " photographs, which has coordinates of "
                        "its own; %s, of %" PRIu64 ", is %s",
                        count, model->place, most, larger ? "left out for it" : "read instead");
        free(path);
        if (!larger) continue;
        snprintf(model->place, sizeof model->place, "%s", place);
        most = count;
    }
}

static void find_model(struct model *model) {
    size_t i = 0;
    while (places[i + 1] && !is_there(model->reader, places[i], "images.bin") &&
           !is_there(model->reader, places[i], "images.txt"))
        i++;
    for (size_t j = 0; !places[i + 1] && j < i; j++) // without images, where cameras are
        if (is_there(model->reader, places[j], "cameras.bin") ||
            is_there(model->reader, places[j], "cameras.txt"))
            i = j;
    snprintf(model->place, sizeof model->place, "%s", places[i]);
    if (i < NUMBERED) choose_largest(model);
    if (is_there(model->reader, model->place, "images.bin") &&
        is_there(model->reader, model->place, "images.txt"))
        rn_problems_add(model->reader->problems, RN_SEVERITY_INFO, model->reader->folder,
                        "has its model %sas text too; the binary one is read", model->place);
    if (is_there(model->reader, model->place, "rigs.bin") ||
        is_there(model->reader, model->place, "rigs.txt"))
        rn_problems_add(model->reader->problems, RN_SEVERITY_INFO, model->reader->folder,
                        "has rigs and frames, which are not read: each image has its whole pose");
}

// ---- cameras ----

static int compare_cameras(const void *a, const void *b) {
    const struct rn_colmap_camera *left = a, *right = b;
    return (left->id > right->id) - (left->id < right->id);
}

static enum rn_status read_cameras(struct model *model, struct rn_error *err) {
    struct rn_colmap_file file;
    size_t capacity = 0;
    bool more = true;
    enum rn_status status = rn_colmap_open(model->reader, model->place, "cameras", &file, err);
    while (status == RN_OK) {
        struct rn_colmap_camera camera;
        status = rn_colmap_next_camera(&file, &camera, &more, err);
        if (status || !more) break;
        struct rn_colmap_camera *cameras =
            grow(model->cameras, model->camera_count, &capacity, sizeof *cameras);
        if (!cameras || model->camera_count == MAX_CAMERAS) {
            status = no_memory(model, err);
            break;
        }
        model->cameras = cameras;
        model->cameras[model->camera_count++] = camera;
    }
    rn_colmap_close(&file);
    if (model->camera_count)
        qsort(model->cameras, model->camera_count, sizeof *model->cameras, compare_cameras);
    return status;
}

// ---- images ----

static int compare_names(const void *a, const void *b) {
    return strcmp(((const struct entry *)a)->name, ((const struct entry *)b)->name);
}

static int compare_keys(const void *a, const void *b) {
    const struct key *left = a, *right = b;
    return (left->id > right->id) - (left->id < right->id);
}

static const struct key *find_key(const struct key *keys, size_t count, uint64_t id) {
    struct key wanted = {.id = id};
    return count ? bsearch(&wanted, keys, count, sizeof *keys, compare_keys) : NULL;
}

// An identifier that two images have: what points were seen in could be either.
static enum rn_status check_ids(const struct model *model, struct rn_error *err) {
    struct key *ids = malloc(model->image_count * sizeof *ids);
    enum rn_status status = RN_OK;
    if (!ids) return no_memory(model, err);
    for (size_t i = 0; i < model->image_count; i++)
        ids[i] = (struct key){.id = model->images[i].id};
    qsort(ids, model->image_count, sizeof *ids, compare_keys);
    for (size_t i = 1; i < model->image_count && status == RN_OK; i++)
        if (ids[i - 1].id == ids[i].id)
            status = rn_error_set(err, RN_ERROR_INVALID, model->images_path,
                                  "two images have the id %" PRIu64, ids[i].id);
    free(ids);
    return status;
}

static enum rn_status add_entry(struct model *model, const struct rn_colmap_image *image,
                                size_t *capacity, struct rn_error *err) {
    struct entry *images = grow(model->images, model->image_count, capacity, sizeof *images);
    if (!images) return no_memory(model, err);
    model->images = images;
    if (model->image_count >= RN_DATASET_MAX_FRAMES)
        return rn_error_set(err, RN_ERROR_LIMIT, model->reader->folder, "has more than %d images",
                            RN_DATASET_MAX_FRAMES);
    struct entry *entry = &images[model->image_count];
    *entry = (struct entry){.id = image->id, .camera = image->camera, .name = strdup(image->name)};
    for (char *c = entry->name; c && *c; c++) // of Windows
        if (*c == '\\') *c = '/';
    memcpy(entry->rotation, image->rotation, sizeof entry->rotation);
    memcpy(entry->translation, image->translation, sizeof entry->translation);
    if (!entry->name) return no_memory(model, err);
    model->image_count++;
    return RN_OK;
}

static enum rn_status read_images(struct model *model, struct rn_error *err) {
    struct rn_colmap_file file;
    struct rn_colmap_image image;
    size_t capacity = 0;
    bool more = true;
    enum rn_status status = rn_colmap_open(model->reader, model->place, "images", &file, err);
    if (status == RN_OK && !(model->images_path = strdup(file.path)))
        status = no_memory(model, err);
    while (status == RN_OK) {
        status = rn_colmap_next_image(&file, &image, NULL, NULL, &more, err);
        if (status || !more) break;
        status = add_entry(model, &image, &capacity, err);
    }
    rn_colmap_close(&file);
    if (status == RN_OK && model->image_count == 0)
        return rn_error_set(err, RN_ERROR_INVALID, model->images_path,
                            "has no images: none of the photographs was registered");
    if (status == RN_OK) status = check_ids(model, err);
    if (model->image_count)
        qsort(model->images, model->image_count, sizeof *model->images, compare_names);
    return status;
}

// The first folder that has one of the first photographs.
static void find_photos(struct model *model) {
    static const char *const folders[] = {"images/", "images_2/", "images_4/", "images_8/",
                                          "input/",  "",          NULL};
    for (const char *const *folder = folders; *folder; folder++)
        for (size_t i = 0; i < model->image_count && i < 16; i++)
            if (is_there(model->reader, *folder, model->images[i].name)) {
                model->photo_folder = *folder;
                return;
            }
    model->photo_folder = folders[0];
}

// World-to-camera q, t to world-from-camera.
static bool set_pose(const struct entry *entry, double pose[3][4]) {
    const double *q = entry->rotation, *t = entry->translation;
    double view[3][4] = {{0, 0, 0, t[0]}, {0, 0, 0, t[1]}, {0, 0, 0, t[2]}};
    if (!rn_rotation_from_quaternion(q, view)) return false;
    rn_pose_invert((const double(*)[4])view, pose);
    return true;
}

static enum rn_status read_photo(const struct model *model, const struct entry *entry,
                                 struct rn_frame *frame, struct rn_error *err) {
    char where[256], file[RN_FILE_NAME_MAX + 16];
    struct rn_error inner;
    struct rn_colmap_camera wanted = {.id = entry->camera};
    snprintf(where, sizeof where, "%.160s, image \"%.60s\"", model->images_path, entry->name);
    bool outside = entry->name[0] == '/' || strstr(entry->name, "..");
    snprintf(file, sizeof file, "%s%s", outside ? "" : model->photo_folder, entry->name);
    enum rn_status status = rn_reader_photo(model->reader, where, file, "", frame, err);
    if (status) return status;
    const struct rn_colmap_camera *camera =
        model->camera_count == 0
            ? NULL
            : bsearch(&wanted, model->cameras, model->camera_count, sizeof wanted, compare_cameras);
    if (!camera)
        return rn_error_set(err, RN_ERROR_INVALID, where,
                            "has the camera %" PRIu32 ", which is not among the model's cameras",
                            entry->camera);
    if (!set_pose(entry, frame->camera.world_from_camera))
        return rn_error_set(err, RN_ERROR_INVALID, where,
                            "its rotation's quaternion has no length");
    if ((status = rn_colmap_take_lens(camera, where, &frame->camera, err)) ||
        (status = rn_reader_fit(model->reader, where, (double)camera->width, (double)camera->height,
                                frame, err)))
        return status;
    if ((status = rn_camera_check(&frame->camera, "", &inner)))
        return rn_error_set(err, status, where, "%s", inner.text);
    return RN_OK;
}

static enum rn_status read_photos(struct model *model, struct rn_error *err) {
    struct rn_reader *reader = model->reader;
    model->photos = malloc(model->image_count * sizeof *model->photos);
    if (!model->photos) return no_memory(model, err);
    find_photos(model);
    for (size_t i = 0; i < model->image_count; i++) {
        const struct entry *entry = &model->images[i];
        struct rn_frame frame = {.index = (int)i, .photo = (int)i, .loss_weight = 1};
        struct rn_error why;
        enum rn_status status;
        if (i && compare_names(entry - 1, entry) == 0)
            status = rn_error_set(&why, RN_ERROR_INVALID, model->images_path,
                                  "two images are called \"%.100s\"", entry->name);
        else
            status = read_photo(model, entry, &frame, &why);
        if (status == RN_OK)
            model->photos[model->photo_count++] = (struct key){entry->id, (uint32_t)i};
        if ((status = rn_reader_add(reader, &frame, status, &why))) {
            if (err) *err = why;
            return status;
        }
    }
    qsort(model->photos, model->photo_count, sizeof *model->photos, compare_keys);
    return RN_OK;
}

// ---- points ----

// Every so many points are kept. Of a binary file the sightings follow from its size: 51 bytes a
// point, 8 a sighting.
static uint64_t point_stride(const struct rn_colmap_file *file) {
    if (file->text) return 1;
    uint64_t records = file->count * 51 + 8;
    uint64_t sightings = file->size > records ? (file->size - records) / 8 : 0;
    uint64_t by_points = (file->count + RN_POINTS_MAX - 1) / RN_POINTS_MAX;
    uint64_t by_sightings = (sightings + RN_SIGHTINGS_MAX - 1) / RN_SIGHTINGS_MAX;
    uint64_t stride = by_points > by_sightings ? by_points : by_sightings;
    return stride ? stride : 1;
}

static enum rn_status add_point(struct model *model, const struct rn_colmap_point *point,
                                size_t *capacity, size_t *key_capacity, struct rn_error *err) {
    struct rn_points *points = &model->reader->dataset->points;
    if (points->count == RN_POINTS_MAX) return RN_OK;
    struct rn_point *items = grow(points->items, points->count, capacity, sizeof *items);
    if (!items) return no_memory(model, err);
    points->items = items;
    struct key *keys = grow(model->points, model->point_count, key_capacity, sizeof *keys);
    if (!keys) return no_memory(model, err);
    model->points = keys;
    keys[model->point_count++] = (struct key){point->id, (uint32_t)points->count};
    struct rn_point *item = &items[points->count++];
    *item = (struct rn_point){.error = (float)point->error};
    memcpy(item->position, point->position, sizeof item->position);
    memcpy(item->colour, point->colour, sizeof item->colour);
    return RN_OK;
}

static enum rn_status read_points(struct model *model, struct rn_error *err) {
    struct rn_colmap_file file;
    struct rn_colmap_point point;
    size_t capacity = 0, key_capacity = 0;
    uint64_t at = 0, stride;
    bool more = true;
    enum rn_status status = rn_colmap_open(model->reader, model->place, "points3D", &file, err);
    stride = status ? 1 : point_stride(&file);
    for (; status == RN_OK; at++) {
        status = rn_colmap_next_point(&file, &point, &more, err);
        if (status || !more) break;
        if (at % stride == 0 && rn_points_take(point.position))
            status = add_point(model, &point, &capacity, &key_capacity, err);
    }
    model->thinned = at > model->point_count;
    if (stride > 1 && status == RN_OK)
        rn_problems_add(model->reader->problems, RN_SEVERITY_INFO, file.path,
                        "has %" PRIu64 " points; every %" PRIu64 "th is kept", at, stride);
    rn_colmap_close(&file);
    if (model->point_count)
        qsort(model->points, model->point_count, sizeof *model->points, compare_keys);
    return status;
}

// A keypoint that belongs to a point: kept where the photograph and the point are. A photograph
// that was kept has its camera.
static enum rn_status see(void *context, const struct rn_colmap_image *image, double x, double y,
                          uint64_t id, struct rn_error *err) {
    struct model *model = context;
    struct rn_points *points = &model->reader->dataset->points;
    const struct key *point = find_key(model->points, model->point_count, id);
    const struct key *photo = find_key(model->photos, model->photo_count, image->id);
    struct rn_colmap_camera wanted = {.id = image->camera};
    if (!point && !model->orphans++) model->first_orphan = id;
    if (!point || !photo || points->sighting_count == RN_SIGHTINGS_MAX) return RN_OK;
    const struct rn_colmap_camera *camera =
        bsearch(&wanted, model->cameras, model->camera_count, sizeof wanted, compare_cameras);
    struct rn_sighting *sightings = grow(points->sightings, points->sighting_count,
                                         &model->sighting_capacity, sizeof *sightings);
    if (!sightings) return no_memory(model, err);
    points->sightings = sightings;
    sightings[points->sighting_count++] =
        (struct rn_sighting){.point = point->index,
                             .photo = photo->index,
                             .x = (float)(x / (double)camera->width),
                             .y = (float)(y / (double)camera->height)};
    return RN_OK;
}

static enum rn_status read_sightings(struct model *model, struct rn_error *err) {
    struct rn_colmap_file file;
    struct rn_colmap_image image;
    bool more = true;
    enum rn_status status = rn_colmap_open(model->reader, model->place, "images", &file, err);
    while (status == RN_OK && more)
        status = rn_colmap_next_image(&file, &image, see, model, &more, err);
    rn_colmap_close(&file);
    return status;
}

// Points help but are not needed: without the file, the rest is read all the same.
static enum rn_status read_sparse(struct model *model, struct rn_error *err) {
    struct rn_problems *problems = model->reader->problems;
    struct rn_error why;
    enum rn_status status = read_points(model, &why);
    if (status == RN_ERROR_NOT_FOUND) {
        rn_problems_add(problems, RN_SEVERITY_WARNING, why.where, "%s; there are no sparse points",
                        why.text);
        return RN_OK;
    }
    if (status) {
        if (err) *err = why;
        return status;
    }
    if ((status = read_sightings(model, err))) return status;
    const struct rn_points *points = &model->reader->dataset->points;
    if (model->orphans && !model->thinned)
        rn_problems_add(problems, RN_SEVERITY_WARNING, model->images_path,
                        "%" PRIu64 " of its keypoints belong to points that points3D does "
                        "not have, the first to point %" PRIu64 "; they are left out",
                        model->orphans, model->first_orphan);
    if (points->count && !points->sighting_count)
        rn_problems_add(problems, RN_SEVERITY_WARNING, model->images_path,
                        "sees none of the model's %zu points: its keypoints belong to none",
                        points->count);
    return RN_OK;
}

static void finish(struct model *model) {
    for (size_t i = 0; i < model->image_count; i++)
        free(model->images[i].name);
    free(model->images);
    free(model->cameras);
    free(model->photos);
    free(model->points);
    free(model->images_path);
}

static enum rn_status read_colmap(struct rn_reader *reader, struct rn_error *err) {
    struct model model = {.reader = reader};
    find_model(&model);
    enum rn_status status = read_cameras(&model, err);
    if (status == RN_OK) status = read_images(&model, err);
    if (status == RN_OK) status = read_photos(&model, err);
    if (status == RN_OK) status = read_sparse(&model, err);
    finish(&model);
    return status;
}

const struct rn_format rn_format_colmap = {
    .name = "colmap",
    .title = "COLMAP",
    .signs = (const struct rn_sign[]){{"sparse/0/cameras.bin", NULL},
                                      {"sparse/0/cameras.txt", NULL},
                                      {"sparse/1/cameras.bin", NULL},
                                      {"sparse/1/cameras.txt", NULL},
                                      {"sparse/cameras.bin", NULL},
                                      {"sparse/cameras.txt", NULL},
                                      {"colmap/sparse/0/cameras.bin", NULL},
                                      {"cameras.bin", NULL},
                                      {"cameras.txt", NULL},
                                      {NULL, NULL}},
    .documents = (const char *const[]){"sparse/*/cameras.*", "sparse/*/images.*",
                                       "sparse/*/points3D.*", "sparse/cameras.*", "sparse/images.*",
                                       "sparse/points3D.*", "colmap/sparse/0/cameras.*",
                                       "colmap/sparse/0/images.*", "colmap/sparse/0/points3D.*",
                                       "cameras.*", "images.*", "points3D.*", "masks/*", NULL},
    .photo_folders =
        (const char *const[]){"images", "images_2", "images_4", "images_8", "input", NULL},
    .read = read_colmap};

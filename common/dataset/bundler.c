// Bundler's bundle.out, format 0.3 (Snavely et al. 2006, "Photo Tourism"), which VisualSFM and
// others write too, and list.txt, which names its photographs in order.
//
// Poses are world-to-camera, axes right, up and backwards. What a camera sees at (x, y) before it
// is f (1 + k1 r^2 + k2 r^4) (x, y) pixels from the picture's middle, upwards above 0.
#include <ctype.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "common/dataset/points.h"
#include "common/dataset/reader.h"
#include "common/math/rotation.h"

#define DOCUMENT "bundle.out"
#define LIST "list.txt"
#define CAMERA_BYTES 30 // of 15 numbers at least
#define POINT_BYTES 14  // of 6 numbers and a count
#define FAR_PX 1e6      // from the picture's middle

// A text that is read line by line.
struct text {
    char *path, *line, *at; // the file; the line; what of it was not read yet
    FILE *file;
    size_t capacity, number, size; // of the line; which it is; bytes of the file
};

struct photo {
    char *name;           // owned
    size_t rank;          // by name
    double width, height; // 0: left out
};

struct bundle {
    struct rn_reader *reader;
    struct text text;
    struct photo *photos;
    size_t photo_count, unplaced, point_count;
    size_t point_capacity, sighting_capacity;
    size_t orphans, orphan; // sightings that cannot be; line of the first of these
    size_t bad_points;
};

static enum rn_status no_memory(const struct bundle *bundle, struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_NO_MEMORY, bundle->reader->folder, "out of memory");
}

// ---- text ----

static void where_in(const struct text *text, char where[256]) {
    size_t length = strlen(text->path), most = 200;
    snprintf(where, 256, "%s:%zu", length > most ? text->path + length - most : text->path,
             text->number);
}

static enum rn_status bad(const struct text *text, const char *what, struct rn_error *err) {
    char where[256];
    where_in(text, where);
    return rn_error_set(err, RN_ERROR_INVALID, where, "%s", what);
}

static enum rn_status open_text(struct rn_reader *reader, const char *name, struct text *text,
                                struct rn_error *err) {
    struct stat about;
    enum rn_status status = rn_reader_document(reader, name, &text->path, err);
    if (status) return status;
    text->file = fopen(text->path, "re");
    if (!text->file || fstat(fileno(text->file), &about))
        return rn_error_from_errno(err, errno, text->path, "open");
    if (!S_ISREG(about.st_mode))
        return rn_error_set(err, RN_ERROR_INVALID, text->path, "is no regular file");
    text->size = (size_t)about.st_size;
    return RN_OK;
}

static void close_text(struct text *text) {
    if (text->file) (void)fclose(text->file);
    free(text->path);
    free(text->line);
    *text = (struct text){0};
}

// Of a last line without an end nobody knows whether its last number is whole.
static enum rn_status next_line(struct text *text, bool *ret_more, struct rn_error *err) {
    ssize_t size = getline(&text->line, &text->capacity, text->file);
    text->at = text->line;
    *ret_more = size > 0;
    text->number += *ret_more;
    if (ferror(text->file)) return rn_error_from_errno(err, errno, text->path, "read");
    if (*ret_more && text->line[size - 1] != '\n')
        return bad(text, "the file ends within this line: copy it again", err);
    return RN_OK;
}

static enum rn_status number(struct text *text, double *ret_number, struct rn_error *err) {
    for (bool more = true;;) {
        text->at += strspn(text->at, " \t\r\n");
        if (*text->at) break;
        enum rn_status status = next_line(text, &more, err);
        if (status) return status;
        if (!more) return bad(text, "the file ends behind this line: copy it again", err);
    }
    char *end;
    *ret_number = strtod(text->at, &end);
    if (end == text->at || !isspace((unsigned char)*end))
        return bad(text, "holds something else than a number: copy it again", err);
    text->at = end;
    return RN_OK;
}

static enum rn_status numbers(struct text *text, double *ret_numbers, size_t count,
                              struct rn_error *err) {
    enum rn_status status = RN_OK;
    for (size_t i = 0; i < count && status == RN_OK; i++)
        status = number(text, &ret_numbers[i], err);
    return status;
}

// How many of something of `least` bytes follow.
static enum rn_status how_many(struct text *text, const char *what, size_t least, size_t *ret_count,
                               struct rn_error *err) {
    char where[256];
    double count = 0;
    enum rn_status status = number(text, &count, err);
    if (status) return status;
    where_in(text, where);
    if (!(count >= 0) || count != floor(count) || count > (double)(text->size / least))
        return rn_error_set(err, RN_ERROR_INVALID, where,
                            "says that there are %.20g %s, but the file has room for %zu at most: "
                            "copy it again",
                            count, what, text->size / least);
    *ret_count = (size_t)count;
    return RN_OK;
}

// ---- list.txt ----

// Takes off the last word where it is a number.
static bool drop_number(char *line) {
    char *space = strrchr(line, ' '), *end;
    if (!space || space == line) return false;
    (void)strtod(space + 1, &end);
    if (end == space + 1 || *end) return false;
    *space = 0;
    return true;
}

// A name, or a name, a 0 and a focal length.
static void name_of(char *line) {
    size_t length = strlen(line);
    while (length > 0 && isspace((unsigned char)line[length - 1]))
        line[--length] = 0;
    char *space = strrchr(line, ' ');
    if (space && drop_number(line) && !drop_number(line)) *space = ' ';
}

static int compare_names(const void *a, const void *b) {
    return strcmp((*(struct photo *const *)a)->name, (*(struct photo *const *)b)->name);
}

static enum rn_status rank(struct bundle *bundle, struct rn_error *err) {
    struct photo **sorted = malloc((bundle->photo_count + 1) * sizeof *sorted);
    if (!sorted) return no_memory(bundle, err);
    for (size_t i = 0; i < bundle->photo_count; i++)
        sorted[i] = &bundle->photos[i];
    qsort(sorted, bundle->photo_count, sizeof(struct photo *), compare_names);
    for (size_t i = 0; i < bundle->photo_count; i++)
        sorted[i]->rank = i;
    free(sorted);
    return RN_OK;
}

static enum rn_status read_names(struct bundle *bundle, struct text *list, struct rn_error *err) {
    size_t count = 0;
    bool more = true;
    enum rn_status status;
    while ((status = next_line(list, &more, err)) == RN_OK && more) {
        name_of(list->line);
        if (!*list->line) continue;
        if (count < bundle->photo_count && !(bundle->photos[count].name = strdup(list->line)))
            return no_memory(bundle, err);
        count++;
    }
    if (status) return status;
    if (count == bundle->photo_count) return rank(bundle, err);
    return rn_error_set(err, RN_ERROR_INVALID, list->path,
                        "names %zu photographs, but %s has %zu cameras, which go with them in "
                        "order: give the list that it was made from",
                        count, DOCUMENT, bundle->photo_count);
}

static enum rn_status read_list(struct bundle *bundle, const char *place, struct rn_error *err) {
    struct text list = {0};
    char name[64];
    snprintf(name, sizeof name, "%s" LIST, place);
    if (!rn_reader_has(bundle->reader, name)) snprintf(name, sizeof name, LIST);
    if (!rn_reader_has(bundle->reader, name))
        return rn_error_set(err, RN_ERROR_NOT_FOUND, bundle->reader->folder,
                            "has no " LIST " beside " DOCUMENT ": a file with the photographs' "
                            "names, a line each, in the order of the cameras");
    enum rn_status status = open_text(bundle->reader, name, &list, err);
    if (status == RN_OK) status = read_names(bundle, &list, err);
    close_text(&list);
    return status;
}

// ---- cameras ----

// Right, up and backwards to right, down and forwards.
static void set_pose(const double rotation[9], const double shift[3], double pose[3][4]) {
    double view[3][4];
    for (int i = 0; i < 3; i++) {
        double sign = i == 0 ? 1 : -1;
        for (int j = 0; j < 3; j++)
            view[i][j] = sign * rotation[3 * i + j];
        view[i][3] = sign * shift[i];
    }
    rn_pose_invert((const double(*)[4])view, pose);
}

// f, k1, k2, rotation row by row, translation.
static enum rn_status read_camera(struct bundle *bundle, const char *where, const double values[15],
                                  struct photo *photo, struct rn_frame *frame,
                                  struct rn_error *err) {
    struct rn_camera *camera = &frame->camera;
    char file[RN_FILE_NAME_MAX + 8];
    struct rn_error inner;
    snprintf(file, sizeof file, "images/%s", photo->name);
    bool elsewhere = rn_reader_has(bundle->reader, photo->name) || strstr(photo->name, "..") ||
                     !rn_reader_has(bundle->reader, file);
    enum rn_status status =
        rn_reader_photo(bundle->reader, where, elsewhere ? photo->name : file, "", frame, err);
    if (status) return status;
    double most = rn_lens_models[RN_LENS_OPENCV].most;
    if (!(fabs(values[1]) <= most) || !(fabs(values[2]) <= most))
        return rn_error_set(err, RN_ERROR_INVALID, where,
                            "k1 and k2 are %g and %g; must lie within %g and %g", values[1],
                            values[2], -most, most);
    bool bends = values[1] != 0 || values[2] != 0;
    camera->lens = bends ? RN_LENS_OPENCV : RN_LENS_PINHOLE;
    camera->lens_k[0] = values[1];
    camera->lens_k[1] = values[2];
    camera->fx = camera->fy = values[0];
    camera->cx = 0.5 * camera->width;
    camera->cy = 0.5 * camera->height;
    set_pose(values + 3, values + 12, camera->world_from_camera);
    if ((status = rn_camera_check(camera, "", &inner)))
        return rn_error_set(err, status, where, "%s", inner.text);
    photo->width = camera->width;
    photo->height = camera->height;
    return RN_OK;
}

static enum rn_status read_cameras(struct bundle *bundle, struct rn_error *err) {
    enum rn_status status = RN_OK;
    for (size_t i = 0; i < bundle->photo_count && status == RN_OK; i++) {
        struct rn_frame frame = {
            .index = (int)bundle->photos[i].rank, .photo = (int)i, .loss_weight = 1};
        struct rn_error why;
        double values[15];
        char where[256];
        if ((status = number(&bundle->text, values, err))) return status;
        where_in(&bundle->text, where);
        if ((status = numbers(&bundle->text, values + 1, 14, err))) return status;
        bundle->unplaced += values[0] == 0;
        if (values[0] == 0) continue;
        status = read_camera(bundle, where, values, &bundle->photos[i], &frame, &why);
        if ((status = rn_reader_add(bundle->reader, &frame, status, &why)) && err) *err = why;
    }
    if (bundle->unplaced && status == RN_OK)
        rn_problems_add(bundle->reader->problems, RN_SEVERITY_WARNING, bundle->text.path,
                        "%zu of its %zu photographs have no focal length: they were not placed, "
                        "and are left out",
                        bundle->unplaced, bundle->photo_count);
    return status;
}

// ---- points ----

// Room for one more.
static bool grow(void **array, size_t count, size_t *capacity, size_t size) {
    if (count < *capacity) return true;
    size_t more = *capacity ? 2 * *capacity : 1024;
    void *grown = realloc(*array, more * size);
    if (!grown) return false;
    *array = grown;
    *capacity = more;
    return true;
}

static enum rn_status see(struct bundle *bundle, const double sighting[4], size_t point,
                          struct rn_error *err) {
    struct rn_points *points = &bundle->reader->dataset->points;
    bool there = sighting[0] >= 0 && sighting[0] < (double)bundle->photo_count &&
                 fabs(sighting[2]) < FAR_PX && fabs(sighting[3]) < FAR_PX;
    if (!there && !bundle->orphans++) bundle->orphan = bundle->text.number;
    if (!there || points->sighting_count == RN_SIGHTINGS_MAX) return RN_OK;
    const struct photo *photo = &bundle->photos[(size_t)sighting[0]];
    if (!(photo->width > 0)) return RN_OK;
    if (!grow((void **)&points->sightings, points->sighting_count, &bundle->sighting_capacity,
              sizeof *points->sightings))
        return no_memory(bundle, err);
    points->sightings[points->sighting_count++] =
        (struct rn_sighting){.point = (uint32_t)point,
                             .photo = (uint32_t)sighting[0],
                             .x = (float)(0.5 + sighting[2] / photo->width),
                             .y = (float)(0.5 - sighting[3] / photo->height)};
    return RN_OK;
}

// Position, colour, and for each photograph that sees it: which, the feature's number, x and y.
static enum rn_status read_point(struct bundle *bundle, struct rn_error *err) {
    struct rn_points *points = &bundle->reader->dataset->points;
    double values[6], sighting[4];
    size_t count = 0, index = points->count;
    enum rn_status status = numbers(&bundle->text, values, 6, err);
    if (status || (status = how_many(&bundle->text, "sightings", 8, &count, err))) return status;
    bool sound = rn_points_take(values) && index < RN_POINTS_MAX;
    bundle->bad_points += !sound;
    if (sound &&
        !grow((void **)&points->items, index, &bundle->point_capacity, sizeof *points->items))
        return no_memory(bundle, err);
    if (sound) {
        struct rn_point *point = &points->items[points->count++];
        *point = (struct rn_point){.error = -1};
        memcpy(point->position, values, sizeof point->position);
        for (int c = 0; c < 3; c++)
            point->colour[c] = (uint8_t)fmin(fmax(values[3 + c], 0), 255);
    }
    for (size_t i = 0; i < count && status == RN_OK; i++) {
        status = numbers(&bundle->text, sighting, 4, err);
        if (status == RN_OK && sound) status = see(bundle, sighting, index, err);
    }
    return status;
}

static enum rn_status read_points(struct bundle *bundle, struct rn_error *err) {
    struct rn_problems *problems = bundle->reader->problems;
    enum rn_status status = RN_OK;
    for (size_t i = 0; i < bundle->point_count && status == RN_OK; i++)
        status = read_point(bundle, err);
    if (status) return status;
    if (bundle->orphans)
        rn_problems_add(problems, RN_SEVERITY_WARNING, bundle->text.path,
                        "%zu of its sightings are by photographs that it does not have, or far "
                        "outside of them, the first in line %zu; they are left out",
                        bundle->orphans, bundle->orphan);
    if (bundle->bad_points)
        rn_problems_add(problems, RN_SEVERITY_WARNING, bundle->text.path,
                        "%zu of its %zu points have no coordinates or ones beyond 1e12, or are too "
                        "many; they are left out",
                        bundle->bad_points, bundle->point_count);
    return RN_OK;
}

// ---- the document ----

static enum rn_status read_head(struct bundle *bundle, struct rn_error *err) {
    struct text *text = &bundle->text;
    bool more;
    enum rn_status status = next_line(text, &more, err);
    if (status) return status;
    if (!more || (strncmp(text->line, "# Bundle file v0.3", 18) != 0 &&
                  strncmp(text->line, "# Bundle file v0.4", 18) != 0))
        return bad(text, "is not \"# Bundle file v0.3\": other versions are not read", err);
    text->at += strlen(text->line);
    if ((status = how_many(text, "cameras", CAMERA_BYTES, &bundle->photo_count, err)) ||
        (status = how_many(text, "points", POINT_BYTES, &bundle->point_count, err)))
        return status;
    if (bundle->photo_count == 0) return bad(text, "has no cameras", err);
    bundle->photos = calloc(bundle->photo_count, sizeof *bundle->photos);
    return bundle->photos ? RN_OK : no_memory(bundle, err);
}

static enum rn_status read_bundler(struct rn_reader *reader, struct rn_error *err) {
    struct bundle bundle = {.reader = reader};
    const char *place = rn_reader_has(reader, DOCUMENT) ? "" : "bundle/";
    char name[64];
    snprintf(name, sizeof name, "%s" DOCUMENT, place);
    enum rn_status status = open_text(reader, name, &bundle.text, err);
    if (status == RN_OK) status = read_head(&bundle, err);
    if (status == RN_OK) status = read_list(&bundle, place, err);
    if (status == RN_OK) status = read_cameras(&bundle, err);
    if (status == RN_OK) status = read_points(&bundle, err);
    for (size_t i = 0; bundle.photos && i < bundle.photo_count; i++)
        free(bundle.photos[i].name);
    free(bundle.photos);
    close_text(&bundle.text);
    return status;
}

const struct rn_format rn_format_bundler = {
    .name = "bundler",
    .title = "Bundler",
    .signs = (const struct rn_sign[]){{DOCUMENT, NULL}, {"bundle/" DOCUMENT, NULL}, {NULL, NULL}},
    .documents =
        (const char *const[]){DOCUMENT, LIST, "bundle/" DOCUMENT, "bundle/" LIST, "masks/*", NULL},
    .photo_folders = (const char *const[]){"images", NULL},
    .read = read_bundler};

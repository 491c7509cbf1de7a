#include "common/dataset/colmap_files.h"

#include <errno.h>
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#define KNOWN_MODELS 18

const struct rn_colmap_model rn_colmap_models[KNOWN_MODELS] = {
    {0, 3, "SIMPLE_PINHOLE", RN_LENS_PINHOLE, {"f", "cx", "cy"}},
    {1, 4, "PINHOLE", RN_LENS_PINHOLE, {"fx", "fy", "cx", "cy"}},
    {2, 4, "SIMPLE_RADIAL", RN_LENS_OPENCV, {"f", "cx", "cy", "k1"}},
    {3, 5, "RADIAL", RN_LENS_OPENCV, {"f", "cx", "cy", "k1", "k2"}},
    {4, 8, "OPENCV", RN_LENS_OPENCV, {"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"}},
    {5, 8, "OPENCV_FISHEYE", RN_LENS_FISHEYE, {"fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"}},
    {6,
     12,
     "FULL_OPENCV",
     RN_LENS_OPENCV,
     {"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"}},
    {7, 5, "FOV", RN_LENS_FOV, {"fx", "fy", "cx", "cy", "omega"}},
    {8, 4, "SIMPLE_RADIAL_FISHEYE", RN_LENS_FISHEYE, {"f", "cx", "cy", "k1"}},
    {9, 5, "RADIAL_FISHEYE", RN_LENS_FISHEYE, {"f", "cx", "cy", "k1", "k2"}},
    {10,
     12,
     "THIN_PRISM_FISHEYE",
     RN_LENS_THIN_PRISM_FISHEYE,
     {"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1"}},
    {11, 16, "RAD_TAN_THIN_PRISM_FISHEYE", RN_LENS_COUNT, {0}},
    {12, 4, "SIMPLE_DIVISION", RN_LENS_COUNT, {0}},
    {13, 5, "DIVISION", RN_LENS_COUNT, {0}},
    {14, 3, "SIMPLE_FISHEYE", RN_LENS_FISHEYE, {"f", "cx", "cy"}},
    {15, 4, "FISHEYE", RN_LENS_FISHEYE, {"fx", "fy", "cx", "cy"}},
    {16, 6, "EUCM", RN_LENS_COUNT, {0}},
    {17, 2, "EQUIRECTANGULAR", RN_LENS_EQUIRECTANGULAR, {"width", "height"}}};

static enum rn_status open_as(struct rn_reader *reader, const char *folder, const char *kind,
                              const char *extension, struct rn_colmap_file *file,
                              struct rn_error *err) {
    char name[256];
    snprintf(name, sizeof name, "%s%s.%s", folder, kind, extension);
    file->path = rn_reader_path(reader, name);
    if (!file->path) return rn_error_set(err, RN_ERROR_NO_MEMORY, reader->folder, "out of memory");
    file->file = fopen(file->path, "rbe");
    if (!file->file) {
        enum rn_status status = rn_error_from_errno(err, errno, file->path, "open");
        rn_colmap_close(file);
        return status;
    }
    char *document;
    enum rn_status status = rn_reader_document(reader, name, &document, err);
    if (status == RN_OK) free(document);
    return status;
}

static enum rn_status cut(const struct rn_colmap_file *file, struct rn_error *err) {
    char where[256];
    rn_colmap_where(file, where);
    return rn_error_set(err, RN_ERROR_INVALID, where,
                        "the file ends within it, after %" PRIu64 " bytes: copy it again",
                        file->size);
}

static uint64_t left(const struct rn_colmap_file *file) {
    return file->size - (uint64_t)ftello(file->file);
}

static bool take(struct rn_colmap_file *file, void *to, size_t size) {
    return fread(to, 1, size, file->file) == size;
}

// Small parts are read, which is quicker than to seek.
static bool skip(struct rn_colmap_file *file, uint64_t size) {
    char part[4096];
    if (size > 16 * sizeof part) return fseeko(file->file, (off_t)size, SEEK_CUR) == 0;
    for (size_t now; size > 0; size -= now) {
        now = size < sizeof part ? (size_t)size : sizeof part;
        if (!take(file, part, now)) return false;
    }
    return true;
}

enum rn_status rn_colmap_open(struct rn_reader *reader, const char *folder, const char *kind,
                              struct rn_colmap_file *ret_file, struct rn_error *err) {
    struct stat about;
    *ret_file = (struct rn_colmap_file){.reader = reader};
    enum rn_status status = open_as(reader, folder, kind, "bin", ret_file, err);
    if (status == RN_ERROR_NOT_FOUND) {
        *ret_file =
            (struct rn_colmap_file){.reader = reader, .text = true, .count = RN_COLMAP_NOT_SAID};
        status = open_as(reader, folder, kind, "txt", ret_file, err);
    }
    if (status == RN_ERROR_NOT_FOUND)
        return rn_error_set(
            err, RN_ERROR_NOT_FOUND, reader->folder,
            "the COLMAP model is incomplete: neither %s%s.bin nor %s%s.txt is there", folder, kind,
            folder, kind);
    if (status) return status;
    if (fstat(fileno(ret_file->file), &about) != 0 || !S_ISREG(about.st_mode))
        return rn_error_set(err, RN_ERROR_INVALID, ret_file->path, "is no regular file");
    ret_file->size = (uint64_t)about.st_size;
    if (ret_file->text || take(ret_file, &ret_file->count, 8)) return RN_OK;
    return rn_error_set(err, RN_ERROR_INVALID, ret_file->path, "ends within its first 8 bytes");
}

void rn_colmap_close(struct rn_colmap_file *file) {
    if (file->file) fclose(file->file);
    free(file->path);
    free(file->line);
    *file = (struct rn_colmap_file){0};
}

void rn_colmap_where(const struct rn_colmap_file *file, char where[256]) {
    size_t length = strlen(file->path), most = 180;
    const char *tail = length > most ? file->path + length - most : file->path;
    if (file->text)
        snprintf(where, 256, "%s:%" PRIu64, tail, file->number);
    else
        snprintf(where, 256, "%s, record %" PRIu64 " of %" PRIu64, tail, file->next, file->count);
}

// Before a binary record of at least `least` bytes; false in *ret_more behind the last. A count for
// which the file has no room is found before anything is read by it.
static enum rn_status begin(struct rn_colmap_file *file, uint64_t least, bool *ret_more,
                            struct rn_error *err) {
    *ret_more = file->next < file->count;
    if (!*ret_more) return RN_OK;
    if (file->next == 0 && file->count > left(file) / least)
        return rn_error_set(err, RN_ERROR_INVALID, file->path,
                            "says that it has %" PRIu64 " records, but has room for %" PRIu64
                            " at most: copy it again",
                            file->count, left(file) / least);
    file->next++;
    return RN_OK;
}

static enum rn_status bad_line(const struct rn_colmap_file *file, const char *what,
                               struct rn_error *err) {
    char where[256];
    rn_colmap_where(file, where);
    return rn_error_set(err, RN_ERROR_INVALID, where, "%s", what);
}

// The next line of text that is no comment; an empty one only where it may be. Of a last line
// without an end nobody knows whether its last number is whole.
static enum rn_status next_line(struct rn_colmap_file *file, bool empty, bool *ret_more,
                                struct rn_error *err) {
    ssize_t size;
    while ((size = getline(&file->line, &file->capacity, file->file)) >= 0) {
        if (file->number++ == 0 && strncmp(file->line, "\xef\xbb\xbf", 3) == 0)
            memmove(file->line, file->line + 3, (size_t)(size -= 3) + 1); // Windows' mark
        if (file->line[size - 1] != '\n')
            return bad_line(file,
                            "the file ends within this line: copy it again or, where the line is "
                            "whole, end it as the others are",
                            err);
        while (size > 0 && strchr("\r\n", file->line[size - 1]))
            file->line[--size] = 0;
        (void)sscanf(file->line, "# Number of %*[a-z]: %" SCNu64, &file->count);
        if (file->line[0] == '#' || (size == 0 && !empty)) continue;
        *ret_more = true;
        return RN_OK;
    }
    *ret_more = false;
    if (ferror(file->file)) return rn_error_from_errno(err, errno, file->path, "read");
    return RN_OK;
}

// The first line of a record of text.
static enum rn_status begin_text(struct rn_colmap_file *file, bool *ret_more,
                                 struct rn_error *err) {
    enum rn_status status = next_line(file, false, ret_more, err);
    if (status) return status;
    file->next += *ret_more;
    if (!*ret_more && file->next < file->count && file->count != RN_COLMAP_NOT_SAID &&
        rn_reader_says(file->reader, file->path))
        rn_problems_add(file->reader->problems, RN_SEVERITY_WARNING, file->path,
                        "has %" PRIu64 " records, but says that there are %" PRIu64
                        ": if nobody took some out, copy it again",
                        file->next, file->count);
    return RN_OK;
}

// Numbers of a line, *at moving behind them.
static bool numbers(char **at, double *values, size_t count) {
    for (size_t i = 0; i < count; i++) {
        char *end;
        values[i] = strtod(*at, &end);
        if (end == *at) return false;
        *at = end;
    }
    return true;
}

static bool whole(char **at, uint64_t most, uint64_t *ret_value) {
    char *end;
    *at += strspn(*at, " \t");
    if (**at == '-') return false;
    errno = 0;
    *ret_value = strtoull(*at, &end, 10);
    if (end == *at || errno || *ret_value > most) return false;
    *at = end;
    return true;
}

// ---- cameras ----

static enum rn_status text_camera(struct rn_colmap_file *file, struct rn_colmap_camera *camera,
                                  struct rn_error *err) {
    char *at = file->line, name[40] = "";
    uint64_t id;
    int used = 0;
    if (!whole(&at, UINT32_MAX, &id) || sscanf(at, " %39[A-Z0-9_]%n", name, &used) != 1 ||
        (at += used, !whole(&at, INT32_MAX, &camera->width)) ||
        !whole(&at, INT32_MAX, &camera->height))
        return bad_line(file, "wants CAMERA_ID MODEL WIDTH HEIGHT PARAMETERS", err);
    camera->id = (uint32_t)id;
    camera->model = KNOWN_MODELS - 1;
    while (camera->model >= 0 && strcmp(rn_colmap_models[camera->model].name, name) != 0)
        camera->model--;
    snprintf(camera->model_name, sizeof camera->model_name, "%s", name);
    if (camera->model >= 0 &&
        !numbers(&at, camera->parameters, (size_t)rn_colmap_models[camera->model].count))
        return bad_line(file, "has fewer parameters than its camera model", err);
    return RN_OK;
}

static enum rn_status binary_camera(struct rn_colmap_file *file, struct rn_colmap_camera *camera,
                                    struct rn_error *err) {
    char where[256];
    int32_t model;
    if (!take(file, &camera->id, 4) || !take(file, &model, 4) || !take(file, &camera->width, 8) ||
        !take(file, &camera->height, 8))
        return cut(file, err);
    if (model < 0 || model >= KNOWN_MODELS) {
        rn_colmap_where(file, where);
        return rn_error_set(err, RN_ERROR_INVALID, where,
                            "camera %" PRIu32 " has the model %" PRId32
                            ", which is not known here, "
                            "so that the cameras behind it cannot be found; export the model as "
                            "text, or undistort the photographs",
                            camera->id, model);
    }
    camera->model = model;
    snprintf(camera->model_name, sizeof camera->model_name, "%s", rn_colmap_models[model].name);
    size_t size = (size_t)rn_colmap_models[model].count * sizeof(double);
    return take(file, camera->parameters, size) ? RN_OK : cut(file, err);
}

enum rn_status rn_colmap_next_camera(struct rn_colmap_file *file, struct rn_colmap_camera *camera,
                                     bool *ret_more, struct rn_error *err) {
    *camera = (struct rn_colmap_camera){0};
    enum rn_status status =
        file->text ? begin_text(file, ret_more, err) : begin(file, 40, ret_more, err);
    if (status || !*ret_more) return status;
    return file->text ? text_camera(file, camera, err) : binary_camera(file, camera, err);
}

// ---- images ----

static enum rn_status binary_name(struct rn_colmap_file *file, struct rn_colmap_image *image,
                                  struct rn_error *err) {
    for (size_t i = 0; i < sizeof image->name; i++) {
        int c = getc(file->file);
        if (c == EOF) return cut(file, err);
        image->name[i] = (char)c;
        if (c == 0) return RN_OK;
    }
    return bad_line(file, "its name is too long", err);
}

static enum rn_status binary_image(struct rn_colmap_file *file, struct rn_colmap_image *image,
                                   rn_colmap_see see, void *context, struct rn_error *err) {
    uint64_t count, point;
    double at[2];
    if (!take(file, &image->id, 4) || !take(file, image->rotation, 32) ||
        !take(file, image->translation, 24) || !take(file, &image->camera, 4))
        return cut(file, err);
    enum rn_status status = binary_name(file, image, err);
    if (status) return status;
    if (!take(file, &count, 8) || count > left(file) / 24) return cut(file, err);
    if (!see) return skip(file, count * 24) ? RN_OK : cut(file, err);
    for (uint64_t i = 0; i < count && status == RN_OK; i++) {
        if (!take(file, at, 16) || !take(file, &point, 8)) return cut(file, err);
        if (point != RN_COLMAP_NO_POINT) status = see(context, image, at[0], at[1], point, err);
    }
    return status;
}

static enum rn_status text_keypoints(struct rn_colmap_file *file,
                                     const struct rn_colmap_image *image, rn_colmap_see see,
                                     void *context, struct rn_error *err) {
    char *at = file->line;
    double xy[2];
    uint64_t point;
    enum rn_status status = RN_OK;
    while (status == RN_OK && *(at += strspn(at, " \t"))) {
        if (!numbers(&at, xy, 2)) return bad_line(file, "wants X Y POINT3D_ID triples", err);
        at += strspn(at, " \t");
        if (*at == '-') {
            at += strcspn(at, " \t");
            continue;
        }
        if (!whole(&at, UINT64_MAX, &point))
            return bad_line(file, "wants X Y POINT3D_ID triples", err);
        status = see(context, image, xy[0], xy[1], point, err);
    }
    return status;
}

// Two lines; the second, the keypoints, may be empty, and missing at the file's end. A name may
// hold blanks.
static enum rn_status text_image(struct rn_colmap_file *file, struct rn_colmap_image *image,
                                 rn_colmap_see see, void *context, struct rn_error *err) {
    char *at = file->line;
    uint64_t id, camera;
    bool more;
    if (!whole(&at, UINT32_MAX, &id) || !numbers(&at, image->rotation, 4) ||
        !numbers(&at, image->translation, 3) || !whole(&at, UINT32_MAX, &camera))
        return bad_line(file, "wants IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME", err);
    image->id = (uint32_t)id;
    image->camera = (uint32_t)camera;
    at += strspn(at, " \t");
    size_t length = strlen(at);
    if (length == 0 || length >= sizeof image->name) return bad_line(file, "wants a NAME", err);
    memcpy(image->name, at, length + 1);
    enum rn_status status = next_line(file, true, &more, err);
    if (status || !more || !see) return status;
    return text_keypoints(file, image, see, context, err);
}

enum rn_status rn_colmap_next_image(struct rn_colmap_file *file, struct rn_colmap_image *image,
                                    rn_colmap_see see, void *context, bool *ret_more,
                                    struct rn_error *err) {
    enum rn_status status =
        file->text ? begin_text(file, ret_more, err) : begin(file, 73, ret_more, err);
    if (status || !*ret_more) return status;
    return file->text ? text_image(file, image, see, context, err)
                      : binary_image(file, image, see, context, err);
}

// ---- points ----

static enum rn_status text_point(struct rn_colmap_file *file, struct rn_colmap_point *point,
                                 struct rn_error *err) {
    char *at = file->line;
    uint64_t colour[3];
    if (!whole(&at, UINT64_MAX, &point->id) || !numbers(&at, point->position, 3) ||
        !whole(&at, 255, &colour[0]) || !whole(&at, 255, &colour[1]) ||
        !whole(&at, 255, &colour[2]) || !numbers(&at, &point->error, 1))
        return bad_line(file, "wants POINT3D_ID X Y Z R G B ERROR", err);
    for (int i = 0; i < 3; i++)
        point->colour[i] = (uint8_t)colour[i];
    return RN_OK;
}

static enum rn_status binary_point(struct rn_colmap_file *file, struct rn_colmap_point *point,
                                   struct rn_error *err) {
    uint64_t track;
    if (!take(file, &point->id, 8) || !take(file, point->position, 24) ||
        !take(file, point->colour, 3) || !take(file, &point->error, 8) || !take(file, &track, 8) ||
        track > left(file) / 8 || !skip(file, track * 8))
        return cut(file, err);
    return RN_OK;
}

enum rn_status rn_colmap_next_point(struct rn_colmap_file *file, struct rn_colmap_point *point,
                                    bool *ret_more, struct rn_error *err) {
    enum rn_status status =
        file->text ? begin_text(file, ret_more, err) : begin(file, 51, ret_more, err);
    if (status || !*ret_more) return status;
    return file->text ? text_point(file, point, err) : binary_point(file, point, err);
}

enum rn_status rn_colmap_take_lens(const struct rn_colmap_camera *from, const char *where,
                                   struct rn_camera *camera, struct rn_error *err) {
    if (from->model < 0 || rn_colmap_models[from->model].lens == RN_LENS_COUNT)
        return rn_error_set(err, RN_ERROR_INVALID, where,
                            "camera %" PRIu32 " has the model %s, a lens that is not known here: "
                            "undistort the photographs, or use another camera model",
                            from->id, from->model_name);
    const struct rn_colmap_model *model = &rn_colmap_models[from->model];
    const struct rn_lens_model *lens = &rn_lens_models[model->lens];
    bool bent = model->lens != RN_LENS_OPENCV; // which without coefficients is a pinhole
    camera->lens = model->lens;
    for (int i = 0; i < model->count; i++) {
        const char *name = model->parameters[i];
        double value = from->parameters[i];
        if (strcmp(name, "f") == 0) camera->fx = camera->fy = value;
        if (strcmp(name, "fx") == 0) camera->fx = value;
        if (strcmp(name, "fy") == 0) camera->fy = value;
        if (strcmp(name, "cx") == 0) camera->cx = value;
        if (strcmp(name, "cy") == 0) camera->cy = value;
        for (int k = 0; k < lens->count; k++)
            if (strcmp(name, lens->parameters[k]) == 0) {
                camera->lens_k[k] = value;
                bent = bent || value != 0;
            }
    }
    if (!bent) camera->lens = RN_LENS_PINHOLE;
    if (model->lens != RN_LENS_EQUIRECTANGULAR) return RN_OK;
    camera->fx = (double)from->width / (2 * M_PI);
    camera->fy = (double)from->height / M_PI;
    camera->cx = 0.5 * (double)from->width;
    camera->cy = 0.5 * (double)from->height;
    return RN_OK;
}

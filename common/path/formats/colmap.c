// COLMAP's images.txt with the cameras.txt beside it: world-to-camera quaternions w, x, y, z; two
// lines an image, the second of which may be empty. Images in the order of their names.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/buf.h"
#include "common/base/names.h"
#include "common/math/rotation.h"
#include "common/path/formats/parts.h"

#define MAX_CAMERAS 4096
#define LINE_MAX_BYTES 2048

struct image {
    double q[4], t[3];
    unsigned camera, line;
    char name[256];
};

struct camera {
    unsigned id;
    int width, height;
    double focal_y;
};

// The next line, without its end, cut at LINE_MAX_BYTES; false at the end of the text.
static bool next_line(const char *text, size_t size, size_t *at, char line[LINE_MAX_BYTES]) {
    if (*at >= size) return false;
    const char *begin = text + *at, *end = memchr(begin, '\n', size - *at);
    size_t length = end ? (size_t)(end - begin) : size - *at;
    *at += length + 1;
    if (length >= LINE_MAX_BYTES) length = LINE_MAX_BYTES - 1;
    memcpy(line, begin, length);
    while (length && (line[length - 1] == '\r' || line[length - 1] == ' '))
        length--;
    line[length] = '\0';
    return true;
}

static bool parse_image(const char *line, struct image *image) {
    unsigned id;
    int end = 0;
    if (sscanf(line, "%u %lf %lf %lf %lf %lf %lf %lf %u %n", &id, &image->q[0], &image->q[1],
               &image->q[2], &image->q[3], &image->t[0], &image->t[1], &image->t[2], &image->camera,
               &end) != 9 ||
        !line[end])
        return false;
    snprintf(image->name, sizeof image->name, "%.255s", line + end); // may hold spaces
    return true;
}

static bool recognise(const struct rn_path_text *in) {
    char line[LINE_MAX_BYTES];
    struct image image;
    size_t at = 0;
    if (in->root) return false;
    while (next_line(in->text, in->size, &at, line))
        if (*line && *line != '#') return parse_image(line, &image);
    return strstr(in->text, "IMAGE_ID") != NULL; // its head alone
}

static enum rn_status read_images(const struct rn_path_text *in, struct rn_buf *images,
                                  struct rn_error *err) {
    char line[LINE_MAX_BYTES], where[256];
    struct image image = {.line = 0};
    bool points = false; // the line of an image's points comes next
    for (size_t at = 0; next_line(in->text, in->size, &at, line);) {
        image.line++;
        if (*line == '#') continue;
        if (!points && !*line) continue;
        if (!points && !parse_image(line, &image)) {
            snprintf(where, sizeof where, "%.230s:%u", in->where, image.line);
            return rn_error_set(err, RN_ERROR_INVALID, where,
                                "must be IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME");
        }
        if (!points) rn_buf_append(images, &image, sizeof image);
        points = !points;
    }
    return rn_buf_status(images, in->where, err);
}

static int by_name(const void *a, const void *b) {
    return strcmp(((const struct image *)a)->name, ((const struct image *)b)->name);
}

// All models of COLMAP begin with f, cx, cy or with fx, fy, cx, cy.
static bool parse_camera(const char *line, struct camera *camera) {
    static const char *const one_focal[] = {
        "SIMPLE_PINHOLE", "SIMPLE_RADIAL",   "RADIAL",         "SIMPLE_RADIAL_FISHEYE",
        "RADIAL_FISHEYE", "SIMPLE_DIVISION", "SIMPLE_FISHEYE", NULL};
    char model[40];
    double first, second = 0;
    int count = sscanf(line, "%u %39s %d %d %lf %lf", &camera->id, model, &camera->width,
                       &camera->height, &first, &second);
    if (count < 5) return false;
    camera->focal_y = count == 6 ? second : first;
    if (rn_name_index(one_focal, model) >= 0) camera->focal_y = first;
    return camera->focal_y > 0 && camera->width > 0 && camera->height > 0 &&
           camera->width <= RN_CAMERA_MAX_SIZE && camera->height <= RN_CAMERA_MAX_SIZE;
}

static size_t read_cameras(const struct rn_path_text *in, struct camera *cameras) {
    char line[LINE_MAX_BYTES];
    size_t count = 0;
    for (size_t at = 0;
         in->beside && count < MAX_CAMERAS && next_line(in->beside, in->beside_size, &at, line);)
        if (*line != '#' && parse_camera(line, &cameras[count])) count++;
    return count;
}

static enum rn_status fill_key(const struct rn_path_text *in, const struct image *image,
                               const struct camera *camera, double fov_y_deg,
                               struct rn_path_key *key, struct rn_error *err) {
    char where[256];
    double view[3][4];
    snprintf(where, sizeof where, "%.230s:%u", in->where, image->line);
    if (!camera && !(fov_y_deg > 0))
        return rn_error_set(err, RN_ERROR_INVALID, where,
                            "has camera %u, of which nothing is known: cameras.txt must lie beside "
                            "the file, or a field of view be given",
                            image->camera);
    for (int i = 0; i < 3; i++)
        if (!isfinite(image->t[i]))
            return rn_error_set(err, RN_ERROR_INVALID, where, "has a position that is no number");
    if (!rn_rotation_from_quaternion(image->q, view))
        return rn_error_set(err, RN_ERROR_INVALID, where, "has a quaternion of length 0");
    for (int i = 0; i < 3; i++)
        view[i][3] = image->t[i];
    rn_pose_invert((const double(*)[4])view, key->world_from_camera);
    key->fov_y_rad = fov_y_deg > 0 ? fov_y_deg * M_PI / 180
                                   : rn_camera_fov_from_focal(camera->focal_y, camera->height);
    return RN_OK;
}

static enum rn_status fill(const struct rn_path_text *in, const struct rn_path_choices *choices,
                           struct image *images, size_t count, const struct camera *cameras,
                           size_t camera_count, struct rn_path *path, struct rn_error *err) {
    struct rn_json at = {.file = in->where};
    if (!count) return rn_error_set(err, RN_ERROR_INVALID, in->where, "names no images");
    enum rn_status status = rn_path_make_keys(path, count, &at, err);
    if (status) return status;
    qsort(images, count, sizeof *images, by_name);
    for (size_t i = 0; i < count && !status; i++) {
        const struct camera *camera = NULL;
        for (size_t k = 0; k < camera_count; k++)
            if (cameras[k].id == images[i].camera) camera = &cameras[k];
        path->keys[i].time_s = (double)i / path->fps;
        status = fill_key(in, &images[i], camera, choices->fov_y_deg, &path->keys[i], err);
        if (i == 0 && camera) {
            path->width = camera->width;
            path->height = camera->height;
        }
    }
    return status;
}

static enum rn_status read(const struct rn_path_text *in, const struct rn_path_choices *choices,
                           struct rn_path *path, struct rn_error *err) {
    struct rn_buf images;
    struct camera *cameras = calloc(MAX_CAMERAS, sizeof *cameras);
    rn_buf_init(&images, RN_PATH_MAX_IMPORT);
    path->fps = choices->fps > 0 ? choices->fps : 30;
    path->interpolation = RN_INTERPOLATE_LINEAR;
    enum rn_status status = cameras ? read_images(in, &images, err)
                                    : rn_error_set(err, RN_ERROR_NO_MEMORY, in->where, "no memory");
    size_t size = 0;
    struct image *list = status ? NULL : (void *)rn_buf_take(&images, &size);
    if (!status)
        status = fill(in, choices, list, size / sizeof *list, cameras, read_cameras(in, cameras),
                      path, err);
    free(list);
    free(cameras);
    rn_buf_finish(&images);
    return status;
}

static void write_image(struct rn_buf *text, const struct rn_camera *camera, size_t i) {
    double view[3][4], q[4];
    rn_pose_invert(camera->world_from_camera, view);
    rn_rotation_to_quaternion((const double(*)[4])view, q);
    rn_buf_printf(text, "%zu %.17g %.17g %.17g %.17g %.17g %.17g %.17g 1 %05zu.png\n\n", i + 1,
                  q[0], q[1], q[2], q[3], view[0][3], view[1][3], view[2][3], i);
}

// COLMAP has a camera's field of view, not a frame's: the first one's stands for all.
static enum rn_status refuse_zoom(const struct rn_path *path, struct rn_error *err) {
    for (size_t i = 1; i < path->key_count; i++)
        if (fabs(path->keys[i].fov_y_rad - path->keys[0].fov_y_rad) > 1e-9)
            return rn_error_set(err, RN_ERROR_UNSUPPORTED, "the camera path",
                                "has keys of several fields of view, which COLMAP's images of one "
                                "camera cannot have; another format can");
    return RN_OK;
}

static enum rn_status write(const struct rn_path *path, const struct rn_path_space *space,
                            char **ret_text, char **ret_beside, struct rn_error *err) {
    struct rn_buf text, beside;
    size_t count = rn_path_frame_count(path), size;
    struct rn_camera first = rn_path_camera(path, 0);
    enum rn_status status = refuse_zoom(path, err);
    if (status) return status;
    rn_buf_init(&text, (size_t)1 << 28);
    rn_buf_init(&beside, 4096);
    rn_buf_printf(&text, "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D\n");
    for (size_t i = 0; i < count; i++) {
        struct rn_camera camera = rn_path_camera(path, i);
        rn_path_out_of_dataset(space, camera.world_from_camera);
        write_image(&text, &camera, i);
    }
    rn_buf_printf(&beside,
                  "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS\n1 PINHOLE %d %d %.17g %.17g "
                  "%.17g %.17g\n",
                  first.width, first.height, first.fx, first.fy, first.cx, first.cy);
    rn_buf_append(&text, "", 1);
    rn_buf_append(&beside, "", 1);
    status = rn_buf_status(&text, "the camera path", err);
    if (!status) status = rn_buf_status(&beside, "the camera path", err);
    if (!status) {
        *ret_text = (char *)rn_buf_take(&text, &size);
        *ret_beside = (char *)rn_buf_take(&beside, &size);
    }
    rn_buf_finish(&text);
    rn_buf_finish(&beside);
    return status;
}

const struct rn_path_format rn_path_format_colmap = {
    .name = "colmap",
    .title = "COLMAP",
    .file = "images.txt",
    .beside = "cameras.txt",
    .usual = {1, {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}},
    .recognise = recognise,
    .read = read,
    .write = write};

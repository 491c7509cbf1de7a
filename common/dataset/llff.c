// LLFF: poses_bounds.npy, a row a photograph, and the photographs in the order of their names
// (Mildenhall et al. 2019, "Local Light Field Fusion"; the file is NumPy's format 1.0 to 3.0).
//
// A row is a 3x5 matrix, row by row, and two depths that hold what is seen: columns 0 to 2 are the
// camera's axes down, right and backwards in the world, 3 is its position, 4 is height, width and
// focal length in pixels of the full-size photograph. It says nothing of a lens: where the one
// camera of the COLMAP model that it was made from lies beside it, that says it.
#include <dirent.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/file.h"
#include "common/dataset/colmap_files.h"

#define DOCUMENT "poses_bounds.npy"
#define MODEL "sparse/0/"
#define COLUMNS 17
#define MAX_BYTES ((size_t)RN_DATASET_MAX_FRAMES * COLUMNS * 8 + 65536)

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "numbers are taken as they lie in files");

// The photographs' names, sorted.
struct listing {
    char **names;
    size_t count, capacity;
};

struct poses {
    const char *path;
    uint8_t *bytes;
    const uint8_t *rows; // COLUMNS doubles each, not aligned
    size_t count;
    struct rn_colmap_camera lens; // of all photographs, with `has_lens`
    bool has_lens;
};

static enum rn_status bad(const struct poses *poses, struct rn_error *err, const char *what) {
    return rn_error_set(err, RN_ERROR_INVALID, poses->path, "%s", what);
}

// The value of a key of the header's Python dictionary, or NULL.
static const char *header_value(const char *header, const char *key) {
    const char *at = strstr(header, key);
    if (!at) return NULL;
    at += strlen(key);
    return at + strspn(at, " :");
}

// The array's description, as in {'descr': '<f8', 'fortran_order': False, 'shape': (20, 17), }.
static enum rn_status read_header(struct poses *poses, const char *header, size_t data_bytes,
                                  struct rn_error *err) {
    const char *type = header_value(header, "'descr'"), *shape = header_value(header, "'shape'");
    const char *order = header_value(header, "'fortran_order'");
    unsigned long long rows = 0, columns = 0;
    if (!type || !shape || !order) return bad(poses, err, "its header describes no array");
    if (strncmp(type, "'<f8'", 5) != 0)
        return bad(poses, err, "holds other numbers than little-endian float64 ('<f8')");
    if (strncmp(order, "False", 5) != 0)
        return bad(poses, err, "holds its array column by column; save it in C order");
    if (sscanf(shape, "(%llu, %llu)", &rows, &columns) != 2 || columns != COLUMNS)
        return bad(poses, err, "its array is not N x 17: 3x4 pose, size and focal, near and far");
    if (rows == 0) return bad(poses, err, "has no rows");
    if (rows > data_bytes / (COLUMNS * sizeof(double)))
        return rn_error_set(err, RN_ERROR_INVALID, poses->path,
                            "ends after %zu of its %llu rows: copy it again",
                            data_bytes / (COLUMNS * sizeof(double)), rows);
    poses->count = (size_t)rows;
    return RN_OK;
}

static enum rn_status read_poses(struct poses *poses, struct rn_error *err) {
    size_t size, header_size, prefix;
    enum rn_status status = rn_file_read(poses->path, MAX_BYTES, &poses->bytes, &size, err);
    if (status) return status;
    const uint8_t *bytes = poses->bytes;
    if (size < 12 || memcmp(bytes, "\x93NUMPY", 6) != 0)
        return bad(poses, err, "is no NumPy array file");
    prefix = bytes[6] == 1 ? 10 : 12;
    header_size = (size_t)bytes[8] | (size_t)bytes[9] << 8;
    if (prefix == 12) header_size |= (size_t)bytes[10] << 16 | (size_t)bytes[11] << 24;
    if (header_size > size - prefix || header_size > 65535)
        return bad(poses, err, "ends within its header: copy it again");
    poses->rows = bytes + prefix + header_size;
    char *header = strndup((const char *)bytes + prefix, header_size);
    if (!header) return rn_error_set(err, RN_ERROR_NO_MEMORY, poses->path, "out of memory");
    status = read_header(poses, header, size - prefix - header_size, err);
    free(header);
    return status;
}

// The one camera of a model beside the poses, where the model has one.
static void find_lens(struct rn_reader *reader, struct poses *poses) {
    struct rn_colmap_file file;
    struct rn_colmap_camera second;
    bool one = false, more = false;
    if (rn_colmap_open(reader, MODEL, "cameras", &file, NULL) == RN_OK)
        one = rn_colmap_next_camera(&file, &poses->lens, &one, NULL) == RN_OK && one &&
              rn_colmap_next_camera(&file, &second, &more, NULL) == RN_OK && !more;
    rn_colmap_close(&file);
    poses->has_lens = one;
}

// Whether a row is of that camera: the size and the focal length are the same.
static bool has_lens(const struct poses *poses, const double row[COLUMNS],
                     struct rn_camera *ret_camera) {
    struct rn_camera camera = {.lens = RN_LENS_PINHOLE};
    if (!poses->has_lens || row[4] != (double)poses->lens.height ||
        row[9] != (double)poses->lens.width ||
        rn_colmap_take_lens(&poses->lens, poses->path, &camera, NULL) != RN_OK)
        return false;
    *ret_camera = camera;
    return fabs(camera.fx - row[14]) <= 1e-6 * row[14] &&
           fabs(camera.fy - row[14]) <= 1e-6 * row[14] && camera.lens != RN_LENS_PINHOLE;
}

static void tell_lens(const struct rn_reader *reader, const struct poses *poses) {
    double row[COLUMNS];
    struct rn_camera camera;
    memcpy(row, poses->rows, sizeof row);
    if (has_lens(poses, row, &camera))
        rn_problems_add(reader->problems, RN_SEVERITY_INFO, poses->path,
                        "says nothing of the lens; the camera of %s, which has the same size and "
                        "focal length, is a %s: it is taken",
                        MODEL "cameras", poses->lens.model_name);
}

static int compare_names(const void *a, const void *b) {
    return strcmp(*(char *const *)a, *(char *const *)b);
}

static void finish_listing(struct listing *listing) {
    for (size_t i = 0; i < listing->count; i++)
        free(listing->names[i]);
    free(listing->names);
    *listing = (struct listing){0};
}

static bool append_name(struct listing *listing, const char *folder, const char *name) {
    if (listing->count == listing->capacity) {
        size_t capacity = listing->capacity ? 2 * listing->capacity : 64;
        char **names = realloc(listing->names, capacity * sizeof *names);
        if (!names) return false;
        listing->names = names;
        listing->capacity = capacity;
    }
    if (asprintf(&listing->names[listing->count], "%s/%s", folder, name) < 0) return false;
    listing->count++;
    return true;
}

// The photographs of one folder; none where it is not there.
static enum rn_status list_photos(const struct rn_reader *reader, const char *folder,
                                  struct listing *listing, struct rn_error *err) {
    char *path = rn_reader_path(reader, folder);
    DIR *directory = path ? opendir(path) : NULL;
    bool complete = path != NULL;
    free(path);
    struct dirent *entry;
    while (directory && complete && (entry = readdir(directory)) != NULL)
        if (entry->d_name[0] != '.' && rn_reader_is_photo(entry->d_name))
            complete = append_name(listing, folder, entry->d_name);
    if (directory) closedir(directory);
    if (!complete) return rn_error_set(err, RN_ERROR_NO_MEMORY, reader->folder, "out of memory");
    if (listing->count)
        qsort(listing->names, listing->count, sizeof *listing->names, compare_names);
    return RN_OK;
}

// The first folder with as many photographs as there are poses.
static enum rn_status find_photos(const struct rn_reader *reader, const struct poses *poses,
                                  struct listing *listing, struct rn_error *err) {
    char found[256] = "";
    for (const char *const *folder = rn_photo_folders; *folder; folder++) {
        enum rn_status status = list_photos(reader, *folder, listing, err);
        if (status || listing->count == poses->count) return status;
        size_t used = strlen(found);
        if (listing->count)
            snprintf(found + used, sizeof found - used, "%s%zu in %s", used ? ", " : "",
                     listing->count, *folder);
        finish_listing(listing);
    }
    return rn_error_set(err, RN_ERROR_INVALID, poses->path,
                        "has %zu poses, which go with the photographs in the order of their names, "
                        "but there are %s photographs",
                        poses->count, found[0] ? found : "no");
}

// Down, right, backwards to right, down, forward.
static void set_pose(const double row[COLUMNS], double pose[3][4]) {
    for (int i = 0; i < 3; i++) {
        const double *m = row + 5 * i;
        pose[i][0] = m[1];
        pose[i][1] = m[0];
        pose[i][2] = -m[2];
        pose[i][3] = m[3];
    }
}

static enum rn_status set_intrinsics(struct rn_reader *reader, const struct poses *poses,
                                     const double row[COLUMNS], const char *where,
                                     struct rn_frame *frame, struct rn_error *err) {
    double height = row[4], width = row[9], focal = row[14];
    struct rn_camera *camera = &frame->camera;
    if (!(height >= 1) || !(width >= 1) || !(height < 1e6) || !(width < 1e6))
        return rn_error_set(err, RN_ERROR_INVALID, where, "says %g x %g pixels", width, height);
    camera->fx = camera->fy = focal;
    camera->cx = 0.5 * width;
    camera->cy = 0.5 * height;
    struct rn_camera lens;
    if (has_lens(poses, row, &lens)) {
        camera->lens = lens.lens;
        memcpy(camera->lens_k, lens.lens_k, sizeof camera->lens_k);
        camera->cx = lens.cx;
        camera->cy = lens.cy;
    }
    return rn_reader_fit(reader, where, width, height, frame, err);
}

static enum rn_status read_row(struct rn_reader *reader, const struct poses *poses, size_t index,
                               const char *photo, struct rn_frame *frame, struct rn_error *err) {
    double row[COLUMNS];
    char where[256];
    struct rn_error inner;
    memcpy(row, poses->rows + index * sizeof row, sizeof row);
    snprintf(where, sizeof where, "%.200s, row %zu", poses->path, index);
    enum rn_status status = rn_reader_photo(reader, where, photo, "", frame, err);
    if (status) return status;
    set_pose(row, frame->camera.world_from_camera);
    frame->near = row[15];
    frame->far = row[16];
    if ((status = set_intrinsics(reader, poses, row, where, frame, err))) return status;
    if ((status = rn_camera_check(&frame->camera, "", &inner)))
        return rn_error_set(err, status, where, "%s", inner.text);
    if (frame->near > 0 && frame->far >= frame->near && isfinite(frame->far)) return RN_OK;
    return rn_error_set(err, RN_ERROR_INVALID, where, "gives the depths %g to %g", frame->near,
                        frame->far);
}

static enum rn_status read_rows(struct rn_reader *reader, const struct poses *poses,
                                struct rn_error *err) {
    struct listing photos = {0};
    enum rn_status status = find_photos(reader, poses, &photos, err);
    for (size_t i = 0; i < poses->count && status == RN_OK; i++) {
        struct rn_frame frame = {.index = (int)i, .loss_weight = 1};
        struct rn_error why;
        status = read_row(reader, poses, i, photos.names[i], &frame, &why);
        if ((status = rn_reader_add(reader, &frame, status, &why)) && err) *err = why;
    }
    finish_listing(&photos);
    return status;
}

static enum rn_status read_llff(struct rn_reader *reader, struct rn_error *err) {
    char *path;
    enum rn_status status = rn_reader_document(reader, DOCUMENT, &path, err);
    if (status) return status;
    struct poses poses = {.path = path};
    status = read_poses(&poses, err);
    if (status == RN_OK) {
        find_lens(reader, &poses);
        tell_lens(reader, &poses);
        status = read_rows(reader, &poses, err);
    }
    free(poses.bytes);
    free(path);
    return status;
}

const struct rn_format rn_format_llff = {
    .name = "llff",
    .title = "LLFF",
    .signs = (const struct rn_sign[]){{DOCUMENT, NULL}, {NULL, NULL}},
    .documents = (const char *const[]){DOCUMENT, MODEL "cameras.*", "masks/*", NULL},
    .photo_folders = rn_photo_folders,
    .read = read_llff};

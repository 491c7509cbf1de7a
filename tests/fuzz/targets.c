// The parsers of what strangers send, and what must hold of what they accept.
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/file.h"
#include "common/base/log.h"
#include "common/base/manifest.h"
#include "common/base/seal.h"
#include "common/base/utf8.h"
#include "common/dataset/dataset.h"
#include "common/image/codec.h"
#include "common/image/image.h"
#include "common/path/formats/formats.h"
#include "common/path/path.h"
#include "proto/job.h"
#include "proto/problem.h"
#include "proto/render.h"
#include "proto/wire_messages.h"
#include "server/config.h"
#include "server/engine/checkpoint/checkpoint.h"
#include "server/engine/scene/scene.h"
#include "server/http/guard.h"
#include "server/http/router.h"
#include "server/runner/ingest/unpack.h"
#include "tests/fuzz/driver.h"

static bool is_utf8(const char *text) {
    unsigned code;
    int size = 1;
    while (*text != '\0' && (size = rn_utf8_decode(text, &code)) > 0)
        text += size;
    return size > 0;
}

// Every refusal has a reason, in UTF-8.
static void check_error(enum rn_status status, const struct rn_error *err) {
    if (status == RN_OK) return;
    if (is_shown()) printf("refused: %s: %s\n", err->where, err->text);
    if (err->status != status) wrong("an error of another status than was returned");
    if (err->text[0] == '\0') wrong("a refusal without a reason");
    if (!is_thorough()) return;
    char *json = NULL;
    if (rn_problem_json_from_error(err, &json, NULL) != RN_OK) wrong("no problem of an error");
    if (json != NULL && !is_utf8(json)) wrong("a problem that is not UTF-8");
    free(json);
}

static const char *place(const char *name) {
    static char path[PATH_MAX];
    snprintf(path, sizeof path, "%s/%s", scratch(), name);
    return path;
}

// The files of an input, which stay from one to the next: making them takes longer than most
// parsers. What is read as a whole is handed to who reads it, and only the rest is written.
static struct kept {
    char name[64];
    int fd;
    const uint8_t *bytes; // of this input
    size_t size;
} files[8];

static struct kept *keep(const char *name) {
    struct kept *file = files;
    while (file->name[0] != '\0' && strcmp(file->name, name) != 0)
        if (++file == files + sizeof files / sizeof *files) abort();
    if (file->name[0] != '\0') return file;
    snprintf(file->name, sizeof file->name, "%s", name);
    file->fd = open(place(name), O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
    return file;
}

static void put_whole(const char *name, const void *bytes, size_t size) {
    struct kept *file = keep(name);
    file->bytes = bytes;
    file->size = size;
}

static void put(const char *name, const void *bytes, size_t size) {
    int fd = keep(name)->fd;
    if (pwrite(fd, bytes, size, 0) != (ssize_t)size || ftruncate(fd, (off_t)size) != 0) {
        perror(name);
        abort();
    }
    put_whole(name, bytes, size);
}

// The linker's --wrap: calls of rn_file_read come here.
enum rn_status __real_rn_file_read(const char *path, size_t max_bytes, uint8_t **ret_bytes,
                                   size_t *ret_size, struct rn_error *err);
enum rn_status __wrap_rn_file_read(const char *path, size_t max_bytes, uint8_t **ret_bytes,
                                   size_t *ret_size, struct rn_error *err);
enum rn_status __wrap_rn_file_read(const char *path, size_t max_bytes, uint8_t **ret_bytes,
                                   size_t *ret_size, struct rn_error *err) {
    size_t folder = strlen(scratch()) + 1;
    bool ours = strlen(path) > folder && strncmp(path, scratch(), folder - 1) == 0;
    for (const struct kept *file = files; ours && file->name[0] != '\0'; file++) {
        if (file->bytes == NULL || strcmp(path + folder, file->name) != 0) continue;
        if (file->size > max_bytes) return rn_error_set(err, RN_ERROR_LIMIT, path, "too large");
        *ret_bytes = malloc(file->size + 1);
        if (*ret_bytes == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, path, "no memory");
        memcpy(*ret_bytes, file->bytes, file->size);
        (*ret_bytes)[file->size] = '\0';
        *ret_size = file->size;
        return RN_OK;
    }
    return __real_rn_file_read(path, max_bytes, ret_bytes, ret_size, err);
}

// ---- JSON of requests and of the wire ---------------------------------------------------------

// What was read can be written, and reads again as the same.
static void round_trip(const struct rn_table *table, const void *message) {
    char *json = NULL, *again = NULL;
    void *copy = malloc(table->size);
    struct rn_error err = {0};
    if (copy == NULL || rn_encode(table, message, &json, NULL, &err) != RN_OK) {
        free(copy);
        if (err.status != RN_ERROR_NO_MEMORY && err.status != RN_OK) wrong(err.text);
        return;
    }
    if (rn_decode(table, json, strlen(json), copy, NULL, &err) != RN_OK) wrong(err.text);
    if (rn_encode(table, copy, &again, NULL, &err) != RN_OK) wrong(err.text);
    if (strcmp(json, again) != 0) wrong("a message that changes when it is written and read");
    rn_message_finish(table, copy);
    free(copy);
    free(json);
    free(again);
}

static void run_request(const uint8_t *bytes, size_t size) {
    struct rn_job_request job;
    struct rn_render_request render;
    struct rn_field_errors errors = {0};
    struct rn_error err = {0};
    const char *json = (const char *)bytes;
    enum rn_status status = rn_job_request_decode(json, size, &job, &errors, &err);
    check_error(status, &err);
    if (status == RN_OK) {
        char *options = NULL;
        check_error(rn_job_request_options(&job, &options, &err), &err);
        free(options);
        rn_job_request_finish(&job);
    }
    err = (struct rn_error){0};
    errors = (struct rn_field_errors){0};
    status = rn_render_request_decode(json, size, &render, &errors, &err);
    check_error(status, &err);
    if (status != RN_OK) return;
    round_trip(&rn_render_request_table, &render);
    rn_message_finish(&rn_render_request_table, &render);
}

// The first byte chooses the message.
static void run_message(const uint8_t *bytes, size_t size) {
    static union {
        char bytes[1 << 16];
        max_align_t aligned;
    } message;
    struct rn_error err = {0};
    if (size == 0) return;
    const struct rn_table *table = rn_wire_table(bytes[0]);
    if (table == NULL || table->size > sizeof message) return;
    enum rn_status status =
        rn_decode(table, (const char *)bytes + 1, size - 1, &message, NULL, &err);
    check_error(status, &err);
    if (status != RN_OK) return;
    round_trip(table, &message);
    rn_message_finish(table, &message);
}

static void run_wire(const uint8_t *bytes, size_t size) {
    struct rn_wire_reader reader;
    struct rn_error err = {0};
    enum rn_status status = RN_OK;
    int pair[2];
    bool ready = true;
    if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0, pair) != 0) abort();
    ssize_t sent = size > 0 ? send(pair[0], bytes, size, MSG_NOSIGNAL) : 0;
    if (sent < 0) abort();
    close(pair[0]);
    rn_wire_reader_init(&reader, pair[1]);
    while (status == RN_OK && ready) {
        struct rn_wire_message message;
        status = rn_wire_read(&reader, &ready, &message, &err);
        if (status != RN_OK || !ready) break;
        if (message.json[message.json_size] != '\0') wrong("a message that does not end");
        rn_wire_message_finish(&message);
    }
    check_error(status, &err);
    rn_wire_reader_finish(&reader);
    close(pair[1]);
}

// ---- paths, pictures --------------------------------------------------------------------------

static void check_camera(const struct rn_camera *camera) {
    bool good = camera->width >= 1 && camera->width <= RN_CAMERA_MAX_SIZE && camera->height >= 1 &&
                camera->height <= RN_CAMERA_MAX_SIZE && camera->fx > 0 && camera->fy > 0;
    for (int i = 0; i < 12; i++)
        good &=
            fabs(camera->world_from_camera[i / 4][i % 4]) <= 2 * RN_CAMERA_MAX_AWAY; // between keys
    if (!good || !isfinite(camera->fx + camera->fy + camera->cx + camera->cy))
        wrong("a camera that no picture can be taken with");
}

static void check_path(const struct rn_path *path) {
    size_t count = rn_path_frame_count(path);
    if (count < 1 || count > RN_PATH_MAX_FRAMES) wrong("a path of no or too many frames");
    for (size_t i = 0; i < count; i += 1 + count / 50) {
        struct rn_camera camera = rn_path_camera(path, i);
        check_camera(&camera);
    }
}

static void run_path(const uint8_t *bytes, size_t size) {
    struct rn_path *path = NULL;
    struct rn_camera camera;
    struct rn_error err = {0};
    enum rn_status status = rn_path_parse((const char *)bytes, size, "file", &path, &err);
    check_error(status, &err);
    if (status == RN_OK) {
        check_path(path);
        rn_path_destroy(&path);
    }
    err = (struct rn_error){0};
    status = rn_camera_parse((const char *)bytes, size, "file", &camera, &err);
    check_error(status, &err);
    if (status == RN_OK) check_camera(&camera);
}

#define DIVIDER "\n====\n"

// What other programs' paths are read from: a file, the one beside it, and the coordinates' space.
static void run_path_file(const uint8_t *bytes, size_t size) {
    struct rn_path_choices choices = {0};
    struct rn_path_text in = {.text = (const char *)bytes, .size = size, .where = "file"};
    const struct rn_path_format *format = NULL;
    struct rn_path_space space;
    struct rn_path *path = NULL;
    struct rn_error err = {0};
    char *beside = memmem(bytes, size, DIVIDER, sizeof DIVIDER - 1), *text = NULL, *other = NULL;
    if (beside != NULL) {
        *beside = '\0';
        in.size = (size_t)(beside - in.text);
        in.beside = beside + sizeof DIVIDER - 1;
        in.beside_size = size - in.size - (sizeof DIVIDER - 1);
        if (rn_path_space_read(in.beside, in.beside_size, "space", &space, &err) == RN_OK)
            choices.space = &space;
    }
    err = (struct rn_error){0};
    enum rn_status status = rn_path_import(&in, NULL, &choices, &path, &format, &err);
    check_error(status, &err);
    if (status != RN_OK) return;
    check_path(path);
    if (rn_path_frame_count(path) <= 100) // others take long to write
        check_error(rn_path_export(path, format, choices.space, &text, &other, &err), &err);
    free(text);
    free(other);
    rn_path_destroy(&path);
}

static void run_image(const uint8_t *bytes, size_t size) {
    const struct rn_image_limits limits = {1024, 1024, 1 << 18, 1 << 20};
    struct rn_image image;
    struct rn_error err = {0};
    enum rn_status status = rn_image_decode(bytes, size, "file", &limits, &image, &err);
    check_error(status, &err);
    if (status != RN_OK) return;
    if (image.width < 1 || image.height < 1 || image.width > 1024 || image.height > 1024)
        wrong("a picture over the limits");
    rn_image_finish(&image);
}

static void check_info(const struct rn_image_info *info) {
    bool there = info->located, north = fabs(info->located_at[0]) <= 90,
         east = fabs(info->located_at[1]) <= 180, high = isfinite(info->located_at[2]);
    if (info->orientation < 1 || info->orientation > 8) wrong("an orientation that there is not");
    if (!north || !east || !high) wrong("a place that there is not");
    if (!there && (info->located_at[0] != 0 || info->located_at[1] != 0))
        wrong("a place that is not said");
}

static void run_exif(const uint8_t *bytes, size_t size) {
    struct rn_image_info info = {.width = 1, .height = 1};
    rn_exif_read(bytes, size, &info);
    check_info(&info);
}

// A photograph's file: what its header says, and then what it holds, as it is and made smaller, and
// a copy without what is not the picture, of the same size and way up.
static void run_photo(const uint8_t *bytes, size_t size) {
    const struct rn_image_limits limits = {1024, 1024, 1 << 18, 1 << 20};
    struct rn_image image;
    struct rn_image_info info, copied;
    struct rn_error err = {0};
    uint8_t *copy;
    size_t copy_size;
    int times;
    put("photo", bytes, size);
    enum rn_status status = rn_image_probe(place("photo"), &limits, &info, &err);
    check_error(status, &err);
    if (status != RN_OK) return;
    check_info(&info);
    status = rn_image_read_smaller(place("photo"), &limits, 4, &image, &times, &err);
    check_error(status, &err);
    if (status != RN_OK) return;
    if (image.width * times != info.width || image.height * times != info.height)
        wrong("a picture of another size than its header says");
    rn_image_finish(&image);
    status = rn_image_strip(place("photo"), &limits, &copy, &copy_size, &err);
    check_error(status, &err);
    if (status != RN_OK) return;
    put("photo", copy, copy_size);
    if (rn_image_probe(place("photo"), &limits, &copied, &err) != RN_OK)
        wrong("a copy that cannot be read");
    else if (copied.width != info.width || copied.height != info.height || copied.located)
        wrong("a copy of another size, or that tells where it was taken");
    free(copy);
}

// ---- datasets ---------------------------------------------------------------------------------

static void make_photographs(void) {
    static const char *const folders[] = {"", "images", "train", "val", "test", "sparse"};
    static const char *const photos[] = {"images/0.png",  "images/1.png",  "images/2.png",
                                         "train/r_0.png", "train/r_1.png", "test/r_0.png"};
    static bool made;
    struct rn_image image;
    char path[PATH_MAX];
    if (made) return;
    made = true;
    for (size_t i = 0; i < sizeof folders / sizeof folders[0]; i++) {
        snprintf(path, sizeof path, "%s/data/%s", scratch(), folders[i]);
        if (mkdir(path, 0700) != 0 && errno != EEXIST) abort();
    }
    if (rn_image_init(16, 16, &image, NULL) != RN_OK) abort();
    for (size_t i = 0; i < sizeof photos / sizeof photos[0]; i++) {
        snprintf(path, sizeof path, "%s/data/%s", scratch(), photos[i]);
        if (rn_image_write_png(&image, path, 1, NULL) != RN_OK) abort();
    }
    rn_image_finish(&image);
}

// Documents of the format, one after the other.
static void run_dataset(const char *format, const char *const *names, const uint8_t *bytes,
                        size_t size) {
    const struct rn_read_options options = {.format = format};
    struct rn_problems problems = {0};
    struct rn_dataset *dataset = NULL;
    struct rn_error err = {0};
    char name[256];
    make_photographs();
    const uint8_t *at = bytes, *end = bytes + size;
    for (int i = 0; names[i] != NULL; i++) {
        const uint8_t *divider = memmem(at, (size_t)(end - at), DIVIDER, sizeof DIVIDER - 1);
        const uint8_t *stop = divider != NULL && names[i + 1] != NULL ? divider : end;
        snprintf(name, sizeof name, "data/%s", names[i]);
        if (strstr(name, ".json") || strstr(name, ".npy"))
            put_whole(name, at, (size_t)(stop - at));
        else
            put(name, at, (size_t)(stop - at));
        at = stop == end ? end : stop + sizeof DIVIDER - 1;
    }
    enum rn_status status = rn_dataset_read_as(place("data"), &options, &problems, &dataset, &err);
    check_error(status, &err);
    if (status == RN_OK) {
        if (dataset->frame_count == 0) wrong("a dataset without a view");
        for (size_t i = 0; i < dataset->frame_count; i++)
            check_camera(&dataset->frames[i].camera);
        rn_dataset_destroy(&dataset);
    }
    rn_problems_finish(&problems);
}

#define DATASET(function, format, ...)                                                             \
    static void run_##function(const uint8_t *bytes, size_t size) {                                \
        static const char *const names[] = {__VA_ARGS__, NULL};                                    \
        run_dataset(format, names, bytes, size);                                                   \
    }
DATASET(native, "native", "dataset.json")
DATASET(multiscale, "multiscale", "metadata.json")
DATASET(blender, "blender", "transforms_train.json", "transforms_test.json")
DATASET(ngp, "instant-ngp", "transforms.json")
DATASET(nerfstudio, "nerfstudio", "transforms.json", "points.ply")
DATASET(opensfm, "opensfm", "reconstruction.json", "tracks.csv")
DATASET(bundler, "bundler", "bundle.out", "list.txt")
DATASET(llff, "llff", "poses_bounds.npy")
DATASET(colmap, "colmap", "sparse/cameras.bin", "sparse/images.bin", "sparse/points3D.bin")

static void run_colmap_text(const uint8_t *bytes, size_t size) {
    static const char *const names[] = {"sparse/cameras.txt", "sparse/images.txt",
                                        "sparse/points3D.txt", NULL};
    run_dataset("colmap", names, bytes, size);
}

// ---- archives, checkpoints, sealed files ------------------------------------------------------

static void run_tar(const uint8_t *bytes, size_t size) {
    const struct rn_unpack_limits limits = {.max_bytes = 1 << 16, .max_entries = 16};
    struct rn_error err = {0};
    char archive[PATH_MAX];
    put("archive.tar", bytes, size);
    snprintf(archive, sizeof archive, "%s", place("archive.tar"));
    if (mkdir(place("unpacked"), 0700) != 0 && errno != EEXIST) abort();
    enum rn_status status = rn_unpack(archive, place("unpacked"), &limits, NULL, NULL, &err);
    check_error(status, &err);
    if (rn_remove_tree(place("unpacked"), NULL) != RN_OK) wrong("what was unpacked stays");
}

// A file for viewing comes from strangers: what it holds is read too, where it is small.
static void load_small(const struct rn_checkpoint *checkpoint) {
    struct rn_error err = {0};
    struct rn_field *field = NULL;
    if (!checkpoint->viewing.bits || rn_field_bytes(&checkpoint->config, 1) > 16u << 20) return;
    enum rn_status status = rn_field_create(&checkpoint->config, &checkpoint->bounds, &field, &err);
    if (status == RN_OK) status = rn_checkpoint_read_field(checkpoint, field, &err);
    check_error(status, &err);
    if (field) rn_field_destroy(&field);
}

// The header of a checkpoint, whose tensors are a hole of the right size.
static void run_checkpoint(const uint8_t *bytes, size_t size) {
    const off_t whole = 161620176; // of the corpus
    struct rn_checkpoint checkpoint;
    struct rn_error err = {0};
    static uint8_t head[1 << 14];
    static size_t written;
    const int fd = keep("checkpoint")->fd;
    if (written == 0 && ftruncate(fd, whole) != 0) abort();
    memcpy(head, bytes, size);
    if (size < written) memset(head + size, 0, written - size); // of the one before
    if (pwrite(fd, head, size > written ? size : written, 0) < (ssize_t)size) abort();
    written = size;
    enum rn_status status = rn_checkpoint_open(place("checkpoint"), &checkpoint, &err);
    check_error(status, &err);
    if (status == RN_OK) load_small(&checkpoint);
    if (status == RN_OK) rn_checkpoint_close(&checkpoint);
}

// A whole file for viewing, tensors and all.
static void run_scene(const uint8_t *bytes, size_t size) {
    struct rn_checkpoint checkpoint;
    struct rn_error err = {0};
    put("scene", bytes, size);
    enum rn_status status = rn_checkpoint_open(place("scene"), &checkpoint, &err);
    check_error(status, &err);
    if (status != RN_OK) return;
    load_small(&checkpoint);
    rn_checkpoint_close(&checkpoint);
}

static void run_sealed(const uint8_t *bytes, size_t size) {
    char first[65] = "", second[65] = "";
    uint8_t block[512];
    struct rn_error err = {0};
    struct rn_sealed *sealed;
    uint64_t whole = 0, got = 0;
    ssize_t part;
    put("sealed", bytes, size);
    enum rn_status status = rn_seal_check(place("sealed"), first, &err);
    check_error(status, &err);
    check_error(rn_seal_read(place("sealed"), second, &err), &err);
    if (status == RN_OK && strcmp(first, second) != 0) wrong("two digests of one file");
    rn_log_set_level((enum rn_log_level)(RN_LOG_ERROR - 1));
    if (rn_sealed_open(place("sealed"), &sealed, &whole, &err) != RN_OK) return;
    while ((part = rn_sealed_read(sealed, block, sizeof block)) > 0)
        got += (uint64_t)part;
    rn_sealed_close(&sealed);
    if ((part == 0 && got == whole) != (status == RN_OK))
        wrong("reading and checking disagree about a file");
}

static void run_manifest(const uint8_t *bytes, size_t size) {
    struct rn_error err = {0};
    if (mkdir(place("listed"), 0700) != 0 && errno != EEXIST) abort();
    put("listed/a", "a", 1);
    put_whole("listed/SHA256SUMS", bytes, size);
    check_error(rn_manifest_check(place("listed"), NULL, NULL, &err), &err);
    err = (struct rn_error){0};
    check_error(rn_manifest_check_file(place("listed"), "a", &err), &err);
}

// ---- HTTP, configuration ----------------------------------------------------------------------

static void run_http(const uint8_t *bytes, size_t size) {
    static const struct rn_route routes[] = {{RN_METHOD_GET, "/a/{b}/c/{d}", 0, 0, NULL, NULL},
                                             {RN_METHOD_GET, "/web/*", 0, 0, NULL, NULL},
                                             {RN_METHOD_POST, "/", 0, 0, NULL, NULL},
                                             {0}};
    char *text = (char *)bytes, *rest = text + strcspn(text, "\n");
    struct rn_match match;
    if (*rest != '\0') *rest++ = '\0';
    rn_router_match(routes, RN_METHOD_GET, text, &match);
    for (int i = 0; match.route != NULL && i < match.param_count; i++)
        if (memchr(match.params[i], '\0', RN_MAX_PARAM_BYTES) == NULL) wrong("a cut parameter");
    (void)rn_guard_host_is_loopback(text);
    (void)rn_guard_address_is_loopback(text);
    const char *token = rn_guard_bearer(text);
    if (token != NULL && (strncasecmp(text, "Bearer ", 7) != 0 || token != text + 7))
        wrong("a token that is none");
    if (rn_guard_origin(rest, text) && strstr(rest, text) == NULL && strcasestr(rest, text) == NULL)
        wrong("an origin of another host");
    (void)size;
}

static const char *no_environment(const char *name) {
    (void)name;
    return NULL;
}

static void run_config(const uint8_t *bytes, size_t size) {
    struct rn_config config;
    struct rn_error err = {0};
    char file[PATH_MAX + 16];
    put_whole("config", bytes, size);
    snprintf(file, sizeof file, "--config=%s", place("config"));
    char *argv[] = {(char *)"ripnerfd", (char *)"--data=/nowhere", file, NULL};
    enum rn_status status = rn_config_load(3, argv, no_environment, &config, &err);
    check_error(status, &err);
    if (status == RN_OK) rn_config_finish(&config);
}

const struct target targets[] = {
    {"request", run_request, 1 << 14},
    {"message", run_message, 1 << 14},
    {"wire", run_wire, 1 << 14},
    {"path", run_path, 1 << 14},
    {"path-file", run_path_file, 1 << 13},
    {"image", run_image, 1 << 14},
    {"photo", run_photo, 1 << 14},
    {"exif", run_exif, 1 << 12},
    {"native", run_native, 1 << 14},
    {"multiscale", run_multiscale, 1 << 14},
    {"blender", run_blender, 1 << 14},
    {"ngp", run_ngp, 1 << 14},
    {"nerfstudio", run_nerfstudio, 1 << 14},
    {"opensfm", run_opensfm, 1 << 14},
    {"bundler", run_bundler, 1 << 13},
    {"llff", run_llff, 1 << 13},
    {"colmap", run_colmap, 1 << 13},
    {"colmap-text", run_colmap_text, 1 << 13},
    {"tar", run_tar, 1 << 14},
    {"checkpoint", run_checkpoint, 1 << 14},
    {"scene", run_scene, 1 << 17},
    {"sealed", run_sealed, 1 << 13},
    {"manifest", run_manifest, 1 << 12},
    {"http", run_http, 1 << 12},
    {"config", run_config, 1 << 12},
    {NULL, NULL, 0},
};

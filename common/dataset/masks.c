// Masks: pictures whose black pixels are left out of the loss.
//
// A document may name a photograph's mask; else it is looked for in a folder, as COLMAP has them
// (masks/IMG.jpg.png) or under the photograph's own name.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/dataset/reader.h"
#include "common/image/image.h"

#define WHITE 128
#define INVERTED "dynamic_mask_" // how instant-ngp calls a mask whose black is what is used

// The photograph's path below its own folder, as "sub/a.jpg" of "DATASET/images/sub/a.jpg".
static const char *below_folder(const struct rn_reader *reader, const char *path) {
    const char *inner = path + strlen(reader->folder);
    inner += strspn(inner, "/");
    const char *slash = strchr(inner, '/');
    return slash ? slash + 1 : inner;
}

char *rn_reader_find_mask(const struct rn_reader *reader, const char *folder, const char *name) {
    const char *dot = strrchr(name, '.');
    int whole = (int)strlen(name), stem = dot ? (int)(dot - name) : whole;
    const struct {
        int length;
        const char *ending;
    } forms[] = {{whole, ".png"}, {whole, ""},    {stem, ".png"},
                 {stem, ".PNG"},  {stem, ".jpg"}, {stem, ".JPG"}};
    for (size_t i = 0; i < sizeof forms / sizeof *forms; i++) {
        char file[2 * RN_FILE_NAME_MAX];
        snprintf(file, sizeof file, "%s/%.*s%s", folder, forms[i].length, name, forms[i].ending);
        char *mask = rn_reader_path(reader, file);
        if (mask && access(mask, F_OK) == 0) return mask;
        free(mask);
    }
    return NULL;
}

enum rn_status rn_mask_check(const char *mask, const char *photo, int width, int height,
                             struct rn_error *err) {
    struct rn_image_info info;
    enum rn_status status = rn_image_probe(mask, &rn_image_default_limits, &info, err);
    if (status) return status;
    if (info.width == width && info.height == height) return RN_OK;
    return rn_error_set(err, RN_ERROR_INVALID, mask,
                        "the mask has %dx%d pixels, its photograph %s %dx%d", info.width,
                        info.height, photo, width, height);
}

static bool is_inverted(const char *mask) {
    const char *slash = strrchr(mask, '/');
    return strncmp(slash ? slash + 1 : mask, INVERTED, strlen(INVERTED)) == 0;
}

// instant-ngp's mask of what moves lies beside the photograph.
static char *find_inverted(const char *photo) {
    const char *name = strrchr(photo, '/') + 1, *dot = strrchr(name, '.');
    int folder = (int)(name - photo), stem = dot ? (int)(dot - name) : (int)strlen(name);
    char *mask;
    if (asprintf(&mask, "%.*s" INVERTED "%.*s.png", folder, photo, stem, name) < 0) return NULL;
    if (access(mask, F_OK) == 0) return mask;
    free(mask);
    return NULL;
}

// Of the whole capture.
static void tell_masks(const struct rn_reader *reader, const char *folder, size_t all,
                       size_t masked, size_t inverted) {
    if (masked)
        rn_problems_add(reader->problems, RN_SEVERITY_INFO, reader->folder,
                        "%zu of %zu photographs have masks, whose black pixels are left out",
                        masked, all);
    if (inverted)
        rn_problems_add(reader->problems, RN_SEVERITY_INFO, reader->folder,
                        "%zu of %zu photographs have a mask " INVERTED
                        "NAME.png, as instant-ngp calls "
                        "those of which what is not black is left out",
                        inverted, all);
    if (!masked && !inverted && !folder && rn_reader_has(reader, RN_MASK_FOLDER))
        rn_problems_add(reader->problems, RN_SEVERITY_WARNING, reader->folder,
                        RN_MASK_FOLDER " has no mask of any photograph, so none is used: "
                                       "NAME.jpg.png, NAME.jpg and NAME.png are looked for");
}

enum rn_status rn_reader_find_masks(struct rn_reader *reader, const char *folder,
                                    struct rn_error *err) {
    struct rn_dataset *dataset = reader->dataset;
    size_t kept = 0, masked = 0, inverted = 0, all = dataset->frame_count;
    for (size_t i = 0; i < all; i++) {
        struct rn_frame *frame = &dataset->frames[i];
        struct rn_error fault;
        if (!frame->mask_path)
            frame->mask_path = rn_reader_find_mask(reader, folder ? folder : RN_MASK_FOLDER,
                                                   below_folder(reader, frame->path));
        masked += frame->mask_path != NULL;
        if (!frame->mask_path && reader->dynamic_masks)
            inverted += (frame->mask_path = find_inverted(frame->path)) != NULL;
        if (!frame->mask_path || rn_mask_check(frame->mask_path, frame->path, frame->camera.width,
                                               frame->camera.height, &fault) == RN_OK) {
            dataset->frames[kept++] = *frame;
            continue;
        }
        rn_problems_add(reader->problems, RN_SEVERITY_ERROR, fault.where, "%s", fault.text);
        dataset->unusable[frame->split]++;
        rn_frame_finish(frame);
    }
    dataset->frame_count = kept;
    tell_masks(reader, folder, all, masked, inverted);
    if (masked || !folder) return RN_OK;
    return rn_error_set(err, RN_ERROR_INVALID, folder,
                        "has no mask of any photograph: NAME.jpg.png, NAME.jpg and NAME.png are "
                        "looked for, relative to the dataset's folder");
}

// Half as bright as white, so that what a lossy file blurred does not count; of a mask of 0 and 1,
// as arrays are saved, 1.
static int threshold_of(const struct rn_image *mask) {
    int most = 0;
    for (size_t i = 0; i < (size_t)mask->width * (size_t)mask->height; i++)
        if (mask->pixels[4 * i] > most) most = mask->pixels[4 * i];
    return most == 1 ? 1 : WHITE;
}

enum rn_status rn_mask_read(const struct rn_frame *frame, uint8_t *used, struct rn_error *err) {
    struct rn_image mask;
    enum rn_status status = rn_image_read(frame->mask_path, &rn_image_default_limits, &mask, err);
    if (status != RN_OK) return status;
    int w = frame->camera.width, h = frame->camera.height;
    if (mask.width != w || mask.height != h)
        status = rn_error_set(err, RN_ERROR_CORRUPT, frame->mask_path,
                              "is %dx%d but its photograph is %dx%d; import the dataset again",
                              mask.width, mask.height, w, h);
    bool inverted = is_inverted(frame->mask_path);
    int threshold = status ? 0 : inverted ? 1 : threshold_of(&mask);
    for (size_t i = 0; status == RN_OK && i < (size_t)w * (size_t)h; i++) {
        const uint8_t *pixel = mask.pixels + 4 * i; // of what is transparent, nothing is white
        bool white = pixel[0] >= threshold && pixel[3] >= WHITE;
        used[i] = white != inverted;
    }
    rn_image_finish(&mask);
    return status;
}

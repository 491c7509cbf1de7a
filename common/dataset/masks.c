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

// The photograph's path below its own folder, as "sub/a.jpg" of "DATASET/images/sub/a.jpg".
static const char *below_folder(const struct rn_reader *reader, const char *path) {
    const char *inner = path + strlen(reader->folder);
    inner += strspn(inner, "/");
    const char *slash = strchr(inner, '/');
    return slash ? slash + 1 : inner;
}

char *rn_reader_find_mask(const struct rn_reader *reader, const char *folder, const char *name) {
    const char *dot = strrchr(name, '.');
    int stem = dot ? (int)(dot - name) : (int)strlen(name);
    const struct {
        int length;
        const char *ending;
    } forms[] = {{(int)strlen(name), ".png"}, {(int)strlen(name), ""}, {stem, ".png"}};
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

enum rn_status rn_reader_find_masks(struct rn_reader *reader, const char *folder,
                                    struct rn_error *err) {
    struct rn_dataset *dataset = reader->dataset;
    size_t kept = 0, masked = 0;
    for (size_t i = 0; i < dataset->frame_count; i++) {
        struct rn_frame *frame = &dataset->frames[i];
        struct rn_error fault;
        if (!frame->mask_path)
            frame->mask_path = rn_reader_find_mask(reader, folder ? folder : RN_MASK_FOLDER,
                                                   below_folder(reader, frame->path));
        masked += frame->mask_path != NULL;
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
    if (masked)
        rn_problems_add(reader->problems, RN_SEVERITY_INFO, reader->folder,
                        "%zu photographs have masks, whose black pixels are left out", masked);
    if (masked || !folder) return RN_OK;
    return rn_error_set(err, RN_ERROR_INVALID, folder,
                        "has no mask of any photograph: NAME.jpg.png, NAME.jpg and NAME.png are "
                        "looked for, relative to the dataset's folder");
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
    for (size_t i = 0; status == RN_OK && i < (size_t)w * (size_t)h; i++)
        used[i] = mask.pixels[4 * i] >= 128;
    rn_image_finish(&mask);
    return status;
}

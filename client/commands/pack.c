#include "client/commands/pack.h"

#include <stdlib.h>
#include <string.h>

static int compare_names(const void *a, const void *b) {
    return strcmp(*(const char *const *)a, *(const char *const *)b);
}

// The path of a frame below the dataset's folder.
static const char *below(const char *folder, const char *path) {
    size_t size = strlen(folder);
    if (strncmp(path, folder, size) != 0) return path;
    path += size;
    return path + strspn(path, "/");
}

static enum rn_status add_images(struct rn_tar *tar, const char *folder,
                                 const struct rn_dataset *dataset, struct rn_error *err) {
    enum rn_status status = RN_OK;
    size_t count = 0;
    const char **names = calloc(2 * dataset->frame_count, sizeof *names);
    if (!names) return rn_error_set(err, RN_ERROR_NO_MEMORY, folder, "memory ran out");
    for (size_t i = 0; i < dataset->frame_count; i++) {
        names[count++] = below(folder, dataset->frames[i].path);
        if (dataset->frames[i].mask_path)
            names[count++] = below(folder, dataset->frames[i].mask_path);
    }
    qsort(names, count, sizeof *names, compare_names);
    for (size_t i = 0; i < count && status == RN_OK; i++)
        status = rn_tar_add(tar, names[i], err);
    free(names);
    return status;
}

// What was read beside images.
static enum rn_status add_documents(struct rn_tar *tar, const struct rn_dataset *dataset,
                                    struct rn_error *err) {
    enum rn_status status = RN_OK;
    for (size_t i = 0; i < dataset->document_count && status == RN_OK; i++)
        status = rn_tar_add(tar, dataset->documents[i], err);
    return status;
}

enum rn_status rn_pack_dataset(struct rn_tar *tar, const char *folder,
                               const struct rn_dataset *dataset, struct rn_error *err) {
    enum rn_status status = add_documents(tar, dataset, err);
    return status == RN_OK ? add_images(tar, folder, dataset, err) : status;
}

enum rn_status rn_pack_photos(struct rn_tar *tar, const char *folder,
                              const struct rn_photos *photos, struct rn_error *err) {
    enum rn_status status = RN_OK;
    if (photos->film) return rn_tar_add(tar, below(folder, photos->film), err);
    for (size_t i = 0; i < photos->count && status == RN_OK; i++) {
        const struct rn_photo *photo = &photos->items[i];
        status = rn_tar_add(tar, below(folder, photo->path), err);
        if (status == RN_OK && photo->mask_path)
            status = rn_tar_add(tar, below(folder, photo->mask_path), err);
    }
    return status;
}

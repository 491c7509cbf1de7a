// The model that poses were found in, kept with the dataset to be had as a tar.
#include <archive.h>
#include <archive_entry.h>
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "server/runner/ingest/poses.h"

#define BLOCK_BYTES (1 << 16)

static enum rn_status failed(struct archive *tar, const char *where, struct rn_error *err) {
    const char *text = archive_error_string(tar);
    return rn_error_set(err, RN_ERROR_IO, where, "the model cannot be kept: %.300s",
                        text ? text : "writing failed");
}

static enum rn_status add_bytes(struct archive *tar, int fd, const char *name,
                                struct rn_error *err) {
    char block[BLOCK_BYTES];
    ssize_t size;
    while ((size = read(fd, block, sizeof block)) > 0)
        if (archive_write_data(tar, block, (size_t)size) != size) return failed(tar, name, err);
    return size < 0 ? rn_error_from_errno(err, errno, name, "read") : RN_OK;
}

static enum rn_status add_file(struct archive *tar, const char *path, const char *name,
                               struct rn_error *err) {
    struct stat about;
    struct archive_entry *entry = archive_entry_new();
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    enum rn_status status = RN_OK;
    if (!entry)
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, name, "out of memory");
    else if (fd < 0 || fstat(fd, &about) != 0)
        status = rn_error_from_errno(err, errno, path, "open");
    if (status == RN_OK && S_ISREG(about.st_mode)) {
        archive_entry_set_pathname(entry, name);
        archive_entry_set_size(entry, about.st_size);
        archive_entry_set_filetype(entry, AE_IFREG);
        archive_entry_set_perm(entry, 0644);
        status = archive_write_header(tar, entry) == ARCHIVE_OK ? add_bytes(tar, fd, name, err)
                                                                : failed(tar, name, err);
    }
    if (fd >= 0) close(fd);
    if (entry) archive_entry_free(entry);
    return status;
}

// The files of FOLDER/sparse/N.
static enum rn_status add_model(struct archive *tar, const char *folder, const char *number,
                                struct rn_error *err) {
    char inner[300], path[PATH_MAX];
    enum rn_status status = RN_OK;
    snprintf(path, sizeof path, "%s/sparse/%s", folder, number);
    DIR *files = opendir(path);
    if (!files) return rn_error_from_errno(err, errno, path, "list");
    for (struct dirent *file; status == RN_OK && (file = readdir(files)) != NULL;) {
        if (file->d_name[0] == '.') continue;
        snprintf(inner, sizeof inner, "sparse/%.20s/%.250s", number, file->d_name);
        if (snprintf(path, sizeof path, "%s/%s", folder, inner) < (int)sizeof path)
            status = add_file(tar, path, inner, err);
    }
    closedir(files);
    return status;
}

enum rn_status rn_poses_keep(const char *folder, const char *target, struct rn_error *err) {
    char path[PATH_MAX], sparse[PATH_MAX];
    snprintf(path, sizeof path, "%s/" RN_POSES_MODEL, target);
    snprintf(sparse, sizeof sparse, "%s/sparse", folder);
    struct archive *tar = archive_write_new();
    DIR *models = opendir(sparse);
    enum rn_status status = RN_OK;
    if (!tar)
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, path, "out of memory");
    else if (!models)
        status = rn_error_from_errno(err, errno, sparse, "list");
    else if (archive_write_set_format_ustar(tar) != ARCHIVE_OK ||
             archive_write_open_filename(tar, path) != ARCHIVE_OK)
        status = failed(tar, path, err);
    for (struct dirent *model; status == RN_OK && (model = readdir(models)) != NULL;)
        if (model->d_name[0] != '.') status = add_model(tar, folder, model->d_name, err);
    if (tar && status == RN_OK && archive_write_close(tar) != ARCHIVE_OK)
        status = failed(tar, path, err);
    if (tar) archive_write_free(tar);
    if (models) closedir(models);
    return status;
}

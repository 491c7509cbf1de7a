#include "common/dataset/output.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdlib.h>
#include <unistd.h>

#include "common/base/file.h"
#include "common/base/threads.h"

enum rn_status rn_output_check_new(const char *folder, struct rn_error *err) {
    DIR *entries = opendir(folder);
    if (!entries) return errno == ENOENT ? RN_OK : rn_error_from_errno(err, errno, folder, "open");
    int count = 0;
    while (readdir(entries))
        count++;
    closedir(entries);
    if (count > 2) // . and ..
        return rn_error_set(err, RN_ERROR_CONFLICT, folder, "is not an empty folder");
    return RN_OK;
}

struct run {
    rn_output_work work;
    void *context;
    rn_output_progress progress;
    void *progress_context;
    const char *where;
    size_t count;
    pthread_mutex_t lock; // guards what follows
    size_t done;
    bool stopped;
    struct rn_error failure;
};

static void run_one(void *context, size_t index) {
    struct run *run = context;
    pthread_mutex_lock(&run->lock);
    bool stopped = run->stopped;
    pthread_mutex_unlock(&run->lock);
    if (stopped) return;
    struct rn_error err = {.status = RN_OK};
    enum rn_status status = run->work(run->context, index, &err);
    pthread_mutex_lock(&run->lock);
    run->done++;
    if (!run->stopped && status) {
        run->stopped = true;
        run->failure = err;
    } else if (!run->stopped && run->progress &&
               !run->progress(run->progress_context, run->done, run->count)) {
        run->stopped = true;
        rn_error_set(&run->failure, RN_ERROR_CANCELLED, run->where, "cancelled");
    }
    pthread_mutex_unlock(&run->lock);
}

enum rn_status rn_output_run(int threads, size_t count, rn_output_work work, void *context,
                             rn_output_progress progress, void *progress_context, const char *where,
                             struct rn_error *err) {
    struct run run = {.work = work,
                      .context = context,
                      .progress = progress,
                      .progress_context = progress_context,
                      .where = where,
                      .count = count,
                      .lock = PTHREAD_MUTEX_INITIALIZER};
    rn_parallel_for(threads, count, run_one, &run);
    if (!run.stopped) return RN_OK;
    return rn_error_set(err, run.failure.status, run.failure.where, "%s", run.failure.text);
}

enum rn_status rn_output_file(const char *path, const void *content, size_t size,
                              struct rn_error *err) {
    int file = open(path, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (file < 0) return rn_error_from_errno(err, errno, path, "create");
    enum rn_status status =
        rn_write_all(file, content, size) ? RN_OK : rn_error_from_errno(err, errno, path, "write");
    if (close(file) != 0 && status == RN_OK)
        status = rn_error_from_errno(err, errno, path, "write");
    return status;
}

enum rn_status rn_output_png(const struct rn_image *image, const char *path, int level,
                             struct rn_error *err) {
    uint8_t *bytes;
    size_t size;
    enum rn_status status = rn_image_encode_png(image, level, &bytes, &size, err);
    if (status) return status;
    status = rn_output_file(path, bytes, size, err);
    free(bytes);
    return status;
}

enum rn_status rn_output_sync(const char *folder, struct rn_error *err) {
    int file = open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (file < 0) return rn_error_from_errno(err, errno, folder, "open");
    enum rn_status status =
        syncfs(file) == 0 ? RN_OK : rn_error_from_errno(err, errno, folder, "write");
    close(file);
    return status;
}

#include "server/store/scrub.h"

#include <dirent.h>
#include <errno.h>
#include <fnmatch.h>
#include <limits.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include "common/base/log.h"
#include "common/base/manifest.h"
#include "common/base/seal.h"

struct pass {
    const char *dir;
    bool (*keep_going)(void *context);
    void *context;
    struct rn_scrub_result result;
};

static bool goes_on(const struct pass *pass) {
    return pass->keep_going == NULL || pass->keep_going(pass->context);
}

static void note(struct pass *pass, enum rn_status status, const struct rn_error *err) {
    if (status == RN_ERROR_NOT_FOUND || status == RN_ERROR_CANCELLED) return; // gone meanwhile
    bool read = status == RN_OK || status == RN_ERROR_CORRUPT;
    pass->result.checked += read;
    pass->result.damaged += status == RN_ERROR_CORRUPT;
    pass->result.unread += !read;
    if (status != RN_OK) rn_log(RN_LOG_ERROR, "scrub: %s: %s", err->where, err->text);
}

static void note_errno(struct pass *pass, const char *folder) {
    struct rn_error err = {0};
    note(pass, rn_error_from_errno(&err, errno, folder, "list the folder"), &err);
}

static void check_sealed(struct pass *pass, const char *path) {
    struct rn_error err = {0};
    char sha256[65];
    note(pass, rn_seal_check(path, sha256, &err), &err);
}

static void check_folder(struct pass *pass, const char *path) {
    struct rn_error err = {0};
    note(pass, rn_manifest_check(path, pass->keep_going, pass->context, &err), &err);
}

// Calls `visit` with the path of each entry of the folder whose name matches the pattern.
static void each(struct pass *pass, const char *folder, const char *pattern,
                 void (*visit)(struct pass *pass, const char *path)) {
    DIR *listing = opendir(folder);
    struct dirent *entry = NULL;
    char path[PATH_MAX];
    if (listing == NULL) {
        if (errno != ENOTDIR) note_errno(pass, folder);
        return;
    }
    errno = 0;
    while (goes_on(pass) && (errno = 0, entry = readdir(listing)) != NULL)
        if (fnmatch(pattern, entry->d_name, FNM_PERIOD) == 0 &&
            snprintf(path, sizeof path, "%s/%s", folder, entry->d_name) < (int)sizeof path)
            visit(pass, path);
    if (entry == NULL && errno != 0) note_errno(pass, folder);
    closedir(listing);
}

static void check_record(struct pass *pass, const char *folder) {
    each(pass, folder, "record.json", check_sealed);
}

static void check_list(struct pass *pass, const char *path) {
    char folder[PATH_MAX];
    snprintf(folder, sizeof folder, "%.*s", (int)(strrchr(path, '/') - path), path);
    check_folder(pass, folder);
}

static void check_dataset(struct pass *pass, const char *folder) {
    check_record(pass, folder);
    each(pass, folder, "SHA256SUMS", check_list);
}

static void check_job(struct pass *pass, const char *folder) {
    check_record(pass, folder);
    each(pass, folder, "frames", check_folder);
}

static void check_scene(struct pass *pass, const char *folder) {
    static const char *const names[][2] = {{"checkpoints", "step-*.safetensors"},
                                           {"marks", "*.safetensors"}};
    char path[PATH_MAX];
    check_record(pass, folder);
    for (size_t i = 0; i < sizeof names / sizeof names[0]; i++)
        if (snprintf(path, sizeof path, "%s/%s", folder, names[i][0]) < (int)sizeof path)
            each(pass, path, names[i][1], check_sealed);
}

void rn_scrub(const char *dir, bool (*keep_going)(void *context), void *context,
              struct rn_scrub_result *ret_result) {
    static const struct {
        const char *folder;
        void (*visit)(struct pass *pass, const char *path);
    } parts[] = {{"datasets", check_dataset},
                 {"scenes", check_scene},
                 {"camera-paths", check_record},
                 {"jobs", check_job}};
    struct pass pass = {.dir = dir, .keep_going = keep_going, .context = context};
    for (size_t i = 0; i < sizeof parts / sizeof parts[0]; i++) {
        char folder[PATH_MAX];
        if (snprintf(folder, sizeof folder, "%s/%s", dir, parts[i].folder) < (int)sizeof folder)
            each(&pass, folder, "*", parts[i].visit);
    }
    *ret_result = pass.result;
}

// ---- in idle time -----------------------------------------------------------------------------

struct rn_scrubber {
    char *dir;
    int64_t interval_s;
    bool (*is_idle)(void *context);
    void *context;
    pthread_t thread;
    pthread_mutex_t lock;
    pthread_cond_t changed;
    bool stopping;
    struct rn_scrub_result result; // of all passes
};

// Waits; false: it is to stop.
static bool rest(struct rn_scrubber *scrubber, int64_t seconds) {
    struct timespec until;
    clock_gettime(CLOCK_MONOTONIC, &until);
    until.tv_sec += seconds;
    pthread_mutex_lock(&scrubber->lock);
    while (!scrubber->stopping &&
           pthread_cond_timedwait(&scrubber->changed, &scrubber->lock, &until) == 0)
        continue;
    bool stopping = scrubber->stopping;
    pthread_mutex_unlock(&scrubber->lock);
    return !stopping;
}

static bool keep_going(void *context) {
    struct rn_scrubber *scrubber = context;
    bool going = rest(scrubber, 0);
    while (going && !scrubber->is_idle(scrubber->context))
        going = rest(scrubber, 5);
    return going;
}

static void *run(void *context) {
    struct rn_scrubber *scrubber = context;
    if (setpriority(PRIO_PROCESS, (id_t)syscall(SYS_gettid), 19) != 0)
        rn_log(RN_LOG_DEBUG, "scrub: %s", strerror(errno));
    while (rest(scrubber, scrubber->interval_s)) {
        struct rn_scrub_result result;
        rn_scrub(scrubber->dir, keep_going, scrubber, &result);
        pthread_mutex_lock(&scrubber->lock);
        scrubber->result.checked += result.checked;
        scrubber->result.damaged += result.damaged;
        scrubber->result.unread += result.unread;
        pthread_mutex_unlock(&scrubber->lock);
    }
    return NULL;
}

enum rn_status rn_scrubber_start(const char *dir, int64_t interval_s,
                                 bool (*is_idle)(void *context), void *context,
                                 struct rn_scrubber **ret_scrubber, struct rn_error *err) {
    struct rn_scrubber *scrubber = calloc(1, sizeof *scrubber);
    char *copy = strdup(dir);
    if (scrubber == NULL || copy == NULL) {
        free(scrubber);
        free(copy);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "scrub", "no memory");
    }
    pthread_condattr_t monotonic;
    pthread_condattr_init(&monotonic);
    pthread_condattr_setclock(&monotonic, CLOCK_MONOTONIC);
    pthread_mutex_init(&scrubber->lock, NULL);
    pthread_cond_init(&scrubber->changed, &monotonic);
    pthread_condattr_destroy(&monotonic);
    scrubber->dir = copy;
    scrubber->interval_s = interval_s;
    scrubber->is_idle = is_idle;
    scrubber->context = context;
    if (pthread_create(&scrubber->thread, NULL, run, scrubber) != 0) {
        free(copy);
        free(scrubber);
        return rn_error_set(err, RN_ERROR_IO, "scrub", "a thread cannot be started");
    }
    *ret_scrubber = scrubber;
    return RN_OK;
}

void rn_scrubber_result(struct rn_scrubber *scrubber, struct rn_scrub_result *ret_result) {
    pthread_mutex_lock(&scrubber->lock);
    *ret_result = scrubber->result;
    pthread_mutex_unlock(&scrubber->lock);
}

void rn_scrubber_stop(struct rn_scrubber **scrubber_pointer) {
    struct rn_scrubber *scrubber = *scrubber_pointer;
    *scrubber_pointer = NULL;
    if (scrubber == NULL) return;
    pthread_mutex_lock(&scrubber->lock);
    scrubber->stopping = true;
    pthread_cond_broadcast(&scrubber->changed);
    pthread_mutex_unlock(&scrubber->lock);
    pthread_join(scrubber->thread, NULL);
    pthread_cond_destroy(&scrubber->changed);
    pthread_mutex_destroy(&scrubber->lock);
    free(scrubber->dir);
    free(scrubber);
}

#include "proto/marks.h"

#include <dirent.h>
#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/log.h"

#define MOST_FILES 64 // in the folder that are looked at

#define S struct rn_mark
static const struct rn_field_spec mark[] = {
    RN_F_NUMBER(S, train_seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, step, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, size_bytes, RN_REQUIRED, 0, INFINITY),
};
const struct rn_table rn_mark_table = RN_TABLE(S, "a mark", mark);
#undef S

static void name_of(const struct rn_mark *m, char ret_name[64]) {
    snprintf(ret_name, 64, "%09" PRId64 "-%09" PRId64 ".safetensors",
             (int64_t)llround(m->train_seconds * 1e3), m->step);
}

enum rn_status rn_mark_path(const char *scene_folder, const struct rn_mark *m,
                            char ret_path[PATH_MAX], struct rn_error *err) {
    char name[64];
    name_of(m, name);
    return snprintf(ret_path, PATH_MAX, "%s/marks/%s", scene_folder, name) < PATH_MAX
               ? RN_OK
               : rn_error_set(err, RN_ERROR_LIMIT, scene_folder, "the path is too long");
}

// Whether it is a mark's name; its size is not known by that.
static bool parse_name(const char *name, struct rn_mark *ret_mark) {
    int64_t milliseconds, step;
    char again[64];
    if (sscanf(name, "%" SCNd64 "-%" SCNd64, &milliseconds, &step) != 2) return false;
    *ret_mark = (struct rn_mark){.train_seconds = (double)milliseconds * 1e-3, .step = step};
    name_of(ret_mark, again);
    return strcmp(again, name) == 0;
}

static int by_time(const void *a, const void *b) {
    const struct rn_mark *x = a, *y = b;
    return (x->train_seconds > y->train_seconds) - (x->train_seconds < y->train_seconds);
}

// All of them by time.
static size_t read_folder(const char *scene_folder, struct rn_mark marks[MOST_FILES]) {
    char path[PATH_MAX];
    size_t count = 0;
    struct dirent *entry;
    struct stat about;
    snprintf(path, sizeof path, "%s/marks", scene_folder);
    DIR *folder = opendir(path);
    while (folder && count < MOST_FILES && (entry = readdir(folder))) {
        if (!parse_name(entry->d_name, &marks[count])) continue;
        if (rn_mark_path(scene_folder, &marks[count], path, NULL) || stat(path, &about)) continue;
        marks[count++].size_bytes = about.st_size;
    }
    if (folder) closedir(folder);
    qsort(marks, count, sizeof *marks, by_time);
    return count;
}

size_t rn_marks_list(const char *scene_folder, struct rn_mark ret_marks[RN_MARKS_KEPT]) {
    struct rn_mark all[MOST_FILES];
    size_t count = read_folder(scene_folder, all);
    size_t first = count > RN_MARKS_KEPT ? count - RN_MARKS_KEPT : 0;
    memcpy(ret_marks, all + first, (count - first) * sizeof *all);
    return count - first;
}

static double ratio(double a, double b) {
    return fabs(log(fmax(a, 1e-3) / fmax(b, 1e-3)));
}

enum rn_status rn_mark_nearest(const struct rn_mark *marks, size_t count, double train_seconds,
                               size_t *ret_nearest, struct rn_error *err) {
    size_t nearest = 0;
    char times[24 * RN_MARKS_KEPT] = "";
    for (size_t i = 0, length = 0; i < count; i++) {
        if (ratio(marks[i].train_seconds, train_seconds) <
            ratio(marks[nearest].train_seconds, train_seconds))
            nearest = i;
        if (length < sizeof times)
            length += (size_t)snprintf(times + length, sizeof times - length, "%s%.1f s",
                                       i ? ", " : "", marks[i].train_seconds);
    }
    if (count > 0 && ratio(marks[nearest].train_seconds, train_seconds) <= log(RN_MARK_APART)) {
        *ret_nearest = nearest;
        return RN_OK;
    }
    return rn_error_set(err, RN_ERROR_INVALID, "#/at",
                        "nothing was kept near %g s of the training; %s%s", train_seconds,
                        count ? "there is " : "it has no marks", times);
}

double rn_mark_next(double train_seconds) {
    double next = RN_MARK_FIRST_S;
    while (next <= train_seconds)
        next *= 2;
    return next;
}

void rn_marks_prune(const char *scene_folder, int64_t step) {
    struct rn_mark all[MOST_FILES];
    char path[PATH_MAX];
    size_t count = read_folder(scene_folder, all), good = 0;
    for (size_t i = 0; i < count; i++)
        good += all[i].step <= step;
    for (size_t i = 0; i < count; i++) {
        if (all[i].step <= step && good <= RN_MARKS_KEPT) continue;
        good -= all[i].step <= step;
        if (rn_mark_path(scene_folder, &all[i], path, NULL) == RN_OK && unlink(path) < 0)
            rn_log(RN_LOG_WARN, "%s cannot be removed: %s", path, strerror(errno));
    }
}

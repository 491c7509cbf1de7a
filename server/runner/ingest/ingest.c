#include "server/runner/ingest/ingest.h"

#include <dirent.h>
#include <errno.h>
#include <fts.h>
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/log.h"
#include "common/base/manifest.h"
#include "common/base/threads.h"
#include "common/dataset/survey.h"
#include "server/runner/ingest/adopt.h"
#include "server/runner/ingest/poses.h"
#include "server/runner/ingest/unpack.h"
#include "server/runner/ingest/validate.h"
#include "server/runner/link/link.h"
#include "server/runner/sandbox/sandbox.h"
#include "server/runner/scene/describe.h"

#define PROGRESS_INTERVAL_S 0.5

struct ingest {
    struct rn_link link;
    struct rn_wire_ingest order;
    struct rn_watch watch;
    const char *folder; // where the dataset lies: the source, or the unpacked tar
    char unpacked[PATH_MAX];
    char *posed;             // the folder in which poses were found; NULL: they were not looked for
    struct rn_photos photos; // for which they were
    bool finds_poses;
    const char *stage;
    int64_t began_ns, began_stage_ns, reported_ns;
    bool late; // the time it may take is over
};

static void post_progress(struct ingest *ingest, size_t done, size_t total) {
    int64_t now = rn_clock_ns();
    if (done < total && (double)(now - ingest->reported_ns) * 1e-9 < PROGRESS_INTERVAL_S) return;
    ingest->reported_ns = now;
    double elapsed = (double)(now - ingest->began_stage_ns) * 1e-9;
    struct rn_work_progress record = {
        .done = (int64_t)done,
        .total = total ? (int64_t)total : RN_ABSENT,
        .fraction = total ? (double)done / (double)total : NAN,
        .eta_seconds = total && done ? elapsed * (double)(total - done) / (double)done : NAN};
    if (ingest->stage) snprintf(record.stage, sizeof record.stage, "%s", ingest->stage);
    struct rn_wire_progress message = {.progress = NULL};
    memcpy(message.job, ingest->order.job, sizeof message.job);
    if (rn_encode(&rn_work_progress_table, &record, &message.progress, NULL, NULL)) return;
    rn_link_post(&ingest->link, RN_WIRE_PROGRESS, &message, NULL, 0);
    free(message.progress);
}

// Unpacking and importing end when the time is over, or the job was cancelled.
static bool keep_going(void *context) {
    struct ingest *ingest = context;
    int64_t most = rn_int_or(ingest->order.max_seconds, 0);
    ingest->late = most > 0 && rn_clock_ns() - ingest->began_ns > most * 1000000000ll;
    return !ingest->late && rn_watch_keep_going(&ingest->watch);
}

// Called by the import's workers, one at a time.
static bool on_progress(void *context, size_t done, size_t total) {
    struct ingest *ingest = context;
    post_progress(ingest, done, total);
    return keep_going(ingest);
}

// Each stage of looking for poses is told on its own: how long they take together nobody knows.
static void on_stage(void *context, const char *name, size_t done, size_t total) {
    struct ingest *ingest = context;
    if (ingest->stage != name) ingest->began_stage_ns = rn_clock_ns();
    if (ingest->stage != name) ingest->reported_ns = 0;
    ingest->stage = name;
    if (done < total || total == 0) post_progress(ingest, done, total);
}

static enum rn_status too_late(const struct ingest *ingest, struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_LIMIT, "import",
                        "takes longer than %lld s, the limit (--import-time of the daemon)",
                        (long long)ingest->order.max_seconds);
}

// A want of memory is the limit's doing, where there is one, and it can be raised.
static enum rn_status too_little_memory(const struct ingest *ingest, struct rn_error *err) {
    int64_t limit = rn_int_or(ingest->order.memory_limit_bytes, 0);
    char text[sizeof err->text], where[sizeof err->where];
    if (limit <= 0) return RN_ERROR_NO_MEMORY;
    snprintf(text, sizeof text, "%s", err->text);
    snprintf(where, sizeof where, "%s", err->where);
    return rn_error_set(err, RN_ERROR_LIMIT, where,
                        "%.300s; an import may take %lld MiB, start ripnerfd with a larger "
                        "--memory-limit",
                        text, (long long)(limit >> 20));
}

// Before a picture is decoded: how many are to be, and of how many pixels in all.
static enum rn_status check_size(const struct ingest *ingest, const struct rn_dataset *source,
                                 struct rn_error *err) {
    int64_t most_frames = rn_int_or(ingest->order.max_frames, 0);
    int64_t most_pixels = rn_int_or(ingest->order.max_pixels, 0);
    int64_t frames = (int64_t)source->frame_count, pixels = 0;
    for (size_t i = 0; i < source->frame_count; i++)
        pixels += (int64_t)source->frames[i].camera.width * source->frames[i].camera.height;
    if (most_frames > 0 && frames > most_frames)
        return rn_error_set(err, RN_ERROR_LIMIT, "dataset",
                            "names %lld frames; the limit is %lld (--max-frames of the daemon)",
                            (long long)frames, (long long)most_frames);
    if (most_pixels > 0 && pixels > most_pixels)
        return rn_error_set(err, RN_ERROR_LIMIT, "dataset",
                            "has %lld pixels in its frames; the limit is %lld (--max-pixels of "
                            "the daemon)",
                            (long long)pixels, (long long)most_pixels);
    return RN_OK;
}

static int is_visible(const struct dirent *entry) {
    return entry->d_name[0] != '.';
}

// A tar of a folder rather than of its contents: all is one level deeper.
static enum rn_status descend(struct ingest *ingest, struct rn_error *err) {
    struct dirent **entries;
    struct stat about;
    const char *work = ingest->order.work;
    int count = scandir(work, &entries, is_visible, NULL);
    if (count < 0) return rn_error_from_errno(err, errno, work, "list");
    if (count == 1) {
        snprintf(ingest->unpacked, sizeof ingest->unpacked, "%s/%s", work, entries[0]->d_name);
        if (stat(ingest->unpacked, &about) == 0 && S_ISDIR(about.st_mode))
            ingest->folder = ingest->unpacked;
    }
    while (count > 0)
        free(entries[--count]);
    free(entries);
    return RN_OK;
}

// A link of the folder, which is canonical. One that leads nowhere is a file that is missing.
static enum rn_status check_link(const char *folder, const char *link, struct rn_error *err) {
    char place[PATH_MAX];
    size_t size = strlen(folder);
    if (realpath(link, place) == NULL)
        return errno == ENOENT ? RN_OK : rn_error_from_errno(err, errno, link, "follow the link");
    if (strncmp(place, folder, size) == 0 && (place[size] == '/' || place[size] == '\0'))
        return RN_OK;
    return rn_error_set(err, RN_ERROR_INVALID, link + size + 1,
                        "the link leads out of the dataset's folder: put there what it leads to, "
                        "or upload the dataset");
}

// Who may name a folder may not read by it what lies elsewhere.
static enum rn_status check_links(const char *folder, struct rn_error *err) {
    char *const folders[] = {(char *)folder, NULL};
    enum rn_status status = RN_OK;
    FTSENT *entry = NULL;
    FTS *tree = fts_open(folders, FTS_PHYSICAL | FTS_NOCHDIR, NULL);
    if (tree == NULL) return rn_error_from_errno(err, errno, folder, "list");
    while (status == RN_OK && (errno = 0, entry = fts_read(tree)) != NULL) {
        if (entry->fts_info == FTS_SL || entry->fts_info == FTS_SLNONE)
            status = check_link(folder, entry->fts_path, err);
        else if (entry->fts_info == FTS_DNR || entry->fts_info == FTS_ERR)
            status = rn_error_from_errno(err, entry->fts_errno, entry->fts_path, "list");
    }
    if (status == RN_OK && errno != 0) status = rn_error_from_errno(err, errno, folder, "list");
    fts_close(tree);
    return status;
}

static enum rn_status find_source(struct ingest *ingest, struct rn_error *err) {
    struct stat about;
    const struct rn_wire_ingest *order = &ingest->order;
    if (stat(order->source, &about) < 0)
        return rn_error_from_errno(err, errno, order->source, "find the dataset");
    ingest->folder = order->source;
    if (S_ISDIR(about.st_mode)) return check_links(order->source, err);
    struct rn_unpack_limits limits = {.max_bytes = (size_t)order->max_bytes,
                                      .max_entries = (size_t)order->max_entries};
    enum rn_status status = rn_mkdir(order->work, 0777, err);
    if (!status) status = rn_unpack(order->source, order->work, &limits, keep_going, ingest, err);
    ingest->folder = order->work;
    return status ? status : descend(ingest, err);
}

static enum rn_status tree_bytes(const struct rn_dataset *dataset, int64_t *ret_bytes,
                                 struct rn_error *err) {
    int64_t bytes = 0;
    for (size_t i = 0; i < dataset->frame_count; i++) {
        struct stat about;
        if (stat(dataset->frames[i].path, &about) < 0)
            return rn_error_from_errno(err, errno, dataset->frames[i].path, "find");
        bytes += about.st_size;
    }
    *ret_bytes = bytes;
    return RN_OK;
}

static struct rn_import_options import_options_of(const struct rn_wire_ingest *order) {
    struct rn_import_options options = rn_ingest_keeping(&order->options);
    int threads = (int)rn_int_or(order->threads, 0);
    options.threads = threads ? threads : rn_usable_cores();
    return options;
}

static enum rn_status import(struct ingest *ingest, struct rn_dataset *source,
                             struct rn_problems *problems, char **ret_json, struct rn_error *err) {
    const struct rn_wire_ingest *order = &ingest->order;
    struct rn_import_options import_options = import_options_of(order);
    struct rn_findings found;
    ingest->began_stage_ns = rn_clock_ns(); // unpacking is over
    enum rn_status status = rn_mkdir(order->target, 0777, err);
    if (!status) status = rn_survey_create(source, &import_options.survey, err);
    if (!status)
        status = rn_dataset_import(source, order->name, &import_options, order->target, problems,
                                   on_progress, ingest, err);
    struct rn_dataset *made = NULL;
    int64_t bytes = 0;
    if (!status)
        status = rn_survey_conclude(import_options.survey, source, &import_options, problems,
                                    &found, err);
    rn_survey_destroy(&import_options.survey);
    if (!status && ingest->posed) status = rn_poses_keep(ingest->posed, order->target, err);
    if (!status) status = rn_manifest_write(order->target, err);
    if (!status) status = rn_dataset_read_whole(order->target, &made, err);
    if (!status) status = tree_bytes(made, &bytes, err);
    if (!status)
        status = rn_describe_dataset(made, bytes, source, ingest->folder, problems, &found,
                                     ret_json, err);
    if (made) rn_dataset_destroy(&made);
    return status;
}

// What was unpacked is told as its sender knows it: files by their names, the folder by none.
static void tell_as_unpacked(const struct ingest *ingest, char *text) {
    static const char called[] = "the folder";
    size_t size = strlen(ingest->folder), shown = strlen(called);
    rn_make_relative(text, ingest->folder);
    if (strcmp(ingest->folder, ingest->order.source) == 0) return;
    for (char *at = text; size >= shown && (at = strstr(at, ingest->folder)) != NULL; at += shown) {
        memmove(at + shown, at + size, strlen(at + size) + 1);
        memcpy(at, called, shown);
    }
}

static void tell_all_as_unpacked(const struct ingest *ingest, struct rn_problems *problems) {
    for (size_t i = 0; i < problems->count; i++) {
        tell_as_unpacked(ingest, problems->items[i].where);
        tell_as_unpacked(ingest, problems->items[i].text);
    }
}

// Reads what COLMAP made of the photographs.
static enum rn_status find_poses(struct ingest *ingest, struct rn_problems *problems,
                                 struct rn_dataset **ret_source, struct rn_error *err) {
    const struct rn_wire_ingest *order = &ingest->order;
    struct rn_poses_order wanted = {.source = ingest->folder,
                                    .masks = *order->options.masks ? order->options.masks : NULL,
                                    .work = order->work,
                                    .threads = (int)rn_int_or(order->threads, 0),
                                    .problems = problems,
                                    .keep_going = keep_going,
                                    .stage = on_stage,
                                    .context = ingest};
    struct rn_read_options options = rn_ingest_reading(&order->options);
    enum rn_status status = rn_mkdir(order->work, 0777, err);
    if (!status) status = rn_poses_find(&wanted, &ingest->posed, &ingest->photos, err);
    if (status) return status;
    tell_all_as_unpacked(ingest, problems);
    ingest->folder = ingest->posed;
    options.format = "colmap";
    options.taken = &ingest->photos;
    options.masks = NULL; // they lie where COLMAP looks for them
    on_stage(ingest, "importing", 0, 0);
    status = rn_dataset_read_as(ingest->posed, &options, problems, ret_source, err);
    if (!status) rn_poses_tell(&ingest->photos, *ret_source, problems);
    return status;
}

static enum rn_status read_source(struct ingest *ingest, struct rn_problems *problems,
                                  struct rn_dataset **ret_source, struct rn_error *err) {
    if (ingest->finds_poses) return find_poses(ingest, problems, ret_source, err);
    struct rn_read_options options = rn_ingest_reading(&ingest->order.options);
    return rn_dataset_read_as(ingest->folder, &options, problems, ret_source, err);
}

// What is said of a dataset calls it by the name it is given, not by that of the unpacked folder.
static enum rn_status rename_dataset(struct rn_dataset *dataset, const char *name,
                                     struct rn_error *err) {
    char *copy = strdup(name);
    if (!copy) return rn_error_set(err, RN_ERROR_NO_MEMORY, name, "out of memory");
    free(dataset->name);
    dataset->name = copy;
    return RN_OK;
}

static enum rn_status validate_photos(struct ingest *ingest, char **ret_json,
                                      struct rn_error *err) {
    struct rn_problems problems = {0};
    struct rn_read_options reading = rn_ingest_reading(&ingest->order.options);
    struct rn_import_options options = import_options_of(&ingest->order);
    enum rn_status status = find_source(ingest, err);
    if (!status)
        status = rn_describe_photos(ingest->folder, ingest->order.name, reading.masks,
                                    options.threads, &problems, ret_json, err);
    rn_problems_finish(&problems);
    return status;
}

static enum rn_status ingest_all(struct ingest *ingest, char **ret_json, struct rn_error *err) {
    struct rn_problems problems = {0};
    struct rn_dataset *source = NULL;
    post_progress(ingest, 0, 0);
    if (ingest->order.scene) return rn_scene_adopt(&ingest->order, ret_json, err);
    if (ingest->order.validate && ingest->order.options.poses == RN_POSES_FIND)
        return validate_photos(ingest, ret_json, err);
    enum rn_status status = find_source(ingest, err);
    if (!status) status = read_source(ingest, &problems, &source, err);
    tell_all_as_unpacked(ingest, &problems);
    if (!status) status = rename_dataset(source, ingest->order.name, err);
    if (!status) status = check_size(ingest, source, err);
    struct rn_import_options options = import_options_of(&ingest->order);
    if (!status && ingest->order.validate)
        status = rn_describe_validation(source, ingest->folder, &options, &problems, ret_json, err);
    else if (!status)
        status = import(ingest, source, &problems, ret_json, err);
    if (source) rn_dataset_destroy(&source);
    rn_problems_finish(&problems);
    rn_photos_finish(&ingest->photos);
    if (status == RN_ERROR_CANCELLED && ingest->late) status = too_late(ingest, err);
    if (status == RN_ERROR_NO_MEMORY) status = too_little_memory(ingest, err);
    return status;
}

static void remove_folder(const char *path) {
    struct rn_error err = {0};
    if (rn_remove_tree(path, &err)) rn_log(RN_LOG_WARN, "%s: %s", err.where, err.text);
}

// Where it was unpacked is nothing to its sender, who chose a folder, or an archive of one.
static void tell_as_sent(const struct ingest *ingest, struct rn_error *err) {
    const char *folder = ingest->folder;
    if (!folder) return;
    if (strcmp(err->where, folder) == 0 && strcmp(folder, ingest->order.source) != 0)
        snprintf(err->where, sizeof err->where, "the folder");
    tell_as_unpacked(ingest, err->where);
    tell_as_unpacked(ingest, err->text);
}

// The two folders to write are made beforehand.
static void confine(const struct ingest *ingest) {
    const struct rn_wire_ingest *order = &ingest->order;
    if (rn_mkdir(order->target, 0777, NULL) || rn_mkdir(order->work, 0777, NULL))
        rn_log(RN_LOG_WARN, "the import's folders cannot be made");
    const struct rn_sandbox_places places = {.paths = {[RN_PLACE_SOURCE] = order->source,
                                                       [RN_PLACE_TARGET] = order->target,
                                                       [RN_PLACE_WORK] = order->work},
                                             .memory_bytes =
                                                 rn_int_or(order->memory_limit_bytes, 0)};
    (void)rn_sandbox_confine(ingest->link.profile, &places); // it says so itself
}

static void carry_out(struct ingest *ingest) {
    struct rn_error err = {0};
    rn_link_log_of(&ingest->link, ingest->order.job);
    char *result = NULL;
    struct stat about;
    ingest->watch =
        (struct rn_watch){.link = &ingest->link, .job = ingest->order.job, .request = RN_ABSENT};
    ingest->began_ns = ingest->began_stage_ns = ingest->reported_ns = rn_clock_ns();
    bool target_is_ours = stat(ingest->order.target, &about) < 0;
    if (target_is_ours && ingest->link.profile) confine(ingest);
    enum rn_status status = target_is_ours
                                ? ingest_all(ingest, &result, &err)
                                : rn_error_set(&err, RN_ERROR_CONFLICT, ingest->order.target,
                                               "the folder exists already");
    remove_folder(ingest->order.work);
    if ((status || ingest->order.validate) && target_is_ours) remove_folder(ingest->order.target);
    if (status) {
        tell_as_sent(ingest, &err);
        rn_link_fail(&ingest->link, ingest->order.job, RN_ABSENT, &err);
        return;
    }
    rn_link_done(&ingest->link, ingest->order.job, result);
    free(result);
}

// Waits for the order; false when none came.
static bool take_order(struct ingest *ingest) {
    struct rn_letter letter;
    struct rn_error err = {0};
    while (!ingest->link.closed && !ingest->link.first)
        rn_link_pump(&ingest->link, -1);
    if (!rn_link_take(&ingest->link, &letter)) return false;
    bool good = letter.message.type == RN_WIRE_INGEST &&
                !rn_wire_take(&letter.message, &ingest->order, &err);
    if (!good && letter.message.type != RN_WIRE_SHUTDOWN)
        rn_log(RN_LOG_ERROR, "no import order: %s %s", err.where, err.text);
    rn_wire_message_finish(&letter.message);
    return good;
}

int rn_ingest_run(int fd, const char *mode, const struct rn_profile *profile) {
    struct ingest ingest = {.finds_poses = strcmp(mode, RN_MODE_POSES) == 0};
    rn_link_init(&ingest.link, fd);
    ingest.link.profile = profile;
    struct rn_wire_hello hello = {
        .version = RIPNERF_VERSION, .protocol = RN_WIRE_PROTOCOL, .pid = getpid()};
    snprintf(hello.mode, sizeof hello.mode, "%s", mode);
    rn_link_post(&ingest.link, RN_WIRE_HELLO, &hello, NULL, 0);
    bool ordered = take_order(&ingest);
    if (ordered) {
        carry_out(&ingest);
        rn_message_finish(rn_wire_table(RN_WIRE_INGEST), &ingest.order);
    }
    rn_link_finish(&ingest.link);
    free(ingest.posed);
    return ordered ? 0 : 1;
}

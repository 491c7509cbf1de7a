#include "server/runner/ingest/poses.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/sendfile.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/log.h"
#include "server/runner/ingest/cameras.h"
#include "server/runner/ingest/pairs.h"

#define FOLDER ".poses"
#define FEWEST 3             // photographs that can be placed
#define EXHAUSTIVE_PAIRS 500 // up to which all are matched: 32 photographs
#define FEATURE_S 1.4e-4     // CPU seconds a pair and feature, matched and verified (EPYC)
#define MATCHING_S 150.0     // CPU seconds for all pairs
#define FEATURES_FEWEST 1024.0
#define FEATURES_MOST 4096.0
#define FEATURES_SIDE "1600" // pixels, longest side of the pictures that features are found in
#define DOUBLED_BELOW 1100   // pixels of that side: smaller ones are looked at twice their size
#define NAMES_SHOWN 12
#define BLOCK "10" // photographs matched with as many between two lines of progress
#define COPY_PIECE (1 << 30)

struct search {
    const struct rn_poses_order *order;
    const char *stage;
    char folder[PATH_MAX];
    struct rn_photos *photos;
    char said[RN_PROGRAM_LAST_WORDS]; // of the mapper, why it began with nothing
    bool masked, exhaustive, placed;
    size_t pairs;
    int features; // a photograph, at most
    char took[128];
};

// ---- the photographs ----

static enum rn_status copy_file(const char *from, const char *to, struct rn_error *err) {
    int in = open(from, O_RDONLY | O_CLOEXEC);
    int out = in < 0 ? -1 : open(to, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    ssize_t size = -1;
    while (out >= 0 && (size = sendfile(out, in, NULL, COPY_PIECE)) > 0) {
    }
    int errnum = errno;
    if (in >= 0) close(in);
    if (out >= 0 && close(out) != 0 && size == 0) size = -1, errnum = errno;
    return size == 0 ? RN_OK : rn_error_from_errno(err, errnum, from, "copy");
}

// Files of ours are moved, others copied.
static enum rn_status take_file(const struct search *search, const char *from, const char *to,
                                struct rn_error *err) {
    size_t size = strlen(search->order->work);
    if (strncmp(from, search->order->work, size) == 0 && from[size] == '/' && rename(from, to) == 0)
        return RN_OK;
    return copy_file(from, to, err);
}

// What COLMAP reads as it is: PNG and JPEG of 8 bits that stand upright.
static bool is_plain(const struct rn_photo *photo) {
    const char *dot = strrchr(photo->name, '.');
    bool kind =
        dot && (!strcasecmp(dot, ".jpg") || !strcasecmp(dot, ".jpeg") || !strcasecmp(dot, ".png"));
    return kind && photo->info.bit_depth == 8 && photo->info.orientation == 1;
}

// A picture of any kind as an upright PNG.
static enum rn_status convert(const struct rn_photo *photo, const char *to, struct rn_error *err) {
    struct rn_image image;
    enum rn_status status = rn_image_read(photo->path, NULL, &image, err);
    if (status) return status;
    status = rn_image_turn(&image, photo->info.orientation, err);
    if (status == RN_OK) status = rn_image_write_png(&image, to, 1, err);
    rn_image_finish(&image);
    return status;
}

// "folder/inner/name", the folders above it made.
static enum rn_status place(const struct search *search, const char *inner, const char *name,
                            const char *ending, char path[PATH_MAX], struct rn_error *err) {
    int size = snprintf(path, PATH_MAX, "%s/%s/%s%s", search->folder, inner, name, ending);
    if (size < 0 || size >= PATH_MAX)
        return rn_error_set(err, RN_ERROR_INVALID, name, "is too long a name");
    char *slash = strrchr(path, '/');
    *slash = '\0';
    enum rn_status status = rn_mkdirs(path, 0777, err);
    *slash = '/';
    return status;
}

// Brings a photograph and its mask into the folder; COLMAP knows masks by NAME.jpg.png.
static enum rn_status bring(struct search *search, struct rn_photo *photo, struct rn_error *err) {
    char path[PATH_MAX];
    bool plain = is_plain(photo);
    enum rn_status status = place(search, "images", photo->name, plain ? "" : ".png", path, err);
    if (status == RN_OK)
        status = plain ? take_file(search, photo->path, path, err) : convert(photo, path, err);
    if (status == RN_OK && !plain) {
        char *name;
        if (asprintf(&name, "%s.png", photo->name) < 0)
            return rn_error_set(err, RN_ERROR_NO_MEMORY, photo->name, "out of memory");
        free(photo->name);
        photo->name = name;
    }
    if (status || !photo->mask_path) return status;
    search->masked = true;
    status = place(search, "masks", photo->name, ".png", path, err);
    return status ? status : take_file(search, photo->mask_path, path, err);
}

// A photograph that cannot be decoded is left out.
static enum rn_status bring_all(struct search *search, struct rn_error *err) {
    struct rn_photos *photos = search->photos;
    size_t kept = 0;
    enum rn_status status = RN_OK;
    for (size_t i = 0; i < photos->count; i++) {
        struct rn_photo photo = photos->items[i];
        struct rn_error fault;
        if (status == RN_OK && !search->order->keep_going(search->order->context))
            status = rn_error_set(err, RN_ERROR_CANCELLED, "import", "was told to end");
        enum rn_status of_this = status ? status : bring(search, &photo, &fault);
        if (of_this == RN_ERROR_INVALID || of_this == RN_ERROR_UNSUPPORTED) {
            rn_problems_add(search->order->problems, RN_SEVERITY_ERROR, fault.where, "%s",
                            fault.text);
            free(photo.name);
            free(photo.path);
            free(photo.mask_path);
            continue;
        }
        if (of_this && !status) {
            status = of_this;
            if (err) *err = fault;
        }
        photos->items[kept++] = photo;
        search->order->stage(search->order->context, "reading photographs", i + 1, photos->count);
    }
    photos->count = kept;
    return status;
}

// The frames of the film, as if they had been photographed.
static enum rn_status take_frames(struct search *search, struct rn_error *err) {
    char images[PATH_MAX + 16];
    struct rn_photos frames;
    snprintf(images, sizeof images, "%s/images", search->folder);
    enum rn_status status = rn_mkdirs(images, 0777, err);
    if (status == RN_OK) status = rn_film_frames(search->order, search->photos->film, images, err);
    if (status == RN_OK) status = rn_photos_read(search->folder, NULL, NULL, &frames, err);
    if (status == RN_ERROR_NOT_FOUND)
        return rn_error_set(err, RN_ERROR_INVALID, search->photos->film,
                            "ffmpeg takes none of its frames: convert it to MP4");
    if (status) return status;
    frames.film = search->photos->film;
    search->photos->film = NULL;
    rn_photos_finish(search->photos);
    *search->photos = frames;
    search->photos->in_order = true;
    search->photos->cameras = 1;
    return RN_OK;
}

// ---- COLMAP ----

static void read_line(void *context, const char *line) {
    struct search *search = context;
    const struct rn_poses_order *order = search->order;
    unsigned long done, total, of, rows;
    const char *at;
    fprintf(stderr, "%s\n", line);
    if (((at = strstr(line, "Processed file [")) != NULL &&
         sscanf(at, "Processed file [%lu/%lu]", &done, &total) == 2) ||
        ((at = strstr(line, "Matching image [")) != NULL &&
         sscanf(at, "Matching image [%lu/%lu]", &done, &total) == 2)) {
        order->stage(order->context, search->stage, done, total);
    } else if ((at = strstr(line, "Matching block [")) != NULL &&
               sscanf(at, "Matching block [%lu/%lu, %lu/%lu]", &done, &rows, &of, &total) == 4) {
        order->stage(order->context, search->stage, (done - 1) * total + of - 1, rows * total);
    } else if (at && sscanf(at, "Matching block [%lu/%lu]", &done, &total) == 2) {
        order->stage(order->context, search->stage, done - 1, total);
    } else if ((at = strstr(line, "Registering image #")) != NULL &&
               sscanf(at, "Registering image #%lu (%lu)", &of, &done) == 2) {
        order->stage(order->context, search->stage,
                     done < search->photos->count ? done : search->photos->count,
                     search->photos->count);
    } else if (strstr(line, "No good initial") || strstr(line, "Could not")) {
        snprintf(search->said, sizeof search->said, "%s", line + strspn(line, " =>"));
    }
}

static bool keep_searching(void *context) {
    struct search *search = context;
    return search->order->keep_going(search->order->context);
}

static enum rn_status run_colmap(struct search *search, const char *stage, const char *const *argv,
                                 struct rn_error *err) {
    struct rn_program colmap = {.name = "colmap",
                                .package = "--no-install-recommends colmap",
                                .line = read_line,
                                .keep_going = keep_searching,
                                .context = search};
    search->stage = stage;
    search->order->stage(search->order->context, stage, 0, 0);
    int64_t began = rn_clock_ns();
    enum rn_status status = rn_program_run(&colmap, argv, err);
    size_t used = strlen(search->took);
    snprintf(search->took + used, sizeof search->took - used, "%s%s %.0f s", used ? ", " : "",
             stage, (double)(rn_clock_ns() - began) * 1e-9);
    if (status == RN_ERROR_IO || status == RN_ERROR_INVALID) {
        struct rn_error inner = *err;
        return rn_error_set(err, inner.status, "colmap", "%s: %.400s", stage, inner.text);
    }
    return status;
}

// Which photographs are matched, and by how many features, so that it takes minutes.
static void choose_effort(struct search *search) {
    const struct rn_photos *photos = search->photos;
    size_t all = photos->count * (photos->count - 1) / 2;
    search->exhaustive = all <= EXHAUSTIVE_PAIRS;
    search->placed = rn_pairs_are_placed(photos);
    search->pairs = search->exhaustive ? all : rn_pairs_expected(photos, search->placed);
    double features = MATCHING_S / (FEATURE_S * (double)search->pairs);
    search->features = (int)fmin(fmax(features, FEATURES_FEWEST), FEATURES_MOST);
}

static int longest_side(const struct rn_photos *photos) {
    int longest = 0;
    for (size_t i = 0; i < photos->count; i++) {
        const struct rn_image_info *info = &photos->items[i].info;
        int side = info->width > info->height ? info->width : info->height;
        if (side > longest) longest = side;
    }
    return longest;
}

static enum rn_status extract(struct search *search, const char *database, const char *images,
                              const char *threads, struct rn_error *err) {
    const struct rn_photos *photos = search->photos;
    char masks[PATH_MAX + 8], features[16];
    const char *octave = longest_side(photos) < DOUBLED_BELOW ? "-1" : "0";
    snprintf(features, sizeof features, "%d", search->features);
    bool one = photos->cameras == 1, settled = one && photos->count >= RN_CAMERAS_SETTLED;
    snprintf(masks, sizeof masks, "%s/masks", search->folder);
    if (one)
        rn_problems_add(search->order->problems, RN_SEVERITY_INFO, "poses",
                        "%zu photographs, all of one size and, by EXIF, of one camera: one camera "
                        "of the kind %s",
                        photos->count, settled ? "OPENCV" : "SIMPLE_RADIAL");
    else
        rn_problems_add(search->order->problems, RN_SEVERITY_INFO, "poses",
                        "%zu photographs, by sizes and EXIF of %d cameras: of the kind OPENCV "
                        "where they took %d or more, else SIMPLE_RADIAL",
                        photos->count, photos->cameras, RN_CAMERAS_SETTLED);
    const char *const argv[] = {"feature_extractor",
                                "--database_path",
                                database,
                                "--image_path",
                                images,
                                "--ImageReader.single_camera",
                                one ? "1" : "0",
                                "--ImageReader.camera_model",
                                settled ? "OPENCV" : "SIMPLE_RADIAL",
                                "--SiftExtraction.use_gpu",
                                "0",
                                "--SiftExtraction.num_threads",
                                threads,
                                "--SiftExtraction.max_num_features",
                                features,
                                "--SiftExtraction.max_image_size",
                                FEATURES_SIDE,
                                "--SiftExtraction.first_octave",
                                octave,
                                search->masked ? "--ImageReader.mask_path" : NULL,
                                masks,
                                NULL};
    enum rn_status status = run_colmap(search, "finding features", argv, err);
    return status || one ? status : rn_cameras_share(photos, database, err);
}

// Writes the list of pairs.
static enum rn_status choose_pairs(struct search *search, const char *database, const char *list,
                                   struct rn_error *err) {
    search->order->stage(search->order->context, "choosing pairs", 0, 0);
    enum rn_status status = rn_pairs_choose(search->photos, search->placed, database, list,
                                            keep_searching, search, &search->pairs, err);
    if (status == RN_OK && search->pairs == 0)
        status = rn_error_set(err, RN_ERROR_INVALID, "colmap",
                              "found no poses: no two photographs have features in common; take "
                              "them again so that each shares two thirds of what it shows with "
                              "the next, with texture and little glare in view");
    return status;
}

static enum rn_status match(struct search *search, const char *database, const char *threads,
                            struct rn_error *err) {
    char list[PATH_MAX + 16];
    snprintf(list, sizeof list, "%s/pairs", search->folder);
    enum rn_status status = search->exhaustive ? RN_OK : choose_pairs(search, database, list, err);
    if (status) return status;
    rn_problems_add(search->order->problems, RN_SEVERITY_INFO, "poses",
                    "each photograph is matched with %s%s%s, %zu pairs, by about %d features each",
                    search->exhaustive ? "every other" : "those whose largest features match best",
                    search->exhaustive || !search->photos->in_order
                        ? ""
                        : " and, since names count upwards, with those near it",
                    search->exhaustive || !search->placed ? ""
                                                          : " and, by GPS, with those around it",
                    search->pairs, search->features);
    const char *const argv[] = {search->exhaustive ? "exhaustive_matcher" : "matches_importer",
                                "--database_path",
                                database,
                                "--SiftMatching.use_gpu",
                                "0",
                                "--SiftMatching.num_threads",
                                threads,
                                search->exhaustive ? "--ExhaustiveMatching.block_size"
                                                   : "--match_list_path",
                                search->exhaustive ? BLOCK : list,
                                NULL};
    if (search->exhaustive) return run_colmap(search, "matching", argv, err);
    status = rn_pairs_rename(search->photos, database, true, err);
    if (status == RN_OK) status = run_colmap(search, "matching", argv, err);
    if (status == RN_OK) status = rn_pairs_rename(search->photos, database, false, err);
    return status;
}

static enum rn_status map(struct search *search, const char *database, const char *images,
                          const char *threads, struct rn_error *err) {
    char sparse[PATH_MAX + 8], first[PATH_MAX + 32];
    snprintf(sparse, sizeof sparse, "%s/sparse", search->folder);
    snprintf(first, sizeof first, "%s/0/images.bin", sparse);
    // Photographs from the air overlap little, and by GPS it shows who was placed wrongly.
    const char *const argv[] = {
        "mapper", "--database_path",
        database, "--image_path",
        images,   "--output_path",
        sparse,   "--Mapper.num_threads",
        threads,  search->placed ? "--Mapper.abs_pose_min_num_inliers" : NULL,
        "15",     "--Mapper.abs_pose_min_inlier_ratio",
        "0.15",   NULL};
    struct rn_error failure = {.status = RN_OK};
    enum rn_status status = rn_mkdirs(sparse, 0777, &failure);
    if (status == RN_OK) status = run_colmap(search, "placing cameras", argv, &failure);
    if (status == RN_OK && access(first, F_OK) == 0) return RN_OK;
    if (status != RN_OK && status != RN_ERROR_INVALID) {
        if (err) *err = failure;
        return status;
    }
    if (status == RN_ERROR_INVALID && !search->said[0])
        snprintf(search->said, sizeof search->said, "%.*s", (int)sizeof search->said - 1,
                 failure.text);
    size_t size = strlen(search->said);
    if (size > 0 && search->said[size - 1] == '.') search->said[size - 1] = '\0';
    return rn_error_set(err, RN_ERROR_INVALID, "colmap",
                        "found no poses%s%s: take the photographs again so that each shares two "
                        "thirds of what it shows with the next, from a new place each time, with "
                        "texture and little glare in view",
                        search->said[0] ? "; it said: " : "", search->said);
}

static enum rn_status run_stages(struct search *search, struct rn_error *err) {
    char database[PATH_MAX + 16], images[PATH_MAX + 16], threads[16];
    int count = search->order->threads;
    snprintf(database, sizeof database, "%s/database.db", search->folder);
    snprintf(images, sizeof images, "%s/images", search->folder);
    snprintf(threads, sizeof threads, "%d", count > 0 ? count : -1);
    choose_effort(search);
    enum rn_status status = extract(search, database, images, threads, err);
    if (status == RN_OK) status = match(search, database, threads, err);
    if (status == RN_OK) status = map(search, database, images, threads, err);
    if (status == RN_OK)
        rn_problems_add(search->order->problems, RN_SEVERITY_INFO, "poses", "COLMAP took %s",
                        search->took);
    return status;
}

enum rn_status rn_poses_find(const struct rn_poses_order *order, char **ret_folder,
                             struct rn_photos *ret_photos, struct rn_error *err) {
    struct rn_photos photos;
    struct search search = {.order = order, .photos = &photos};
    snprintf(search.folder, sizeof search.folder, "%s/" FOLDER, order->work);
    enum rn_status status =
        rn_photos_read(order->source, order->masks, order->problems, &photos, err);
    if (status) return status;
    status = photos.film ? take_frames(&search, err) : bring_all(&search, err);
    if (status == RN_OK && photos.count < FEWEST)
        status = rn_error_set(err, RN_ERROR_INVALID, order->source,
                              "holds %zu usable photographs; poses are found for %d at least",
                              photos.count, FEWEST);
    if (status == RN_OK) status = run_stages(&search, err);
    char *folder = status ? NULL : strdup(search.folder);
    if (status == RN_OK && !folder)
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, order->source, "out of memory");
    if (status) {
        rn_photos_finish(&photos);
        return status;
    }
    *ret_folder = folder;
    *ret_photos = photos;
    return RN_OK;
}

// ---- what became of the photographs ----

static bool is_placed(const struct rn_photo *photo, const struct rn_dataset *dataset) {
    for (size_t i = 0; i < dataset->frame_count; i++)
        if (rn_photo_is_at(photo, dataset->frames[i].path)) return true;
    return false;
}

void rn_poses_tell(const struct rn_photos *photos, const struct rn_dataset *dataset,
                   struct rn_problems *problems) {
    char names[256] = "";
    size_t lost = 0, used = 0;
    for (size_t i = 0; i < photos->count; i++) {
        if (is_placed(&photos->items[i], dataset)) continue;
        if (lost++ < NAMES_SHOWN && used < sizeof names)
            used += (size_t)snprintf(names + used, sizeof names - used, "%s%s",
                                     lost > 1 ? ", " : "", photos->items[i].name);
    }
    rn_problems_add(problems, lost ? RN_SEVERITY_WARNING : RN_SEVERITY_INFO, "poses",
                    "COLMAP found poses for %zu of %zu photographs%s%.240s%s", photos->count - lost,
                    photos->count, lost ? "; none for " : "", names,
                    lost ? ": photograph again between these and their neighbours, in smaller "
                           "steps"
                         : "");
}

#include "common/dataset/photos.h"

#include <dirent.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/dataset/output.h"
#include "common/dataset/reader.h"

#define MAX_DEPTH 8
#define SAME_STEP 3 // names count upwards where half of them follow within so many numbers

static const char *const films[] = {".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", NULL};

// Pictures that are not read.
static const char *const others[] = {".bmp", ".gif", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf",
                                     ".orf", ".rw2", ".jxl", ".jp2", ".psd", ".tga", NULL};

static bool has_extension(const char *name, const char *const *extensions) {
    const char *dot = strrchr(name, '.');
    for (size_t i = 0; dot && extensions[i]; i++)
        if (strcasecmp(dot, extensions[i]) == 0) return true;
    return false;
}

bool rn_is_film(const char *name) {
    return has_extension(name, films);
}

bool rn_photo_is_at(const struct rn_photo *photo, const char *path) {
    size_t size = strlen(photo->name), length = strlen(path);
    return length > size && path[length - size - 1] == '/' &&
           strcmp(path + length - size, photo->name) == 0;
}

static void finish_photo(struct rn_photo *photo) {
    free(photo->name);
    free(photo->path);
    free(photo->mask_path);
}

void rn_photos_finish(struct rn_photos *photos) {
    for (size_t i = 0; i < photos->count; i++)
        finish_photo(&photos->items[i]);
    free(photos->items);
    free(photos->film);
    *photos = (struct rn_photos){0};
}

// What a walk through folders gathers.
struct walk {
    const char *root, *masks;
    struct rn_problems *problems;
    struct rn_photos photos;
    size_t capacity;
    int film_count;
    size_t unread; // pictures of kinds that are not read
    char first_unread[128];
};

static enum rn_status no_memory(const struct walk *walk, struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_NO_MEMORY, walk->root, "out of memory");
}

static enum rn_status add_photo(struct walk *walk, const char *path, struct rn_error *err) {
    struct rn_photos *photos = &walk->photos;
    struct rn_error fault;
    struct rn_photo photo = {.mask_path = NULL};
    enum rn_status status = rn_image_probe(path, &rn_image_default_limits, &photo.info, &fault);
    if (status == RN_ERROR_NO_MEMORY) return no_memory(walk, err);
    if (status) {
        rn_problems_add(walk->problems, RN_SEVERITY_ERROR, fault.where, "%s", fault.text);
        return RN_OK;
    }
    if (photos->count == RN_PHOTOS_MAX)
        return rn_error_set(err, RN_ERROR_LIMIT, walk->root, "holds more than %d photographs",
                            RN_PHOTOS_MAX);
    if (photos->count == walk->capacity) {
        size_t capacity = walk->capacity ? 2 * walk->capacity : 64;
        struct rn_photo *items = realloc(photos->items, capacity * sizeof *items);
        if (!items) return no_memory(walk, err);
        photos->items = items;
        walk->capacity = capacity;
    }
    photo.path = strdup(path);
    photo.name = strdup(path + strlen(walk->root) + 1);
    photos->items[photos->count++] = photo;
    return photo.path && photo.name ? RN_OK : no_memory(walk, err);
}

static enum rn_status look_at(struct walk *walk, const char *path, int depth, struct rn_error *err);

static int is_visible(const struct dirent *entry) {
    return entry->d_name[0] != '.';
}

static enum rn_status look_through(struct walk *walk, const char *folder, int depth,
                                   struct rn_error *err) {
    struct dirent **entries;
    enum rn_status status = RN_OK;
    int count = scandir(folder, &entries, is_visible, alphasort);
    if (count < 0) return rn_error_from_errno(err, errno, folder, "list the folder");
    for (int i = 0; i < count; i++) {
        char *path = NULL;
        if (status == RN_OK && asprintf(&path, "%s/%s", folder, entries[i]->d_name) < 0)
            status = no_memory(walk, err);
        else if (status == RN_OK)
            status = look_at(walk, path, depth, err);
        free(path);
        free(entries[i]);
    }
    free(entries);
    return status;
}

static enum rn_status look_at(struct walk *walk, const char *path, int depth,
                              struct rn_error *err) {
    struct stat about;
    const char *name = strrchr(path, '/') + 1;
    if (rn_reader_is_photo(name) && rn_reader_leads_nowhere(path))
        rn_problems_add(walk->problems, RN_SEVERITY_ERROR, path, RN_LEADS_NOWHERE);
    if (stat(path, &about) != 0) return RN_OK;
    if (S_ISDIR(about.st_mode)) {
        const char *below = path + strlen(walk->root) + 1;
        bool other = strcmp(below, walk->masks) == 0 || strcmp(below, RN_PHOTOS_LOOKS) == 0;
        return other || depth == MAX_DEPTH ? RN_OK : look_through(walk, path, depth + 1, err);
    }
    if (!S_ISREG(about.st_mode)) return RN_OK;
    if (rn_reader_is_photo(name)) return add_photo(walk, path, err);
    if (has_extension(name, others) && !walk->unread++)
        snprintf(walk->first_unread, sizeof walk->first_unread, "%s", name);
    if (!rn_is_film(name)) return RN_OK;
    walk->film_count++;
    free(walk->photos.film);
    walk->photos.film = strdup(path);
    return walk->photos.film ? RN_OK : no_memory(walk, err);
}

// "a2" before "a10".
static int compare_photos(const void *a, const void *b) {
    return strverscmp(((const struct rn_photo *)a)->name, ((const struct rn_photo *)b)->name);
}

// The last number in a name; -1 without one.
static long last_number(const char *name) {
    size_t end = strlen(name);
    while (end > 0 && (name[end - 1] < '0' || name[end - 1] > '9'))
        end--;
    size_t begin = end;
    while (begin > 0 && end - begin < 9 && name[begin - 1] >= '0' && name[begin - 1] <= '9')
        begin--;
    return begin < end ? strtol(name + begin, NULL, 10) : -1;
}

static bool is_alike(const struct rn_image_info *a, const struct rn_image_info *b) {
    bool turned = (a->orientation >= 5) != (b->orientation >= 5);
    return a->camera_key == b->camera_key && a->width == (turned ? b->height : b->width) &&
           a->height == (turned ? b->width : b->height);
}

static void tell_cameras_apart(struct rn_photos *photos) {
    struct rn_photo *items = photos->items;
    bool all_alike = true;
    for (size_t i = 1; i < photos->count && all_alike; i++)
        all_alike = is_alike(&items[i].info, &items[0].info);
    photos->cameras = 0;
    for (size_t i = 0; i < photos->count; i++) {
        size_t same = items[i].info.camera_key || all_alike ? 0 : i;
        while (!is_alike(&items[same].info, &items[i].info))
            same++;
        items[i].camera = same < i ? items[same].camera : photos->cameras++;
    }
}

static void judge(struct rn_photos *photos) {
    size_t steps = 0;
    tell_cameras_apart(photos);
    for (size_t i = 1; i < photos->count; i++) {
        long before = last_number(photos->items[i - 1].name);
        long now = last_number(photos->items[i].name);
        steps += before >= 0 && now > before && now <= before + SAME_STEP;
    }
    photos->in_order = photos->count > 1 && 2 * steps >= photos->count;
}

// The photographs' folder within `path`.
static enum rn_status find_folder(const char *path, char **ret_folder, struct rn_error *err) {
    struct dirent **entries;
    char *images = NULL;
    if (asprintf(&images, "%s/%s", path, rn_photo_folders[0]) < 0)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, path, "out of memory");
    int count = scandir(images, &entries, is_visible, NULL);
    bool has_photo = false;
    for (int i = 0; i < count; i++) {
        has_photo = has_photo || rn_reader_is_photo(entries[i]->d_name);
        free(entries[i]);
    }
    if (count >= 0) free(entries);
    if (!has_photo) {
        free(images);
        images = strdup(path);
    }
    *ret_folder = images;
    return images ? RN_OK : rn_error_set(err, RN_ERROR_NO_MEMORY, path, "out of memory");
}

// Masks belong to the photographs as they stand upright. One whose mask does not fit is left out.
static void look_for_masks(struct walk *walk, const char *path) {
    struct rn_reader reader = {.folder = path};
    size_t found = 0, kept = 0;
    for (size_t i = 0; i < walk->photos.count; i++) {
        struct rn_photo photo = walk->photos.items[i];
        struct rn_error fault;
        bool lies = photo.info.orientation >= 5;
        photo.mask_path = rn_reader_find_mask(&reader, walk->masks, photo.name);
        found += photo.mask_path != NULL;
        if (photo.mask_path &&
            rn_mask_check(photo.mask_path, photo.path, lies ? photo.info.height : photo.info.width,
                          lies ? photo.info.width : photo.info.height, &fault) != RN_OK) {
            rn_problems_add(walk->problems, RN_SEVERITY_ERROR, fault.where, "%s", fault.text);
            finish_photo(&photo);
            continue;
        }
        walk->photos.items[kept++] = photo;
    }
    walk->photos.count = kept;
    if (found)
        rn_problems_add(walk->problems, RN_SEVERITY_INFO, path,
                        "%zu photographs have masks, whose black pixels are left out", found);
}

// Where photographs lie in a folder of their own, those beside it.
static enum rn_status count_beside(const char *path, const char *root, size_t *ret_count,
                                   struct rn_error *err) {
    struct dirent **entries;
    int count = strcmp(path, root) == 0 ? 0 : scandir(path, &entries, is_visible, NULL);
    if (count < 0) return rn_error_from_errno(err, errno, path, "list the folder");
    *ret_count = 0;
    for (int i = 0; i < count; i++) {
        *ret_count += rn_reader_is_photo(entries[i]->d_name);
        free(entries[i]);
    }
    if (strcmp(path, root) != 0) free(entries);
    return RN_OK;
}

static enum rn_status tell_left_out(const struct walk *walk, const char *path,
                                    struct rn_error *err) {
    size_t beside = 0;
    enum rn_status status = count_beside(path, walk->root, &beside, err);
    if (beside)
        rn_problems_add(walk->problems, RN_SEVERITY_WARNING, path,
                        "has photographs outside of its folder %s too, %zu, which are left out: "
                        "put them there as well, or give a folder without it",
                        rn_photo_folders[0], beside);
    if (walk->unread)
        rn_problems_add(walk->problems, RN_SEVERITY_WARNING, walk->root,
                        "has %zu pictures of kinds that are not read, the first %s; they are left "
                        "out: save them as PNG, JPEG or TIFF",
                        walk->unread, walk->first_unread);
    return status;
}

static enum rn_status gather(struct walk *walk, const char *path, struct rn_error *err) {
    enum rn_status status = look_through(walk, walk->root, 0, err);
    if (status) return status;
    if (!walk->photos.count && walk->film_count == 1) return RN_OK;
    if (!walk->photos.count && walk->unread)
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, path,
                            "holds no photograph that is read, but %zu of other kinds, the first "
                            "%s: save them as PNG, JPEG or TIFF",
                            walk->unread, walk->first_unread);
    if (!walk->photos.count)
        return rn_error_set(err, RN_ERROR_NOT_FOUND, path,
                            walk->film_count ? "holds several films: give one of them"
                                             : "holds no photograph and no film");
    free(walk->photos.film);
    walk->photos.film = NULL;
    qsort(walk->photos.items, walk->photos.count, sizeof *walk->photos.items, compare_photos);
    judge(&walk->photos);
    look_for_masks(walk, path);
    return tell_left_out(walk, path, err);
}

enum rn_status rn_photos_read(const char *path, const char *masks, struct rn_problems *problems,
                              struct rn_photos *ret_photos, struct rn_error *err) {
    struct stat about;
    char *folder;
    if (stat(path, &about) != 0) return rn_error_from_errno(err, errno, path, "find");
    if (!S_ISDIR(about.st_mode)) {
        if (!rn_is_film(path))
            return rn_error_set(err, RN_ERROR_INVALID, path, "is neither a folder nor a film");
        *ret_photos = (struct rn_photos){.film = strdup(path)};
        return ret_photos->film ? RN_OK
                                : rn_error_set(err, RN_ERROR_NO_MEMORY, path, "out of memory");
    }
    enum rn_status status = find_folder(path, &folder, err);
    if (status) return status;
    struct walk walk = {
        .root = folder, .masks = masks ? masks : RN_MASK_FOLDER, .problems = problems};
    status = gather(&walk, path, err);
    free(folder);
    if (status == RN_OK)
        *ret_photos = walk.photos;
    else
        rn_photos_finish(&walk.photos);
    return status;
}

void rn_photos_tell(const struct rn_photos *photos, const char *path,
                    struct rn_problems *problems) {
    if (photos->film) {
        rn_problems_add(problems, RN_SEVERITY_INFO, photos->film,
                        "is a film: import takes its sharpest frames and looks for their poses "
                        "with COLMAP");
        return;
    }
    const struct rn_image_info *first = &photos->items[0].info;
    rn_problems_add(problems, RN_SEVERITY_INFO, path,
                    "%zu photographs without poses, the first of %dx%d pixels, %s: import looks "
                    "for their poses with COLMAP",
                    photos->count, first->width, first->height,
                    photos->cameras == 1 ? "all of one camera as far as sizes and EXIF say"
                                         : "of several sizes or, by EXIF, cameras");
}

// ---- whether they can be decoded, and what they look like ----

// Upright, as decoding leaves it, in no place.
static struct rn_frame frame_of(const struct rn_photo *photo, int index) {
    struct rn_frame frame = {.name = strdup(photo->name),
                             .path = strdup(photo->path),
                             .split = RN_SPLIT_TRAIN,
                             .index = index,
                             .photo = index,
                             .has_alpha = photo->info.has_alpha,
                             .held = photo->info.orientation,
                             .turn = photo->info.orientation,
                             .camera_key = photo->info.camera_key,
                             .camera = {.width = photo->info.width, .height = photo->info.height}};
    for (int i = 0; i < 3; i++)
        frame.camera.world_from_camera[i][i] = 1;
    return frame;
}

enum rn_status rn_photos_frames(const struct rn_photos *photos, const char *name,
                                struct rn_dataset **ret_frames, struct rn_error *err) {
    struct rn_dataset *made = calloc(1, sizeof *made);
    bool whole = made && (made->name = strdup(name)) &&
                 (made->frames = calloc(photos->count + 1, sizeof *made->frames));
    for (size_t i = 0; whole && i < photos->count; i++) {
        struct rn_frame *frame = &made->frames[made->frame_count++];
        *frame = frame_of(&photos->items[i], (int)i);
        whole = frame->name && frame->path;
    }
    if (!whole) {
        rn_dataset_destroy(&made);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, name, "out of memory");
    }
    made->scale_count = 1;
    made->view_count[RN_SPLIT_TRAIN] = (int)photos->count;
    *ret_frames = made;
    return RN_OK;
}

struct decoding {
    const struct rn_photos *photos;
    const struct rn_dataset *frames;
    struct rn_survey *survey;
    struct rn_error *faults; // of each; status RN_OK where none
};

static enum rn_status decode(void *context, size_t index, struct rn_error *err) {
    const struct decoding *decoding = context;
    struct rn_error *fault = &decoding->faults[index];
    struct rn_image image;
    enum rn_status status =
        rn_image_read(decoding->photos->items[index].path, &rn_image_default_limits, &image, fault);
    if (status == RN_OK) {
        rn_survey_look(decoding->survey, &decoding->frames->frames[index], &image, false);
        rn_image_finish(&image);
    }
    if (status == RN_ERROR_NO_MEMORY) *err = *fault;
    return status == RN_ERROR_NO_MEMORY ? status : RN_OK;
}

static void leave_out(struct rn_photos *photos, const struct rn_error *faults,
                      struct rn_problems *problems) {
    size_t kept = 0;
    for (size_t i = 0; i < photos->count; i++) {
        if (faults[i].status == RN_OK) {
            photos->items[kept++] = photos->items[i];
            continue;
        }
        rn_problems_add(problems, RN_SEVERITY_ERROR, faults[i].where, "%s", faults[i].text);
        finish_photo(&photos->items[i]);
    }
    photos->count = kept;
}

enum rn_status rn_photos_check(struct rn_photos *photos, const char *name, int threads,
                               struct rn_problems *problems,
                               bool (*progress)(void *context, size_t done, size_t total),
                               void *context, struct rn_findings *ret_findings,
                               struct rn_error *err) {
    struct rn_dataset *frames = NULL;
    struct rn_survey *survey = NULL;
    struct rn_error *faults = calloc(photos->count + 1, sizeof *faults);
    enum rn_status status =
        faults ? RN_OK : rn_error_set(err, RN_ERROR_NO_MEMORY, name, "out of memory");
    if (!status) status = rn_photos_frames(photos, name, &frames, err);
    if (!status) status = rn_survey_create(frames, &survey, err);
    struct decoding decoding = {photos, frames, survey, faults};
    if (!status)
        status = rn_output_run(threads, photos->count, decode, &decoding, progress, context,
                               "photographs", err);
    if (!status) leave_out(photos, faults, problems);
    if (!status) status = rn_survey_conclude_photos(survey, frames, problems, ret_findings, err);
    rn_survey_destroy(&survey);
    rn_dataset_destroy(&frames);
    free(faults);
    return status;
}

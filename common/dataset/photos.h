// Photographs without poses: which a folder holds, before a program looks for their poses.
#ifndef RN_COMMON_DATASET_PHOTOS_H
#define RN_COMMON_DATASET_PHOTOS_H

#include "common/dataset/survey.h"

struct rn_photo {
    char *name; // relative to the photographs' folder, with slashes
    char *path;
    char *mask_path; // NULL without one
    struct rn_image_info info;
    int camera; // its number; those of one number were taken by one camera, as far as sizes, as the
                // pictures stand upright, and EXIF say
};

// Thread-safety: immutable once read. Owner: whoever read it; rn_photos_finish.
struct rn_photos {
    struct rn_photo *items; // by name, as numbers count: a2 before a10
    size_t count;
    char *film;    // instead of photographs; NULL: none
    int cameras;   // how many took them, at most: who says nothing of its camera has its own,
                   // where sizes or cameras differ
    bool in_order; // names count upwards, as a camera names what it takes one after the other
};
#define RN_PHOTOS_MAX 20000
#define RN_PHOTOS_LOOKS                                                                            \
    "ripnerf-looks" // a folder of small pictures of them, which are none of them

// Looks through `path`: a folder of photographs (those in its folder "images", where that has some,
// else all below it but masks), a folder of one film, or a film. `masks` as of rn_read_options.
// Files that are no pictures, and photographs whose mask is of another size, are left out, each
// with an error in `problems` (optional). RN_ERROR_NOT_FOUND where there is neither;
// RN_ERROR_LIMIT, RN_ERROR_NO_MEMORY.
enum rn_status rn_photos_read(const char *path, const char *masks, struct rn_problems *problems,
                              struct rn_photos *ret_photos, struct rn_error *err) RN_MUST_CHECK;
void rn_photos_finish(struct rn_photos *photos);
// How many there are, of what size and by how many cameras, into `problems`.
void rn_photos_tell(const struct rn_photos *photos, const char *path, struct rn_problems *problems);
// For a survey (rn_survey_conclude_photos): training views without poses, as they are decoded. It
// has no format and is not to be trained on. rn_dataset_destroy. RN_ERROR_NO_MEMORY.
enum rn_status rn_photos_frames(const struct rn_photos *photos, const char *name,
                                struct rn_dataset **ret_frames, struct rn_error *err) RN_MUST_CHECK;
// Decodes all of them and judges them by a survey, into `problems`; those that are damaged are left
// out, each with an error there. `progress` as of rn_dataset_check_images. RN_ERROR_NO_MEMORY,
// RN_ERROR_CANCELLED.
enum rn_status rn_photos_check(struct rn_photos *photos, const char *name, int threads,
                               struct rn_problems *problems,
                               bool (*progress)(void *context, size_t done, size_t total),
                               void *context, struct rn_findings *ret_findings,
                               struct rn_error *err) RN_MUST_CHECK;

// Whether `path` is that of the photograph, in whatever folder.
bool rn_photo_is_at(const struct rn_photo *photo, const char *path);

// Whether a file of this name is a film, by its extension.
bool rn_is_film(const char *name);

#endif

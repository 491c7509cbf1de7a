// Camera paths of other programs: one row a format. Whatever asks which there are reads this table.
#ifndef RN_COMMON_PATH_FORMATS_FORMATS_H
#define RN_COMMON_PATH_FORMATS_FORMATS_H

#include <jansson.h>
#include <stdbool.h>
#include <stddef.h>

#include "common/base/status.h"
#include "common/path/path.h"

// Where a file's coordinates lie beside the dataset's: p_file = scale * (transform * p_dataset),
// rotations by the transform alone.
struct rn_path_space {
    double scale;
    double transform[3][4]; // a rotation and a translation
};
extern const struct rn_path_space rn_path_space_same;

// What a file may leave open, and what it cannot say. 0 and NULL: as the file says, or a default.
struct rn_path_choices {
    int width, height;                 // of the frames, pixels
    double fps;                        // frames a second
    double seconds;                    // between keys without times (1)
    double fov_y_deg;                  // of cameras without one
    const struct rn_path_space *space; // of the file's coordinates
};

// The text of a file, and of the one beside it that some formats have (COLMAP's cameras.txt).
struct rn_path_text {
    const char *text, *beside; // `beside` may be NULL
    size_t size, beside_size;  // bytes
    const char *where;         // names the file in errors
    json_t *root;              // NULL where the text is no JSON
};

struct rn_path_format {
    const char *name, *title; // "colmap", "COLMAP"
    const char *file;         // what such a file is called
    const char *beside;       // the name of the file beside it; NULL: none
    bool needs_space;         // its coordinates are those of one training: the space must be given
    struct rn_path_space usual; // where needs_space is not set, and none is given
    bool (*recognise)(const struct rn_path_text *in);
    enum rn_status (*read)(const struct rn_path_text *in, const struct rn_path_choices *choices,
                           struct rn_path *path, struct rn_error *err);
    // malloc'd texts; *ret_beside stays NULL where there is none.
    enum rn_status (*write)(const struct rn_path *path, const struct rn_path_space *space,
                            char **ret_text, char **ret_beside, struct rn_error *err);
};

// NULL ends.
extern const struct rn_path_format *const rn_path_formats[];
const struct rn_path_format *rn_path_format_find(const char *name);
// "ripnerf, nerfstudio, ...", with ", " between them.
void rn_path_format_names(const char *between, char *text, size_t capacity);

// A path in a file's text; `format` NULL: recognised by the file's signs. *ret_format (may be NULL)
// says which it was. RN_ERROR_INVALID names the place and what is wrong with it; RN_ERROR_LIMIT:
// more keys than a path may have; RN_ERROR_UNSUPPORTED: coordinates that only their training knows,
// without `choices->space`.
enum rn_status rn_path_import(struct rn_path_text *in, const struct rn_path_format *format,
                              const struct rn_path_choices *choices, struct rn_path **ret_path,
                              const struct rn_path_format **ret_format,
                              struct rn_error *err) RN_MUST_CHECK;
// Which format a file's text is of; as rn_path_import says.
enum rn_status rn_path_recognise(struct rn_path_text *in, const struct rn_path_format **ret_format,
                                 struct rn_error *err) RN_MUST_CHECK;
// The other way; `space` NULL: the format's usual one, else the dataset's own coordinates.
enum rn_status rn_path_export(const struct rn_path *path, const struct rn_path_format *format,
                              const struct rn_path_space *space, char **ret_text, char **ret_beside,
                              struct rn_error *err) RN_MUST_CHECK;
// nerfstudio's dataparser_transforms.json: {"transform": 3x4, "scale"}.
enum rn_status rn_path_space_read(const char *text, size_t size, const char *where,
                                  struct rn_path_space *ret_space,
                                  struct rn_error *err) RN_MUST_CHECK;
// Corrects a format's space by the dataset's own transforms.json: nerfstudio's applied_transform
// and applied_scale, instant-ngp's scale and offset. RN_ERROR_UNSUPPORTED: the format has neither.
enum rn_status rn_path_space_of_dataset(const struct rn_path_format *format, const char *text,
                                        size_t size, const char *where, struct rn_path_space *space,
                                        struct rn_error *err) RN_MUST_CHECK;
// Where a format's coordinates lie by what was said of that: `space`, the text of such a
// dataparser_transforms.json or the word dataset, and `dataset`, that of the dataset's own
// transforms.json (of each, text NULL: not given). *ret_given is false where neither is, and
// *ret_space the format's usual one.
enum rn_status rn_path_space_find(const struct rn_path_format *format,
                                  const struct rn_path_text *space,
                                  const struct rn_path_text *dataset,
                                  struct rn_path_space *ret_space, bool *ret_given,
                                  struct rn_error *err) RN_MUST_CHECK;
// The object within {"path": ...} as text, malloc'd.
enum rn_status rn_path_object_text(const struct rn_path *path, char **ret_json,
                                   struct rn_error *err) RN_MUST_CHECK;

#endif

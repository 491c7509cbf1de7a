// A COLMAP model's files, binary or text, record by record: a model of any size is streamed.
// Internal to common/dataset. Layouts: COLMAP's src/colmap/scene/reconstruction_io; little endian.
#ifndef RN_COMMON_DATASET_COLMAP_FILES_H
#define RN_COMMON_DATASET_COLMAP_FILES_H

#include <stdint.h>
#include <stdio.h>

#include "common/dataset/reader.h"

#define RN_COLMAP_PARAMETERS 16
#define RN_COLMAP_NO_POINT UINT64_MAX

struct rn_colmap_camera {
    uint32_t id;
    int model; // rn_colmap_models, or -1: not known
    char model_name[40];
    uint64_t width, height;
    double parameters[RN_COLMAP_PARAMETERS];
};

// World-to-camera: a Hamilton quaternion w x y z, and a translation.
struct rn_colmap_image {
    uint32_t id, camera;
    double rotation[4], translation[3];
    char name[RN_FILE_NAME_MAX];
};

struct rn_colmap_point {
    uint64_t id;
    double position[3], error;
    uint8_t colour[3];
};

// A model's parameters by name, and the lens that they make; `lens` is RN_LENS_COUNT where it is
// not known here.
struct rn_colmap_model {
    int id, count;
    const char *name;
    enum rn_lens lens;
    const char *parameters[RN_COLMAP_PARAMETERS];
};
extern const struct rn_colmap_model rn_colmap_models[];

#define RN_COLMAP_NOT_SAID UINT64_MAX
// One open file. Thread-safety: one thread. Finish it in any case, also one that was not opened.
struct rn_colmap_file {
    struct rn_reader *reader;
    FILE *file;
    char *path; // owned
    bool text;
    uint64_t count; // of records; of text as its comments say, RN_COLMAP_NOT_SAID without
    uint64_t next;  // record that is read next
    uint64_t size;  // bytes
    char *line;     // of text, owned
    size_t capacity;
    uint64_t number; // of the line
};

// Opens folder/kind.bin or, without it, folder/kind.txt, which becomes a document of the dataset.
// RN_ERROR_NOT_FOUND names the missing file.
enum rn_status rn_colmap_open(struct rn_reader *reader, const char *folder, const char *kind,
                              struct rn_colmap_file *ret_file, struct rn_error *err) RN_MUST_CHECK;
void rn_colmap_close(struct rn_colmap_file *file);
// "path, record 3 of 8" or "path:12": where the record that was read last stands.
void rn_colmap_where(const struct rn_colmap_file *file, char where[256]);

// The next record; *ret_more is false at the end. RN_ERROR_INVALID for a file that ends early or
// holds what it should not. A text with fewer records than its comments say is told.
enum rn_status rn_colmap_next_camera(struct rn_colmap_file *file, struct rn_colmap_camera *camera,
                                     bool *ret_more, struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_colmap_next_point(struct rn_colmap_file *file, struct rn_colmap_point *point,
                                    bool *ret_more, struct rn_error *err) RN_MUST_CHECK;
// `see` (may be NULL) is called with each keypoint that belongs to a point: pixels from the corner.
typedef enum rn_status (*rn_colmap_see)(void *context, const struct rn_colmap_image *image,
                                        double x, double y, uint64_t point, struct rn_error *err);
enum rn_status rn_colmap_next_image(struct rn_colmap_file *file, struct rn_colmap_image *image,
                                    rn_colmap_see see, void *context, bool *ret_more,
                                    struct rn_error *err) RN_MUST_CHECK;

// The intrinsics and the lens of a model's camera. RN_ERROR_INVALID for a lens that is not known.
enum rn_status rn_colmap_take_lens(const struct rn_colmap_camera *from, const char *where,
                                   struct rn_camera *camera, struct rn_error *err) RN_MUST_CHECK;

#endif

// What the readers of all layouts share. Internal to common/dataset.
#ifndef RN_COMMON_DATASET_READER_H
#define RN_COMMON_DATASET_READER_H

#include "common/dataset/dataset.h"
#include "common/dataset/json.h"

#define RN_DATASET_MAX_FRAMES 1000000
#define RN_DATASET_MAX_SCALE 12
#define RN_BLENDER_SPHERE 1.5 // radius of the NeRF-synthetic scenes, about the origin
#define RN_FILE_NAME_MAX 1024
#define RN_PHOTO_FOLDERS 4
#define RN_NATIVE_DOCUMENT "dataset.json"
#define RN_NATIVE_FORMAT "ripnerf-dataset"
#define RN_NATIVE_VERSION 1

// A dataset being filled. Thread-safety: one thread. Owner: rn_dataset_read.
struct rn_reader {
    const char *folder;
    const struct rn_read_options *options;
    struct rn_problems *problems; // may be NULL
    struct rn_dataset *dataset;
    size_t capacity;       // of dataset->frames
    json_t *reported;      // what was told once: unknown fields, and rn_reader_says
    bool missing_is_usual; // a photograph that is not there is no fault of the dataset
    bool dynamic_masks;    // dynamic_mask_NAME.png beside a photograph is its mask
    struct rn_error missing, last_missing; // the first and the last photograph that is not there
    size_t missing_count;
    struct rn_error fault; // what was told last: of the whole file, it is told once
    double resized;        // widths by those that the source says; NAN: not all alike; 0: none yet
    bool told_moved;       // that files named elsewhere were found by their ends
};

// A format's `read` appends frames in any order. A bad document is an error, a bad frame a problem.

// "folder/name", malloc'd; NULL when memory is out.
char *rn_reader_path(const struct rn_reader *reader, const char *name);
// The same of a document, which is kept as read from. RN_ERROR_NO_MEMORY.
enum rn_status rn_reader_document(struct rn_reader *reader, const char *name, char **ret_path,
                                  struct rn_error *err) RN_MUST_CHECK;
// Parses a JSON document and hands its root to `read`; `context` is the caller's. Also
// rn_json_parse_file's statuses.
typedef enum rn_status (*rn_reader_root)(struct rn_reader *reader, const struct rn_json *root,
                                         void *context, struct rn_error *err);
enum rn_status rn_reader_json(struct rn_reader *reader, const char *name, bool comments,
                              rn_reader_root read, void *context,
                              struct rn_error *err) RN_MUST_CHECK;

// Whether a link stands there whose file does not.
bool rn_reader_leads_nowhere(const char *path);
#define RN_LEADS_NOWHERE "the link there leads nowhere; put there what it led to"

// Where photographs lie in captures whose documents do not say: full size first.
extern const char *const rn_photo_folders[RN_PHOTO_FOLDERS + 1];
// Whether a file of this name is a photograph, by its extension.
bool rn_reader_is_photo(const char *name);
// The photograph that a document calls `named`, with `extension` appended unless it is "" or the
// name has an image's: fills name (without folder and extension), path, has_alpha and the camera's
// width and height from the header. A path that is not there, or leaves the folder, as one of
// another machine does, is looked for by its end. On failure nothing is owned by *frame, and
// `where` is where the name stands.
#define RN_ANY_EXTENSION "*" // one by which the file is there
enum rn_status rn_reader_photo(struct rn_reader *reader, const char *where, const char *named,
                               const char *extension, struct rn_frame *frame,
                               struct rn_error *err) RN_MUST_CHECK;
// Whether the folder has a file of this name.
bool rn_reader_has(const struct rn_reader *reader, const char *file);
// The file, relative to the folder, that the string member `key` of `object` names; it need not be
// there. As rn_reader_photo for paths that leave the folder.
enum rn_status rn_reader_locate(struct rn_reader *reader, const struct rn_json *object,
                                const char *key, char file[RN_FILE_NAME_MAX],
                                struct rn_error *err) RN_MUST_CHECK;
// The image that the string member `key` of `object` names, as rn_reader_photo.
enum rn_status rn_reader_image(struct rn_reader *reader, const struct rn_json *object,
                               const char *key, const char *extension, struct rn_frame *frame,
                               struct rn_error *err) RN_MUST_CHECK;

// A 4x4 camera-to-world matrix in OpenGL axes; last row 0 0 0 1.
enum rn_status rn_reader_pose(const struct rn_json *object, const char *key, double pose[3][4],
                              struct rn_error *err) RN_MUST_CHECK;
// rn_camera_check with the error placed at member `key`.
enum rn_status rn_reader_check_camera(const struct rn_json *object, const char *key,
                                      struct rn_camera *camera, struct rn_error *err) RN_MUST_CHECK;

// Ends one frame: appends it (taking its name and path) when `status` is RN_OK; else frees them and
// records `err` as a problem. Fails only when memory is out or there are too many frames.
enum rn_status rn_reader_add(struct rn_reader *reader, struct rn_frame *frame,
                             enum rn_status status, struct rn_error *err) RN_MUST_CHECK;

// Tells of all photographs that are not there at once.
void rn_reader_tell_missing(struct rn_reader *reader);
// Frames of full size by photograph, malloc'd, NULL where one has none; NULL when memory is out.
const struct rn_frame **rn_frames_by_photo(const struct rn_dataset *dataset, size_t *ret_count);
// Leaves out test and validation views of photographs that are trained on too, and tells of them.
enum rn_status rn_reader_leave_out_shared(struct rn_reader *reader,
                                          struct rn_error *err) RN_MUST_CHECK;
// Tells how the points meet the photographs.
void rn_reader_tell_reprojection(struct rn_reader *reader);
// Tells how photographs were taken and how they lie, with the evidence.
void rn_reader_tell_place(struct rn_reader *reader, const struct rn_scene_place *place);
// Reads the folder in another format as well and tells, with both values, what differs most.
void rn_reader_compare(struct rn_reader *reader, const struct rn_format *format);
// The mask, in a folder relative to the dataset's, of the photograph `name`, relative to its own;
// malloc'd, NULL without one.
#define RN_MASK_FOLDER "masks"
char *rn_reader_find_mask(const struct rn_reader *reader, const char *folder, const char *name);
// Whether the mask is a picture of the photograph's width and height. RN_ERROR_INVALID and those of
// rn_image_probe name the mask.
enum rn_status rn_mask_check(const char *mask, const char *photo, int width, int height,
                             struct rn_error *err) RN_MUST_CHECK;
// Gives photographs the masks that lie in a folder, relative to the dataset's (NULL: "masks"), and
// takes those out whose mask is damaged or of another size, each with its problem. RN_ERROR_INVALID
// when a folder is given that has no mask.
enum rn_status rn_reader_find_masks(struct rn_reader *reader, const char *folder,
                                    struct rn_error *err) RN_MUST_CHECK;
// Scales the camera's focal lengths and principal point, which are those of width x height pixels,
// to the image's size, which is told once. RN_ERROR_INVALID for an image of another shape.
enum rn_status rn_reader_fit(struct rn_reader *reader, const char *where, double width,
                             double height, struct rn_frame *frame,
                             struct rn_error *err) RN_MUST_CHECK;
// True the first time it is asked of `what`: so that what recurs is told once.
bool rn_reader_says(struct rn_reader *reader, const char *what);
// Warns once for each member of a foreign file's object that is not among the NULL-terminated
// `known`.
void rn_reader_warn_unknown(struct rn_reader *reader, const struct rn_json *object,
                            const char *const *known);

// Of the cameras' mean distance from what they look at: the radius of a sphere that they look at,
// and of one that holds them and what is behind.
#define RN_OBJECT_DISTANCES 0.5
#define RN_CAPTURE_DISTANCES 1.5
// Alpha channels that are opaque everywhere, by some photographs, cut nothing out: they are told
// and taken for none.
void rn_reader_settle_alpha(struct rn_reader *reader);
// Whether black bars lie along an edge of all photographs (rn_dataset_cut_bars).
bool rn_dataset_has_bars(const struct rn_dataset *dataset);
// Where photographs without masks, bars and alpha stand on one colour, by eight of them, it is cut
// off when they are decoded, unless it is to be kept: either is told.
void rn_reader_settle_backdrop(struct rn_reader *reader);
// Makes transparent what is of the colour, to 4 of 255, from the edges on, and partly so the pixels
// beside it: over the colour the image stays what it was, to 4 and the rounding. RN_ERROR_NO_MEMORY
// leaves it as it is.
enum rn_status rn_backdrop_cut(const uint8_t colour[3], struct rn_image *image,
                               struct rn_error *err) RN_MUST_CHECK;
// How near the point, dataset units, the rays through all but little of what alpha channels cut out
// pass; NAN where they cut out nothing that can be decoded.
double rn_outline_reach(const struct rn_dataset *dataset, const double point[3]);
// Whether a ray, whose direction is unit, meets the sphere.
bool rn_bounds_met(const struct rn_bounds *bounds, const double origin[3],
                   const double direction[3]);
// Share of the training photographs' pixels, of 16 x 16 in each, whose rays meet the sphere.
double rn_bounds_seen(const struct rn_dataset *dataset, const struct rn_bounds *bounds);
// Whether the camera's optical axis (forwards) meets the sphere.
bool rn_camera_looks_at(const struct rn_camera *camera, const struct rn_bounds *bounds);

// Sorts the frames and counts views and scales. RN_ERROR_INVALID for two frames of the same split,
// index and scale, or when no training view is left.
enum rn_status rn_dataset_seal(struct rn_dataset *dataset, const char *where,
                               const struct rn_problems *problems,
                               struct rn_error *err) RN_MUST_CHECK;
void rn_frame_finish(struct rn_frame *frame);
// Decodes a frame's image, which must have the size that its header had when it was read, and shows
// it to the survey (optional). A mask that cannot be read is a fault of the frame.
struct rn_survey;
enum rn_status rn_frame_decode(const struct rn_frame *frame, struct rn_survey *survey,
                               struct rn_image *ret_image, struct rn_error *err) RN_MUST_CHECK;

#endif

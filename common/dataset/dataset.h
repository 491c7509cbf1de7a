// Posed photographs: one structure, whatever the files' layout was.
//
// Readers, one file a format (formats.h), fill a struct rn_dataset. No pixel is decoded here: only
// image headers are read.
#ifndef RN_COMMON_DATASET_DATASET_H
#define RN_COMMON_DATASET_DATASET_H

#include <stddef.h>

#include "common/base/status.h"
#include "common/dataset/formats.h"
#include "common/image/image.h"
#include "common/math/camera.h"

enum rn_split { RN_SPLIT_TRAIN, RN_SPLIT_VAL, RN_SPLIT_TEST, RN_SPLIT_COUNT };
extern const char *const rn_split_names[];      // "train", "val", "test"
const char *rn_split_name(enum rn_split split); // "?" of what is none

// One colour that photographs stand on all around.
struct rn_backdrop {
    bool known;  // false: there is none, or it is kept as a part of the scene
    bool to_cut; // the file still shows it; else it is transparent there
    uint8_t colour[3];
};

// One image file. A view photographed once and kept at several scales has one frame a scale.
struct rn_frame {
    char *name;      // e.g. "r_12": the JSON's file name without folder and extension
    char *path;      // absolute or relative to the working directory; readable
    char *mask_path; // a picture of the same size whose black pixels are left out of the loss; NULL
                     // where there is none
    enum rn_split split;
    int index;            // zero-based among the views of its split, in the JSON's order; views
                          // that were left out leave a gap
    int scale;            // 0 = full size, j = downsampled 2^j times
    double loss_weight;   // area weight of a pixel's loss: 4^scale (1 on single-scale data)
    bool has_alpha;       // by the file's header, or since a backdrop is cut off when it is decoded
    int held;             // how the camera was held, by the file's EXIF: 1 upright, to 8
    uint32_t camera_key;  // of struct rn_image_info: which camera it was; 0: not said
    bool located;         // the file's EXIF says where it was taken
    double located_at[3]; // of struct rn_image_info
    int turn;    // the EXIF orientation that is undone when the file is decoded; 0 and 1: none
    int bars[4]; // pixels that are cut off then, at the left, top, right and bottom: `camera` is
                 // of what is left
    struct rn_backdrop backdrop; // the same for all of a dataset's
    double gain[3];   // how bright its stored values are against the other photographs', by
                      // channel; 0: not measured
    double light;     // by how much points look brighter or darker in it than in the photograph
                      // whose camera looks most nearly the same way, their exposures left out:
                      // median of the logarithms; 0: not measured
    int photo;        // which photograph it is of, for struct rn_sighting
    double near, far; // along the optical axis, dataset units, as the source gives or its points
                      // say; 0: not known
    struct rn_camera camera;
};

// A point of the sparse model that poses were found with.
struct rn_point {
    double position[3]; // dataset units
    float error;        // reprojection error in pixels, as its source says; below 0: not said
    uint8_t colour[3];
};
// A photograph sees a point there.
struct rn_sighting {
    uint32_t point, photo; // of struct rn_points; of struct rn_frame
    float x, y;            // from the top-left corner, shares of the width and the height
};
// Points beyond RN_POINTS_MAX and sightings beyond RN_SIGHTINGS_MAX are thinned out evenly.
#define RN_POINTS_MAX 1000000
#define RN_SIGHTINGS_MAX 8000000
struct rn_points {
    struct rn_point *items;
    size_t count;
    struct rn_sighting *sightings; // in no order
    size_t sighting_count;
    bool found; // by the import, with the poses as they are, of which they say nothing
};

// DEPTHS: near and far of each photograph, as the source gives them. OUTLINES: of what alpha
// channels cut out, about the layout's centre. Checkpoints hold the numbers.
enum rn_bounds_source {
    RN_BOUNDS_GIVEN,
    RN_BOUNDS_LAYOUT,
    RN_BOUNDS_CAMERAS,
    RN_BOUNDS_POINTS,
    RN_BOUNDS_DEPTHS,
    RN_BOUNDS_OUTLINES,
    RN_BOUNDS_SOURCES
};
extern const char *const rn_bounds_source_names[];  // "given", "layout", ..., NULL
extern const char *const rn_bounds_source_titles[]; // for people: "as given", "by its layout", ...

#define RN_BOUNDS_LEAST 1e-9 // of a radius
#define RN_BOUNDS_MOST 1e9

// The sphere that holds the scene, dataset units.
struct rn_bounds {
    double centre[3];
    double radius; // > 0
    enum rn_bounds_source source;
};

// How photographs were taken: around an object; one way, at a wall; from within a room; around
// something that stands in its surroundings; down, from the air.
enum rn_capture_kind {
    RN_CAPTURE_OBJECT,
    RN_CAPTURE_FORWARD,
    RN_CAPTURE_ROOM,
    RN_CAPTURE_OUTDOOR,
    RN_CAPTURE_DRONE,
    RN_CAPTURE_KINDS
};
extern const char *const rn_capture_names[];  // "object", "forward-facing", ..., NULL
extern const char *const rn_capture_titles[]; // for people: "an object, turned around", ..., NULL

struct rn_box {
    double low[3], high[3]; // dataset units
};

// How the scene lies. With the bounds it is the similarity from the dataset's coordinates, in which
// all else stays, to a ball of radius 1 with z up.
struct rn_lie {
    enum rn_capture_kind kind;
    double up[3]; // unit
    bool up_given, cropped;
    struct rn_box crop; // what matters, where `cropped`
    bool known;         // an import has found it out
};

// Thread-safety: immutable once read. Owner: whoever read it; rn_dataset_destroy.
struct rn_dataset {
    char *name;
    const struct rn_format *format;
    char **documents; // what was read beside images, relative to the folder; document_count of them
    size_t document_count;
    struct rn_frame *frames; // ordered by split, index, scale
    size_t frame_count;
    int view_count[RN_SPLIT_COUNT]; // usable views (not frames) per split
    int unusable[RN_SPLIT_COUNT];   // images that were left out, each with its problem
    int scale_count;                // frames per view
    struct rn_bounds bounds;
    struct rn_lie lie;
    struct rn_points points;   // none: count is 0
    bool premultiplied_scales; // false: made by the legacy (straight, truncating) converter
};

// Problems found on the way, each with file and field: what `validate` prints.
enum rn_severity { RN_SEVERITY_INFO, RN_SEVERITY_WARNING, RN_SEVERITY_ERROR };
struct rn_problem {
    enum rn_severity severity;
    char where[256];
    char text[512];
};
// Bounded list; further problems are only counted. Zero-initialise; rn_problems_finish frees.
struct rn_problems {
    struct rn_problem *items;
    size_t count, capacity, dropped;
    size_t errors, warnings; // of all, dropped ones included
};
void rn_problems_add(struct rn_problems *problems, enum rn_severity severity, const char *where,
                     const char *fmt, ...) RN_PRINTF(4, 5);
void rn_problems_finish(struct rn_problems *problems);

// Reads a dataset folder in the first of the formats whose signs it bears (formats.h has them);
// another that it bears as well is told. Frames with a bad pose or file name, or whose image is
// missing, unreadable or of another size than the document says, are left out, each with an error
// in `problems` (optional) that names file and field. RN_ERROR_NOT_FOUND without any sign;
// RN_ERROR_INVALID when a document itself is bad or no training view is usable; RN_ERROR_LIMIT,
// RN_ERROR_NO_MEMORY.
enum rn_status rn_dataset_read(const char *folder, struct rn_problems *problems,
                               struct rn_dataset **ret_dataset, struct rn_error *err) RN_MUST_CHECK;
struct rn_photos;
// As rn_dataset_read, with what the caller knows better; NULL options: nothing. RN_ERROR_INVALID
// for a format of no such name.
struct rn_read_options {
    const char *format; // the name of the format to read as; NULL: by signs
    const char *masks; // a folder of masks, relative to the dataset's; NULL: "masks" if it is there
    struct rn_bounds
        bounds; // radius > 0: the sphere that is asked for, and nothing is said of others
    bool up_given, cropped;
    double up[3];       // of any length above 0
    struct rn_box crop; // only points in it say where the scene is, and it lies in the bounds
    bool keep_backdrop; // one that photographs stand on is a part of the scene
    // The photographs as they were taken, by the same names: what their EXIF said holds for copies
    // that lost it. NULL: none.
    const struct rn_photos *taken;
};
enum rn_status rn_dataset_read_as(const char *folder, const struct rn_read_options *options,
                                  struct rn_problems *problems, struct rn_dataset **ret_dataset,
                                  struct rn_error *err) RN_MUST_CHECK;
// A dataset that was imported, and is whole: a view that is left out now could not be read, for
// want of memory, say, and is RN_ERROR_IO.
enum rn_status rn_dataset_read_whole(const char *folder, struct rn_dataset **ret_dataset,
                                     struct rn_error *err) RN_MUST_CHECK;
void rn_dataset_destroy(struct rn_dataset **dataset);

// From the cameras alone: about the point nearest to all optical axes, `distances` times the mean
// distance wide.
struct rn_bounds rn_bounds_from_cameras(const struct rn_dataset *dataset, double distances);

// What a mask leaves out of a frame: 0 into `used`, a byte a pixel, where it is black, else 1.
// RN_ERROR_CORRUPT for a mask of another size, rn_image_read's statuses.
enum rn_status rn_mask_read(const struct rn_frame *frame, uint8_t *used,
                            struct rn_error *err) RN_MUST_CHECK;

// Where black bars lie along an edge of all photographs, by eight of them, they are cut off: of
// cameras, of where points are seen, and when files are decoded; `problems` (optional) are told.
// Photographs with masks, alpha channels or of several sizes keep theirs.
void rn_dataset_cut_bars(struct rn_dataset *dataset, struct rn_problems *problems);

struct rn_survey;
// Decodes every image, `threads` at a time, and leaves out those that cannot be decoded whole,
// each with an error in `problems` (optional), as rn_dataset_read does with what headers tell.
// `survey` (optional) looks at each. `progress` as rn_dataset_import's. RN_ERROR_INVALID when no
// training view is left (the frames are gone then); RN_ERROR_CANCELLED and RN_ERROR_NO_MEMORY leave
// the dataset as it was.
enum rn_status rn_dataset_check_images(struct rn_dataset *dataset, int threads,
                                       struct rn_problems *problems, struct rn_survey *survey,
                                       bool (*progress)(void *context, size_t done, size_t total),
                                       void *context, struct rn_error *err) RN_MUST_CHECK;

// First frame of (split, index, scale) or NULL. O(log n).
const struct rn_frame *rn_dataset_frame(const struct rn_dataset *dataset, enum rn_split split,
                                        int index, int scale);
// Where to begin to look: the first test view, else the first, as large as it is. NULL: no view.
const struct rn_frame *rn_dataset_start(const struct rn_dataset *dataset);
// Resolves "test:12" (zero-based index) or "test:r_12" (name) at a scale. RN_ERROR_INVALID for
// another form, RN_ERROR_NOT_FOUND, RN_ERROR_CONFLICT when several views bear the name.
enum rn_status rn_dataset_find_view(const struct rn_dataset *dataset, const char *view, int scale,
                                    const struct rn_frame **ret_frame,
                                    struct rn_error *err) RN_MUST_CHECK;

// What `validate` reports beside the problems.
struct rn_dataset_report {
    int usable[RN_SPLIT_COUNT], unusable[RN_SPLIT_COUNT]; // images
    int scale_count;
    double footprint_min, footprint_max; // pixel cone radius at the bounds' centre, dataset units
    double camera_distance_min, camera_distance_max; // to the bounds' centre
    double looking_at_bounds;                        // share of cameras whose axis meets the sphere
    int with_alpha;                                  // images whose header has alpha
    int width_min, width_max, height_min, height_max;
};
void rn_dataset_describe(const struct rn_dataset *dataset, struct rn_dataset_report *ret_report);

// How well the sparse points meet the photographs that saw them, through the cameras as they are
// read. RN_ERROR_NO_MEMORY.
struct rn_reprojection {
    size_t points, sightings; // that took part
    size_t unseen;            // sightings in a direction that the camera does not see
    double mean_px;           // mean over points of their mean distance, pixels of the photographs
    double median_px;         // of those means
    double p95_px;            // which 95 % of them stay below
    double said_px;           // mean_px as the source says; below 0: it does not
};
enum rn_status rn_dataset_reproject(const struct rn_dataset *dataset,
                                    struct rn_reprojection *ret_found,
                                    struct rn_error *err) RN_MUST_CHECK;
// The same of each of `count` of the dataset's frames: the mean over what it sees, pixels; NAN
// where it sees none of the points. RN_ERROR_NO_MEMORY.
enum rn_status rn_dataset_reproject_photos(const struct rn_dataset *dataset,
                                           const struct rn_frame *const *frames, size_t count,
                                           double *ret_px) RN_MUST_CHECK;

// Where on Earth the cameras stood, by GPS.
struct rn_located {
    size_t count;  // of frames that it is known by; 0: GPS does not say, or not well enough
    size_t of;     // that it says a place of
    double up[3];  // unit
    double metres; // a dataset unit
    double off_m;  // root mean square of how far GPS is from where the cameras stand, as fitted
};
// The similarity from the cameras' places to those that GPS gave (Horn 1987), without those that it
// got wrong. Not known where fewer than half agree or GPS is off by more than a tenth of the
// cameras' second longest spread. RN_ERROR_NO_MEMORY.
enum rn_status rn_dataset_locate(const struct rn_dataset *dataset, struct rn_located *ret_located,
                                 struct rn_error *err) RN_MUST_CHECK;
// Metres east, north and up of `from`, by the curvature of the ellipsoid there (WGS 84): places
// near each other, degrees north and east and metres up.
void rn_located_metres(const double of[3], const double from[3], double ret_metres[3]);

// Where the scene is, and the evidence of it.
struct rn_scene_place {
    struct rn_lie lie;
    struct rn_located located;
    bool up_located; // `up` is by GPS, since the cameras' says another
    struct rn_bounds bounds;
    double turned_around[3]; // the point nearest to all optical axes
    double distance;         // median of the cameras' distances from it
    double miss;             // by which half of the axes pass it at most, parts of the distance
    double alignment;        // length of the mean view direction: 1 where all look the same way
    double below_deg;        // median of the axes' angles below the horizon
    double tilt_deg;         // by which half of the cameras are held askew at most, against `up`
    bool cut_out;            // by an alpha channel
    bool by_points;          // there are sparse points
    size_t witnesses; // sparse points, or points at the depths that the source gives, looked at
    double beyond;    // share of them farther from that point than the cameras; NAN: too few
};
// By GPS, cameras, axes, sparse points or depths (robust quantiles), within dataset->lie.crop and
// with dataset->lie.up where those are given. RN_ERROR_NO_MEMORY.
enum rn_status rn_dataset_find_place(const struct rn_dataset *dataset,
                                     struct rn_scene_place *ret_place,
                                     struct rn_error *err) RN_MUST_CHECK;

// Fills in near and far of all frames where none has any, all cameras look one way and sightings
// say what is seen. RN_ERROR_NO_MEMORY.
enum rn_status rn_dataset_find_depths(struct rn_dataset *dataset,
                                      struct rn_error *err) RN_MUST_CHECK;
// That all photographs have an alpha channel.
bool rn_dataset_is_cut_out(const struct rn_dataset *dataset);

extern const char *const rn_downscale_names[]; // "premultiplied", "straight"

// Import: decode, scale and write a native dataset (dataset.json and images/) into the empty
// folder `target`, dataset.json last and atomically. At most `threads` source images are in memory
// at once, and where points are looked for (triangulate.h) small copies of 1,000 at most that are
// trained on and as many that are not, 240 KB each as a rule, 480 KB at most. An image that cannot
// be decoded is left out, of `source` too (counted there as unusable), with an error in `problems`
// (optional); RN_ERROR_INVALID when that leaves no training view. `progress` may be NULL; it is
// called by worker threads, one at a time; returning false from it cancels (RN_ERROR_CANCELLED).
// Level j of a view is downscaled from its full-size (after max_size) image to round(size / 2^j)
// and weighs 4^j; in straight mode the levels are rn_image_legacy_pyramid's.
struct rn_import_options {
    int max_size;                // longest side in pixels, 0 = as is
    int scales;                  // >= 1: how many scales to make; 1 keeps the dataset's own
    enum rn_downscale downscale; // premultiplied or the legacy straight mode
    int test_every;              // > 0: when there is no test split, every n-th training view
    int threads;                 // >= 1
    struct rn_survey *survey;    // looks at each image; NULL: none
};
// The options as they hold for this dataset: one that names its test views is not split again, of
// which `problems` are told.
struct rn_import_options rn_import_settle(const struct rn_dataset *source,
                                          const struct rn_import_options *options,
                                          struct rn_problems *problems);
// Split, index, scale, weight and camera of a view as it is kept at a level, by options that are
// settled; it borrows nothing and has no files.
struct rn_frame rn_import_place(const struct rn_frame *view,
                                const struct rn_import_options *options, int level);
enum rn_status rn_dataset_import(struct rn_dataset *source, const char *name,
                                 const struct rn_import_options *options, const char *target,
                                 struct rn_problems *problems,
                                 bool (*progress)(void *context, size_t done, size_t total),
                                 void *context, struct rn_error *err) RN_MUST_CHECK;

// Procedural scenes with known truth: analytic intersection, many samples a pixel. "sphere",
// "fence", "nested" and "still-life" are objects, cut out by alpha; "place" (around in a room) and
// "window" (one way, out of it) are two captures of a place without bounds, photographs without
// alpha. Writes the NeRF-synthetic layout: transforms_{train,val,test}.json, PNGs, and the test
// views' depth as rn_synth_depth's float32 in test/r_N_depth.npy; or, as a `capture`, COLMAP's, of
// whose photographs every 8th from the first is as a test view, with sparse points that are right.
// The target is new or empty, else RN_ERROR_CONFLICT; of what fails or is cancelled nothing is
// left.
#define RN_SYNTH_LENS 4
#define RN_SYNTH_MOVERS 8
struct rn_synth_options {
    int size;                   // image side, pixels
    int views;                  // training views; validation and test get max(8, views / 4) each
    int threads;                // >= 1
    int samples;                // per pixel, a square number; 0 = 64
    double lens[RN_SYNTH_LENS]; // k1 k2 p1 p2 of every camera's lens (RN_LENS_OPENCV); 0: none
    // How photographs are taken, but for the test views:
    double exposure; // each up to so many stops lighter or darker, 0 .. 4
    double aperture; // the lens's radius, dataset units, sharp where the camera looks at, 0 .. 1
    double shutter;  // so far a camera moves while it looks, dataset units, 0 .. 1
    int movers;      // who stand somewhere else in each, 0 .. RN_SYNTH_MOVERS
    bool capture;
};
enum rn_status rn_synthesise(const char *scene, const struct rn_synth_options *options,
                             const char *target,
                             bool (*progress)(void *context, size_t done, size_t total),
                             void *context, struct rn_error *err) RN_MUST_CHECK;
// The truth at any camera. Used by tests and benches. Colour: straight-alpha rgba, the mean of
// `samples` rays a pixel. Depth: one channel, the distance along the ray through each pixel's
// centre in dataset units, INFINITY where it meets nothing but sky.
enum rn_status rn_synth_render(const char *scene, const struct rn_camera *camera, int samples,
                               struct rn_picture *ret_rgba, struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_synth_depth(const char *scene, const struct rn_camera *camera,
                              struct rn_picture *ret_depth, struct rn_error *err) RN_MUST_CHECK;

#endif

// A device other than the CPU, behind one table of functions. The engine loads the module
// ripnerf-cuda.so, asks it for the table, and keeps everything else: configuration, pixels,
// schedule, checkpoints, pictures. C ABI; plain data crosses it.
//
// One thread calls into a backend. After RN_ERROR_UNAVAILABLE the device cannot be used again in
// this process: the runner ends, and its job goes on from the last checkpoint in a new one.
#ifndef RN_ENGINE_KERNELS_BACKEND_H
#define RN_ENGINE_KERNELS_BACKEND_H

#include "common/math/camera.h"
#include "server/engine/kernels/draw.h"
#include "server/engine/kernels/kernels.h"

#define RN_BACKEND_VERSION 15
#define RN_BACKEND_SYMBOL "rn_backend_table"

struct rn_backend_device; // owner: rn_backend.open's caller
struct rn_device_field;   // parameters, pyramid, occupancy on the device

struct rn_device_about {
    char name[128];      // "NVIDIA H200"
    char kernels[32];    // "sm_90"
    size_t memory_bytes; // of the device
};

// The cells that a picture's rays march through (scene/occupancy.h): finer ones of a field at rest,
// and of these the firm ones; or those of training, also where there are no others.
#define RN_DEVICE_FINER 2
enum rn_device_cells { RN_CELLS_FINE, RN_CELLS_FIRM, RN_CELLS_OF_TRAINING };

// Pixels of cameras, each by cones x cones rays that are averaged (kernels/pixel.h).
#define RN_DEVICE_CAMERAS 32
struct rn_device_view {
    const struct rn_camera *cameras; // at most RN_DEVICE_CAMERAS, all of one size
    int camera_count;
    int cones; // a side of a pixel, at most RN_CONES_MOST
    enum rn_device_cells cells;
    bool halves; // colour and opacity as fp16 has them and no depth: 8 bytes on the way, not 20
};
// Which pixels: number y * width + x of the first camera's, the next one's behind them. `numbers`
// NULL: `count` from `first` on.
struct rn_device_places {
    const uint32_t *numbers;
    uint32_t first;
    size_t count;
};

// What a field on the device is made from. The arrays are the CPU field's, copied.
struct rn_device_scene {
    struct rn_train_config config;
    double centre[3], radius; // of the scene's ball, dataset units
    struct rn_disparity disparity;
    struct rn_solid solid;
    struct rn_mlp_shape base_shape, head_shape;
    int levels;             // of the pyramids
    size_t parameter_count; // planes, density network, colour network
    const float *parameters;
    const float *occupancy; // cells^3
    const uint8_t *hull;    // cells^3
    // Of a field at rest; NULL: there are none.
    const struct rn_occupancy_bits *finer[RN_DEVICE_FINER];
};

// Where training rays come from.
struct rn_device_frame {
    struct rn_camera camera;
    uint64_t offset; // of its first pixel in rgba, in pixels
    uint64_t before; // pixels of the frames of the same scale before this one
    float loss_weight;
};
struct rn_device_block { // of pixels that may see the hull (train/trainer.h)
    uint32_t frame;
    uint16_t x, y;
};
struct rn_device_pixels {
    const struct rn_device_frame *frames;
    const uint8_t *rgba;  // straight alpha
    const uint32_t *used; // a bit a pixel, 0 where no ray is drawn; NULL: all are
    const struct rn_device_block *live;
    // Of the blocks in `live`: how they are drawn, and the errors of their rays so far; `share`
    // NULL: all alike.
    struct rn_shares shares;
    const float *block_error;
    int frame_count, scale_count;
    int scale_first[17];
    uint64_t scale_pixels[16], pixel_count, live_first[17], live_count;
};
static inline size_t rn_device_used_words(uint64_t pixels) {
    return (size_t)(pixels / 32 + 1);
}

// State of a training that is not in the parameters.
struct rn_device_training {
    bool deterministic; // the same bytes every time, at a price (cuda/README.md)
    bool last_on_chip; // likewise: where the last layer's gradient of the density network is summed
    bool two_tiles;    // likewise: warps take two tiles at a time; the numbers are the same
    int next_rays;
    int64_t step, updates;
    float gradient_scale; // a power of two; 0: as at the start
    int good_steps;       // since it was last changed
    float gradient_size;  // of a sample, mean of the step before, for the roulette; 0: none yet
    uint64_t rays;        // of all steps before
    double march_step;    // scene radii; the configuration's own is for the occupancy
    bool split;           // rn_march_options
    struct rn_colouring colour;
    const float *m, *v;   // NULL: zero
    const uint32_t *seen; // of a place: what cells showed since the last round (rn_group); NULL: 0
};

// What a step needs that the host decides.
struct rn_device_step {
    float network_rate, plane_rate;
    bool measure;                           // the occupancy first; of a place by what was seen:
    bool seen_counts, all_looked;           // train/hull.h
    bool measure_drawn;                     // cells that are drawn (rn_chances_of_cells), or
    uint32_t measure_first, measure_stride; // which cells of the hull
    float measure_decay;
    float distortion; // weight of that loss, where the configuration has it
    float smoothing;  // of planes and voxels, last (kernels/kernels.h); 0: none
};

struct rn_device_progress {
    int64_t steps, updates;
    uint64_t steps_rejected, nonfinite_rays, nonfinite_numbers, samples, rays;
    uint64_t samples_returned; // that were backpropagated
    uint64_t level_samples[RN_MAX_LEVELS];
    double loss; // of the last step, per weight
    int next_rays, rejected_in_a_row;
    float gradient_scale;
    int good_steps;
    float gradient_size;
};

// What is copied from a device, in the CPU's layout; NULL: is not.
struct rn_device_numbers {
    float *parameters, *occupancy;
    float *m, *v, *block_error; // of a field that is trained, and the next
    uint32_t *seen;
};

#define RN_DEVICE_STAGES 16
struct rn_device_stage {
    const char *name;
    float ms;
};

struct rn_backend {
    int version;
    const char *name; // "cuda"
    // Device `ordinal`. UNSUPPORTED when there is no such device, with the reason.
    enum rn_status (*open)(int ordinal, struct rn_backend_device **ret_device,
                           struct rn_device_about *ret_about, struct rn_error *err);
    void (*close)(struct rn_backend_device **device);
    // Of its memory: taken by what was made on it, and free for this and every other process.
    size_t (*used_bytes)(const struct rn_backend_device *device);
    size_t (*free_bytes)(const struct rn_backend_device *device);
    // Bytes that field_create takes; where there are pixels with train_begin, and with planes grown
    // as large as they will be. UNSUPPORTED names what of the configuration this backend cannot do.
    // LIMIT where it is more than `budget_bytes` says what is needed and what would fit.
    enum rn_status (*needs)(const struct rn_device_scene *scene,
                            const struct rn_device_pixels *pixels,
                            const struct rn_device_training *training, size_t budget_bytes,
                            size_t *ret_bytes, struct rn_error *err);
    // NO_MEMORY when the device does not have what `needs` says. `scene` need not outlive the call.
    enum rn_status (*field_create)(struct rn_backend_device *device,
                                   const struct rn_device_scene *scene,
                                   struct rn_device_field **ret_field, struct rn_error *err);
    void (*field_destroy)(struct rn_device_field **field);
    // Adds what training needs; once a field.
    enum rn_status (*train_begin)(struct rn_device_field *field,
                                  const struct rn_device_pixels *pixels,
                                  const struct rn_device_training *training, struct rn_error *err);
    // Queues one step and returns; the host waits in train_finish.
    enum rn_status (*train_step)(struct rn_device_field *field, const struct rn_device_step *step,
                                 struct rn_error *err);
    enum rn_status (*train_finish)(struct rn_device_field *field,
                                   struct rn_device_progress *ret_progress, struct rn_error *err);
    // One step kernel by kernel instead of as a graph, and how long each stage took on the device.
    enum rn_status (*train_timed)(struct rn_device_field *field, const struct rn_device_step *step,
                                  struct rn_device_stage ret_stages[RN_DEVICE_STAGES],
                                  int *ret_count, struct rn_error *err);
    // Other shares of the blocks, from the next step on.
    enum rn_status (*train_share)(struct rn_device_field *field, const struct rn_shares *shares,
                                  struct rn_error *err);
    enum rn_status (*download)(struct rn_device_field *field, const struct rn_device_numbers *to,
                               struct rn_error *err);
    // Of a view the pixels at `places`, in their order. Rays that end earlier than in training are
    // closed (rn_close_ended).
    enum rn_status (*render)(struct rn_device_field *field, const struct rn_device_view *view,
                             const struct rn_march_options *options,
                             const struct rn_device_places *places, struct rn_pixel *ret_pixels,
                             uint64_t *ret_samples, struct rn_error *err);
};

#endif

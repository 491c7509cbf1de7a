// A field in memory: parameters, pyramid, occupancy and what is known about them. Inside the
// engine only.
#ifndef RN_ENGINE_SCENE_SCENE_H
#define RN_ENGINE_SCENE_SCENE_H

#include "server/engine/cpu/pool.h"
#include "server/engine/kernels/kernels.h"
#include "server/engine/scene/engine.h"

struct rn_backend; // backend.h
struct rn_backend_device;
struct rn_device_field;

struct rn_engine {
    struct rn_pool *pool;
    const struct rn_kernels *kernels;
    struct rn_device_info info;
    void *workspaces;                // one a thread
    size_t workspace_bytes;          // of one
    struct rn_field_config laid_out; // that they are laid out for, and the step
    double laid_out_step;
    char folder[RN_ENGINE_FOLDER_MAX]; // rn_engine_keep_in; "": none
    bool (*keep_going)(void *context); // rn_engine_watch; NULL = never asked
    void *watcher;
    bool (*wanted)(void *context); // rn_engine_yield_to; NULL = never asked
    void *wanter;
    enum rn_status (*share)(void *context, const struct rn_device_wish *wish, size_t *ret_granted,
                            struct rn_error *err); // rn_engine_share; NULL = all is its own
    void *sharer;
    const struct rn_exchange *exchange; // rn_engine_join; NULL: one rank
    const struct rn_backend *backend;   // of a device other than the CPU; NULL without one
    struct rn_backend_device *device;
    void *module;               // that the backend comes from
    char device_kernels[32];    // "sm_90"
    size_t device_memory_bytes; // that fields may take of it; 0 = what is free
    bool deterministic;         // what a device trains
    bool last_on_chip;          // likewise
    bool two_tiles;             // likewise
    bool device_optional;       // what the device cannot do, the CPU does
};

// Whether the calling thread is preempted. `engine`: struct rn_engine.
bool rn_engine_is_wanted(void *engine);

// Numbers of one field: planes and voxels (rn_grid_count of them), density network, colour network,
// photographs' appearances, in one block in this order.
struct rn_parameters {
    size_t plane_count, base_count, head_count, appearance_count, count;
    float *values; // 64-byte aligned, owned by whoever made the block
};
// All of them behind the planes and voxels.
static inline size_t rn_parameters_behind(const struct rn_parameters *p) {
    return p->count - p->plane_count;
}

// Thread-safety: as the engine. Owner: rn_field_load's caller or the trainer.
struct rn_field {
    struct rn_cpu_field cpu;
    struct rn_train_config config;
    struct rn_bounds bounds;
    double finest_cone; // radius at the scene's centre of the finest training pixel's cone, dataset
                        // units; 0: not known
    struct rn_parameters parameters;
    float *packed; // networks as the kernel set `packed_for` reads them: base, then head
    const struct rn_kernels *packed_for;
    float *pyramid;     // every map but the base ones, for pyramid_levels
    int pyramid_levels; // maps with lx, ly < this exist; cpu.built_levels of them are in use
    int fresh_levels;   // of them, the ones pooled from the parameters as they are
    float *occupancy;   // decayed maxima of density * step, cells^3
    uint8_t *hull;      // cells^3: 1 where matter is possible at all (carving)
    uint64_t hull_cells;
    struct rn_occupancy_bits coarse; // of both
    struct rn_occupancy_bits fine;   // finer ones of a field at rest (occupancy.h), or empty
    struct rn_occupancy_bits firm;   // and those of them that are not thin haze
    int fine_levels;                 // of the pyramid, that those hold for
    int64_t steps;
    double train_seconds, psnr;
    struct rn_effect_record effects[RN_EFFECT_COUNT];
    char kernels[32];
    struct rn_viewing viewing; // of 0 bits: it holds what training left
    // Its copy on the engine's device (device.h); NULL without one.
    struct rn_device_field *on_device;
    const struct rn_backend *backend;
    struct rn_engine *engine;    // whose device
    int device_levels;           // of the copy's maps
    bool behind, moments_behind; // the device trained since these were read from it
    bool rests;                  // not there for want of memory: the next picture tries again
};

// A block of zeros, 4,096-byte aligned; on huge pages where it is large and the machine has them,
// as texels are read at random. Memory is taken as it is first written. NULL without memory.
void *rn_block_create(size_t bytes);
void rn_block_touch(void *block, size_t bytes); // takes it now; what it holds stays
void rn_block_destroy(void *block);

// Allocates everything for a configuration; parameters zero, all cells of the ball occupied.
enum rn_status rn_field_create(const struct rn_train_config *config, const struct rn_bounds *bounds,
                               struct rn_field **ret_field, struct rn_error *err) RN_MUST_CHECK;
// The hull anew, and what of its cells is occupied: all that the field's space holds.
enum rn_status rn_field_fill(struct rn_field *field) RN_MUST_CHECK;
// Random parameters: planes U(-0.01, 0.01), networks Xavier-uniform over padded sizes.
void rn_field_randomise(struct rn_field *field, uint64_t seed);
// Bytes that rn_field_create will take, the pyramid at `levels` included.
size_t rn_field_bytes(const struct rn_train_config *config, int levels);

// Makes maps up to `levels` a side exist (never fewer than now) and be in use; their content is
// stale beyond fresh_levels until rn_field_refresh. RN_ERROR_NO_MEMORY.
enum rn_status rn_field_need_levels(struct rn_field *field, int levels,
                                    struct rn_error *err) RN_MUST_CHECK;
// The field's parameters and pyramid become these, laid out alike, its own are handed out in their
// place; `*levels` likewise. All are blocks as the field made its own.
void rn_field_exchange(struct rn_field *field, float **values, float **pyramid, int *levels);
// After a change of the networks or kernel set: packs them as the set reads them.
void rn_field_pack(struct rn_field *field, struct rn_engine *engine);
// After any change of parameters: rn_field_pack, and all maps in use are built anew.
void rn_field_refresh(struct rn_field *field, struct rn_engine *engine);

// Numbers of a pyramid of one plane beyond its base map, and the maps' places in a block that
// starts with plane 0's.
size_t rn_pyramid_count(const struct rn_field_config *config, int levels);
void rn_pyramid_lay_out(const struct rn_field_config *config, int levels, float *base, float *block,
                        struct rn_map maps[RN_MAX_PLANES][RN_MAX_LEVELS][RN_MAX_LEVELS]);

// The step that pictures march in where nothing else is asked for. A training ray starts anywhere
// within a step, and the field learns what is right on the mean; a picture's rays all start alike,
// and in places, where a step is about a pixel of parallax, that shows. So these are marched in
// half the steps they are trained in, and the last of a forward-facing training is as its pictures
// are.
double rn_picture_step(const struct rn_field *field);

// The engine's workspaces for a field: laid out on first use and after a change of configuration.
enum rn_status rn_engine_prepare(struct rn_engine *engine, const struct rn_field *field,
                                 struct rn_error *err) RN_MUST_CHECK;
struct rn_workspace *rn_engine_workspace(const struct rn_engine *engine, int thread);
// All that the kernels need to evaluate a field at `levels` levels: rn_field_need_levels,
// rn_engine_prepare, and rn_field_refresh where parameters have changed.
enum rn_status rn_field_make_ready(struct rn_field *field, struct rn_engine *engine, int levels,
                                   struct rn_error *err) RN_MUST_CHECK;

// The ray of a cone in dataset coordinates as the kernels want it: normalised, cut to the ball,
// starting where it enters the scene's cube plus `jitter` in [0, 1) of a sample's interval. Start
// and end are off by at most 2^-21 (fp32 positions) + 2^-50 of the origin's distance, the end's
// times the condition of the chord: 1 + 1 / its half length. With config.cone_step a sample spans
// as many steps as its cone is wide.
struct rn_march_ray rn_march_ray_from(const struct rn_field *field, const struct rn_ray *ray,
                                      double step, double jitter);
// A point of dataset coordinates in the cube that planes and cells cover; false where the field has
// nothing: beyond the ball, or beyond a disparity box. *ret is finite but in the plane of a box's
// reference camera.
bool rn_field_cube_of(const struct rn_field *field, const double point[3], double ret[3]);
// And back; |cube| < 1 in unbounded space.
void rn_field_place_of(const struct rn_field *field, const double cube[3], double ret[3]);
// A photograph's camera as the field was trained with it: a pinhole where lenses make no
// difference, or are not followed.
struct rn_camera rn_field_camera(const struct rn_field *field, const struct rn_frame *frame);
// A camera for the kernels' `rays`.
struct rn_view rn_field_view(const struct rn_field *field, const struct rn_camera *camera);
// A pixel is rendered as several cones where it is as many times as wide as the finest trained on.
#define RN_CONES_RATIO 1.41421356
// The radius of a camera's cones where they pass the ball's centre, dataset units. Unbounded space
// is looked at from within, at all distances: there it is the radius one of the inner ball's away.
double rn_cone_at_centre(const struct rn_field *field, const struct rn_camera *camera);
// The highest level that a camera's rays can reach, and levels per axis, 1 = only the base map.
double rn_top_level(const struct rn_field *field, const struct rn_camera *camera, double step);
int rn_levels_for_camera(const struct rn_field *field, const struct rn_camera *camera, double step);

#endif

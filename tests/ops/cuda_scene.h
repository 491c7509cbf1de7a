// A small field with cameras and pixels, once in the float64 reference and once behind a backend.
#ifndef RN_TESTS_OPS_CUDA_SCENE_H
#define RN_TESTS_OPS_CUDA_SCENE_H

#include "server/engine/kernels/backend.h"
#include "server/engine/reference/reference.h"
#include "server/engine/scene/occupancy.h"
#include "tests/support/suite.h"

#define FRAMES 4
#define SIDE 12 // pixels of a frame a side
#define RAYS 96 // of most tests
#define MOST_RAYS 1100

// The backend under test: the emulated one, or with cuda_device.c the module RIPNERF_CUDA_MODULE on
// this machine's GPU, NULL when there is none. With a GPU the emulator's knobs do nothing.
const struct rn_backend *test_backend(void);
bool test_is_emulated(void);

struct test_scene {
    struct rn_train_config config;
    struct rn_engine engine; // the CPU's kernels, to compare with
    struct rn_field *field;
    struct rn_reference *reference;
    struct rn_device_frame frames[FRAMES];
    uint8_t rgba[FRAMES * SIDE * SIDE * 4];
    int rays;                  // of a training step, at most MOST_RAYS; RAYS at first
    float background_variance; // of training (rn_march_options); 0.1 at first
    bool split;                // likewise; false at first
    bool last_on_chip;         // likewise
    bool two_tiles;            // likewise
    float gradient_scale;      // that training begins with; 0, the backend's own, at first
    const float *m, *v;        // moments that training begins with; NULL at first
    const uint32_t *seen;      // of a place: what cells showed before; NULL at first
    const struct rn_occupancy_bits *finer[RN_DEVICE_FINER]; // of pictures; NULL at first
    struct rn_backend_device *device;
    struct rn_device_field *on_device;
};

// A field of numbers that fp16 holds exactly, every cell of the ball occupied; a CPU field and a
// reference of the same numbers.
void test_scene_init(struct test_scene *s, const struct rn_train_config *config);
// All cells of its hull occupied, again.
void test_scene_occupy(struct test_scene *s);
// Before it is uploaded: in place of the ball a forward-facing space's box, and cameras before it.
// The reference does not know such a space.
void test_scene_face(struct test_scene *s);
// The same field on the device, with `budget` bytes (0: all).
enum rn_status test_scene_upload(struct test_scene *s, size_t budget, struct rn_error *err);
// Starts training with `rays` rays a step; one scale.
enum rn_status test_scene_train(struct test_scene *s, bool deterministic, struct rn_error *err);
void test_scene_finish(struct test_scene *s);
// Rows [row, row + rows) of a camera, each pixel one cone.
enum rn_status test_render(const struct test_scene *s, const struct rn_camera *camera,
                           const struct rn_march_options *options, enum rn_device_cells cells,
                           int row, int rows, struct rn_pixel *ret_pixels, uint64_t *ret_samples,
                           struct rn_error *err);
// What training leaves.
struct test_numbers {
    float *parameters, *m, *v;
    struct rn_device_progress progress;
};
extern const struct rn_device_step test_step; // of most tests
void test_read_back(struct test_scene *s, struct test_numbers *ret);
void test_numbers_finish(struct test_numbers *n);
// Uploads, and trains `steps` of them.
void test_train(struct test_scene *s, int steps, bool deterministic, struct test_numbers *ret);
// The rays of a training step as the reference takes them; `mid` for test_rays_finish.
void test_scene_rays(const struct test_scene *s, int64_t step, struct rn_reference_ray *rays,
                     int count);
void test_rays_finish(struct rn_reference_ray *rays, int count);
// One ray of a camera's pixel, every sample inside the ball, or of unbounded space.
struct rn_reference_ray test_reference_ray(const struct test_scene *s,
                                           const struct rn_camera *camera, int x, int y,
                                           double jitter);

struct rn_train_config test_config(enum rn_footprint footprint, int planes, int channels, int width,
                                   int levels);

// A case of its own for a test that runs `count` times; CK_RUN_CASE chooses one.
void test_add(Suite *suite, const char *name, const TTest *test, int count);
void test_add_pictures(Suite *suite); // cuda_pictures.c
void test_add_choices(Suite *suite);  // cuda_choices.c
void test_add_places(Suite *suite);   // cuda_places.c

#endif

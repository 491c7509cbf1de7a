// Fields on a device behind a backend's table: the CPU's field stays the owner of everything, the
// device holds a copy that it renders from and trains.
#ifndef RN_ENGINE_SCENE_DEVICE_H
#define RN_ENGINE_SCENE_DEVICE_H

#include "server/engine/kernels/backend.h"
#include "server/engine/scene/scene.h"

// Loads the backend's module and opens "cuda:N", or with "auto" the first one if that works and its
// kernels agree with the CPU's (rn_device_check), which the engine's info says either way. The
// module is looked for at RIPNERF_CUDA_MODULE, where it was installed, and in the build folder.
// RN_ERROR_UNSUPPORTED says why there is none.
enum rn_status rn_engine_open_device(struct rn_engine *engine, const char *device,
                                     struct rn_error *err) RN_MUST_CHECK;
void rn_engine_close_device(struct rn_engine *engine);
// Whether a checkpoint's kernel set is a device's: any machine may go on from it.
bool rn_device_trained(const char *kernels);

// How far a device's kernels are from the CPU's, on small fields: a pixel's largest difference, of
// the largest number, and by how much the loss leaves its gradient when it is followed.
struct rn_device_agreement {
    double pixels, gradient, ms;
};
#define RN_DEVICE_PIXELS 5e-3
#define RN_DEVICE_GRADIENT 0.1
// Compares them; `whole`: every group of parameters by itself; else pixels alone where a training
// finds no room, and `gradient` is NAN. RN_ERROR_NUMERIC where the bounds do not hold,
// then with `ret` written too; the backend's errors.
enum rn_status rn_device_check(struct rn_engine *engine, bool whole,
                               struct rn_device_agreement *ret, struct rn_error *err) RN_MUST_CHECK;

// A field as the backend takes it, with maps of `levels` a side.
struct rn_device_scene rn_device_scene_of(const struct rn_field *field, int levels);

// Makes the field exist on the engine's device as the CPU has it now, with maps of `levels` a side,
// in place of what is there; with `pixels` it is trained there from now on, else both are NULL. Its
// memory is asked for first (rn_engine_share): while it waits it holds none. Errors are the
// backend's and the sharer's; then nothing of it is on the device.
enum rn_status rn_field_put(struct rn_engine *engine, struct rn_field *field, int levels,
                            const struct rn_device_pixels *pixels,
                            const struct rn_device_training *training,
                            struct rn_error *err) RN_MUST_CHECK;
// The same with as many levels as the backend can build, for a field that is not trained. Nothing
// where there is no device, or one that may be done without cannot hold the field.
enum rn_status rn_field_put_to_render(struct rn_engine *engine, struct rn_field *field,
                                      struct rn_error *err) RN_MUST_CHECK;
// Copies parameters and occupancy from the device, after training there; for its training to go on
// here, where not NULL, what of `training` is not NULL. Nothing to do where the CPU's are as
// new.
enum rn_status rn_field_fetch(struct rn_field *field, const struct rn_device_numbers *training,
                              struct rn_error *err) RN_MUST_CHECK;
// Gives the device's copy and its memory back.
void rn_field_withdraw(struct rn_field *field);

#endif

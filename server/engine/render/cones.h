// A pixel by several cones: n x n narrower ones side by side, averaged. One cone's Gaussian blurs
// what lies within a pixel before the networks see it; where pixels are wider than those the field
// was trained on, averaging colours instead is closer to the truth, and costs n^2 times as much.
#ifndef RN_ENGINE_RENDER_CONES_H
#define RN_ENGINE_RENDER_CONES_H

#include "server/engine/kernels/backend.h"
#include "server/engine/kernels/pixel.h"
#include "server/engine/render/optics.h"

#define RN_CONES_BLOCK 256 // cones evaluated together, and the most a pixel has

// Cones a side of the camera's pixels, a power of two, at most 16: as many as make them as narrow
// as the finest that the field was trained on, where its configuration asks for that; else 1.
int rn_cones_for_camera(const struct rn_field *field, const struct rn_camera *camera);
// Whether pixels that are compared with a photograph are averaged so.
bool rn_field_averages_straight(const struct rn_field *field, const struct rn_frame *frame);
// A pixel's place: column, row.
struct rn_spot {
    int x, y;
};
// What the pixels of a picture have in common. All is the caller's.
struct rn_cones {
    const struct rn_engine *engine;
    const struct rn_field *field;
    const struct rn_march_options *march; // `step`: of one cone
    const struct rn_camera *camera;
    const struct rn_viewpoints *viewpoints; // where cones are seen from instead, which are then
                                            // averaged as light; NULL: all from the camera
    int n;                                  // a side of a pixel
};
// Renders `count` pixels, each by n x n cones, on the calling thread, which is the engine's that
// `thread` says; returns the field evaluations. `ret_costs`: NULL, or of each pixel its own.
uint64_t rn_cones_render(const struct rn_cones *cones, const struct rn_spot *spots, int count,
                         int thread, struct rn_pixel *ret_pixels, uint16_t *ret_costs);
// Pixels of cameras on the field's device, in the order of their places, from the cells that the
// CPU's march would read. The backend's errors.
enum rn_status rn_cones_render_there(struct rn_field *field, const struct rn_march_options *march,
                                     const struct rn_device_view *view,
                                     const struct rn_device_places *places,
                                     struct rn_pixel *ret_pixels, uint64_t *ret_samples,
                                     struct rn_error *err) RN_MUST_CHECK;

#endif

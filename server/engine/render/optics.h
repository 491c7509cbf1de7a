// Pictures of a camera that is no pinhole at one instant: every cone of a pixel is seen from a
// place of its own on the lens, at an instant of its own while the shutter is open. Seen from a
// place on a thin lens, what lies in the focal plane keeps its pixel; so that place is a pinhole
// whose principal point is shifted (Potmesil and Chakravarty 1981; Cook, Porter and Carpenter
// 1984), and the kernels know of nothing. Parallel rays (an orthographic picture) are cut here, one
// by one.
#ifndef RN_ENGINE_RENDER_OPTICS_H
#define RN_ENGINE_RENDER_OPTICS_H

#include "server/engine/render/render.h"
#include "server/engine/scene/scene.h"

#define RN_OPTICS_VIEWS 256  // places and instants in all: as many as a pixel has cones at most
#define RN_OPTICS_CONES 8    // a side of a pixel, where none are asked for
#define RN_OPTICS_FAR 1024.0 // scene radii that parallel rays' common origin is taken to lie away

// The places that a picture's cones are seen from. Thread-safety: immutable once made. Owner: the
// caller; rn_viewpoints_destroy.
struct rn_viewpoints {
    bool parallel; // rays are
    bool spread;   // there are several places: colours are averaged as light

    struct rn_camera camera[RN_OPTICS_VIEWS]; // of the cones
    struct rn_view view[RN_OPTICS_VIEWS];
    double lens[RN_OPTICS_VIEWS][2]; // where on it, dataset units
    double focus, pitch;             // pitch: between parallel rays, dataset units
};

// Whether a picture needs any: otherwise it is a pinhole's, and nothing below is called.
bool rn_shot_needs_viewpoints(const struct rn_shot *shot);
// What cannot be: a lens that bends with an aperture, parallel rays in a forward-facing space, a
// shutter without instants. RN_ERROR_INVALID, RN_ERROR_UNSUPPORTED.
enum rn_status rn_shot_check(const struct rn_shot *shot, const struct rn_camera *camera,
                             const struct rn_field *field, struct rn_error *err) RN_MUST_CHECK;
// The camera that stands for a shot's: for parallel rays a pinhole far behind it, whose cones are
// as wide in the scene; else the same.
struct rn_camera rn_shot_camera(const struct rn_shot *shot, const struct rn_camera *camera,
                                const struct rn_field *field);
// `width` x `height` cones in all. NULL: no memory.
struct rn_viewpoints *rn_viewpoints_create(const struct rn_shot *shot,
                                           const struct rn_camera *camera,
                                           const struct rn_field *field, int width, int height);
void rn_viewpoints_destroy(struct rn_viewpoints **viewpoints);
// Which place cone `i` of the n x n of the pixel at (x, y) is seen from: those of a pixel are
// spread evenly over lens and time, and neighbours have others.
int rn_viewpoints_choose(int x, int y, int n, int i);
// A parallel ray: of the cone (x, y), seen from place `i`. `ret_moved`: how much farther than it is
// its origin is told to be, so that the cone is as wide as the pixel in the scene's middle.
struct rn_march_ray rn_viewpoints_ray(const struct rn_viewpoints *viewpoints,
                                      const struct rn_field *field, int i, int x, int y,
                                      double step, float *ret_moved);

#endif

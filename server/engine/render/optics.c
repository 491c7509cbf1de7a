#include "server/engine/render/optics.h"

#include <math.h>
#include <stdlib.h>

#include "server/engine/kernels/ray.h"

#define PI 3.14159265358979323846

bool rn_shot_needs_viewpoints(const struct rn_shot *shot) {
    return rn_optics_spreads(&shot->optics) || shot->optics.ortho_height > 0;
}

enum rn_status rn_shot_check(const struct rn_shot *shot, const struct rn_camera *camera,
                             const struct rn_field *field, struct rn_error *err) {
    const struct rn_optics *o = &shot->optics;
    enum rn_status status = rn_optics_check(o, err);
    if (status) return status;
    if ((o->aperture > 0 || o->ortho_height > 0) && camera->lens)
        return rn_error_set(err, RN_ERROR_INVALID, o->aperture > 0 ? "aperture" : "ortho_height",
                            "goes with a camera whose lens is a pinhole");
    if (o->ortho_height > 0 && field->cpu.disparity.on)
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, "ortho_height",
                            "parallel rays do not go with a forward-facing scene, whose space is "
                            "seen from its cameras");
    if (o->shutter > 0 && shot->instant_count < 1)
        return rn_error_set(err, RN_ERROR_INVALID, "shutter",
                            "goes with a camera path: a single picture has no motion");
    return RN_OK;
}

struct rn_camera rn_shot_camera(const struct rn_shot *shot, const struct rn_camera *camera,
                                const struct rn_field *field) {
    struct rn_camera out = *camera;
    double radius = field->bounds.radius;
    if (!(shot->optics.ortho_height > 0)) return out;
    out.fx = out.fy = radius * camera->height / shot->optics.ortho_height;
    for (int i = 0; i < 3; i++)
        out.world_from_camera[i][3] =
            field->bounds.centre[i] - radius * camera->world_from_camera[i][2];
    return out;
}

// ---- where cones are seen from --------------------------------------------------------------

// The first three dimensions of Sobol's sequence with 256 points: of any 4^m in a row that begin at
// a multiple of it, each part of 4^m of the interval has one, and of the first two dimensions each
// cell of 2^m x 2^m has. Direction numbers by Joe and Kuo (2008).
static double sobol(int dimension, unsigned index) {
    static const uint8_t directions[3][8] = {{0x80, 0x40, 0x20, 0x10, 0x08, 0x04, 0x02, 0x01},
                                             {0x80, 0xc0, 0xa0, 0xf0, 0x88, 0xcc, 0xaa, 0xff},
                                             {0x80, 0xc0, 0x60, 0x90, 0xe8, 0x5c, 0x8e, 0xc5}};
    unsigned bits = 0;
    for (int b = 0; b < 8; b++)
        if (index >> b & 1) bits ^= directions[dimension][b];
    return (bits + 0.5) / 256;
}

// The unit square to the unit disc, areas in proportion (Shirley and Chiu 1997).
static void disc(double u, double v, double ret[2]) {
    double a = 2 * u - 1, b = 2 * v - 1;
    bool wide = fabs(a) > fabs(b);
    double r = wide ? a : b, angle = wide ? PI / 4 * (b / a) : PI / 2 - PI / 4 * (a / b);
    ret[0] = r * cos(angle);
    ret[1] = r * sin(angle);
}

// The pinhole at a place on the lens: what lies in the focal plane keeps its pixel.
static void stand_on_lens(struct rn_camera *camera, const double lens[2], double focus) {
    for (int i = 0; i < 3; i++)
        camera->world_from_camera[i][3] +=
            camera->world_from_camera[i][0] * lens[0] + camera->world_from_camera[i][1] * lens[1];
    camera->cx += camera->fx * lens[0] / focus;
    camera->cy += camera->fy * lens[1] / focus;
}

static void fill(struct rn_viewpoints *v, const struct rn_shot *shot,
                 const struct rn_camera *camera, const struct rn_field *field, int width,
                 int height, int i) {
    const struct rn_optics *o = &shot->optics;
    const struct rn_camera *now = camera;
    if (o->shutter > 0) now = &shot->instants[(int)(sobol(2, (unsigned)i) * shot->instant_count)];
    v->camera[i] = rn_camera_resized(now, width, height);
    disc(sobol(0, (unsigned)i), sobol(1, (unsigned)i), v->lens[i]);
    for (int k = 0; k < 2; k++)
        v->lens[i][k] *= 0.5 * o->aperture;
    if (o->aperture > 0 && !v->parallel) stand_on_lens(&v->camera[i], v->lens[i], o->focus);
    v->view[i] = rn_field_view(field, &v->camera[i]);
}

struct rn_viewpoints *rn_viewpoints_create(const struct rn_shot *shot,
                                           const struct rn_camera *camera,
                                           const struct rn_field *field, int width, int height) {
    struct rn_viewpoints *v = calloc(1, sizeof *v);
    if (!v) return NULL;
    v->parallel = shot->optics.ortho_height > 0;
    v->spread = rn_optics_spreads(&shot->optics);
    v->focus = shot->optics.focus;
    v->pitch = shot->optics.ortho_height / height;
    for (int i = 0; i < RN_OPTICS_VIEWS; i++)
        fill(v, shot, camera, field, width, height, i);
    return v;
}

void rn_viewpoints_destroy(struct rn_viewpoints **viewpoints) {
    free(*viewpoints);
    *viewpoints = NULL;
}

int rn_viewpoints_choose(int x, int y, int n, int i) {
    unsigned h = (unsigned)x * 0x9e3779b1u ^ (unsigned)y * 0x85ebca77u; // two odd factors, mixed
    h = (h ^ h >> 15) * 0x2c1b3c6du;
    h = (h ^ h >> 12) * 0x297a2d39u;
    h ^= h >> 15;
    unsigned cones = (unsigned)(n * n), block = h % (RN_OPTICS_VIEWS / cones);
    return (int)(block * cones + ((unsigned)i ^ (h >> 16 & (cones - 1))));
}

struct rn_march_ray rn_viewpoints_ray(const struct rn_viewpoints *v, const struct rn_field *field,
                                      int i, int x, int y, double step, float *ret_moved) {
    const struct rn_camera *camera = &v->camera[i];
    double at[2] = {(x + 0.5 - camera->cx) * v->pitch, (y + 0.5 - camera->cy) * v->pitch};
    double look[2] = {0, 0}, cone = v->pitch / sqrt(PI) / field->bounds.radius;
    struct rn_ray ray = {.radius = cone};
    for (int k = 0; k < 2 && v->focus > 0; k++)
        look[k] = -v->lens[i][k] / v->focus;
    rn_camera_turn(camera->world_from_camera, look[0], look[1], 1.0, ray.direction);
    for (int k = 0; k < 3; k++)
        ray.origin[k] = camera->world_from_camera[k][3] +
                        camera->world_from_camera[k][0] * (at[0] + v->lens[i][0]) +
                        camera->world_from_camera[k][1] * (at[1] + v->lens[i][1]);
    double middle = 0;
    for (int k = 0; k < 3; k++)
        middle +=
            (field->bounds.centre[k] - ray.origin[k]) / field->bounds.radius * ray.direction[k];
    struct rn_march_ray out = rn_march_ray_from(field, &ray, step, 0);
    if (field->config.cone_step && field->config.field.space != RN_SPACE_UNBOUNDED)
        out.stride = rn_sample_stride(cone, step);
    *ret_moved = (float)(RN_OPTICS_FAR - middle);
    out.near += *ret_moved;
    out.radius = (float)(cone / RN_OPTICS_FAR);
    return out;
}

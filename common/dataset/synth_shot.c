#include "common/dataset/synth_shot.h"

#include <math.h>
#include <string.h>

#include "common/math/rng.h"
#include "common/math/srgb.h"
#include "common/math/vector.h"

// Streams of random numbers of a photograph.
enum { STREAM_EXPOSURE = 1, STREAM_SHUTTER, STREAM_CROWD };

bool rn_synth_ray(const struct rn_camera *camera, double px, double py, struct ray *ret) {
    struct rn_ray cone = rn_camera_ray(camera, px, py);
    *ret = (struct ray){{cone.origin[0], cone.origin[1], cone.origin[2]},
                        {cone.direction[0], cone.direction[1], cone.direction[2]},
                        {0},
                        NULL};
    return cone.radius > 0;
}

// Sample s of a pixel on a disc of radius 1: an additive recurrence over radius and angle, so that
// the samples of a pixel cover it evenly.
static void place_on_disc(int s, struct rn_rng4 offset, const double steps[2], double at[2]) {
    double radius = fmod((double)rn_rng_unit(offset.v[0]) + s * steps[0], 1);
    double angle = 2 * M_PI * fmod((double)rn_rng_unit(offset.v[1]) + s * steps[1], 1);
    at[0] = sqrt(radius) * cos(angle);
    at[1] = sqrt(radius) * sin(angle);
}

static void place_on_lamp(int s, uint64_t pixel, double lamp[2]) {
    static const double steps[2] = {0.7548776662466927, 0.5698402909980532};
    place_on_disc(s, rn_rng_draw(1, pixel, 0), steps, lamp);
}

// From somewhere on the lens, some time while it is open, to where the ray was sharp.
static void blur(const struct rn_synth_shot *shot, int s, uint64_t pixel, struct ray *ray) {
    static const double steps[3] = {0.8191725133961645, 0.6710436067037893, 0.5497004779019703};
    const double(*pose)[4] = shot->camera.world_from_camera;
    struct rn_rng4 offset = rn_rng_draw(2, pixel, 0);
    double lens[2], ahead = 0;
    place_on_disc(s, offset, steps, lens);
    double when = fmod((double)rn_rng_unit(offset.v[2]) + s * steps[2], 1) - 0.5;
    double direction[3] = {ray->direction.x, ray->direction.y, ray->direction.z};
    for (int i = 0; i < 3; i++)
        ahead += pose[i][2] * direction[i];
    struct vec sharp = ray_at(ray, shot->focus / ahead);
    for (int axis = 0; axis < 2; axis++)
        ray->origin = vec_add(ray->origin, shot->aperture * lens[axis],
                              (struct vec){pose[0][axis], pose[1][axis], pose[2][axis]});
    if (shot->aperture > 0) ray->direction = vec_unit(vec_add(sharp, -1, ray->origin));
    ray->origin = vec_add(ray->origin, when, shot->moved);
}

// Light is what is brighter, not its stored value.
static float expose(double value, double stops) {
    float light = rn_srgb_to_linear((float)value) * (float)exp2(stops);
    return fminf(1, rn_srgb_from_linear(light));
}

// The mean over one pixel: `side` x `side` strata with one jittered ray each.
static void render_pixel(const struct rn_synth_scene *scene, const struct rn_synth_shot *shot,
                         int x, int y, int side, float rgba[4]) {
    double sum[3] = {0};
    int hits = 0, samples = side * side;
    uint64_t stream = (uint64_t)y * (uint64_t)shot->camera.width + (uint64_t)x;
    bool blurred = shot->aperture > 0 || vec_dot(shot->moved, shot->moved) > 0;
    struct rn_rng4 jitter = {{0}};
    for (int s = 0; s < samples; s++) {
        if (s % 2 == 0) jitter = rn_rng_draw(0, stream, (uint64_t)s / 2);
        double u = (s % side + (double)rn_rng_unit(jitter.v[s % 2 * 2])) / side;
        double v = ((double)(s / side) + (double)rn_rng_unit(jitter.v[s % 2 * 2 + 1])) / side;
        struct ray ray;
        if (!rn_synth_ray(&shot->camera, x + u, y + v, &ray)) continue;
        if (blurred) blur(shot, s, stream, &ray);
        if (shot->crowd.count > 0) ray.crowd = &shot->crowd;
        if (scene->lamp > 0) place_on_lamp(s, stream, ray.lamp);
        double rgb[3], distance;
        if (!rn_synth_trace(scene, &ray, rgb, &distance)) continue;
        hits++;
        for (int i = 0; i < 3; i++)
            sum[i] += rgb[i];
    }
    for (int i = 0; i < 3; i++) {
        rgba[i] = hits ? (float)(sum[i] / hits) : 0;
        if (shot->stops != 0) rgba[i] = expose((double)rgba[i], shot->stops);
    }
    rgba[3] = (float)hits / (float)samples;
}

// Whether no ray of the pixel can meet the scene's sphere: the centre ray stays away from it by
// more than the pixel's diagonal.
static bool pixel_is_empty(const struct rn_synth_scene *scene, const struct rn_synth_shot *shot,
                           int x, int y) {
    const struct rn_camera *camera = &shot->camera;
    if (camera->lens != RN_LENS_PINHOLE || shot->aperture > 0) return false;
    struct rn_ray cone = rn_camera_ray(camera, x + 0.5, y + 0.5);
    double along = 0, squared = 0;
    for (int i = 0; i < 3; i++) {
        along -= cone.origin[i] * cone.direction[i];
        squared += cone.origin[i] * cone.origin[i];
    }
    double distance = sqrt(squared), half_diagonal = 0.7072 * 1.7725 * cone.radius;
    double reach =
        scene->radius + half_diagonal * distance + 0.5 * sqrt(vec_dot(shot->moved, shot->moved));
    return along > 0 && squared - along * along > reach * reach;
}

void rn_synth_shoot(const struct rn_synth_scene *scene, const struct rn_synth_shot *shot, int side,
                    struct rn_picture *picture) {
    int width = shot->camera.width;
    for (int y = 0; y < shot->camera.height; y++)
        for (int x = 0; x < width; x++) {
            float *rgba = picture->values + 4 * ((size_t)y * (size_t)width + (size_t)x);
            if (pixel_is_empty(scene, shot, x, y))
                memset(rgba, 0, 4 * sizeof *rgba);
            else
                render_pixel(scene, shot, x, y, side, rgba);
        }
}

// ---- where photographs are taken, and how -----------------------------------------------------

static double between(double low, double high, uint32_t word) {
    return low + (high - low) * (double)rn_rng_unit(word);
}

// A direction, evenly over the sphere.
static struct vec direction_of(struct rn_rng4 draw) {
    double z = between(-1, 1, draw.v[0]), angle = between(0, 2 * M_PI, draw.v[1]);
    double across = sqrt(1 - z * z);
    return (struct vec){across * cos(angle), across * sin(angle), z};
}

static void gather(const struct rn_synth_scene *scene, int count, uint64_t photo,
                   struct rn_crowd *crowd) {
    crowd->count = count;
    crowd->floor = scene->roam_low.z;
    for (int i = 0; i < count; i++) {
        struct rn_rng4 draw = rn_rng_draw(STREAM_CROWD, photo, (uint64_t)i);
        struct rn_mover *mover = &crowd->movers[i];
        mover->x = between(scene->roam_low.x, scene->roam_high.x, draw.v[0]);
        mover->y = between(scene->roam_low.y, scene->roam_high.y, draw.v[1]);
        for (int c = 0; c < 3; c++)
            mover->colour[c] = 0.1 + 0.8 * (double)(draw.v[2] >> (8 * c) & 255) / 255;
    }
}

// The camera and what it is focused on.
static enum rn_status stand(const struct rn_synth_scene *scene,
                            const struct rn_synth_options *options, enum rn_split split, int index,
                            int count, struct rn_synth_shot *shot) {
    static const double up[3] = {0, 0, 1};
    double eye[3], target[3];
    int size = options->size;
    struct rn_camera *camera = &shot->camera;
    *camera = (struct rn_camera){.lens = RN_LENS_PINHOLE, .width = size, .height = size};
    camera->fx = camera->fy = rn_camera_focal_from_fov(scene->angle_x, size);
    camera->cx = camera->cy = 0.5 * size;
    for (int i = 0; i < RN_SYNTH_LENS; i++) {
        camera->lens_k[i] = options->lens[i];
        if (options->lens[i] != 0) camera->lens = RN_LENS_OPENCV;
    }
    scene->stand(split, index, count, eye, target);
    shot->focus = rn_apart(target, eye);
    enum rn_status status = rn_camera_look_at(eye, target, up, camera->world_from_camera);
    return status ? status : rn_camera_check(camera, "lens", NULL);
}

enum rn_status rn_synth_place_shot(const struct rn_synth_scene *scene,
                                   const struct rn_synth_options *options, enum rn_split split,
                                   int index, int count, struct rn_synth_shot *ret_shot) {
    struct rn_synth_shot shot = {.stops = 0};
    uint64_t photo = (uint64_t)split << 32 | (uint64_t)index;
    enum rn_status status = stand(scene, options, split, index, count, &shot);
    if (status) return status;
    if (split != RN_SPLIT_TEST) {
        shot.aperture = options->aperture;
        shot.moved =
            vec_scale(options->shutter, direction_of(rn_rng_draw(STREAM_SHUTTER, photo, 0)));
        shot.stops =
            options->exposure * between(-1, 1, rn_rng_draw(STREAM_EXPOSURE, photo, 0).v[0]);
        gather(scene, options->movers, photo, &shot.crowd);
    }
    *ret_shot = shot;
    return RN_OK;
}

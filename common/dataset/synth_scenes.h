// The synthetic scenes: what a ray sees, and where cameras stand. Internal to common/dataset.
//
// A scene is a row of the table in synth_trace.c and a file with its shapes and colours.
#ifndef RN_COMMON_DATASET_SYNTH_SCENES_H
#define RN_COMMON_DATASET_SYNTH_SCENES_H

#include "common/dataset/dataset.h"
#include "common/dataset/synth_shapes.h"

// People, roughly: a striped post with a head, somewhere else in every photograph.
struct rn_mover {
    double x, y, colour[3];
};
struct rn_crowd {
    int count;
    double floor; // on which they stand
    struct rn_mover movers[RN_SYNTH_MOVERS];
};

// What shading needs to know of a point.
struct surface {
    double colour[3];
    double ambient; // share of the light that comes from everywhere
    double gloss;   // strength of the highlight
    double mirror;  // share of what is reflected, seen at right angles; more at grazing ones
};

// Thread-safety: immutable.
struct rn_synth_scene {
    const char *name;
    double radius;    // about the origin, holds the whole scene; INFINITY: a place with a sky
    struct vec light; // towards the light, unit
    double lamp;      // its radius over its distance; 0: sharp shadows
    void (*nearest)(const struct ray *ray, struct hit *hit);
    void (*describe)(const struct hit *hit, struct vec point, struct surface *surface);
    // Where view `index` of the split's `count` stands and looks; up is z.
    void (*stand)(enum rn_split split, int index, int count, double eye[3], double target[3]);
    double angle_x;                 // field of view across, radians
    struct vec roam_low, roam_high; // where people may stand, on the height `low`; low = high: none
    // The colour behind everything, by direction; NULL: nothing is there, alpha 0.
    void (*sky)(struct vec direction, double rgb[3]);
    // What mirrors show where they show nothing of the scene.
    void (*mirrored)(struct vec direction, double rgb[3]);
};

extern const struct rn_synth_scene rn_synth_sphere, rn_synth_fence, rn_synth_nested, rn_synth_place,
    rn_synth_window, rn_synth_still_life;

// Around an object: a golden spiral over part of a sphere about the origin; each split has its own.
void rn_synth_orbit(enum rn_split split, int index, int count, double eye[3], double target[3]);
#define RN_SYNTH_DISTANCE 4.0311289 // of that sphere, as in the published scenes
#define RN_SYNTH_ANGLE_X 0.6911112
#define RN_SYNTH_LAMP                                                                              \
    { 0.40824829046386302, -0.40824829046386302, 0.81649658092772603 }

// NULL for an unknown name.
const struct rn_synth_scene *rn_synth_find(const char *name);
// Writes the scenes' names into `names`, separated by commas.
void rn_synth_names(char *names, size_t size);
// Whether the ray meets the scene; then its colour there, 0..1, and the distance, INFINITY for the
// sky. Diffuse light with shadows; highlights, and reflections of one bounce, that move with the
// viewer where a surface has gloss.
bool rn_synth_trace(const struct rn_synth_scene *scene, const struct ray *ray, double rgb[3],
                    double *ret_distance);

static inline void rn_paint(struct surface *surface, double r, double g, double b) {
    surface->colour[0] = r;
    surface->colour[1] = g;
    surface->colour[2] = b;
}

static inline void rn_mix(struct surface *surface, const double a[3], const double b[3], double t) {
    for (int i = 0; i < 3; i++)
        surface->colour[i] = a[i] + (b[i] - a[i]) * t;
}

static inline bool rn_odd(double x) {
    return ((long)floor(x)) & 1;
}

#endif

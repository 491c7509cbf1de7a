// Cameras sought by what they photographed (pose-refinement; scores of photographs whose poses are
// fitted): Gauss-Newton over the colours of drawn pixels, as in direct image alignment (Engel,
// Koltun and Cremers 2018, "Direct sparse odometry", section 2.3). What a colour changes by when
// the camera moves reaches the field through the rays: central differences of rendered rays, half
// a pixel to each side, so that they are those of the kernels that train. Their error beside the
// derivative in float64: tests/ops/pose_test.c.
#ifndef RN_ENGINE_SCENE_POSE_H
#define RN_ENGINE_SCENE_POSE_H

#include "server/engine/scene/scene.h"

enum { RN_POSE_TURN, RN_POSE_SHIFT = 3, RN_POSE_FOCAL = 6, RN_POSE_UNKNOWNS };

// The camera turned about its own axes by a vector (radians), moved along them as they were by
// `unit` times a vector, its focal lengths times exp of the last.
struct rn_camera rn_pose_move(const struct rn_camera *camera, const double by[RN_POSE_UNKNOWNS],
                              double unit);

// A photograph whose camera is sought: 8-bit RGBA, straight alpha, width * height pixels of the
// camera. Borrowed.
struct rn_pose_photo {
    const uint8_t *rgba, *used; // used: a byte a pixel, 0: left out; NULL: all are used
    struct rn_camera camera;
};

enum rn_pose_part { RN_POSE_WHOLE, RN_POSE_LEFT, RN_POSE_RIGHT };
#define RN_POSE_SIGHTS 256
// Squares of side x side pixels whose mean colours are compared.
struct rn_pose_sights {
    int side, count;
    struct rn_pose_sight {
        int x, y; // top left pixel
        float target[3];
    } at[RN_POSE_SIGHTS];
};
// Draws up to `wanted` <= RN_POSE_SIGHTS of them, evenly over the part, over a background; fewer
// where masks leave pixels out. The same numbers, the same sights.
struct rn_pose_draw {
    enum rn_pose_part part;
    int side, wanted;
    const float *background;        // 3
    uint64_t seed, stream, counter; // of the random numbers
};
void rn_pose_draw(const struct rn_pose_photo *photo, const struct rn_pose_draw *draw,
                  struct rn_pose_sights *ret_sights);

// Who looks: a field as its kernels read it (rn_field_make_ready), on one of the engine's threads.
struct rn_pose_looker {
    const struct rn_engine *engine;
    const struct rn_field *field;
    int thread;
    struct rn_march_options march;
};

// What it sees: the mean colour of each sight's pixels.
typedef float rn_pose_colours[RN_POSE_SIGHTS][3];
void rn_pose_look(const struct rn_pose_looker *looker, const struct rn_camera *camera,
                  const struct rn_pose_sights *sights, rn_pose_colours ret_colours);

// Of the squared differences between a photograph's colours and `gain` times the rendered ones plus
// `offset`, weighed by Huber's function: half the sum's second derivatives to the camera's moves
// (Gauss-Newton) and minus half its first. Gain and offset are those of least squares.
struct rn_pose_equations {
    double a[RN_POSE_UNKNOWNS][RN_POSE_UNKNOWNS], b[RN_POSE_UNKNOWNS];
    double cost, gain, offset;
};
void rn_pose_equations(const struct rn_pose_looker *looker, const struct rn_camera *camera,
                       const struct rn_pose_sights *sights, struct rn_pose_equations *ret);
// The derivatives themselves: by how much each sight's rendered colour changes with each move.
void rn_pose_slopes(const struct rn_pose_looker *looker, const struct rn_camera *camera,
                    const struct rn_pose_sights *sights,
                    float (*ret_slopes)[RN_POSE_SIGHTS][3]); // RN_POSE_UNKNOWNS of them
// The move that they ask for, of the first `unknowns` (6: pose alone, or 7), damped as Levenberg
// and Marquardt have it; 0 in all where they have no solution.
void rn_pose_solve(const struct rn_pose_equations *equations, int unknowns, double damping,
                   double ret_by[RN_POSE_UNKNOWNS]);

// Gain and offset by one part's sights, then the mean squared difference of another's; 1 where
// there are none.
double rn_pose_error(const struct rn_pose_looker *looker, const struct rn_camera *camera,
                     const struct rn_pose_sights *fitted, const struct rn_pose_sights *scored);

// Seeks the camera by a part of its photograph, from squares of 8 pixels down to single ones, each
// move only where it lessens the cost. `unknowns` as above.
struct rn_camera rn_pose_seek(const struct rn_pose_looker *looker,
                              const struct rn_pose_photo *photo, enum rn_pose_part part,
                              int unknowns, uint64_t seed);

#endif

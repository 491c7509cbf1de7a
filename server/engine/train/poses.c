#include "server/engine/train/poses.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/vector.h"
#include "server/engine/train/photographs.h"
#include "server/engine/train/schedule.h"
#include "server/engine/train/trainer.h"

#define STREAM 0x706f736500000000u
#define MEASURED_AT 0.15 // of the schedule: whether cameras gain by being moved
#define LAST_AT 0.85     // the field has the rest to follow the last moves
#define TURNS 24         // evenly from one to the other, at most
#define MEASURING 6      // passes in which held-out cameras are sought, before one that scores them
#define MEASURED_SIDE 2  // pixels, of squares
#define MEASURED_SIGHTS 128
#define MEASURED_SHARE 0.02 // of the rays that are trained on: what measuring takes, of some of the
#define FEWEST 3            // held-out photographs, these at least
#define MOVED_SIGHTS 192
#define MOVED_SHARE 0.5 // of the rays trained on in a time: what turns may render
#define DAMPING 0.01
#define FARTHEST 2.0     // pixels that a turn may move a camera by, about
#define FOCAL_STEP 0.005 // of a focal length, in a turn
#define FOCAL_PRIOR 1e4  // sights' worth of trust in a focal length, per square of its logarithm

// What a pass finds out about a photograph.
struct rn_pose_view {
    struct rn_pose_equations equations;
    struct rn_camera found; // measuring: where the held-out camera was sought so far
    double before, after;   // squared errors of pixels that were not looked at
    double focal;           // moving: by how much, in logarithms
};

void rn_poses_finish(struct rn_poses *poses) {
    free(poses->moves);
    free(poses->views);
    poses->moves = NULL;
    poses->views = NULL;
}

static const struct rn_effect_record *record_of(const struct rn_trainer *t) {
    return &t->field->effects[RN_EFFECT_POSE_REFINEMENT];
}

enum rn_status rn_trainer_allocate_poses(struct rn_trainer *t, struct rn_error *err) {
    if (!record_of(t)->on || t->poses.moves) return RN_OK;
    t->poses.moves = calloc((size_t)t->train.frame_count, sizeof *t->poses.moves);
    return t->poses.moves ? RN_OK : rn_error_set(err, RN_ERROR_NO_MEMORY, "poses", "out of memory");
}

struct rn_camera rn_trainer_pose(const struct rn_trainer *t, int frame,
                                 const struct rn_camera *camera) {
    double by[RN_POSE_UNKNOWNS];
    if (!t->poses.moves) return *camera;
    for (int k = 0; k < RN_POSE_UNKNOWNS; k++)
        by[k] = (double)t->poses.moves[frame][k];
    return rn_pose_move(camera, by, t->field->bounds.radius);
}

// How many turns there are: fewer of many photographs where the time is limited.
static int turn_count(const struct rn_trainer *t) {
    const struct rn_train_config *config = &t->field->config;
    double rays = (double)t->train.frame_count * MOVED_SIGHTS * (1 + 2.0 * RN_POSE_UNKNOWNS);
    double most = MOVED_SHARE * rn_schedule_rays(config, &t->progress) / rays;
    return config->max_seconds > 0 ? (int)fmin(TURNS, fmax(1, most)) : TURNS;
}

bool rn_trainer_poses_due(const struct rn_trainer *t) {
    const struct rn_effect_record *record = record_of(t);
    double done = rn_schedule_done(&t->field->config, &t->progress);
    if (!(done >= MEASURED_AT)) return false;
    if (!record->decided) return !t->poses.gain_known;
    int turns = record->on ? turn_count(t) : 0;
    return t->poses.turns < turns &&
           done >= MEASURED_AT + (LAST_AT - MEASURED_AT) * t->poses.turns / turns;
}

// ---- a pass ----

// In the steps that training takes now.
static struct rn_pose_looker looker_of(const struct rn_trainer *t, int thread) {
    struct rn_pose_looker looker = {t->engine, t->field, thread,
                                    rn_effects_march_trained(t->field)};
    looker.march.step = rn_schedule_march(t->field, &t->progress).step;
    return looker;
}

static struct rn_pose_photo photo_of(const struct rn_pixels *pixels,
                                     const struct rn_pixel_frame *frame) {
    rn_pixels_let_go(pixels);
    return (struct rn_pose_photo){.rgba = pixels->rgba + 4 * frame->offset,
                                  .used = pixels->used ? pixels->used + frame->offset : NULL,
                                  .camera = frame->camera};
}

// How many held-out photographs are measured by: a sight's pixels are rendered where its camera is
// and moved along each unknown both ways.
static int measured_count(const struct rn_trainer *t) {
    double rays =
        MEASURING * MEASURED_SIGHTS * MEASURED_SIDE * MEASURED_SIDE * (1 + 2.0 * RN_POSE_FOCAL);
    double most = MEASURED_SHARE * rn_schedule_rays(&t->field->config, &t->progress) / rays;
    int count = t->held.frame_count;
    return most >= count || count <= FEWEST ? count : most > FEWEST ? (int)most : FEWEST;
}

static void look_held_out(void *context, int index, int thread) {
    struct rn_trainer *t = context;
    struct rn_pose_view *view = &t->poses.views[index];
    struct rn_pose_looker looker = looker_of(t, thread);
    int frame = index * t->held.frame_count / t->poses.view_count; // evenly over all
    struct rn_pose_photo photo = photo_of(&t->held, &t->held.frames[frame]);
    struct rn_pose_draw draw = {.part = RN_POSE_WHOLE,
                                .side = MEASURED_SIDE,
                                .wanted = MEASURED_SIGHTS,
                                .background = looker.march.colour.background,
                                .seed = t->field->config.seed,
                                .stream = STREAM + (uint64_t)index,
                                .counter = (uint64_t)t->poses.pass};
    struct rn_pose_sights looked, scored;
    bool scores = t->poses.pass == MEASURING;
    if (t->poses.pass == 0) view->found = photo.camera;
    rn_pose_draw(&photo, &draw, &looked);
    if (!scores) {
        rn_pose_equations(&looker, &view->found, &looked, &view->equations);
        return;
    }
    draw.wanted = RN_POSE_SIGHTS;
    draw.counter++;
    rn_pose_draw(&photo, &draw, &scored);
    view->before = rn_pose_error(&looker, &photo.camera, &looked, &scored);
    view->after = rn_pose_error(&looker, &view->found, &looked, &scored);
}

static void look_trained(void *context, int index, int thread) {
    struct rn_trainer *t = context;
    struct rn_pose_looker looker = looker_of(t, thread);
    struct rn_pose_photo photo = photo_of(&t->train, &t->train.frames[index]);
    struct rn_pose_sights sights;
    struct rn_pose_draw draw = {.part = RN_POSE_WHOLE,
                                .side = 1,
                                .wanted = MOVED_SIGHTS,
                                .background = looker.march.colour.background,
                                .seed = t->field->config.seed,
                                .stream = STREAM + (uint64_t)index,
                                .counter = 1000 + (uint64_t)t->poses.turns};
    rn_pose_draw(&photo, &draw, &sights);
    rn_pose_equations(&looker, &photo.camera, &sights, &t->poses.views[index].equations);
}

// A move no farther than a step can be trusted.
static void solve(const struct rn_trainer *t, const struct rn_pose_equations *equations,
                  const struct rn_camera *camera, int unknowns, double by[RN_POSE_UNKNOWNS]) {
    double turned = 0, shifted = 0, away = 0;
    const struct rn_bounds *bounds = &t->field->bounds;
    rn_pose_solve(equations, unknowns, DAMPING, by);
    for (int i = 0; i < 3; i++) {
        turned += by[RN_POSE_TURN + i] * by[RN_POSE_TURN + i];
        shifted += by[RN_POSE_SHIFT + i] * by[RN_POSE_SHIFT + i];
        away += pow((camera->world_from_camera[i][3] - bounds->centre[i]) / bounds->radius, 2);
    }
    double pixels = camera->fx * fmax(sqrt(turned), sqrt(shifted / fmax(away, 0.01)));
    for (int k = 0; k < RN_POSE_UNKNOWNS && pixels > FARTHEST; k++)
        by[k] *= FARTHEST / pixels;
}

// ---- whether it gains ----

static void conclude_measuring(struct rn_trainer *t) {
    struct rn_poses *poses = &t->poses;
    double sum = 0;
    if (poses->pass < MEASURING) {
        for (int f = 0; f < poses->view_count; f++) {
            struct rn_pose_view *view = &poses->views[f];
            double by[RN_POSE_UNKNOWNS];
            solve(t, &view->equations, &view->found, RN_POSE_FOCAL, by);
            view->found = rn_pose_move(&view->found, by, t->field->bounds.radius);
        }
        poses->pass++;
        return;
    }
    for (int f = 0; f < poses->view_count; f++)
        sum += 10 * log10(fmax(poses->views[f].before, 1e-10) / fmax(poses->views[f].after, 1e-10));
    poses->gain = sum / poses->view_count;
    poses->gain_known = true;
    poses->pass = 0;
}

// ---- moving ----

static bool same_intrinsics(const struct rn_camera *a, const struct rn_camera *b) {
    return a->lens == b->lens && a->width == b->width && a->height == b->height && a->fx == b->fx &&
           a->fy == b->fy && a->cx == b->cx && a->cy == b->cy &&
           memcmp(a->lens_k, b->lens_k, sizeof a->lens_k) == 0;
}

// What the focal length that photographs of one camera share moves by: their equations with the
// poses eliminated (Schur's complement), and a prior on none.
static double focal_move(const struct rn_trainer *t, int of) {
    const struct rn_camera *camera = &t->train.frames[of].frame->camera;
    double second = 0, first = 0;
    for (int f = 0; f < t->poses.view_count; f++) {
        if (!same_intrinsics(&t->train.frames[f].frame->camera, camera)) continue;
        struct rn_pose_equations e = t->poses.views[f].equations, mixed = e;
        double by[RN_POSE_UNKNOWNS], with[RN_POSE_UNKNOWNS];
        for (int k = 0; k < RN_POSE_FOCAL; k++)
            mixed.b[k] = e.a[RN_POSE_FOCAL][k];
        rn_pose_solve(&e, RN_POSE_FOCAL, DAMPING, by);
        rn_pose_solve(&mixed, RN_POSE_FOCAL, DAMPING, with);
        second += e.a[RN_POSE_FOCAL][RN_POSE_FOCAL];
        first += e.b[RN_POSE_FOCAL];
        for (int k = 0; k < RN_POSE_FOCAL; k++) {
            second -= e.a[RN_POSE_FOCAL][k] * with[k];
            first -= e.a[RN_POSE_FOCAL][k] * by[k];
        }
    }
    first -= FOCAL_PRIOR * (double)t->poses.moves[of][RN_POSE_FOCAL];
    double move = first / (fmax(second, 0) * (1 + DAMPING) + FOCAL_PRIOR);
    return fmin(fmax(move, -FOCAL_STEP), FOCAL_STEP);
}

// Adds a move of the camera where it is to those that brought it there, to second order in them.
static void add_move(float to[RN_POSE_UNKNOWNS], const double by[RN_POSE_UNKNOWNS]) {
    double turn[3], turned[3], shifted[3];
    for (int i = 0; i < 3; i++)
        turn[i] = (double)to[RN_POSE_TURN + i];
    rn_cross(turn, by + RN_POSE_TURN, turned);
    rn_cross(turn, by + RN_POSE_SHIFT, shifted);
    for (int i = 0; i < 3; i++) {
        to[RN_POSE_TURN + i] += (float)(by[RN_POSE_TURN + i] + 0.5 * turned[i]);
        to[RN_POSE_SHIFT + i] += (float)(by[RN_POSE_SHIFT + i] + shifted[i]);
    }
    to[RN_POSE_FOCAL] += (float)by[RN_POSE_FOCAL];
}

// A move in the frame of the scene's ball: the turn's vector, the shift, and where the camera is.
struct world_move {
    double turn[3], shift[3], at[3];
};

static struct world_move in_world(const struct rn_trainer *t, int f) {
    const struct rn_camera *camera = &t->train.frames[f].frame->camera;
    const struct rn_bounds *bounds = &t->field->bounds;
    const float *by = t->poses.moves[f];
    struct world_move move = {{0}, {0}, {0}};
    for (int i = 0; i < 3; i++) {
        move.at[i] = (camera->world_from_camera[i][3] - bounds->centre[i]) / bounds->radius;
        for (int j = 0; j < 3; j++) {
            move.turn[i] += camera->world_from_camera[i][j] * (double)by[RN_POSE_TURN + j];
            move.shift[i] += camera->world_from_camera[i][j] * (double)by[RN_POSE_SHIFT + j];
        }
    }
    return move;
}

static void from_world(const struct rn_camera *camera, const struct world_move *move,
                       float ret[RN_POSE_UNKNOWNS]) {
    for (int j = 0; j < 3; j++) {
        double turn = 0, shift = 0;
        for (int i = 0; i < 3; i++) {
            turn += camera->world_from_camera[i][j] * move->turn[i];
            shift += camera->world_from_camera[i][j] * move->shift[i];
        }
        ret[RN_POSE_TURN + j] = (float)turn;
        ret[RN_POSE_SHIFT + j] = (float)shift;
    }
}

// What a move has beyond the mean turn and shift, and where from their middle; returned: the move.
static struct world_move beyond_mean(const struct world_move *move, const struct world_move *mean,
                                     double ret_from[3]) {
    struct world_move own = *move;
    double around[3];
    for (int i = 0; i < 3; i++)
        ret_from[i] = move->at[i] - mean->at[i];
    rn_cross(mean->turn, ret_from, around);
    for (int i = 0; i < 3; i++) {
        own.turn[i] -= mean->turn[i];
        own.shift[i] = move->shift[i] - mean->shift[i] - around[i];
    }
    return own;
}

// Cameras that all turn, move and scatter together move nothing in their pictures but the gauge, in
// which other photographs' poses are given. Takes off the similarity that is nearest to what they
// did: turn `mean.turn`, shift `mean.shift`, both about `mean.at`, and a scale.
static void keep_gauge(struct rn_trainer *t) {
    struct world_move mean = {{0}, {0}, {0}};
    int count = t->poses.view_count;
    double along = 0, squares = 1e-30, from[3];
    for (int f = 0; f < count; f++) {
        struct world_move move = in_world(t, f);
        for (int i = 0; i < 3; i++) {
            mean.turn[i] += move.turn[i] / count;
            mean.shift[i] += move.shift[i] / count;
            mean.at[i] += move.at[i] / count;
        }
    }
    for (int f = 0; f < count; f++) {
        struct world_move move = in_world(t, f), own = beyond_mean(&move, &mean, from);
        for (int i = 0; i < 3; i++) {
            along += own.shift[i] * from[i];
            squares += from[i] * from[i];
        }
    }
    for (int f = 0; f < count; f++) {
        struct world_move move = in_world(t, f), own = beyond_mean(&move, &mean, from);
        for (int i = 0; i < 3; i++)
            own.shift[i] -= along / squares * from[i];
        from_world(&t->train.frames[f].frame->camera, &own, t->poses.moves[f]);
    }
}

static void tell(struct rn_trainer *t) {
    double turn = 0, shift = 0, n = t->poses.view_count;
    for (int f = 0; f < t->poses.view_count; f++) {
        const float *by = t->poses.moves[f];
        turn += sqrt((double)(by[0] * by[0] + by[1] * by[1] + by[2] * by[2])) / n;
        shift += sqrt((double)(by[3] * by[3] + by[4] * by[4] + by[5] * by[5])) / n;
    }
    rn_effect_tell_moves(&t->field->effects[RN_EFFECT_POSE_REFINEMENT], turn * 180 / M_PI, shift);
}

// The focal lengths' moves first; what is left of the equations moves the poses.
static void conclude_moving(struct rn_trainer *t) {
    for (int f = 0; f < t->poses.view_count; f++) {
        int first = 0;
        while (!same_intrinsics(&t->train.frames[first].frame->camera,
                                &t->train.frames[f].frame->camera))
            first++;
        double focal = first == f ? focal_move(t, f) : t->poses.views[first].focal;
        t->poses.views[f].focal = focal;
    }
    for (int f = 0; f < t->poses.view_count; f++) {
        struct rn_pose_view *view = &t->poses.views[f];
        double by[RN_POSE_UNKNOWNS];
        for (int k = 0; k < RN_POSE_FOCAL; k++)
            view->equations.b[k] -= view->equations.a[RN_POSE_FOCAL][k] * view->focal;
        solve(t, &view->equations, &t->train.frames[f].camera, RN_POSE_FOCAL, by);
        by[RN_POSE_FOCAL] = view->focal;
        add_move(t->poses.moves[f], by);
    }
    keep_gauge(t);
    rn_trainer_place_cameras(t);
    t->poses.turns++;
    tell(t);
}

// ---- a turn ----

static enum rn_status begin_pass(struct rn_trainer *t, int count, struct rn_error *err) {
    struct rn_poses *poses = &t->poses;
    if (poses->views && poses->view_count == count) return RN_OK;
    free(poses->views);
    poses->view_count = count;
    poses->next = 0;
    poses->views = calloc((size_t)count, sizeof *poses->views);
    return poses->views ? RN_OK : rn_error_set(err, RN_ERROR_NO_MEMORY, "poses", "out of memory");
}

enum rn_status rn_trainer_refine_poses(struct rn_trainer *t, bool *ret_busy, struct rn_error *err) {
    struct rn_poses *poses = &t->poses;
    bool measures = !record_of(t)->decided;
    *ret_busy = false;
    if (measures && t->held.frame_count == 0) {
        poses->gain = NAN;
        poses->gain_known = true;
        return RN_OK;
    }
    bool begun = measures && poses->views;
    int count = begun ? poses->view_count : measures ? measured_count(t) : t->train.frame_count;
    enum rn_status status = begin_pass(t, count, err);
    if (status != RN_OK) return status;
    *ret_busy = !rn_pool_run_some(t->engine->pool, count, &poses->next,
                                  measures ? look_held_out : look_trained, t, rn_engine_is_wanted,
                                  t->engine);
    if (*ret_busy) return RN_OK;
    poses->next = 0;
    if (measures)
        conclude_measuring(t);
    else
        conclude_moving(t);
    *ret_busy = measures && !poses->gain_known;
    return RN_OK;
}

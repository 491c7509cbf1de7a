#include "server/engine/scene/appearance.h"

#include <math.h>
#include <string.h>

#define STEPS 12
#define SLOPE 0.05f   // of a code's number, to each side, over which derivatives are taken
#define FARTHEST 0.5  // that a step moves the code by
#define PIXEL 0.1     // how far a photograph's colours are from the field's, for the prior
#define NARROWEST 0.1 // of codes: their spread counts as no less
#define DAMPING 1e-3

_Static_assert(RN_APPEARANCE <= RN_POSE_UNKNOWNS, "its equations are those of a pose");

const float *rn_field_appearances(const struct rn_field *field) {
    const struct rn_parameters *p = &field->parameters;
    return p->appearance_count ? p->values + p->count - p->appearance_count : NULL;
}

// The code of a photograph that no ray was drawn from is 0 in all.
static bool is_trained(const float code[RN_APPEARANCE]) {
    bool any = false;
    for (int i = 0; i < RN_APPEARANCE; i++)
        any |= code[i] != 0;
    return any;
}

struct rn_appearance rn_field_appearance(const struct rn_field *field, size_t photograph) {
    struct rn_appearance out = {.own = false};
    if (photograph >= (size_t)field->config.field.appearances) return out;
    memcpy(out.code, rn_field_appearances(field) + photograph * RN_APPEARANCE, sizeof out.code);
    out.own = is_trained(out.code);
    return out;
}

void rn_field_centre_appearances(struct rn_field *field) {
    const struct rn_parameters *p = &field->parameters;
    float *codes = p->values + p->count - p->appearance_count;
    double mean[RN_APPEARANCE] = {0}, count = 0;
    for (float *code = codes; code < p->values + p->count; code += RN_APPEARANCE) {
        if (!is_trained(code)) continue;
        count++;
        for (int i = 0; i < RN_APPEARANCE; i++)
            mean[i] += (double)code[i];
    }
    for (float *code = codes; code < p->values + p->count; code += RN_APPEARANCE) {
        if (!is_trained(code)) continue;
        for (int i = 0; i < RN_APPEARANCE; i++)
            code[i] -= (float)(mean[i] / count);
    }
}

// The mean square of the codes' numbers, of those that are trained.
static double spread_of(const struct rn_field *field) {
    const struct rn_parameters *p = &field->parameters;
    double sum = 0, count = 0;
    for (size_t i = p->count - p->appearance_count; i < p->count; i++) {
        sum += (double)p->values[i] * (double)p->values[i];
        count += p->values[i] != 0;
    }
    return fmax(count > 0 ? sum / count : 0, NARROWEST * NARROWEST);
}

// Colours of sights, and what they change by with each number of the code.
struct seen {
    rn_pose_colours now, slope[RN_APPEARANCE];
};

static void look(struct rn_pose_looker *looker, const struct rn_camera *camera,
                 const struct rn_pose_sights *sights, const float code[RN_APPEARANCE],
                 rn_pose_colours ret) {
    looker->march.appearances = code;
    rn_pose_look(looker, camera, sights, ret);
}

static void see(struct rn_pose_looker *looker, const struct rn_camera *camera,
                const struct rn_pose_sights *sights, const float code[RN_APPEARANCE],
                struct seen *ret) {
    rn_pose_colours back;
    float moved[RN_APPEARANCE];
    look(looker, camera, sights, code, ret->now);
    for (int k = 0; k < RN_APPEARANCE; k++) {
        memcpy(moved, code, sizeof moved);
        moved[k] = code[k] + SLOPE;
        look(looker, camera, sights, moved, ret->slope[k]);
        moved[k] = code[k] - SLOPE;
        look(looker, camera, sights, moved, back);
        for (int i = 0; i < 3 * sights->count; i++)
            ret->slope[k][i / 3][i % 3] =
                (ret->slope[k][i / 3][i % 3] - back[i / 3][i % 3]) / (2 * SLOPE);
    }
}

static struct rn_pose_equations equations_of(const struct rn_pose_sights *sights,
                                             const struct seen *seen, double prior,
                                             const float code[RN_APPEARANCE]) {
    struct rn_pose_equations e = {.gain = 1};
    for (int i = 0; i < 3 * sights->count; i++) {
        double r = (double)(sights->at[i / 3].target[i % 3] - seen->now[i / 3][i % 3]);
        for (int k = 0; k < RN_APPEARANCE; k++) {
            double slope = (double)seen->slope[k][i / 3][i % 3];
            e.b[k] += slope * r;
            for (int j = 0; j < RN_APPEARANCE; j++)
                e.a[k][j] += slope * (double)seen->slope[j][i / 3][i % 3];
        }
    }
    for (int k = 0; k < RN_APPEARANCE; k++) {
        e.a[k][k] += prior;
        e.b[k] -= prior * (double)code[k];
    }
    return e;
}

static void move(float code[RN_APPEARANCE], const double by[RN_POSE_UNKNOWNS]) {
    double length = 0;
    for (int k = 0; k < RN_APPEARANCE; k++)
        length += by[k] * by[k];
    double share = length > FARTHEST * FARTHEST ? FARTHEST / sqrt(length) : 1;
    for (int k = 0; k < RN_APPEARANCE; k++)
        code[k] += (float)(share * by[k]);
}

void rn_appearance_seek(const struct rn_pose_looker *looker, const struct rn_pose_photo *photo,
                        enum rn_pose_part part, uint64_t seed, float ret_code[RN_APPEARANCE]) {
    struct rn_pose_looker own = *looker;
    struct rn_pose_draw draw = {.part = part,
                                .side = 1,
                                .wanted = RN_POSE_SIGHTS,
                                .background = own.march.colour.background,
                                .seed = seed,
                                .stream = (uint64_t)part};
    double prior = PIXEL * PIXEL / spread_of(looker->field), by[RN_POSE_UNKNOWNS];
    struct rn_pose_sights sights;
    struct seen seen;
    memset(ret_code, 0, RN_APPEARANCE * sizeof *ret_code);
    for (int step = 0; step < STEPS; step++) {
        draw.counter = (uint64_t)step;
        rn_pose_draw(photo, &draw, &sights);
        see(&own, &photo->camera, &sights, ret_code, &seen);
        struct rn_pose_equations e = equations_of(&sights, &seen, prior, ret_code);
        rn_pose_solve(&e, RN_APPEARANCE, DAMPING, by);
        move(ret_code, by);
    }
}

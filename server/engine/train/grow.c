// Growth: training begins on coarse planes and refines them as it goes on (Instant-NGP's and
// TensoRF's coarse-to-fine idea, by doubling). Coarse planes learn the shape in fewer steps, for
// each of their texels sees more samples.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/field/voxels.h"
#include "server/engine/scene/occupancy.h"
#include "server/engine/train/grow.h"
#include "server/engine/train/guard.h"
#include "server/engine/train/schedule.h"
#include "server/engine/train/trainer.h"

// One map made larger, bilinearly, texel centres to texel centres, and scaled. Each number is
// within 3 ULP of the largest of the texels that enter with a weight, constant maps stay as they
// are, and what was positive keeps its relative accuracy: a second moment does not vanish beside a
// larger one. A doubling moves no value of a footprint by more than (|D_u| + |D_v|) / 8 + |D_u D_v|
// / 64, D the largest second differences of the texels (tests/numerics/growth.c).
struct enlarge {
    const float *from;
    float *to;
    int old, side, channels; // texels a side before and after
    float scale;
};

static void enlarge_row(void *context, int index, int thread) {
    (void)thread;
    const struct enlarge *e = context;
    int plane = index / e->side, y = index % e->side;
    double ratio = (double)e->old / e->side;
    double v = fmin(fmax((y + 0.5) * ratio - 0.5, 0), e->old - 1);
    int row = (int)v;
    float fy = (float)(v - row);
    size_t stride = (size_t)e->old * (size_t)e->channels, below = row + 1 < e->old ? stride : 0;
    const float *upper = e->from + ((size_t)plane * (size_t)e->old + (size_t)row) * stride;
    float *out = e->to + (size_t)index * (size_t)e->side * (size_t)e->channels;
    for (int x = 0; x < e->side; x++) {
        double u = fmin(fmax((x + 0.5) * ratio - 0.5, 0), e->old - 1);
        int column = (int)u, right = column + 1 < e->old ? e->channels : 0;
        float fx = (float)(u - column);
        const float *a = upper + (size_t)column * (size_t)e->channels, *b = a + below;
        for (int c = 0; c < e->channels; c++) {
            float top = a[c] + fx * (a[c + right] - a[c]);
            float bottom = b[c] + fx * (b[c + right] - b[c]);
            *out++ = e->scale * (top + fy * (bottom - top));
        }
    }
}

// Voxels made larger, trilinearly, likewise: within 5 ULP of the largest that enter.
struct enlarge_voxels {
    const float *from;
    float *to;
    int old, side; // voxels a side before and after
    float scale;
};

// Where voxel i of `side` falls among `old`: the one before, how far the next is, its weight.
static int voxel_before(const struct enlarge_voxels *e, int i, int *ret_next, float *ret_weight) {
    double p = fmin(fmax((i + 0.5) * e->old / e->side - 0.5, 0), e->old - 1);
    int low = (int)p;
    *ret_next = low + 1 < e->old ? 1 : 0;
    *ret_weight = (float)(p - low);
    return low;
}

static float between(const float *a, size_t next, float weight) {
    return a[0] + weight * (a[next] - a[0]);
}

static void enlarge_voxel_row(const struct enlarge_voxels *e, int row) {
    int next[3];
    float f[3];
    size_t a_row = (size_t)e->old * RN_VOXEL_CHANNELS, slice = a_row * (size_t)e->old;
    int y = voxel_before(e, row % e->side, &next[1], &f[1]);
    int z = voxel_before(e, row / e->side, &next[2], &f[2]);
    const float *from = e->from + (size_t)z * slice + (size_t)y * a_row;
    size_t below = next[1] ? a_row : 0, behind = next[2] ? slice : 0;
    float *out = e->to + (size_t)row * (size_t)e->side * RN_VOXEL_CHANNELS;
    for (int i = 0; i < e->side; i++) {
        int x = voxel_before(e, i, &next[0], &f[0]);
        size_t right = next[0] ? RN_VOXEL_CHANNELS : 0;
        for (int c = 0; c < RN_VOXEL_CHANNELS; c++) {
            const float *a = from + (size_t)x * RN_VOXEL_CHANNELS + c, *b = a + behind;
            float near[2] = {between(a, right, f[0]), between(a + below, right, f[0])};
            float far[2] = {between(b, right, f[0]), between(b + below, right, f[0])};
            float ends[2] = {between(near, 1, f[1]), between(far, 1, f[1])};
            *out++ = e->scale * between(ends, 1, f[2]);
        }
    }
}

// What a field knows of space.
static void carry_grids(const struct rn_field *from, struct rn_field *to) {
    size_t side = (size_t)from->config.field.occupancy, cells = side * side * side;
    memcpy(to->occupancy, from->occupancy, cells * sizeof *to->occupancy);
    memcpy(to->hull, from->hull, cells);
    to->hull_cells = from->hull_cells;
    to->cpu.disparity = from->cpu.disparity;
    rn_field_refresh_occupancy(to);
}

// What a field knows of its training. A validation that ends meanwhile changes it.
static void carry_record(const struct rn_field *from, struct rn_field *to) {
    memcpy(to->effects, from->effects, sizeof to->effects);
    memcpy(to->kernels, from->kernels, sizeof to->kernels);
    to->finest_cone = from->finest_cone;
    to->steps = from->steps;
    to->train_seconds = from->train_seconds;
    to->psnr = from->psnr;
}

// A growth under way, beside the field that is rendered meanwhile: the larger one, and the block of
// its gradients and moments. The moments follow their texels: a texel of the new grid gets a
// quarter of the gradient, so its moments are a quarter and a sixteenth of the old; a voxel's part
// is as the cube of the sides.
struct rn_growth {
    struct rn_field *field;
    float *grad;
    int stage, next; // next row of the stage that carries rows
};

void rn_trainer_drop_growth(struct rn_trainer *t) {
    if (!t->growth) return;
    rn_field_destroy(&t->growth->field);
    rn_block_destroy(t->growth->grad);
    free(t->growth);
    t->growth = NULL;
}

// Parameters and moments of both sizes, as blocks of one layout.
struct carry {
    struct enlarge planes[3];
    struct enlarge_voxels voxels[3];
    int plane_rows; // of all planes
    const struct rn_parameters *old, *new;
};

static struct carry carry_of(const struct rn_trainer *t) {
    const struct rn_field *from = t->field, *to = t->growth->field;
    const struct rn_field_config *c = &to->config.field;
    int old = from->config.field.base;
    float share = powf((float)old / (float)c->base, 2);
    float *m = t->growth->grad + rn_optimiser_moments(to), *v = m + rn_optimiser_moments(to);
    struct carry carry = {
        .plane_rows = c->planes * c->base,
        .planes = {{from->parameters.values, to->parameters.values, old, c->base, c->channels, 1},
                   {t->optimiser.m, m, old, c->base, c->channels, share},
                   {t->optimiser.v, v, old, c->base, c->channels, share * share}},
        .old = &from->parameters,
        .new = &to->parameters};
    for (int i = 0; i < 3; i++) {
        const struct enlarge *e = &carry.planes[i];
        const struct rn_field_config *before = &from->config.field;
        int side = rn_voxel_side(before), new_side = rn_voxel_side(c);
        carry.voxels[i] =
            (struct enlarge_voxels){.from = e->from + (size_t)c->planes * rn_grid_numbers(before),
                                    .to = e->to + (size_t)c->planes * rn_grid_numbers(c),
                                    .old = side,
                                    .side = new_side,
                                    .scale = powf((float)side / (float)new_side, 3 * (float)i)};
    }
    return carry;
}

static void carry_row(void *context, int index, int thread) {
    const struct carry *carry = context;
    int row = index / 3;
    if (row < carry->plane_rows)
        enlarge_row((void *)&carry->planes[index % 3], row, thread);
    else
        enlarge_voxel_row(&carry->voxels[index % 3], row - carry->plane_rows);
}

static void carry_networks(const struct carry *carry) {
    const struct rn_parameters *p = carry->new;
    for (int i = 0; i < 3; i++)
        memcpy(carry->planes[i].to + p->plane_count,
               carry->planes[i].from + carry->old->plane_count,
               rn_parameters_behind(p) * sizeof(float));
}

// ---- stages: each takes some milliseconds, or can be cut short --------------------------------

static enum rn_status make_field(struct rn_trainer *t, struct rn_error *err) {
    struct rn_train_config config = t->field->config;
    config.field.base = rn_schedule_base(&t->field->config, &t->progress);
    enum rn_status status = rn_field_create(&config, &t->field->bounds, &t->growth->field, err);
    if (status != RN_OK) return status;
    t->growth->grad = rn_block_create(3 * rn_optimiser_moments(t->growth->field) * sizeof(float));
    if (!t->growth->grad) return rn_error_set(err, RN_ERROR_NO_MEMORY, "trainer", "out of memory");
    return RN_OK;
}

static enum rn_status make_grids(struct rn_trainer *t, struct rn_error *err) {
    (void)err;
    carry_grids(t->field, t->growth->field);
    return RN_OK;
}

static enum rn_status carry_rows(struct rn_trainer *t, struct rn_error *err) {
    (void)err;
    struct carry carry = carry_of(t);
    const struct rn_field_config *c = &t->growth->field->config.field;
    int side = rn_voxel_side(c), rows = 3 * (carry.plane_rows + (c->voxels ? side * side : 0));
    if (!rn_pool_run_some(t->engine->pool, rows, &t->growth->next, carry_row, &carry,
                          rn_engine_is_wanted, t->engine))
        t->growth->stage--; // this stage again
    else
        carry_networks(&carry);
    return RN_OK;
}

// The field's contents move; the field keeps its address. Not to be cut short: a device has no copy
// of what moves in, and training stays there only if whoever called brings it at once.
static enum rn_status move_in(struct rn_trainer *t, struct rn_error *err) {
    carry_record(t->field, t->growth->field);
    struct rn_field swap = *t->field;
    *t->field = *t->growth->field;
    *t->growth->field = swap;
    t->field->cpu.config = &t->field->config.field;
    t->growth->field->cpu.config = &t->growth->field->config.field;
    rn_block_destroy(t->optimiser.grad);
    rn_trainer_free_step(t);
    t->optimiser.grad = t->growth->grad;
    t->growth->grad = NULL;
    rn_field_destroy(&t->growth->field); // the old planes go before what follows needs memory
    enum rn_status status = rn_trainer_set_up(t, err);
    if (status == RN_OK) status = rn_trainer_keep_good(t, err);
    if (status == RN_OK) rn_field_refresh(t->field, t->engine);
    return status;
}

static enum rn_status (*const stages[])(struct rn_trainer *t, struct rn_error *err) = {
    make_field, make_grids, carry_rows, move_in};
#define STAGES (int)(sizeof stages / sizeof *stages)

bool rn_trainer_grows(const struct rn_trainer *t) {
    int base = t->field->config.field.base;
    return t->field->config.grow_to > base &&
           rn_schedule_base(&t->field->config, &t->progress) > base;
}

enum rn_status rn_trainer_grow(struct rn_trainer *t, struct rn_error *err) {
    if (!t->growth) {
        // What is not finite, or makes steps be rejected (it overflows on its way), is left to the
        // guard at the step's end: it must not become the state that a rollback returns to.
        if (!rn_trainer_grows(t) || t->optimiser.rejected > 0 || !rn_trainer_all_finite(t))
            return RN_OK;
        t->growth = calloc(1, sizeof *t->growth);
        if (!t->growth) return rn_error_set(err, RN_ERROR_NO_MEMORY, "trainer", "out of memory");
    }
    do {
        enum rn_status status = stages[t->growth->stage++](t, err);
        if (status != RN_OK) return status;
    } while (t->growth->stage < STAGES && !rn_engine_is_wanted(t->engine));
    if (t->growth->stage == STAGES) rn_trainer_drop_growth(t);
    return RN_OK;
}

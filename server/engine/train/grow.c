// Growth: training begins on coarse planes and refines them as it goes on (Instant-NGP's and
// TensoRF's coarse-to-fine idea, by doubling). Coarse planes learn the shape in fewer steps, for
// each of their texels sees more samples.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/train/trainer.h"

#define LAST_GROWTH 0.35 // fraction of the run at which the planes reach their final size
#define EARLIER 0.3      // each doubling before that comes at this share of the next one's fraction

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

// Planes, then networks, of a block laid out as the old field's parameters.
static void carry_over(struct rn_trainer *t, const struct rn_field *old, const float *from,
                       float *to, float scale) {
    const struct rn_field_config *c = &t->field->config.field;
    const struct rn_parameters *p = &t->field->parameters;
    struct enlarge e = {from, to, old->config.field.base, c->base, c->channels, scale};
    rn_pool_run(t->engine->pool, c->planes * c->base, enlarge_row, &e);
    memcpy(to + p->plane_count, from + old->parameters.plane_count,
           (p->base_count + p->head_count) * sizeof *to);
}

// What a field knows beyond its parameters.
static void carry_knowledge(const struct rn_field *from, struct rn_field *to) {
    size_t side = (size_t)from->config.field.occupancy, cells = side * side * side;
    memcpy(to->occupancy, from->occupancy, cells * sizeof *to->occupancy);
    memcpy(to->hull, from->hull, cells);
    memcpy(to->effects, from->effects, sizeof to->effects);
    memcpy(to->kernels, from->kernels, sizeof to->kernels);
    to->hull_cells = from->hull_cells;
    to->steps = from->steps;
    to->train_seconds = from->train_seconds;
    to->psnr = from->psnr;
}

// The base side that the run should have by now.
static int wanted_base(const struct rn_trainer *t) {
    const struct rn_train_config *c = &t->field->config;
    double fraction = rn_trainer_fraction(t);
    int base = c->grow_to;
    if (isnan(fraction)) return base;
    for (double at = LAST_GROWTH; base / 2 >= c->field.base && fraction < at; at *= EARLIER)
        base /= 2;
    return base;
}

// The field's contents move to one with larger planes; the field keeps its address. The moments
// follow their texels: a texel of the new grid gets a quarter of the gradient, so its moments are a
// quarter and a sixteenth of the old.
static enum rn_status grow_to(struct rn_trainer *t, int base, struct rn_error *err) {
    struct rn_train_config config = t->field->config;
    struct rn_field *other;
    config.field.base = base;
    enum rn_status status = rn_field_create(&config, &t->field->bounds, &other, err);
    if (status != RN_OK) return status;
    carry_knowledge(t->field, other);
    struct rn_field swap = *t->field;
    *t->field = *other;
    *other = swap;
    float *grad = t->grad, *m = t->m, *v = t->v;
    float share = powf((float)other->config.field.base / (float)base, 2);
    rn_trainer_free_step(t);
    t->grad = NULL;
    status = rn_trainer_set_up(t, err);
    if (status == RN_OK) {
        carry_over(t, other, other->parameters.values, t->field->parameters.values, 1);
        carry_over(t, other, m, t->m, share);
        carry_over(t, other, v, t->v, share * share);
        status = rn_trainer_keep_good(t, err);
    }
    free(grad);
    rn_field_destroy(&other);
    if (status != RN_OK) return status;
    rn_field_refresh(t->field, t->engine);
    rn_field_refresh_occupancy(t->field);
    return RN_OK;
}

bool rn_trainer_grows(const struct rn_trainer *t) {
    int base = t->field->config.field.base;
    return t->field->config.grow_to > base && wanted_base(t) > base;
}

enum rn_status rn_trainer_grow(struct rn_trainer *t, struct rn_error *err) {
    if (!rn_trainer_grows(t)) return RN_OK;
    // What is not finite, or makes steps be rejected (it overflows on its way), is left to the
    // guard at the step's end: it must not become the state that a rollback returns to.
    bool good = t->rejected == 0 && rn_trainer_all_finite(t);
    return good ? grow_to(t, wanted_base(t), err) : RN_OK;
}

// Case 8: parameters that are finite as fp32 and overflow on their way: as bf16 (the largest float
// rounds to infinity), in a product, in a sum. On every kernel set the step is skipped, changing
// nothing; when that does not help training returns to good parameters, and it learns again.
#include <float.h>

#include "tests/numerics/trainer.h"

#define OVERFLOWS 3
static const char *const names[OVERFLOWS] = {"bf16: the largest float in both networks",
                                             "1e30 in two layers", "the largest float in texels"};

static void overflow(struct rn_trainer *t, int what, struct numerics_random *random) {
    const struct rn_parameters *p = &t->field->parameters;
    const struct rn_mlp_shape *shape = &t->field->cpu.base_shape;
    float *base = p->values + p->plane_count, *head = base + p->base_count;
    if (what == 0) {
        base[(int)numerics_uniform(random, 0, shape->in[0] * shape->out[0])] = FLT_MAX;
        head[(int)numerics_uniform(random, 0, t->field->config.field.width)] = -FLT_MAX;
    }
    for (int l = 0; l < 2 && what == 1; l++)
        for (int i = 0; i < shape->in[l] * shape->out[l]; i++)
            base[shape->offset[l] + (size_t)i] = i % 2 ? -1e30f : 1e30f;
    for (size_t i = 0; i < p->plane_count && what == 2; i++)
        p->values[i] = numerics_uniform(random, 0, 1) < 0.5 ? -FLT_MAX : FLT_MAX;
    rn_field_refresh(t->field, t->engine);
}

// Bytes of the parameters that the first step after changed; then to the end.
static void see_overflow(struct numerics_case cases[3], struct rn_engine *engine,
                         const struct rn_dataset *dataset, int what,
                         struct numerics_random *random) {
    struct rn_trainer *t = make_trainer(engine, dataset, 1);
    while (t->progress.step < 10)
        advance(t);
    overflow(t, what, random);
    size_t bytes = t->field->parameters.count * sizeof(float);
    float *before = malloc(bytes);
    if (!before) exit(1);
    memcpy(before, t->field->parameters.values, bytes);
    advance(t);
    bool skipped = t->progress.steps_rejected == 1 && t->progress.step == 11;
    bool same = memcmp(before, t->field->parameters.values, bytes) == 0;
    numerics_see(&cases[0], !(skipped && same), "%s", names[what]);
    while (advance(t))
        continue;
    numerics_see(&cases[1], t->progress.loss, "%s, %d steps rejected, %d rollback", names[what],
                 (int)t->progress.steps_rejected, (int)t->progress.rollbacks);
    bool grown = t->field->config.field.base == t->field->config.grow_to;
    numerics_see(&cases[2], t->progress.rollbacks == 1 && grown ? count_left(engine, t) : INFINITY,
                 "%s, base %d", names[what], t->field->config.field.base);
    free(before);
    rn_trainer_destroy(&t);
}

static int check_set(const struct rn_dataset *dataset, const struct rn_kernels *kernels,
                     struct numerics_random *random) {
    static const char *const what[3] = {"an overflowing step is skipped",
                                        "loss after recovering from overflow",
                                        "non-finite numbers left by overflow"};
    const char *range = "planted after step 10 of 60, the planes grow at step 21";
    char text[3][80];
    for (int i = 0; i < 3; i++)
        snprintf(text[i], sizeof text[i], "8 %s, %s", what[i], kernels->name);
    struct numerics_case cases[3] = {{text[0], range, "not skipped", 0.5, 0, ""},
                                     {text[1], range, "absolute, untrained 0.2", 0.1, 0, ""},
                                     {text[2], range, "numbers", 0.5, 0, ""}};
    struct rn_engine_options options = {.device = "cpu", .threads = 1, .kernels = kernels->name};
    struct rn_error err = {0};
    struct rn_engine *engine;
    must(rn_engine_create(&options, &engine, &err), &err);
    for (int i = rn_kernels_bf16(kernels) ? 0 : 1; i < OVERFLOWS; i++)
        see_overflow(cases, engine, dataset, i, random);
    rn_engine_destroy(&engine);
    return numerics_close(&cases[0]) + numerics_close(&cases[1]) + numerics_close(&cases[2]);
}

int main(void) {
    struct numerics_random random = numerics_random();
    const struct rn_kernels *kernels;
    struct rn_error err = {0};
    int failed = 0;
    if (!mkdtemp(folder)) return 1;
    struct rn_dataset *dataset = read_views(6);
    for (int i = 0; (kernels = rn_kernels_available(i)); i++)
        failed += check_set(dataset, kernels, &random);
    rn_dataset_destroy(&dataset);
    must(rn_remove_tree(folder, &err), &err);
    return failed > 0;
}

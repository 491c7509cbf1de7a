// Case 9: what went wrong is recorded with the offending rays, and the record reproduces it; what
// is not finite is never rendered, and never read back from a file.
#include <float.h>
#include <math.h>

#include "server/engine/checkpoint/checkpoint.h"
#include "tests/numerics/trainer.h"

// ---- the record -----------------------------------------------------------------------------

static struct rn_march_ray replayed(const struct rn_incident_ray *ray) {
    struct rn_march_ray out = {.near = ray->near,
                               .length = ray->length,
                               .radius = ray->radius,
                               .stride = ray->stride,
                               .weight = ray->weight,
                               .id = ray->id};
    memcpy(out.origin, ray->origin, sizeof out.origin);
    memcpy(out.direction, ray->direction, sizeof out.direction);
    memcpy(out.target, ray->target, sizeof out.target);
    return out;
}

// Rays of the record that are not as expected: sound, or wild as they were recorded.
static double count_wrong(struct rn_trainer *t, const struct rn_incident *incident, bool wild) {
    double wrong = 0;
    rn_field_refresh(t->field, t->engine);
    for (int r = 0; r < incident->ray_count; r++) {
        struct rn_march_ray ray = replayed(&incident->rays[r]);
        enum rn_ray_fault fault =
            rn_try_rays(t->engine->kernels, &t->field->cpu, &t->step.march, &ray, 0, 1,
                        rn_engine_workspace(t->engine, 0), &t->step.groups[0], NULL);
        wrong += fault != (wild ? incident->rays[r].fault : RN_FAULT_NONE);
    }
    return wrong;
}

// After a rollback: where, when and which rays; all are sound with the parameters that were
// restored, and wild again with those of that step, `before`, and the recorded ones in their
// places. Moments are no parameters: what they spoil is.
static void see_record(struct numerics_case *c, struct rn_trainer *t, int what,
                       const float *before) {
    struct rn_incident incident;
    float *values = t->field->parameters.values;
    int faults = 0;
    bool any = rn_trainer_take_incident(t, &incident);
    while (any && incident.kind != RN_INCIDENT_ROLLBACK)
        any = rn_trainer_take_incident(t, &incident);
    if (!any || incident.step != 10 || incident.seed != t->field->config.seed ||
        incident.ray_count == 0 || incident.parameter_count == 0) {
        numerics_see(c, INFINITY, "%s: step %lld, %d rays, %d parameters", plant_names[what],
                     any ? (long long)incident.step : -1, any ? incident.ray_count : 0,
                     any ? incident.parameter_count : 0);
        return;
    }
    for (int r = 0; r < incident.ray_count; r++)
        faults += incident.rays[r].fault != RN_FAULT_NONE;
    double wrong = count_wrong(t, &incident, false) > 0 ? INFINITY : 0;
    memcpy(values, before, t->field->parameters.count * sizeof *values);
    for (int i = 0; i < incident.parameter_count; i++)
        values[incident.parameters[i].index] = incident.parameters[i].value;
    if (what < 6) // 32 of all texels are too few
        wrong += count_wrong(t, &incident, true);
    numerics_see(c, wrong, "%s: %d of %d rays at fault, %llu parameters", plant_names[what], faults,
                 incident.ray_count, (unsigned long long)incident.nonfinite_parameters);
}

static int check_records(struct rn_engine *engine, const struct rn_dataset *dataset,
                         struct numerics_random *random) {
    struct numerics_case c = {"9 recorded rays that do not replay",
                              "planted in seven places, with and without the recorded numbers",
                              "rays",
                              0.5,
                              0,
                              ""};
    for (int what = 0; what < PLANTS; what++) {
        struct rn_trainer *t = make_trainer(engine, dataset, 1);
        while (t->progress.step < 10)
            advance(t);
        size_t bytes = t->field->parameters.count * sizeof(float);
        float *before = malloc(bytes);
        if (!before) abort();
        memcpy(before, t->field->parameters.values, bytes);
        plant(t, what, random);
        while (t->progress.rollbacks == 0 && advance(t))
            continue;
        see_record(&c, t, what, before);
        free(before);
        rn_trainer_destroy(&t);
    }
    return numerics_close(&c);
}

// A step over a background that is no number, or so large that gradients are none.
struct behind {
    float renderer, photographs; // what each sees; 0: as it was. Photographs are integers: nothing
                                 // else can enter them
    bool rejected;               // the step, and no ray left out
};

static void see_background(struct numerics_case *c, struct rn_engine *engine,
                           const struct rn_dataset *dataset, const struct behind *behind) {
    struct rn_trainer *t = make_trainer(engine, dataset, 1);
    struct rn_incident incident = {0};
    float *background = t->field->config.background, before = *background;
    t->field->config.random_background = 0; // the photographs lie over that one
    while (t->progress.step < 16)
        advance(t);
    rn_trainer_update_occupancy(t);
    if (behind->renderer != 0) *background = behind->renderer;
    rn_trainer_begin_step(t);
    *background = behind->photographs != 0 ? behind->photographs : before;
    while (t->step.under_way)
        rn_trainer_run_wave(t);
    *background = before;
    uint64_t rays = t->progress.nonfinite_rays;
    bool good = rn_trainer_take_incident(t, &incident) && incident.step == 16 &&
                incident.kind == (behind->rejected ? RN_INCIDENT_REJECTED : RN_INCIDENT_RAYS) &&
                t->progress.steps_rejected == behind->rejected && (rays > 0) != behind->rejected &&
                incident.ray_count > 0;
    for (int r = 0; r < incident.ray_count && !behind->rejected; r++)
        good &= incident.rays[r].fault == RN_FAULT_COLOUR;
    while (advance(t))
        continue;
    good &= t->progress.nonfinite_rays == rays && t->progress.rollbacks == 0;
    double left = count_left(engine, t);
    numerics_see(c, !good + left, "%llu rays, %d listed, %g numbers left%s",
                 (unsigned long long)rays, incident.ray_count, left,
                 behind->rejected ? ", step rejected" : "");
    rn_trainer_destroy(&t);
}

static int check_background(struct rn_engine *engine, const struct rn_dataset *dataset) {
    static const struct behind all[] = {{0, NAN, false}, {NAN, NAN, false}, {FLT_MAX, 0, true}};
    struct numerics_case c = {
        "9 NaN or 3e38 behind the photographs: left out or rejected, recorded, gone",
        "one step of 60",
        "wrong",
        0.5,
        0,
        ""};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++)
        see_background(&c, engine, dataset, &all[i]);
    return numerics_close(&c);
}

// Each rollback halves the rate; the last one ends the training.
static int check_rates(struct rn_engine *engine, const struct rn_dataset *dataset,
                       struct numerics_random *random) {
    struct numerics_case c = {
        "9 learning rate after a rollback", "NaN before every step", "from half", 1e-12, 0, ""};
    struct rn_trainer *t = make_trainer(engine, dataset, 1);
    struct rn_incident incident;
    double rates[8];
    int n = 0;
    bool more = true;
    t->field->config.max_steps = 1000000; // the schedule stands still
    while (more) {
        struct rn_error err;
        plant(t, 1, random);
        more = rn_trainer_advance(t, 0, &err) == RN_OK;
        while (rn_trainer_take_incident(t, &incident) && n < 8)
            if (incident.kind == RN_INCIDENT_ROLLBACK) rates[n++] = incident.rate;
    }
    for (int i = 1; i < n; i++)
        numerics_see(&c, fabs(rates[i] / rates[i - 1] - 0.5), "rollback %d, rate %g", i, rates[i]);
    numerics_see(&c, n == 4 ? 0 : INFINITY, "%d rollbacks", n);
    rn_trainer_destroy(&t);
    return numerics_close(&c);
}

// ---- rendered and read ----------------------------------------------------------------------

static int check_rendered(const struct rn_dataset *dataset, const struct rn_kernels *kernels,
                          struct numerics_random *random) {
    char names[2][80];
    snprintf(names[0], sizeof names[0], "9 non-finite numbers rendered, %s", kernels->name);
    snprintf(names[1], sizeof names[1], "9 pictures whose replaced rays are not counted, %s",
             kernels->name);
    struct numerics_case c = {
        names[0], "four kinds in the parameters themselves", "numbers", 0.5, 0, ""};
    struct numerics_case counted = {
        names[1], "with and without NaN in a colour's weights", "pictures", 0.5, 0, ""};
    static const int kinds[] = {0, 1, 2, 6};
    struct rn_engine_options options = {.device = "cpu", .threads = 1, .kernels = kernels->name};
    struct rn_error err = {0};
    struct rn_engine *engine;
    must(rn_engine_create(&options, &engine, &err), &err);
    for (int i = 0; i < 4; i++) {
        struct rn_trainer *t = make_trainer(engine, dataset, 1);
        while (t->progress.step < 20) // something is to be seen
            advance(t);
        count_rendered(engine, t, &dataset->frames[0].camera);
        numerics_see(&counted, replaced != 0, "nothing planted");
        plant(t, kinds[i], random);
        t->field->fresh_levels = 0;
        for (size_t f = 0; f < dataset->frame_count; f += 3) {
            numerics_see(&c, count_rendered(engine, t, &dataset->frames[f].camera), "%s",
                         plant_names[kinds[i]]);
            if (kinds[i] == 2) numerics_see(&counted, replaced == 0, "%s", plant_names[2]);
        }
        rn_trainer_destroy(&t);
    }
    rn_engine_destroy(&engine);
    return numerics_close(&c) + numerics_close(&counted);
}

// Whether a file with a number of the tensor at `at` spoilt is refused as damaged.
static bool refused(struct rn_engine *engine, const struct rn_dataset *dataset, const char *path,
                    uint8_t *bytes, size_t size, size_t at, float wild) {
    struct rn_error err = {0};
    struct rn_trainer *t = NULL;
    float kept;
    memcpy(&kept, bytes + at, sizeof kept);
    memcpy(bytes + at, &wild, sizeof wild);
    must(rn_file_write_atomic(path, bytes, size, &err), &err);
    memcpy(bytes + at, &kept, sizeof kept);
    enum rn_status status = rn_trainer_restore(engine, dataset, path, 0, &t, &err);
    rn_trainer_destroy(&t);
    return status == RN_ERROR_CORRUPT && strstr(err.text, "non-finite");
}

static int check_checkpoints(struct rn_engine *engine, const struct rn_dataset *dataset) {
    struct numerics_case c = {
        "9 spoilt checkpoints read", "NaN and infinity in each fp32 tensor", "files", 0.5, 0, ""};
    struct rn_error err = {0};
    struct rn_trainer *t = make_trainer(engine, dataset, 1);
    char path[64];
    uint8_t *bytes;
    size_t size;
    int tensors = 0;
    snprintf(path, sizeof path, "%s/spoilt", folder);
    advance(t);
    must(rn_trainer_save(t, path, &err), &err);
    must(rn_file_read(path, 1u << 30, &bytes, &size, &err), &err);
    uint64_t header;
    memcpy(&header, bytes, sizeof header);
    const char *at = (const char *)bytes + 8;
    while ((at = strstr(at, "\"F32\"")) && at < (const char *)bytes + 8 + header) {
        const char *offsets = strstr(at, "data_offsets");
        size_t first = offsets ? strtoull(strchr(offsets, '[') + 1, NULL, 10) : 0;
        first += 8 + header + 4 * (size_t)(tensors % 3);
        numerics_see(&c, !refused(engine, dataset, path, bytes, size, first, NAN), "tensor %d",
                     tensors);
        numerics_see(&c, !refused(engine, dataset, path, bytes, size, first, INFINITY), "tensor %d",
                     tensors);
        tensors++;
        at++;
    }
    numerics_see(&c, tensors >= 6 ? 0 : INFINITY, "%d tensors found", tensors);
    free(bytes);
    rn_trainer_destroy(&t);
    return numerics_close(&c);
}

// A cell that is no number is measured anew, and none is saved.
static int check_cells(struct rn_engine *engine, const struct rn_dataset *dataset) {
    struct numerics_case c = {"9 occupancy cells left non-finite",
                              "all planted, saved or refreshed",
                              "cells",
                              0.5,
                              0,
                              ""};
    struct rn_error err = {0};
    char path[64];
    snprintf(path, sizeof path, "%s/cells", folder);
    for (int saved = 0; saved < 2; saved++) {
        struct rn_trainer *t = make_trainer(engine, dataset, 1);
        size_t side = (size_t)t->field->config.field.occupancy, n = side * side * side;
        advance(t);
        for (size_t i = 0; i < n; i++)
            t->field->occupancy[i] = i % 2 ? NAN : INFINITY;
        if (saved) must(rn_trainer_save(t, path, &err), &err);
        for (int i = 0; i < 4 && !saved; i++) { // each cell's turn comes once
            t->progress.step = RN_OCCUPANCY_EVERY * (RN_OCCUPANCY_WARM_UP + i);
            rn_trainer_update_occupancy(t);
        }
        double wild = 0;
        size_t word = 0;
        for (size_t i = 0; i < t->hull.count; i++)
            wild += !isfinite(t->field->occupancy[rn_hull_cell(t, i, &word)]);
        numerics_see(&c, wild, "%s", saved ? "saved" : "refreshed");
        rn_trainer_destroy(&t);
    }
    return numerics_close(&c);
}

int main(void) {
    struct numerics_random random = numerics_random();
    struct rn_engine_options options = {.device = "cpu", .threads = 1};
    struct rn_engine *engine;
    struct rn_error err = {0};
    const struct rn_kernels *kernels;
    if (!mkdtemp(folder)) return 1;
    must(rn_engine_create(&options, &engine, &err), &err);
    struct rn_dataset *dataset = read_views(6);
    int failed = check_records(engine, dataset, &random) + check_background(engine, dataset);
    failed += check_rates(engine, dataset, &random) + check_checkpoints(engine, dataset);
    failed += check_cells(engine, dataset);
    for (int i = 0; (kernels = rn_kernels_available(i)); i++)
        failed += check_rendered(dataset, kernels, &random);
    rn_dataset_destroy(&dataset);
    rn_engine_destroy(&engine);
    must(rn_remove_tree(folder, &err), &err);
    return failed > 0;
}

#include "server/engine/doctor/doctor.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "common/math/rng.h"
#include "server/engine/doctor/cases.h"
#include "server/engine/scene/device.h"

// ---- cases ----------------------------------------------------------------------------------

struct rn_doctor_case *rn_doctor_open(struct rn_doctor_result *result, const char *name,
                                      const char *kernels, double bound, const char *unit) {
    static struct rn_doctor_case none; // more cases than there is room for: none is closed
    if (result->case_count == RN_DOCTOR_CASES) return &none;
    struct rn_doctor_case *c = &result->cases[result->case_count];
    *c = (struct rn_doctor_case){.bound = bound};
    snprintf(c->name, sizeof c->name, "%s", name);
    snprintf(c->kernels, sizeof c->kernels, "%s", kernels);
    snprintf(c->unit, sizeof c->unit, "%s", unit);
    return c;
}

void rn_doctor_see(struct rn_doctor_case *c, double error, const char *where, ...) {
    if (isnan(error)) error = INFINITY;
    if (!(error > c->worst) && *c->where) return;
    c->worst = error;
    va_list args;
    va_start(args, where);
    vsnprintf(c->where, sizeof c->where, where, args);
    va_end(args);
}

void rn_doctor_close(struct rn_doctor_result *result, struct rn_doctor_case *c) {
    bool shown = isnan(c->bound);
    c->passed = !c->skipped && *c->where && (shown || c->worst <= c->bound);
    result->passed &= c->passed || c->skipped;
    result->case_count++;
}

double rn_doctor_uniform(struct rn_doctor_random *random, double low, double high) {
    struct rn_rng4 draw = rn_rng_draw(random->seed, 0x646f63, random->count++);
    uint64_t bits = ((uint64_t)draw.v[0] << 32 | draw.v[1]) >> 11;
    return low + (high - low) * ((double)bits * 0x1p-53);
}

double rn_doctor_spread(struct rn_doctor_random *random, double low, double high) {
    return low * exp(rn_doctor_uniform(random, 0, log(high / low)));
}

// ---- the whole ------------------------------------------------------------------------------

static void say(void (*progress)(const char *what), const char *what) {
    if (progress) progress(what);
}

static void see_device(struct rn_doctor_result *result, const char *name, double bound,
                       const char *unit, double error, const char *where) {
    struct rn_doctor_case *c = rn_doctor_open(result, name, "cuda", bound, unit);
    rn_doctor_see(c, error, "%.120s", where);
    rn_doctor_close(result, c);
}

// The first GPU beside the CPU's kernels, or why there is none. (`meson test` holds its kernels
// against float64.)
static void check_cuda(struct rn_doctor_result *result) {
    struct rn_engine_options first = {.device = "cuda:0", .threads = 1, .kernels = "generic"};
    struct rn_device_agreement found = {NAN, NAN, 0};
    struct rn_engine *engine = NULL;
    struct rn_device_info info;
    struct rn_error err = {0};
    if (rn_engine_create(&first, &engine, &err) != RN_OK) {
        struct rn_doctor_case *c = rn_doctor_open(result, "beside the CPU", "cuda", NAN, "");
        c->skipped = true;
        snprintf(c->where, sizeof c->where, "%.159s", err.text);
        rn_doctor_close(result, c);
        return;
    }
    rn_engine_describe(engine, &info);
    enum rn_status status = rn_device_check(engine, true, &found, &err);
    const char *where = status == RN_OK || status == RN_ERROR_NUMERIC ? info.name : err.text;
    see_device(result, "pixels beside the CPU's", RN_DEVICE_PIXELS, "of the largest", found.pixels,
               where);
    see_device(result, "the loss along its gradient", RN_DEVICE_GRADIENT, "of its change",
               found.gradient, where);
    rn_engine_destroy(&engine);
}

static enum rn_status examine_scene(const struct rn_doctor_options *options,
                                    struct rn_doctor_random *random, struct rn_engine *engine,
                                    struct rn_doctor_result *result, struct rn_error *err) {
    struct rn_field *field = NULL;
    enum rn_status status = rn_field_load(engine, options->checkpoint, &field, err);
    if (status == RN_OK) status = rn_doctor_scene(options, random, engine, field, result, err);
    if (status == RN_OK && options->incident)
        status = rn_doctor_replay(options->incident, engine, field, result, err);
    rn_field_destroy(&field);
    return status;
}

enum rn_status rn_doctor_run(const struct rn_doctor_options *options,
                             void (*progress)(const char *what),
                             struct rn_doctor_result *ret_result, struct rn_error *err) {
    struct rn_doctor_random random = {options->seed, 0};
    struct rn_engine_options one = {.device = "cpu", .threads = 1, .kernels = "generic"};
    struct rn_engine *engine = NULL;
    struct rn_device_info info;
    *ret_result = (struct rn_doctor_result){.seed = options->seed, .passed = true};
    enum rn_status status = rn_engine_create(&one, &engine, err);
    if (status != RN_OK) return status;
    rn_engine_describe(engine, &info);
    snprintf(ret_result->kernels, sizeof ret_result->kernels, "%s", info.available);
    say(progress, "the float64 code");
    rn_doctor_float64(&random, ret_result);
    say(progress, "the kernel sets");
    rn_doctor_kernels(&random, ret_result);
    say(progress, "the GPU");
    check_cuda(ret_result);
    if (options->checkpoint) {
        say(progress, "the scene");
        status = examine_scene(options, &random, engine, ret_result, err);
    }
    rn_engine_destroy(&engine);
    return status;
}

// An engine that pretends: "training" counts steps, a render is a gradient, every figure is a
// formula. Deterministic, so that the runner and the daemon can be tested in seconds.
//
// RIPNERF_FAKE_STEP_US: microseconds a step takes (1000). RIPNERF_FAKE_ROW_US: a rendered row (0).
// RIPNERF_FAKE_STEP_S: seconds that a step, or a part of a round of views, counts on the training
// clock (what it took).
// RIPNERF_FAKE_PASS_S: seconds of that clock that passes over the photographs take, at step 300
// (0). RIPNERF_FAKE_HOLD: a file; while it is there work stands still, however long a test takes:
// trainings (of seed RIPNERF_FAKE_HELD_SEED, where that is set) at step RIPNERF_FAKE_HELD_AT
// (1000), pictures after the first RIPNERF_FAKE_HELD_PICTURES of a process (all), and the making of
// a trainer at its end where it takes any time. RIPNERF_FAKE_LOAD_MS: milliseconds that making a
// trainer takes (0). RIPNERF_FAKE_NEED_MB: memory that a training says it needs (1).
// RIPNERF_FAKE_KERNELS: the one kernel set of the machine (scalar).
// RIPNERF_FAKE_DIVERGE_AT: the step that diverges.
// RIPNERF_FAKE_INCIDENT_AT: the step that is rolled back. With `subsample` rows are left out. With
// a lens or a shutter a row takes as many times as long as a pixel has cones, and so do samples; of
// a picture narrower than 19 degrees four times.
#include <limits.h>
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/sha256.h"
#include "server/engine/bench/bench.h"
#include "server/engine/doctor/doctor.h"
#include "server/engine/engine.h"

#define HELD_OUT 8
#define SPARE 16 // samples a step "evaluates" per level

struct rn_engine {
    struct rn_device_info info;
    bool (*keep_going)(void *context);
    void *watcher;
};

struct rn_field {
    char magic[8]; // the struct is also the checkpoint's content
    struct rn_train_config config;
    struct rn_bounds bounds;
    int64_t steps;
    double train_seconds, psnr;
    uint64_t state; // stands for the parameters
    bool has_alpha;
    int scale_count;
};

struct rn_trainer {
    struct rn_field field;
    int64_t psnr_step;
    double evaluate_seconds, load_seconds, turn_seconds;
    int validated; // views of the round under way
    char saved_sha256[65];
    bool incident; // noted, not taken
};

static long setting(const char *name, long fallback) {
    const char *text = getenv(name);
    return text ? atol(text) : fallback;
}

static double now_s(void) {
    return (double)rn_clock_ns() * 1e-9;
}

static bool is_held(void) {
    const char *path = getenv("RIPNERF_FAKE_HOLD");
    return path && access(path, F_OK) == 0;
}

// ---- device --------------------------------------------------------------------------------

enum rn_status rn_engine_create(const struct rn_engine_options *options,
                                struct rn_engine **ret_engine, struct rn_error *err) {
    const char *kernels = options->kernels ? options->kernels : "auto";
    const char *own = getenv("RIPNERF_FAKE_KERNELS");
    if (!own) own = "scalar";
    if (strcmp(kernels, "auto") != 0 && strcmp(kernels, own) != 0)
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, "kernels",
                            "this machine has no kernel set %s", kernels);
    if (options->device && strncmp(options->device, "cuda", 4) == 0)
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, "device", "there is no GPU");
    struct rn_engine *engine = calloc(1, sizeof *engine);
    if (!engine) return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "out of memory");
    engine->info = (struct rn_device_info){
        .device = "cpu", .name = "pretended", .threads = options->threads ? options->threads : 1};
    snprintf(engine->info.kernels, sizeof engine->info.kernels, "%s", own);
    snprintf(engine->info.available, sizeof engine->info.available, "%s", own);
    *ret_engine = engine;
    return RN_OK;
}

void rn_engine_destroy(struct rn_engine **engine) {
    free(*engine);
    *engine = NULL;
}

void rn_engine_describe(const struct rn_engine *engine, struct rn_device_info *ret_info) {
    *ret_info = engine->info;
}

void rn_engine_watch(struct rn_engine *engine, bool (*keep_going)(void *context), void *context) {
    engine->keep_going = keep_going;
    engine->watcher = context;
}
void rn_engine_keep_in(struct rn_engine *engine, const char *folder) {}
void rn_engine_yield_to(struct rn_engine *engine, bool (*wanted)(void *context), void *context) {}
void rn_field_rest(struct rn_field *field) {}
void rn_engine_join(struct rn_engine *engine, const struct rn_exchange *exchange) {}
enum rn_status rn_exchange_open(const struct rn_exchange **ret_exchange, struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_UNSUPPORTED, "ranks", "what pretends has no others");
}
void rn_trainer_dismiss(const struct rn_exchange *exchange) {}
enum rn_status rn_trainer_follow(struct rn_trainer *trainer, struct rn_error *err) {
    return RN_OK;
}
void rn_engine_share(struct rn_engine *engine,
                     enum rn_status (*share)(void *context, const struct rn_device_wish *wish,
                                             size_t *ret_granted, struct rn_error *err),
                     void *context) {}

// ---- fields --------------------------------------------------------------------------------

static const char magic[8] = "rnfake1";

// A file for viewing has another: "rnview" and its form.
static int form_of(const void *bytes) {
    return memcmp(bytes, "rnview", 6) == 0 ? ((const char *)bytes)[6] : -1;
}

// Content, then the SHA-256 of it in hex.
static enum rn_status write_field(const struct rn_field *field, const char *path,
                                  struct rn_error *err) {
    struct {
        struct rn_field field;
        char digest[65];
    } file;
    memset(&file, 0, sizeof file);
    file.field = *field;
    struct rn_sha256 hash;
    rn_sha256_init(&hash);
    rn_sha256_update(&hash, field, sizeof *field);
    rn_sha256_final_hex(&hash, file.digest);
    return rn_file_write_atomic(path, &file, sizeof file, err);
}

// What an earlier build wrote had another configuration, of another size: it counts as `standard`.
static enum rn_status read_field(const char *path, struct rn_field *ret_field,
                                 struct rn_error *err) {
    const size_t behind = offsetof(struct rn_field, bounds), rest = sizeof *ret_field - behind;
    uint8_t *bytes;
    size_t size;
    char digest[65] = "";
    enum rn_status status = rn_file_read(path, 1 << 20, &bytes, &size, err);
    if (status) return status;
    size_t own = size > sizeof digest + 7 ? size - sizeof digest - 7 : 0; // padded to 8 bytes
    if (own > rest + sizeof magic) {
        struct rn_sha256 hash;
        rn_sha256_init(&hash);
        rn_sha256_update(&hash, bytes, own);
        rn_sha256_final_hex(&hash, digest);
    }
    bool good = *digest && (memcmp(bytes, magic, sizeof magic) == 0 || form_of(bytes) >= 0) &&
                memcmp(digest, bytes + own, sizeof digest) == 0;
    if (good && own == sizeof *ret_field)
        memcpy(ret_field, bytes, own);
    else if (good) {
        status = rn_preset("standard", false, &ret_field->config, err);
        memcpy(ret_field->magic, magic, sizeof magic);
        memcpy((char *)ret_field + behind, bytes + own - rest, rest);
    }
    free(bytes);
    return good ? status : rn_error_set(err, RN_ERROR_CORRUPT, path, "the checkpoint is damaged");
}

enum rn_status rn_field_load(struct rn_engine *engine, const char *checkpoint_path,
                             struct rn_field **ret_field, struct rn_error *err) {
    struct rn_field *field = calloc(1, sizeof *field);
    if (!field) return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "out of memory");
    enum rn_status status = read_field(checkpoint_path, field, err);
    if (status)
        free(field);
    else
        *ret_field = field;
    return status;
}

void rn_field_destroy(struct rn_field **field) {
    free(*field);
    *field = NULL;
}

const int rn_viewing_bits[RN_VIEWING_FORMS] = {4, 5, 6, 8, 16, 32};

size_t rn_viewing_bytes(const struct rn_field *field, int bits) {
    return sizeof *field + 72 + (size_t)bits;
}

enum rn_status rn_viewing_write(struct rn_field *field, const struct rn_viewing *viewing,
                                const char *path, struct rn_error *err) {
    struct rn_field file = *field;
    memcpy(file.magic, "rnview", 6);
    file.magic[6] = (char)viewing->bits;
    return write_field(&file, path, err);
}

// The one effect that can be switched off.
static bool without_lens(const struct rn_train_config *config) {
    return config->effect[RN_EFFECT_DISTORTION] == RN_EFFECT_UNWANTED;
}

struct rn_appearance rn_field_appearance(const struct rn_field *field, size_t photograph) {
    return (struct rn_appearance){.own = false};
}

void rn_field_describe(const struct rn_field *field, struct rn_field_info *ret_info) {
    *ret_info = (struct rn_field_info){.config = field->config,
                                       .bounds = field->bounds,
                                       .steps = field->steps,
                                       .train_seconds = field->train_seconds,
                                       .psnr = field->psnr,
                                       .memory_bytes = sizeof *field,
                                       .parameter_count = 1,
                                       .kernels = "scalar"};
    for (int i = 0; i < RN_EFFECT_COUNT; i++) {
        ret_info->effects[i] = (struct rn_effect_record){.name = rn_effect_name((enum rn_effect)i),
                                                         .on = true,
                                                         .decided = i != RN_EFFECT_VIEW_DEPENDENCE,
                                                         .number = 1};
        snprintf(ret_info->effects[i].reason, sizeof ret_info->effects[i].reason, "pretended");
    }
    ret_info->effects[RN_EFFECT_VIEW_DEPENDENCE].number = NAN;
    ret_info->effects[RN_EFFECT_DISTORTION].on = !without_lens(&field->config);
    if (form_of(field->magic) > 0)
        ret_info->viewing = (struct rn_viewing){.bits = form_of(field->magic),
                                                .psnr = 20,
                                                .trained = 20,
                                                .views = 1,
                                                .split = "test",
                                                .dataset = "pretended",
                                                .version = "pretended"};
}

void rn_effect_text(enum rn_effect effect, double number, char *text, size_t capacity) {
    (void)effect;
    *text = '\0';
    if (!isnan(number)) snprintf(text, capacity, "%g pretended", number);
}

int rn_effect_below(enum rn_effect effect) {
    return effect == RN_EFFECT_FORWARD_FACING;
}

bool rn_effect_is_optional(enum rn_effect effect, bool on) {
    (void)effect;
    return on;
}

unsigned rn_effects_fit(const struct rn_effect_record records[RN_EFFECT_COUNT]) {
    (void)records;
    return 0;
}

void rn_field_sha256(const struct rn_field *field, char ret_hex[65]) {
    struct rn_sha256 hash;
    rn_sha256_init(&hash);
    rn_sha256_update(&hash, &field->state, sizeof field->state);
    rn_sha256_final_hex(&hash, ret_hex);
}

// ---- meshes --------------------------------------------------------------------------------

// A ball in a cube.
static enum rn_status slice(void *context, int z, float *ret_values, struct rn_error *err) {
    const int *cells = context;
    for (int i = 0; i < (*cells + 1) * (*cells + 1); i++) {
        int at[3] = {i % (*cells + 1), i / (*cells + 1), z};
        double squares = 0;
        for (int k = 0; k < 3; k++)
            squares += pow(2.0 * at[k] / *cells - 1, 2);
        *ret_values++ = (float)(0.8 - sqrt(squares));
    }
    return RN_OK;
}

enum rn_status rn_field_mesh(struct rn_engine *engine, struct rn_field *field,
                             const struct rn_mesh_options *options,
                             bool (*keep_going)(void *context), void *context,
                             struct rn_mesh *ret_mesh, struct rn_error *err) {
    int cells = options->cells;
    struct rn_mesh_grid grid = {.low = {-1, -1, -1},
                                .high = {1, 1, 1},
                                .cells = {cells, cells, cells},
                                .slice = slice,
                                .context = &cells};
    if (isfinite(options->box[0][0]) && !(options->box[1][0] > options->box[0][0]))
        return rn_error_set(err, RN_ERROR_INVALID, "#/options/crop", "has no size");
    *ret_mesh = (struct rn_mesh){0};
    return rn_mesh_march(&grid, options->level - 0.5, ret_mesh, err);
}

// ---- training ------------------------------------------------------------------------------

static enum rn_status load(const struct rn_engine *engine, struct rn_error *err) {
    long takes = setting("RIPNERF_FAKE_LOAD_MS", 0);
    for (long left = takes; left > 0 || (takes > 0 && is_held()); left -= 20) {
        if (engine->keep_going && !engine->keep_going(engine->watcher))
            return rn_error_set(err, RN_ERROR_CANCELLED, "images", "stopped while loading");
        usleep(20000);
    }
    return RN_OK;
}

static enum rn_status create(const struct rn_engine *engine, const struct rn_field *field,
                             struct rn_trainer **ret_trainer, struct rn_error *err) {
    struct rn_trainer *trainer = calloc(1, sizeof *trainer);
    if (!trainer) return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "out of memory");
    double begin = now_s();
    enum rn_status status = load(engine, err);
    if (status != RN_OK) {
        free(trainer);
        return status;
    }
    trainer->field = *field;
    trainer->psnr_step = isnan(field->psnr) ? 0 : field->steps;
    trainer->load_seconds = now_s() - begin;
    *ret_trainer = trainer;
    return RN_OK;
}

int rn_train_scale(const struct rn_dataset *dataset, const struct rn_train_config *config) {
    return 1;
}

enum rn_status rn_train_need(struct rn_engine *engine, const struct rn_dataset *dataset,
                             const struct rn_train_config *config, size_t *ret_bytes,
                             struct rn_error *err) {
    *ret_bytes = (size_t)setting("RIPNERF_FAKE_NEED_MB", 1) << 20;
    return RN_OK;
}

enum rn_status rn_field_need(const char *checkpoint_path, size_t *ret_bytes, struct rn_error *err) {
    *ret_bytes = sizeof(struct rn_field);
    return RN_OK;
}

enum rn_status rn_trainer_create(struct rn_engine *engine, const struct rn_dataset *dataset,
                                 const struct rn_train_config *config, size_t memory_limit_bytes,
                                 struct rn_trainer **ret_trainer, struct rn_error *err) {
    if (memory_limit_bytes && memory_limit_bytes < 4096)
        return rn_error_set(err, RN_ERROR_LIMIT, "memory", "4096 bytes are needed");
    struct rn_field field;
    memset(&field, 0, sizeof field);
    memcpy(field.magic, magic, sizeof magic);
    field.config = *config;
    field.bounds = dataset->bounds;
    field.psnr = NAN;
    field.state = config->seed;
    field.scale_count = dataset->scale_count;
    return create(engine, &field, ret_trainer, err);
}

enum rn_status rn_trainer_restore(struct rn_engine *engine, const struct rn_dataset *dataset,
                                  const char *checkpoint_path, size_t memory_limit_bytes,
                                  struct rn_trainer **ret_trainer, struct rn_error *err) {
    struct rn_field field;
    enum rn_status status = read_field(checkpoint_path, &field, err);
    return status ? status : create(engine, &field, ret_trainer, err);
}

void rn_trainer_destroy(struct rn_trainer **trainer) {
    free(*trainer);
    *trainer = NULL;
}

static bool is_done(const struct rn_trainer *trainer) {
    const struct rn_train_config *config = &trainer->field.config;
    const struct rn_field *field = &trainer->field;
    return (config->max_steps && field->steps >= config->max_steps) ||
           (config->max_seconds > 0 && field->train_seconds >= config->max_seconds) ||
           (config->until_psnr > 0 && field->psnr >= config->until_psnr);
}

static bool stands_still(const struct rn_field *field) {
    long seed = (long)field->config.seed;
    return field->steps >= setting("RIPNERF_FAKE_HELD_AT", 1000) &&
           setting("RIPNERF_FAKE_HELD_SEED", seed) == seed && is_held();
}

enum rn_status rn_trainer_advance(struct rn_trainer *trainer, double budget_ms,
                                  struct rn_error *err) {
    struct rn_field *field = &trainer->field;
    double begin = now_s(), last = begin;
    long diverge_at = setting("RIPNERF_FAKE_DIVERGE_AT", -1);
    useconds_t step_us = (useconds_t)setting("RIPNERF_FAKE_STEP_US", 1000);
    const char *step_s = getenv("RIPNERF_FAKE_STEP_S");
    while (!is_done(trainer) && (last - begin) * 1e3 < budget_ms) {
        if (field->steps == diverge_at)
            return rn_error_set(err, RN_ERROR_NUMERIC, "training", "diverged at step %lld",
                                (long long)field->steps);
        trainer->incident |= field->steps == setting("RIPNERF_FAKE_INCIDENT_AT", -1);
        usleep(step_us);
        if (stands_still(field)) break;
        field->state = field->state * 6364136223846793005u + 1442695040888963407u;
        if (field->steps++ == 300) {
            trainer->turn_seconds = (double)setting("RIPNERF_FAKE_PASS_S", 0);
            field->train_seconds += trainer->turn_seconds;
        }
        double now = now_s();
        field->train_seconds += step_s ? atof(step_s) : now - last;
        last = now;
    }
    return RN_OK;
}

bool rn_trainer_take_incident(struct rn_trainer *trainer, struct rn_incident *ret_incident) {
    if (!trainer->incident) return false;
    trainer->incident = false;
    *ret_incident = (struct rn_incident){.kind = RN_INCIDENT_ROLLBACK,
                                         .step = setting("RIPNERF_FAKE_INCIDENT_AT", 0),
                                         .seed = trainer->field.config.seed,
                                         .rate = 0.01,
                                         .nonfinite_rays = 70,
                                         .nonfinite_parameters = 1,
                                         .march_step = 0.01f,
                                         .ray_count = 2,
                                         .parameter_count = 1};
    for (int i = 0; i < 2; i++)
        ret_incident->rays[i] = (struct rn_incident_ray){.id = (uint32_t)i,
                                                         .fault = RN_FAULT_COLOUR,
                                                         .index = 1,
                                                         .x = 2,
                                                         .y = 3,
                                                         .direction = {0, 0, 1},
                                                         .near = 3,
                                                         .length = 2,
                                                         .radius = 1e-3f,
                                                         .target = {NAN, 0.5f, 1},
                                                         .weight = 1,
                                                         .stride = 1};
    ret_incident->parameters[0] = (struct rn_incident_parameter){5, -INFINITY};
    return true;
}

enum rn_status rn_trainer_validate(struct rn_trainer *trainer, double budget_ms, bool *ret_done,
                                   struct rn_error *err) {
    double begin = now_s();
    usleep(1000);
    trainer->validated += 4;
    *ret_done = trainer->validated >= HELD_OUT;
    const char *step_s = getenv("RIPNERF_FAKE_STEP_S");
    trainer->evaluate_seconds += step_s ? atof(step_s) : now_s() - begin;
    if (!*ret_done) return RN_OK;
    trainer->validated = 0;
    trainer->field.psnr = (without_lens(&trainer->field.config) ? 18 : 20) +
                          15 * (1 - exp(-(double)trainer->field.steps / 200));
    trainer->psnr_step = trainer->field.steps;
    return RN_OK;
}

enum rn_figure rn_trainer_figure(const struct rn_trainer *trainer) {
    return RN_FIGURE_ANY_TIME;
}

void rn_trainer_progress(const struct rn_trainer *trainer, struct rn_progress *ret_progress) {
    const struct rn_field *field = &trainer->field;
    const struct rn_train_config *config = &field->config;
    double fraction = NAN;
    if (config->max_steps) fraction = (double)field->steps / (double)config->max_steps;
    if (config->max_seconds > 0)
        fraction = fmax(isnan(fraction) ? 0 : fraction, field->train_seconds / config->max_seconds);
    long incident_at = setting("RIPNERF_FAKE_INCIDENT_AT", -1);
    bool passed = incident_at >= 0 && field->steps > incident_at;
    double rate = field->train_seconds > 0 ? (double)field->steps / field->train_seconds : 0;
    *ret_progress = (struct rn_progress){
        .step = field->steps,
        .train_seconds = field->train_seconds,
        .turn_seconds = trainer->turn_seconds,
        .load_seconds = trainer->load_seconds,
        .evaluate_seconds = trainer->evaluate_seconds,
        .loss = exp(-(double)field->steps / 200),
        .rays_per_second = 64 * rate,
        .samples_per_second = 1024 * rate,
        .samples = 1024 * (uint64_t)field->steps,
        .rays = 64 * (uint64_t)field->steps,
        .level_samples = {1008 * (uint64_t)field->steps, SPARE * (uint64_t)field->steps},
        .psnr = field->psnr,
        .psnr_step = trainer->psnr_step,
        .nonfinite_rays = passed ? 70 : 0,
        .rollbacks = passed,
        .eta_seconds = fraction > 0 ? field->train_seconds * (1 / fmin(fraction, 1) - 1) : NAN,
        .fraction = fmin(fraction, 1),
        .done = is_done(trainer)};
    if (isnan(fraction)) ret_progress->fraction = NAN; // fmin prefers a number
}

const char *rn_trainer_held_out(const struct rn_trainer *trainer) {
    return "8 pretended views";
}

const struct rn_train_config *rn_trainer_config(const struct rn_trainer *trainer) {
    return &trainer->field.config;
}

struct rn_field *rn_trainer_field(struct rn_trainer *trainer) {
    return &trainer->field;
}

enum rn_status rn_trainer_save_begin(struct rn_trainer *trainer, enum rn_save_part part,
                                     const char *path, bool *ret_begun, struct rn_error *err) {
    enum rn_status status = write_field(&trainer->field, path, err);
    rn_field_sha256(&trainer->field, trainer->saved_sha256);
    *ret_begun = status == RN_OK;
    return status;
}

enum rn_save_stage rn_trainer_save_stage(const struct rn_trainer *trainer) {
    return RN_SAVE_OVER;
}

enum rn_status rn_trainer_save_end(struct rn_trainer *trainer, char ret_sha256[65],
                                   struct rn_error *err) {
    memcpy(ret_sha256, trainer->saved_sha256, sizeof trainer->saved_sha256);
    return RN_OK;
}

struct rn_field *rn_trainer_finish(struct rn_trainer **trainer) {
    struct rn_field *field = malloc(sizeof *field);
    if (field) *field = (*trainer)->field;
    rn_trainer_destroy(trainer);
    return field;
}

// ---- rendering -----------------------------------------------------------------------------

// How many times as much a picture takes as others of its size.
static unsigned cost_of(const struct rn_render_options *options) {
    const struct rn_camera *camera = &options->camera;
    unsigned side = options->settings.supersample > 0 ? (unsigned)options->settings.supersample : 8;
    if (rn_optics_spreads(&options->shot.optics)) return side * side;
    return camera->fy > 3 * camera->height ? 4 : 1;
}

static enum rn_status fill(struct rn_picture *picture, const struct rn_field *field,
                           const struct rn_render_options *options, int channels,
                           bool (*keep_going)(void *), void *context, struct rn_error *err) {
    const struct rn_camera *camera = &options->camera;
    int apart = options->settings.subsample > 1 ? options->settings.subsample : 1;
    enum rn_status status = rn_picture_init(camera->width, camera->height, channels, picture, err);
    if (status) return status;
    useconds_t row_us = (useconds_t)setting("RIPNERF_FAKE_ROW_US", 0) * cost_of(options);
    for (int y = 0; y < camera->height; y++) {
        if (keep_going && !keep_going(context))
            return rn_error_set(err, RN_ERROR_CANCELLED, "render", "cancelled");
        if (options->deadline_ns && rn_clock_ns() > options->deadline_ns)
            return rn_error_set(err, RN_ERROR_LIMIT, "deadline", "there was no time");
        if (row_us && y % apart == 0) usleep(row_us);
        for (int x = 0; x < camera->width * channels; x++) {
            float value = (float)(x / channels / apart * apart) / (float)camera->width;
            if (x % channels == 1) value = (float)y / (float)camera->height;
            if (x % channels == 2) value = (float)(field->steps % 256) / 255.0f;
            picture->values[(size_t)y * (size_t)camera->width * (size_t)channels + (size_t)x] =
                value;
        }
    }
    return RN_OK;
}

static enum rn_status wait_while_held(bool (*keep_going)(void *), void *context,
                                      struct rn_error *err) {
    static long made; // pictures of this process
    for (made++; made > setting("RIPNERF_FAKE_HELD_PICTURES", LONG_MAX) && is_held(); usleep(10000))
        if (keep_going && !keep_going(context))
            return rn_error_set(err, RN_ERROR_CANCELLED, "render", "cancelled");
    return RN_OK;
}

enum rn_status rn_render(struct rn_engine *engine, struct rn_field *field,
                         const struct rn_render_options *options, bool (*keep_going)(void *context),
                         void *context, struct rn_render_result *ret_result, struct rn_error *err) {
    struct rn_render_result result = {.stats = {.render_ms = 0}};
    const struct rn_camera *camera = &options->camera;
    double begin = now_s();
    enum rn_status status = wait_while_held(keep_going, context, err);
    struct rn_picture *const pictures[] = {&result.rgb,      &result.depth, &result.alpha,
                                           &result.normal,   &result.cost,  &result.level,
                                           &result.footprint};
    for (unsigned i = 0; i < sizeof pictures / sizeof *pictures && !status; i++) // by RN_OUTPUT_*
        if (options->outputs >> i & 1) {
            bool three = pictures[i] == &result.rgb || pictures[i] == &result.normal; // channels
            status = fill(pictures[i], field, options, three ? 3 : 1, keep_going, context, err);
        }
    if (status) {
        rn_render_result_finish(&result);
        return status;
    }
    result.stats.tolerance = options->settings.tolerance;
    if (options->settings.subsample > 1) result.stats.interpolation = 1e-4 * cost_of(options);
    result.stats.rays = (uint64_t)camera->width * (uint64_t)camera->height;
    result.stats.samples = 8 * result.stats.rays * cost_of(options);
    result.stats.render_ms = (now_s() - begin) * 1e3;
    *ret_result = result;
    return RN_OK;
}

int rn_render_fit(struct rn_engine *engine, struct rn_field *field,
                  const struct rn_render_options *options) {
    return (int)setting("RIPNERF_FAKE_TOGETHER", 1);
}

enum rn_status rn_render_together(struct rn_engine *engine, struct rn_field *field,
                                  const struct rn_render_options *options, int count,
                                  bool (*keep_going)(void *context), void *context,
                                  struct rn_render_result *ret_results, int *ret_count,
                                  struct rn_error *err) {
    enum rn_status status = RN_OK;
    for (*ret_count = 0; *ret_count < count && !status; *ret_count += !status)
        status = rn_render(engine, field, &options[*ret_count], keep_going, context,
                           &ret_results[*ret_count], err);
    return status;
}

int rn_render_cones(const struct rn_field *field, const struct rn_camera *camera) {
    return 1;
}

void rn_render_result_finish(struct rn_render_result *result) {
    rn_picture_finish(&result->rgb);
    rn_picture_finish(&result->depth);
    rn_picture_finish(&result->alpha);
    rn_picture_finish(&result->normal);
    rn_picture_finish(&result->cost);
    rn_picture_finish(&result->level);
    rn_picture_finish(&result->footprint);
}

struct rn_render_options rn_view_options(const struct rn_field *field, const struct rn_frame *frame,
                                         const struct rn_render_options *given) {
    struct rn_render_options options = *given;
    options.camera = frame->camera;
    options.outputs = RN_OUTPUT_RGB;
    return options;
}

enum rn_status rn_view_render(struct rn_engine *engine, struct rn_field *field,
                              const struct rn_frame *frame, const struct rn_render_options *given,
                              bool (*keep_going)(void *context), void *context,
                              struct rn_rendered_view *ret_view, struct rn_error *err) {
    struct rn_rendered_view view = {.frame = frame,
                                    .options = rn_view_options(field, frame, given)};
    enum rn_status status =
        rn_render(engine, field, &view.options, keep_going, context, &view.result, err);
    if (!status) *ret_view = view;
    return status;
}

enum rn_status rn_view_compare(struct rn_rendered_view *view, struct rn_view_score *ret_score,
                               struct rn_error *err) {
    const struct rn_frame *frame = view->frame;
    *ret_score = (struct rn_view_score){.psnr = 30 + frame->scale + 0.1 * (frame->index % 3),
                                        .ssim = 0.9 + 0.01 * frame->scale,
                                        .lpips = NAN,
                                        .render_ms = view->result.stats.render_ms};
    rn_render_result_finish(&view->result);
    return RN_OK;
}

bool rn_view_is_apart(const struct rn_rendered_view *view) {
    return true;
}

enum rn_status rn_evaluate_depth(struct rn_engine *engine, struct rn_field *field,
                                 const struct rn_frame *frame, const struct rn_points *points,
                                 const struct rn_render_options *given,
                                 bool (*keep_going)(void *context), void *context,
                                 struct rn_depth_score *ret_score, struct rn_error *err) {
    *ret_score = (struct rn_depth_score){.median = NAN};
    return RN_OK;
}

// ---- doctor ------------------------------------------------------------------------------

enum rn_status rn_doctor_run(const struct rn_doctor_options *options,
                             void (*progress)(const char *what),
                             struct rn_doctor_result *ret_result, struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_UNSUPPORTED, "doctor", "there is nothing to examine here");
}

// ---- figures ----------------------------------------------------------------------------

enum rn_status rn_bench_run(const struct rn_bench_options *options,
                            void (*progress)(const char *what), struct rn_bench_result *ret_result,
                            struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_UNSUPPORTED, "bench", "there is nothing to measure here");
}

#include "server/engine/train/outliers.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/numbers.h"
#include "common/math/rng.h"
#include "server/engine/train/schedule.h"
#include "server/engine/train/trainer.h"
#include "server/engine/train/withheld.h"

#define STREAM 0x6f75746c69657200u
#define MEASURED_AT 0.2 // of the schedule: how much of the photographs is left out
#define LAST_AT 0.8
#define TURNS 7     // evenly from one to the other, at most
#define SHARE 0.08  // of the rays trained on, about: what all passes take that nobody asked for
#define OTHERS 64   // photographs, at most about, that a block is compared with
#define WITNESSES 3 // of them that see the place, at least
#define STANDS 64   // distances at which it may stand, evenly in disparity,
#define NEAREST 6.0 // that of where the field has it is 1
#define FARTHEST 0.25
#define LOOKS 2        // pixels of a block that are looked at
#define MOST (1 << 18) // blocks of a pass, about
#define FEWEST 32      // photographs of a pass, where there are as many, however short training is
#define BATCH 128      // rays rendered together, RN_TRAINER_RAYS at most

static const struct rn_effect_record *record_of(const struct rn_trainer *t) {
    return &t->field->effects[RN_EFFECT_ROBUST_LOSS];
}

static int across_of(const struct rn_pixel_frame *frame) {
    return (frame->camera.width + RN_OUTLIER_BLOCK - 1) / RN_OUTLIER_BLOCK;
}

static int down_of(const struct rn_pixel_frame *frame) {
    return (frame->camera.height + RN_OUTLIER_BLOCK - 1) / RN_OUTLIER_BLOCK;
}

// ---- the formulas -----------------------------------------------------------------------------

// The median of values[0], values[stride], .. that are known, 0 of none; `room` for `count`
// numbers.
static float median(const float *values, const uint8_t *known, size_t count, size_t stride,
                    double *room) {
    size_t kept = 0;
    for (size_t i = 0; i < count; i++)
        if (known[i]) room[kept++] = (double)values[i * stride];
    return kept ? (float)rn_numbers_quantile(room, kept, 0.5) : 0;
}

// The sum, less so much each, over a block and its neighbours that are known: how many they are.
static int sum_around(const float *values, const uint8_t *known, int across, int down, int block,
                      const float less[3], float ret_sum[3]) {
    int x = block % across, y = block / across, count = 0;
    memset(ret_sum, 0, 3 * sizeof *ret_sum);
    for (int j = y > 0 ? y - 1 : 0; j <= y + 1 && j < down; j++)
        for (int i = x > 0 ? x - 1 : 0; i <= x + 1 && i < across; i++) {
            if (!known[j * across + i]) continue;
            for (int c = 0; c < 3; c++)
                ret_sum[c] += values[3 * (j * across + i) + c] - less[c];
            count++;
        }
    return count;
}

enum rn_status rn_outlier_sizes(const float *difference, const uint8_t *known, int across, int down,
                                float *ret_size, struct rn_error *err) {
    float middle[3];
    double *room = malloc((size_t)across * (size_t)down * sizeof *room);
    if (!room) return rn_error_set(err, RN_ERROR_NO_MEMORY, "outliers", "out of memory");
    for (int c = 0; c < 3; c++)
        middle[c] = median(difference + c, known, (size_t)across * (size_t)down, 3, room);
    free(room);
    for (int block = 0; block < across * down; block++) {
        float sum[3], squares = 0;
        int count = sum_around(difference, known, across, down, block, middle, sum);
        for (int c = 0; c < 3 && count > 0; c++)
            squares += sum[c] / (float)count * sum[c] / (float)count;
        ret_size[block] = sqrtf(squares / 3);
    }
    return RN_OK;
}

void rn_outlier_trim(const uint8_t *large, int across, int down, uint8_t *ret_out) {
    for (int y = 0; y < down; y++)
        for (int x = 0; x < across; x++) {
            int count = 0;
            for (int j = y > 1 ? y - 2 : 0; j <= y + 2 && j < down; j++)
                for (int i = x > 1 ? x - 2 : 0; i <= x + 2 && i < across; i++)
                    count += large[j * across + i];
            ret_out[y * across + x] = count >= 9;
        }
}

// ---- memory -----------------------------------------------------------------------------------

static void end_pass(struct rn_outliers *o) {
    free(o->difference);
    free(o->taken);
    free(o->known);
    free(o->size);
    free(o->depth);
    free(o->large);
    o->difference = o->taken = NULL;
    o->known = o->large = NULL;
    o->size = o->depth = NULL;
}

void rn_outliers_finish(struct rn_outliers *o) {
    end_pass(o);
    free(o->out);
    free(o->first);
    o->out = NULL;
    o->first = NULL;
}

// Where each photograph's blocks are.
static enum rn_status list_blocks(struct rn_trainer *t, struct rn_error *err) {
    struct rn_outliers *o = &t->outliers;
    if (o->first) return RN_OK;
    o->first = malloc((size_t)t->train.frame_count * sizeof *o->first);
    if (!o->first) return rn_error_set(err, RN_ERROR_NO_MEMORY, "outliers", "out of memory");
    o->count = 0;
    if (!o->most) o->most = MOST;
    bool wanted = t->field->config.effect[RN_EFFECT_ROBUST_LOSS] == RN_EFFECT_WANTED;
    if (!(o->affords > 0)) o->affords = wanted ? INFINITY : SHARE;
    for (int f = 0; f < t->train.frame_count; f++) {
        o->first[f] = o->count;
        o->count += (size_t)across_of(&t->train.frames[f]) * (size_t)down_of(&t->train.frames[f]);
    }
    return RN_OK;
}

enum rn_status rn_trainer_allocate_outliers(struct rn_trainer *t, struct rn_error *err) {
    struct rn_outliers *o = &t->outliers;
    if (!record_of(t)->on || o->out) return RN_OK;
    enum rn_status status = list_blocks(t, err);
    if (status != RN_OK) return status;
    o->out = calloc(o->count, 1);
    return o->out ? RN_OK : rn_error_set(err, RN_ERROR_NO_MEMORY, "outliers", "out of memory");
}

// A pass looks at every so many-th photograph, the next one at those beside them, so that of 1,000
// it takes as long as of some, and of a short training no larger a part than of a long one.
static int apart(const struct rn_trainer *t) {
    double rays = rn_schedule_rays(&t->field->config, &t->progress);
    double most = fmin((double)t->outliers.most, t->outliers.affords * rays / (TURNS + 1) / LOOKS);
    double by_blocks = floor((double)t->outliers.count / fmax(most, 1)) + 1;
    int by_photographs = t->train.frame_count / FEWEST;
    return by_blocks < by_photographs ? (int)by_blocks : by_photographs > 1 ? by_photographs : 1;
}

// How many turns a training of this length can afford, where passes are no smaller than they can
// be.
static int turns(const struct rn_trainer *t) {
    double pass = LOOKS * (double)t->outliers.count / apart(t);
    double most = t->outliers.affords * rn_schedule_rays(&t->field->config, &t->progress) / pass;
    return most < 1 ? 1 : most < TURNS ? (int)most : TURNS;
}

static enum rn_status begin_pass(struct rn_trainer *t, struct rn_error *err) {
    struct rn_outliers *o = &t->outliers;
    enum rn_status status = list_blocks(t, err);
    if (status != RN_OK || o->difference) return status;
    o->next = 0;
    o->threshold = 0;
    o->apart = apart(t);
    o->difference = calloc(o->count, sizeof *o->difference);
    o->taken = calloc(o->count, sizeof *o->taken);
    o->known = calloc(o->count, 1);
    o->size = calloc(o->count, sizeof *o->size);
    o->depth = calloc(o->count, sizeof *o->depth);
    o->large = calloc(o->count, 1);
    if (o->difference && o->taken && o->known && o->size && o->depth && o->large) return RN_OK;
    return rn_error_set(err, RN_ERROR_NO_MEMORY, "outliers", "out of memory");
}

size_t rn_outlier_pass_bytes(size_t blocks, size_t most) {
    const struct rn_outliers *o = NULL;
    size_t each = sizeof *o->difference + sizeof *o->taken + sizeof *o->known + sizeof *o->size +
                  sizeof *o->depth + sizeof *o->large + sizeof(double); // measure's
    // Memory that is not looked at is not taken; and no fewer photographs than FEWEST are.
    size_t looked = MOST + most > FEWEST * most ? MOST + most : FEWEST * most;
    return each * (looked < blocks ? looked : blocks);
}

// ---- a pass -----------------------------------------------------------------------------------

// What is withheld is not learned, whatever it shows.
static bool is_looked_at(const struct rn_trainer *t, int f) {
    return f % t->outliers.apart == t->outliers.turns % t->outliers.apart &&
           !rn_trainer_withholds(t, t->train.frames[f].frame);
}

bool rn_trainer_is_outlier(const struct rn_trainer *t, const struct rn_pixel_frame *frame, int x,
                           int y) {
    const struct rn_outliers *o = &t->outliers;
    if (!o->out) return false;
    size_t first = o->first[frame - t->train.frames];
    return o->out[first + (size_t)(y / RN_OUTLIER_BLOCK) * (size_t)across_of(frame) +
                  (size_t)(x / RN_OUTLIER_BLOCK)];
}

bool rn_trainer_outliers_due(const struct rn_trainer *t) {
    const struct rn_effect_record *record = record_of(t);
    double done = rn_schedule_done(&t->field->config, &t->progress);
    if (!record->decided) return !t->outliers.share_known && done >= MEASURED_AT;
    int all = record->on ? turns(t) : 0;
    return t->outliers.turns < all &&
           done >= MEASURED_AT + (LAST_AT - MEASURED_AT) * t->outliers.turns / all;
}

// Pixels of consecutive blocks, in the order of the blocks.
struct looks {
    int count;
    size_t block[BATCH]; // of the photograph
    struct rn_trainer_place places[BATCH];
};

static void render(struct rn_trainer *t, int thread, const struct looks *looks, size_t first) {
    struct rn_outliers *o = &t->outliers;
    struct rn_march_ray rays[BATCH];
    struct rn_pixel pixels[BATCH];
    struct rn_march_options march = rn_effects_march_trained(t->field);
    march.step = rn_schedule_march(t->field, &t->progress).step;
    rn_trainer_rays(t, &t->train, looks->places, looks->count, (double)march.step, rays);
    t->engine->kernels->render(&t->field->cpu, &march, rays, looks->count,
                               rn_engine_workspace(t->engine, thread), pixels);
    for (int i = 0; i < looks->count; i++) {
        size_t block = first + looks->block[i];
        for (int c = 0; c < 3; c++) {
            float mean = o->difference[block][c] * (float)o->known[block];
            o->difference[block][c] =
                (mean + pixels[i].rgb[c] - rays[i].target[c]) / (float)(o->known[block] + 1);
            o->taken[block][c] = (o->taken[block][c] * (float)o->known[block] + rays[i].target[c]) /
                                 (float)(o->known[block] + 1);
        }
        o->depth[block] = (o->depth[block] * (float)o->known[block] + pixels[i].depth) /
                          (float)(o->known[block] + 1);
        o->known[block]++;
    }
}

static void look(void *context, int index, int thread) {
    struct rn_trainer *t = context;
    const struct rn_pixel_frame *frame = &t->train.frames[index];
    int across = across_of(frame), blocks = across * down_of(frame);
    struct looks looks = {.count = 0};
    if (!is_looked_at(t, index)) return;
    for (int i = 0; i < LOOKS * blocks; i++) {
        int block = i / LOOKS;
        struct rn_rng4 draw = rn_rng_draw(t->field->config.seed, STREAM + (uint64_t)index,
                                          (uint64_t)t->outliers.turns << 32 | (uint64_t)i);
        int x = block % across * RN_OUTLIER_BLOCK + (int)rn_rng_below(draw.v[0], RN_OUTLIER_BLOCK);
        int y = block / across * RN_OUTLIER_BLOCK + (int)rn_rng_below(draw.v[1], RN_OUTLIER_BLOCK);
        if (x < frame->camera.width && y < frame->camera.height &&
            rn_pixel_is_used(&t->train, frame, x, y)) {
            looks.block[looks.count] = (size_t)block;
            looks.places[looks.count++] =
                (struct rn_trainer_place){.frame = frame, .x = x, .y = y, .block = -1};
        }
        if (looks.count < BATCH && (looks.count == 0 || i + 1 < LOOKS * blocks)) continue;
        render(t, thread, &looks, t->outliers.first[index]);
        looks.count = 0;
    }
}

// What a photograph shows in a block and its neighbours, on the mean.
static void taken_around(const struct rn_trainer *t, int f, int block, float ret[3]) {
    const struct rn_outliers *o = &t->outliers;
    const struct rn_pixel_frame *frame = &t->train.frames[f];
    static const float nothing[3] = {0, 0, 0};
    int count = sum_around(o->taken[o->first[f]], o->known + o->first[f], across_of(frame),
                           down_of(frame), block, nothing, ret);
    for (int c = 0; c < 3 && count > 0; c++)
        ret[c] /= (float)count;
}

// The other photographs that see what a block looks at, at a distance: how many, how many of them
// are near the field there, and how many show there what the block shows.
struct witnesses {
    int seen, near, alike;
};

static struct witnesses ask_others(const struct rn_trainer *t, int f, int block, double distance,
                                   float threshold) {
    const struct rn_outliers *o = &t->outliers;
    const struct rn_pixel_frame *frame = &t->train.frames[f];
    struct witnesses others = {.seen = 0};
    int across = across_of(frame), every = o->apart;
    int stride = every * (t->train.frame_count / every / OTHERS + 1);
    float size = o->size[o->first[f] + (size_t)block], here[3], there[3];
    struct rn_ray ray = rn_camera_ray(&frame->camera, (block % across + 0.5) * RN_OUTLIER_BLOCK,
                                      ((double)(block / across) + 0.5) * RN_OUTLIER_BLOCK);
    double point[3], axes[3], at[2];
    for (int i = 0; i < 3; i++)
        point[i] = ray.origin[i] + ray.direction[i] * distance;
    taken_around(t, f, block, here);
    for (int g = o->turns % every; g < t->train.frame_count; g += stride) {
        const struct rn_pixel_frame *other = &t->train.frames[g];
        rn_camera_axes(&other->camera, point, axes);
        if (g == f || !rn_camera_project(&other->camera, axes, at) || !(at[0] >= 0) ||
            !(at[1] >= 0) || at[0] >= other->camera.width || at[1] >= other->camera.height)
            continue;
        int its =
            (int)(at[1] / RN_OUTLIER_BLOCK) * across_of(other) + (int)(at[0] / RN_OUTLIER_BLOCK);
        if (!o->known[o->first[g] + (size_t)its]) continue;
        taken_around(t, g, its, there);
        float squares = 0;
        for (int c = 0; c < 3; c++)
            squares += (there[c] - here[c]) * (there[c] - here[c]);
        others.seen++;
        others.near += o->size[o->first[g] + (size_t)its] < 0.5f * threshold;
        others.alike += sqrtf(squares / 3) < 0.75f * size;
    }
    return others;
}

// Whether photographs that look at what is behind a block, where the field has it, mostly agree
// with the field there: what is not learned yet, all of them miss. Where the field has it too near
// or too far, they say nothing of it; so at no distance may most of them show what the block shows.
static bool is_contradicted(const struct rn_trainer *t, int f, int block, float threshold) {
    const struct rn_outliers *o = &t->outliers;
    double depth = (double)o->depth[o->first[f] + (size_t)block] * t->field->bounds.radius;
    struct witnesses others = ask_others(t, f, block, depth, threshold);
    if (others.seen < WITNESSES || 2 * others.near <= others.seen) return false;
    for (int i = 0; i < STANDS; i++) {
        double disparity = FARTHEST + (NEAREST - FARTHEST) * (double)i / STANDS;
        others = ask_others(t, f, block, depth / disparity, threshold);
        if (others.alike >= WITNESSES && 2 * others.alike > others.seen) return false;
    }
    return true;
}

// The sizes of all differences, and from where on they are large.
static enum rn_status measure(struct rn_trainer *t, struct rn_error *err) {
    struct rn_outliers *o = &t->outliers;
    enum rn_status status = RN_OK;
    for (int f = 0; f < t->train.frame_count && status == RN_OK; f++) {
        const struct rn_pixel_frame *frame = &t->train.frames[f];
        size_t first = o->first[f];
        if (is_looked_at(t, f))
            status = rn_outlier_sizes(o->difference[first], o->known + first, across_of(frame),
                                      down_of(frame), o->size + first, err);
    }
    double *room = status == RN_OK ? malloc(o->count * sizeof *room) : NULL;
    if (!room) return rn_error_set(err, RN_ERROR_NO_MEMORY, "outliers", "out of memory");
    float middle = median(o->size, o->known, o->count, 1, room);
    o->threshold = fmaxf((float)RN_OUTLIER_LEAST, RN_OUTLIER_TIMES * middle);
    free(room);
    return RN_OK;
}

static void judge(void *context, int index, int thread) {
    (void)thread;
    struct rn_trainer *t = context;
    struct rn_outliers *o = &t->outliers;
    const struct rn_pixel_frame *frame = &t->train.frames[index];
    for (int b = 0; b < across_of(frame) * down_of(frame) && is_looked_at(t, index); b++) {
        size_t at = o->first[index] + (size_t)b;
        o->large[at] = o->size[at] > o->threshold && is_contradicted(t, index, b, o->threshold);
    }
}

static void conclude(struct rn_trainer *t) {
    struct rn_outliers *o = &t->outliers;
    size_t out = 0, all = 0;
    uint8_t *mask = o->out ? o->out : o->known;
    for (int f = 0; f < t->train.frame_count; f++) {
        int across = across_of(&t->train.frames[f]), down = down_of(&t->train.frames[f]);
        if (!is_looked_at(t, f)) continue;
        rn_outlier_trim(o->large + o->first[f], across, down, mask + o->first[f]);
        for (int b = 0; b < across * down; b++)
            out += mask[o->first[f] + (size_t)b];
        all += (size_t)across * (size_t)down;
    }
    o->share = (double)out / (double)(all ? all : 1);
}

// Photographs from o->next on, until all are done (true) or the engine is wanted.
static bool go_through(struct rn_trainer *t, void (*work)(void *context, int index, int thread)) {
    struct rn_outliers *o = &t->outliers;
    return rn_pool_run_some(t->engine->pool, t->train.frame_count, &o->next, work, t,
                            rn_engine_is_wanted, t->engine);
}

enum rn_status rn_trainer_seek_outliers(struct rn_trainer *t, bool *ret_busy,
                                        struct rn_error *err) {
    struct rn_outliers *o = &t->outliers;
    *ret_busy = false;
    enum rn_status status = begin_pass(t, err);
    if (status != RN_OK) return status;
    if (!(o->threshold > 0)) { // not all are looked at
        *ret_busy = !go_through(t, look);
        if (*ret_busy) return RN_OK;
        status = measure(t, err);
        if (status != RN_OK) return status;
        o->next = 0;
    }
    *ret_busy = !go_through(t, judge);
    if (*ret_busy) return RN_OK;
    conclude(t);
    end_pass(o);
    if (record_of(t)->decided)
        o->turns++;
    else
        o->share_known = true;
    return RN_OK;
}

// One training by several ranks: threads of this process, each with an engine of its own, that tell
// each other by copying. Whatever their number, parameters end as the same bytes; so too where rank
// 0 renders, evaluates and saves meanwhile, and where a training goes on with another number.
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/kernels/exchange.h"
#include "tests/ops/train_scene.h"

// ---- ranks as threads ------------------------------------------------------------------------

static struct {
    int ranks;
    pthread_barrier_t barrier;
    void *bytes[RN_MAX_RANKS]; // that each rank is at
    size_t told;               // bytes, by rank 0
} all;
static _Thread_local int own_rank;

static void meet(void *bytes) {
    all.bytes[own_rank] = bytes;
    pthread_barrier_wait(&all.barrier);
}

static void part(void) {
    pthread_barrier_wait(&all.barrier);
}

static void broadcast(void *bytes, size_t size) {
    meet(bytes);
    if (own_rank > 0) memcpy(bytes, all.bytes[0], size);
    part();
}

static void gather(void *bytes, const size_t sizes[RN_MAX_RANKS]) {
    size_t at = 0;
    meet(bytes);
    for (int r = 0; r < all.ranks; at += sizes[r++])
        if (r != own_rank) memcpy((uint8_t *)bytes + at, (uint8_t *)all.bytes[r] + at, sizes[r]);
    if (own_rank == 0) all.told += at;
    part();
}

static void maxima(uint32_t *numbers, size_t count) {
    uint32_t *largest = malloc(count * sizeof *largest);
    ck_assert_ptr_nonnull(largest);
    meet(numbers);
    memcpy(largest, numbers, count * sizeof *largest);
    for (int r = 0; r < all.ranks; r++)
        for (size_t i = 0; i < count; i++) {
            uint32_t number = ((const uint32_t *)all.bytes[r])[i];
            if (number > largest[i]) largest[i] = number;
        }
    part();
    memcpy(numbers, largest, count * sizeof *largest);
    part();
    free(largest);
}

static void abandon(void) {
    abort();
}

static struct rn_exchange exchange_of(int rank) {
    return (struct rn_exchange){.version = RN_EXCHANGE_VERSION,
                                .rank = rank,
                                .ranks = all.ranks,
                                .broadcast = broadcast,
                                .gather = gather,
                                .maxima = maxima,
                                .abandon = abandon};
}

// ---- trainings -------------------------------------------------------------------------------

struct training {
    const struct rn_dataset *dataset;
    struct rn_train_config config;
    int ranks;
    char from[128];                    // a checkpoint; "": none
    void (*lead)(struct rn_trainer *); // rank 0's beginning; NULL: none
    bool cut_off;                      // it ends there
    char sha256[65];
    float *parameters[2]; // of ranks 0 and 1 at the end
    size_t count;
};

static struct rn_trainer *make(const struct training *training, struct rn_engine *engine) {
    struct rn_trainer *trainer;
    struct rn_error err;
    if (!*training->from) return trainer_for(engine, training->dataset, &training->config);
    ck_assert_msg(
        rn_trainer_restore(engine, training->dataset, training->from, 0, &trainer, &err) == RN_OK,
        "%s", err.text);
    return trainer;
}

static void keep(struct training *training, int rank, const struct rn_field *field) {
    const struct rn_parameters *p = &field->parameters;
    if (rank > 1) return;
    training->count = p->count;
    training->parameters[rank] = malloc(p->count * sizeof(float));
    memcpy(training->parameters[rank], p->values, p->count * sizeof(float));
}

struct seat {
    struct training *training;
    int rank;
    struct rn_engine *engine;
};

static void *run_rank(void *context) {
    struct seat *seat = context;
    struct training *training = seat->training;
    struct rn_exchange exchange = exchange_of(own_rank = seat->rank);
    struct rn_error err;
    rn_engine_join(seat->engine, &exchange);
    struct rn_trainer *trainer = make(training, seat->engine);
    if (seat->rank > 0) {
        ck_assert_int_eq(rn_trainer_follow(trainer, &err), RN_OK);
        keep(training, seat->rank, trainer->field);
        rn_trainer_destroy(&trainer);
        return NULL;
    }
    if (training->lead) training->lead(trainer);
    if (!training->cut_off) run_to_end(trainer);
    struct rn_field *field = rn_trainer_finish(&trainer);
    keep(training, 0, field);
    rn_field_sha256(field, training->sha256);
    rn_field_destroy(&field);
    return NULL;
}

static void run(struct training *training) {
    pthread_t threads[RN_MAX_RANKS];
    struct seat seats[RN_MAX_RANKS];
    all.ranks = training->ranks;
    all.told = 0;
    pthread_barrier_init(&all.barrier, NULL, (unsigned)all.ranks);
    for (int r = 0; r < all.ranks; r++) {
        seats[r] = (struct seat){training, r, engine_with(1)};
        ck_assert_int_eq(pthread_create(&threads[r], NULL, run_rank, &seats[r]), 0);
    }
    for (int r = 0; r < all.ranks; r++) {
        pthread_join(threads[r], NULL);
        rn_engine_destroy(&seats[r].engine);
    }
    pthread_barrier_destroy(&all.barrier);
    // Each rank ends with the same ones.
    if (all.ranks > 1)
        ck_assert_mem_eq(training->parameters[0], training->parameters[1],
                         training->count * sizeof(float));
    free(training->parameters[0]);
    free(training->parameters[1]);
}

static void expect_the_same(struct training *one, struct training *other) {
    run(one);
    run(other);
    ck_assert_str_eq(one->sha256, other->sha256);
    ck_assert(all.told > 0);
}

// ---- tests -----------------------------------------------------------------------------------

START_TEST(test_any_number_of_ranks) {
    // Three scales, planes that grow, split pixels, rays drawn by error.
    struct training one = {.dataset = scaled, .config = config_for(scaled), .ranks = 1};
    one.config.draw_by_error = true;
    one.config.max_steps = 70; // errors are looked at after 64
    one.config.target_samples = 4096;
    struct training three = one;
    three.ranks = 3;
    expect_the_same(&one, &three);
}
END_TEST

START_TEST(test_a_rank_a_group) {
    struct training one = {.dataset = dataset, .config = config_for(dataset), .ranks = 1};
    one.config.max_steps = 2;
    one.config.initial_rays = one.config.target_samples = 1024;
    struct training most = one;
    most.ranks = RN_GROUPS;
    expect_the_same(&one, &most);
}
END_TEST

// Cells are kept by what they showed, to any rank, and each photograph has an appearance.
START_TEST(test_a_place) {
    struct training one = {.dataset = dataset, .config = config_for(dataset), .ranks = 1};
    one.config.effect[RN_EFFECT_UNBOUNDED] = RN_EFFECT_WANTED;
    one.config.max_steps = 18; // cells are looked at after 16
    one.config.initial_rays = 64;
    one.config.target_samples = 2048;
    one.config.effect[RN_EFFECT_POSE_REFINEMENT] = RN_EFFECT_UNWANTED; // takes long
    one.config.effect[RN_EFFECT_APPEARANCE] = RN_EFFECT_WANTED;
    struct training two = one;
    two.ranks = 2;
    expect_the_same(&one, &two);
}
END_TEST

// As a runner does that is asked for pictures all the time.
static void lead_with_much_else(struct rn_trainer *t) {
    struct rn_error err;
    char path[128], sha256[65];
    bool begun = false;
    snprintf(path, sizeof path, "%s/ranks.rnf", folder);
    rn_engine_yield_to(t->engine, always, NULL);
    for (int i = 0; i < 100 && t->progress.step < 10; i++)
        ck_assert_int_eq(rn_trainer_advance(t, 1, &err), RN_OK);
    (void)held_out_psnr(t);
    ck_assert_int_eq(rn_trainer_advance(t, 1, &err), RN_OK);
    while (!begun)
        ck_assert_int_eq(rn_trainer_save_begin(t, RN_SAVE_ALL, path, &begun, &err), RN_OK);
    ck_assert_int_eq(rn_trainer_advance(t, 1, &err), RN_OK);
    ck_assert_int_eq(rn_trainer_save_end(t, sha256, &err), RN_OK);
    rn_engine_yield_to(t->engine, NULL, NULL);
}

// And then is told to end, within a step.
static void lead_into_a_step(struct rn_trainer *t) {
    struct rn_error err;
    lead_with_much_else(t);
    rn_engine_yield_to(t->engine, always, NULL);
    while (!t->ranks.agreed)
        ck_assert_int_eq(rn_trainer_advance(t, 1, &err), RN_OK);
}

START_TEST(test_what_rank_0_does_beside) {
    struct training one = {.dataset = scaled, .config = config_for(scaled), .ranks = 1};
    one.config.max_steps = 18;
    one.config.target_samples = 4096;
    struct training two = one, rest = one;
    two.ranks = 2;
    two.lead = lead_with_much_else;
    expect_the_same(&one, &two);
    // What was saved then goes on alone.
    snprintf(rest.from, sizeof rest.from, "%s/ranks.rnf", folder);
    run(&rest);
    ck_assert_str_eq(one.sha256, rest.sha256);
    // And with others.
    rest.ranks = 3;
    run(&rest);
    ck_assert_str_eq(one.sha256, rest.sha256);
    two.lead = lead_into_a_step;
    two.cut_off = true;
    run(&two);
}
END_TEST

static void add_tests(TCase *tests) {
    tcase_add_test(tests, test_any_number_of_ranks);
    tcase_add_test(tests, test_a_rank_a_group);
    tcase_add_test(tests, test_a_place);
    tcase_add_test(tests, test_what_rank_0_does_beside);
}

int main(void) {
    return run_on_scene("ranks", add_tests);
}

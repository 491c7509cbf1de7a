// One training by several ranks: how long a step takes, and what the ranks tell each other in it.
//
//   [mpirun -n N] ranks DATASET [preset=draft] [steps=200] [threads=1] [kernels=SET] [skip=20]
//
// Started by mpirun or srun, each process is a rank; RIPNERF_MPI_MODULE names the module that joins
// them (build/server/engine/mpi/ripnerf-mpi.so). Rank 0 prints a line: the digest of the
// parameters, milliseconds a step after the first `skip` ones, of these the ones spent in the
// exchange, waiting included, what processor the rest took, and bytes that all ranks together have
// told a step. No test by itself.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "common/base/clock.h"
#include "server/engine/engine.h"
#include "server/engine/kernels/exchange.h"

static const struct rn_exchange *inner; // what is measured; NULL: one process
struct times {
    int64_t clock_ns, cpu_ns; // of the world, of this process
};
static struct {
    struct times times;
    int64_t calls;
    double bytes;
} spent;

static struct times times_now(void) {
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (struct times){rn_clock_ns(), (int64_t)t.tv_sec * 1000000000 + t.tv_nsec};
}

static struct times times_since(struct times begin) {
    struct times now = times_now();
    return (struct times){now.clock_ns - begin.clock_ns, now.cpu_ns - begin.cpu_ns};
}

static void die(const struct rn_error *err) {
    fprintf(stderr, "ranks: %s: %s\n", err->where, err->text);
    exit(1);
}

static void count(struct times begin, size_t bytes) {
    struct times passed = times_since(begin);
    spent.times.clock_ns += passed.clock_ns;
    spent.times.cpu_ns += passed.cpu_ns;
    spent.bytes += (double)bytes;
    spent.calls++;
}

static void broadcast(void *bytes, size_t size) {
    struct times begin = times_now();
    inner->broadcast(bytes, size);
    count(begin, size);
}

static void gather(void *bytes, const size_t sizes[RN_MAX_RANKS]) {
    struct times begin = times_now();
    size_t all = 0;
    for (int r = 0; r < inner->ranks; r++)
        all += sizes[r];
    inner->gather(bytes, sizes);
    count(begin, all);
}

static void maxima(uint32_t *numbers, size_t n) {
    struct times begin = times_now();
    inner->maxima(numbers, n);
    count(begin, n * sizeof *numbers);
}

static void set(struct rn_train_config *config, struct rn_engine_options *options, int *skip,
                const char *argument) {
    const char *value = strchr(argument, '=');
    value = value ? value + 1 : "";
    if (strncmp(argument, "steps=", 6) == 0) config->max_steps = atoll(value);
    if (strncmp(argument, "threads=", 8) == 0) options->threads = atoi(value);
    if (strncmp(argument, "kernels=", 8) == 0) options->kernels = value;
    if (strncmp(argument, "skip=", 5) == 0) *skip = atoi(value);
}

static void lead(struct rn_trainer *trainer, int skip) {
    struct rn_error err;
    struct rn_progress p = {.done = false};
    struct rn_field_info about;
    struct times begin = {0, 0};
    int64_t first = 0;
    char sha256[65];
    while (!p.done) {
        if (rn_trainer_advance(trainer, 1, &err)) die(&err);
        rn_trainer_progress(trainer, &p);
        if (begin.clock_ns || p.step < skip) continue;
        begin = times_now();
        first = p.step;
        memset(&spent, 0, sizeof spent);
    }
    struct times passed = times_since(begin);
    double steps = (double)(p.step - first);
    rn_field_describe(rn_trainer_field(trainer), &about);
    rn_field_sha256(rn_trainer_field(trainer), sha256);
    printf("%s ranks %d ms_a_step %.3f ms_exchange %.3f cpu_ms_a_step %.3f bytes_a_step %.0f "
           "calls_a_step %.1f samples_a_step %.0f kernels %s\n",
           sha256, inner ? inner->ranks : 1, 1e-6 * (double)passed.clock_ns / steps,
           1e-6 * (double)spent.times.clock_ns / steps,
           1e-6 * (double)(passed.cpu_ns - spent.times.cpu_ns) / steps, spent.bytes / steps,
           (double)spent.calls / steps, (double)p.samples / (double)p.step, about.kernels);
}

int main(int argc, char **argv) {
    const char *preset = "draft";
    bool ranks = getenv("OMPI_COMM_WORLD_SIZE") || getenv("PMIX_RANK");
    struct rn_engine_options options = {.device = "cpu", .threads = 1};
    struct rn_train_config config;
    struct rn_exchange counted = {.rank = 0};
    struct rn_device_info device;
    struct rn_dataset *dataset;
    struct rn_engine *engine;
    struct rn_trainer *trainer;
    struct rn_error err;
    int skip = 20;
    if (argc < 2) {
        fprintf(stderr,
                "usage: [mpirun -n N] %s DATASET [preset=] [steps=] [threads=] [kernels=] "
                "[skip=]\n",
                argv[0]);
        return 2;
    }
    for (int i = 2; i < argc; i++)
        if (strncmp(argv[i], "preset=", 7) == 0) preset = argv[i] + 7;
    if (rn_dataset_read_whole(argv[1], &dataset, &err)) die(&err);
    if (rn_preset(preset, dataset->scale_count > 1, &config, &err)) die(&err);
    config.max_seconds = 0;
    config.max_steps = 200;
    for (int i = 2; i < argc; i++)
        set(&config, &options, &skip, argv[i]);
    if (ranks && rn_exchange_open(&inner, &err)) die(&err);
    if (rn_engine_create(&options, &engine, &err)) die(&err);
    if (inner) { // which may have timed kernels otherwise than rank 0
        rn_engine_describe(engine, &device);
        inner->broadcast(device.kernels, sizeof device.kernels);
        rn_engine_destroy(&engine);
        options.kernels = device.kernels;
        if (rn_engine_create(&options, &engine, &err)) die(&err);
        counted = *inner;
        counted.broadcast = broadcast;
        counted.gather = gather;
        counted.maxima = maxima;
        rn_engine_join(engine, &counted);
    }
    if (rn_trainer_create(engine, dataset, &config, 0, &trainer, &err)) die(&err);
    if (inner && inner->rank > 0) {
        if (rn_trainer_follow(trainer, &err)) die(&err);
    } else {
        lead(trainer, skip);
    }
    rn_trainer_destroy(&trainer);
    rn_engine_destroy(&engine);
    rn_dataset_destroy(&dataset);
    if (inner) inner->leave();
    return 0;
}

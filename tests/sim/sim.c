// A deterministic simulation of the daemon: the shipped code of server/jobs and server/store over a
// scheduler, a disk, a clock and runners that are drawn from a seed.
//
//   sim [--seed N] [--histories N | --seconds S | --seeds FILE] [--lives N] [--week] [--trace]
//
// A seed is a history: lives of one daemon on one disk, most of which end in a crash, and a last
// one that ends all jobs; or, with --week, a single one of seven days, in which nothing may grow.
// Prints what was found, with the seed that shows it again, and the figures.
#include <getopt.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/resource.h>

#include "tests/sim/life.h"

#define DISK_BYTES ((size_t)1 << 30)

struct sim_world *sim;
static uint8_t *block;

struct options {
    uint64_t seed;
    long histories, lives;
    double seconds;
    const char *seeds; // a file: a seed, and what it has found, a line
    bool week, trace;
};

static void *share(size_t size) {
    void *memory =
        mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (memory == MAP_FAILED) {
        perror("sim: mmap");
        exit(2);
    }
    return memory;
}

static void begin_history(const struct options *options, uint64_t seed) {
    struct sim_figures figures = sim->figures;
    memset(sim, 0, sizeof *sim);
    sim->figures = figures;
    sim->seed = sim->random = seed;
    sim->trace = options->trace;
    sim->week = options->week;
    sim->wall_ms = 1700000000000;
    sim->now_ns = 1000000000;
    sim_disk_reset(&sim->disk, block, DISK_BYTES);
    sim->figures.histories++;
}

// How this life will end, when nothing else ends it.
static void draw_end(void) {
    static const int spans[] = {200, 2000, 20000};
    sim->crash = sim_chance(2) ? SIM_KILLED : SIM_NO_POWER;
    sim->crash_after = sim_chance(8) ? 0 : 1 + sim_below(spans[sim_below(3)]);
    sim->life_end_ns = sim->now_ns + (5 + sim_below(240)) * 1000000000ll;
    sim->pause_ms = sim_chance(3) ? 300 : 3000;
}

static bool live_once(bool last) {
    draw_end();
    if (last) sim->crash_after = 0;
    if (sim->week) sim->pause_ms = 300000;
    enum sim_end end = sim_live(last);
    sim->figures.lives++;
    if (end != SIM_STOPPED && end != SIM_KILLED && end != SIM_NO_POWER) return false;
    sim->figures.stops += end == SIM_STOPPED;
    sim->figures.kills += end == SIM_KILLED;
    sim->figures.power_losses += end == SIM_NO_POWER;
    sim->crash = end;
    sim->in_runner = sim->disk.full = false;
    sim_runners_survive();
    if (end == SIM_NO_POWER)
        sim_disk_lose_power(&sim->disk);
    else
        sim_disk_close_all(&sim->disk);
    sim->now_ns += sim_below(30) * 1000000000ll; // until it is started again
    return true;
}

// False: something is wrong, and said.
static bool run_history(const struct options *options, uint64_t seed) {
    begin_history(options, seed);
    int64_t begin_ns = sim->now_ns;
    long life_number = 0;
    bool good = true;
    while (good && life_number < options->lives)
        good = live_once(++life_number == options->lives);
    sim->figures.virtual_ms += (uint64_t)(sim->now_ns - begin_ns) / 1000000;
    if (!good)
        printf("seed %llu, life %ld, %.3f s: %s\n", (unsigned long long)seed, life_number,
               (double)sim->now_ns * 1e-9, sim->violation);
    return good;
}

// What this and all lives have cost: as many histories on a busy machine as on an idle one.
static double processor_s(void) {
    double seconds = 0;
    const int whose[] = {RUSAGE_SELF, RUSAGE_CHILDREN};
    for (int i = 0; i < 2; i++) {
        struct rusage used;
        getrusage(whose[i], &used);
        seconds += (double)(used.ru_utime.tv_sec + used.ru_stime.tv_sec);
        seconds += (double)(used.ru_utime.tv_usec + used.ru_stime.tv_usec) * 1e-6;
    }
    return seconds;
}

static void print_figures(double seconds) {
    const struct sim_figures *f = &sim->figures;
    double per_hour = 3600 / seconds;
    uint64_t crashes = f->kills + f->power_losses;
    printf("%llu histories, %llu lives: %llu kills, %llu losses of power, %llu orderly ends, %llu "
           "rebuilt\n",
           (unsigned long long)f->histories, (unsigned long long)f->lives,
           (unsigned long long)f->kills, (unsigned long long)f->power_losses,
           (unsigned long long)f->stops, (unsigned long long)f->rebuilds);
    printf("%llu transitions of jobs, %llu requests (%llu refused), %llu pictures, %llu runners "
           "(%llu died), %llu full disks, %.1f virtual hours\n",
           (unsigned long long)f->transitions, (unsigned long long)f->requests,
           (unsigned long long)f->refused, (unsigned long long)f->pictures,
           (unsigned long long)f->runners, (unsigned long long)f->runners_lost,
           (unsigned long long)f->full_disks, (double)f->virtual_ms / 3.6e6);
    printf("%.1f s: %.3g transitions and %.3g crashes an hour\n", seconds,
           (double)f->transitions * per_hour, (double)crashes * per_hour);
}

static struct options parse(int argc, char **argv) {
    static const struct option known[] = {
        {"seed", required_argument, NULL, 's'},    {"histories", required_argument, NULL, 'n'},
        {"seconds", required_argument, NULL, 't'}, {"lives", required_argument, NULL, 'l'},
        {"seeds", required_argument, NULL, 'f'},   {"trace", no_argument, NULL, 'v'},
        {"week", no_argument, NULL, 'w'},          {NULL, 0, NULL, 0}};
    struct options options = {.seed = 1, .histories = 1, .lives = 24};
    int letter;
    while ((letter = getopt_long(argc, argv, "", known, NULL)) != -1) {
        if (letter == 's') options.seed = strtoull(optarg, NULL, 10);
        if (letter == 'n') options.histories = strtol(optarg, NULL, 10);
        if (letter == 't') options.seconds = strtod(optarg, NULL);
        if (letter == 'l') options.lives = strtol(optarg, NULL, 10);
        if (letter == 'f') options.seeds = optarg;
        if (letter == 'v') options.trace = true;
        if (letter == 'w') options.week = true;
        if (letter == '?') exit(2);
    }
    if (options.week) options.lives = 1;
    return options;
}

static bool run_kept(const struct options *options) {
    FILE *file = fopen(options->seeds, "r");
    char line[256];
    bool good = file != NULL;
    while (good && fgets(line, sizeof line, file) != NULL)
        if (line[0] >= '0' && line[0] <= '9') good = run_history(options, strtoull(line, NULL, 10));
    if (file == NULL)
        perror(options->seeds);
    else
        fclose(file);
    return good;
}

static bool run_fresh(const struct options *options, double begin_s) {
    bool good = true;
    for (long i = 0; good && (options->seconds > 0 ? processor_s() - begin_s < options->seconds
                                                   : i < options->histories);
         i++)
        good = run_history(options, options->seed + (uint64_t)i);
    return good;
}

int main(int argc, char **argv) {
    struct options options = parse(argc, argv);
    double begin_s = processor_s();
    sim = share(sizeof *sim);
    block = share(DISK_BYTES);
    bool good = options.seeds != NULL ? run_kept(&options) : run_fresh(&options, begin_s);
    print_figures(processor_s() - begin_s);
    return good ? 0 : 1;
}

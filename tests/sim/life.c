#include "tests/sim/life.h"

#include <fcntl.h>
#include <malloc.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/log.h"
#include "tests/sim/calls.h"

#define SECOND_NS 1000000000ll
#define PATIENCE_NS (4 * 3600 * SECOND_NS)
#define MOST_CACHED (4 << 20) // pages of a growing database, until its cache is full

struct sim_life life;
static bool is_last;

uint64_t sim_random(void) { // splitmix64
    uint64_t z = sim->random += 0x9e3779b97f4a7c15u;
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9u;
    z = (z ^ z >> 27) * 0x94d049bb133111ebu;
    return z ^ z >> 31;
}

int sim_below(int n) {
    return (int)(sim_random() % (uint64_t)n);
}

bool sim_chance(int one_in) {
    return sim_below(one_in) == 0;
}

static void tell(const char *fmt, va_list args) {
    char text[600];
    vsnprintf(text, sizeof text, fmt, args);
    fprintf(stderr, "%12.6f  %s\n", (double)sim->now_ns * 1e-9, text);
}

void sim_tell(const char *fmt, ...) {
    if (!sim->trace) return;
    va_list args;
    va_start(args, fmt);
    tell(fmt, args);
    va_end(args);
}

// In place of common/base/log.c: the log has the simulation's time.
const char *rn_log_set_trace(const char *traceparent) {
    (void)traceparent;
    return NULL;
}

void rn_log(enum rn_log_level level, const char *fmt, ...) {
    if (!sim->trace) return;
    va_list args;
    va_start(args, fmt);
    tell(fmt, args);
    va_end(args);
}

void sim_crash(enum sim_end end) {
    sim_tell("%s", end == SIM_KILLED ? "the daemon is killed" : "the power is lost");
    _exit((int)end);
}

void sim_violated(const char *fmt, ...) {
    va_list args;
    va_start(args, fmt);
    vsnprintf(sim->violation, sizeof sim->violation, fmt, args);
    va_end(args);
    sim_tell("VIOLATED: %s", sim->violation);
    _exit(SIM_VIOLATION);
}

static int64_t now_ns(void) {
    return sim->now_ns;
}

static int64_t wall_ms(void) {
    return sim->wall_ms + sim->now_ns / 1000000;
}

// ---- the daemon -------------------------------------------------------------------------------

static void check(enum rn_status status, const char *what, const struct rn_error *err) {
    if (status != RN_OK) sim_violated("%s: %s: %s", what, err->where, err->text);
}

static void open_store(bool rebuild) {
    struct rn_error err = {0};
    check(rn_store_open(SIM_DATA, rebuild, &life.store, &err), "the store is not opened", &err);
    check(rn_store_sweep(life.store, &err), "the store is not swept", &err);
    sim_promises_check(rebuild);
}

static void start(void) {
    const struct rn_control_options options = {.training_slots = 2,
                                               .max_queued = 40,
                                               .max_loaded = 4,
                                               .keep_alive_s = 30,
                                               .runner_timeout_s = 20,
                                               .curve_after_s = 60,
                                               .retain_pictures_s = sim->week ? 86400 : 0,
                                               .threads = 2,
                                               .version = "sim"};
    struct rn_error err = {0};
    check(rn_control_create(&options, life.store, sim_executor(), &life.control, &err),
          "the control is not created", &err);
    life.open = true;
}

static bool is_open(const struct sim_job *job) {
    return job->state != RN_JOB_SUCCEEDED && job->state != RN_JOB_FAILED &&
           job->state != RN_JOB_CANCELLED;
}

// Nothing new is wanted and nothing fails any more: all jobs come to an end.
static void finish_all(void) {
    int64_t deadline_ns = sim->now_ns + PATIENCE_NS;
    sim->calm = true;
    sim->disk.full = false;
    for (int i = 0; i < sim->job_count; i++) {
        struct rn_error err = {0};
        char *json = NULL;
        if (sim->jobs[i].state == RN_JOB_PAUSED)
            (void)!rn_control_command(life.control, sim->jobs[i].id, RN_JOB_RESUME, &json, &err);
        free(json);
    }
    for (int i = 0; i < sim->job_count;) {
        if (!is_open(&sim->jobs[i])) {
            i++;
            continue;
        }
        if (sim->now_ns > deadline_ns)
            sim_violated("job %s is still %s after four quiet hours", sim->jobs[i].id,
                         rn_job_state_names[sim->jobs[i].state]);
        sim_sleep(SECOND_NS);
    }
    sim_sleep(200 * SECOND_NS); // pictures that are asked for are given up by then
}

// What could not be written while the disk was full has been written since.
static void settle(void) {
    sim->disk.full = false;
    sim_sleep(5 * SECOND_NS);
    if (sim->disk.full) return;
    for (int i = 0; i < sim->job_count; i++)
        sim->jobs[i].doubt = false;
}

static void stop(void) {
    life.open = false;
    settle();
    while (life.busy > 0)
        sim_sleep(SECOND_NS / 100);
    rn_control_drain(life.control, 20000);
    rn_control_destroy(&life.control);
    sim_pictures_check();
    sim->crash_after = 0;
    sim->disk.full = false;
    if (is_last) sim_promises_check(false);
    rn_store_close(&life.store);
}

static void remove_database(void) {
    static const char *const names[] = {"ripnerf.db", "ripnerf.db-wal", "ripnerf.db-journal"};
    for (int i = 0; i < 3; i++) {
        char path[64];
        snprintf(path, sizeof path, SIM_DATA "/%s", names[i]);
        sim_unlinkat(AT_FDCWD, path, 0);
    }
}

// ---- a week -----------------------------------------------------------------------------------

struct usage {
    int64_t memory, cached, descriptors, files, bytes; // cached: SQLite's memory, which is apart
};

static void cancel_paused(void) {
    for (int i = 0; i < sim->job_count; i++) {
        struct rn_error err = {0};
        char *json = NULL;
        if (sim->jobs[i].state == RN_JOB_PAUSED)
            (void)!rn_control_command(life.control, sim->jobs[i].id, RN_JOB_CANCEL, &json, &err);
        free(json);
    }
}

// At rest: no request under way, no job, no runner, and what was asked for written.
static struct usage measure(void) {
    struct usage usage;
    struct rn_control_stats stats;
    life.open = false;
    for (int tries = 0;; tries++) {
        cancel_paused();
        sim_sleep(60 * SECOND_NS);
        rn_control_stats(life.control, &stats);
        unsigned open = 0;
        for (int i = 0; i <= RN_JOB_INTERRUPTED; i++)
            open += stats.jobs_open[i];
        if (open == 0 && stats.runners == 0 && !sim->disk.full) break;
        if (tries > 600) sim_violated("ten hours after the last request, %u jobs are open", open);
    }
    usage.cached = sim_vfs_memory();
    usage.memory = (int64_t)mallinfo2().uordblks - usage.cached;
    usage.descriptors = sim_open_descriptors();
    sim_disk_usage(&sim->disk, &usage.bytes, &usage.files);
    life.open = true;
    return usage;
}

// Every day's end is like that of the second, but for the records of what was done.
static void live_a_week(void) {
    struct usage second = {0};
    for (int day = 1; day <= 7; day++) {
        while (sim->now_ns < day * 24 * 3600 * SECOND_NS)
            sim_sleep(60 * SECOND_NS);
        struct usage now = measure();
        printf("day %d: %d jobs, %lld kB of memory and %lld of SQLite, %lld descriptors, %lld "
               "files of "
               "%lld kB\n",
               day, sim->job_count, (long long)now.memory / 1000, (long long)now.cached / 1000,
               (long long)now.descriptors, (long long)now.files, (long long)now.bytes / 1000);
        fflush(stdout);
        if (day == 2) second = now;
        if (day > 2 && now.memory > second.memory + second.memory / 10)
            sim_violated("memory grows: %lld bytes after %d days, %lld after two",
                         (long long)now.memory, day, (long long)second.memory);
        if (now.cached > MOST_CACHED)
            sim_violated("SQLite holds %lld bytes after %d days", (long long)now.cached, day);
        if (day > 2 && now.descriptors != second.descriptors)
            sim_violated("%lld descriptors are open after %d days, %lld after two",
                         (long long)now.descriptors, day, (long long)second.descriptors);
    }
}

static void be_daemon(void *context) {
    open_store(false);
    start();
    sim_clients_begin(3);
    if (sim->week) live_a_week();
    if (is_last)
        finish_all();
    else
        while (sim->now_ns < sim->life_end_ns)
            sim_sleep(SECOND_NS);
    stop();
    if (!is_last) return;
    if (sim->week) { // the disk was full: copies that had no room are written at a start
        open_store(false);
        rn_store_close(&life.store);
    }
    remove_database(); // before a start could bring the copies up to date
    open_store(true);
    rn_store_close(&life.store);
    sim->figures.rebuilds++;
    if (sim_open_descriptors() > 0)
        sim_violated("%d descriptors are left open", sim_open_descriptors());
}

enum sim_end sim_live(bool last) {
    int status = 0;
    fflush(NULL);
    pid_t pid = fork();
    if (pid == 0) {
        is_last = last;
        rn_clock_set_source(now_ns, wall_ms);
        sim_vfs_register();
        sim_threads_run(be_daemon);
        _exit(SIM_STOPPED);
    }
    waitpid(pid, &status, 0);
    if (WIFEXITED(status)) return (enum sim_end)WEXITSTATUS(status);
    snprintf(sim->violation, sizeof sim->violation, "the daemon died of signal %d",
             WTERMSIG(status));
    return SIM_VIOLATION;
}

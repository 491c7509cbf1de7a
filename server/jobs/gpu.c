// Memory of GPUs. Runners are processes of their own and share a device, so it is counted here: a
// runner asks for what it will hold, holds none while it waits, and takes it when it is told to.
//
// What fits is granted at once. Else idle scenes make room, the one that was used longest ago
// first: its runner keeps it in the machine's memory, and asks for the device's again before its
// next picture; the runner of a paused training ends. Where that is not enough, a patient runner
// waits for those that work, as long as an empty device would do, and is served before patient ones
// that asked later; any other is told what there is.
#include <stdio.h>
#include <string.h>

#include "common/base/clock.h"
#include "common/base/log.h"
#include "server/jobs/inside.h"

#define LOAD_NS (60 * 1000000000ll) // for a runner that is still opening, after its grant
#define MIB(bytes) ((long long)((bytes) >> 20))

// What runners hold of a GPU: all of them, those that keep it, or those of them that are idle. One
// that waits holds none.
struct held {
    int64_t all, staying, idle;
};
static struct held held_of(const struct rn_control *control, const char *gpu) {
    struct held held = {0, 0, 0};
    for (const struct rn_runner *r = control->runners; r != NULL; r = r->next) {
        if (strcmp(r->gpu, gpu) != 0) continue;
        held.all += r->gpu_bytes;
        if (r->state != RN_RUNNER_ENDING && !r->rests) held.staying += r->gpu_bytes;
        if (rn_runner_is_idle(r)) held.idle += r->gpu_bytes;
    }
    return held;
}

// What all runners together may hold on the device of a wish: the option's, or what was free there
// when none of them held any.
static int64_t capacity_of(struct rn_control *control, const struct rn_runner *runner,
                           const struct held *held) {
    struct rn_gpu *gpu = control->gpus, *end = gpu + RN_MAX_GPUS - 1;
    if (control->options.gpu_memory_bytes > 0) return control->options.gpu_memory_bytes;
    while (gpu < end && gpu->name[0] != '\0' && strcmp(gpu->name, runner->gpu) != 0)
        gpu++;
    snprintf(gpu->name, sizeof gpu->name, "%s", runner->gpu);
    if (held->all == 0) gpu->capacity_bytes = runner->wish.free_bytes;
    return gpu->capacity_bytes;
}

// Being told something is no use of its scene.
static void tell(struct rn_control *control, struct rn_runner *runner, enum rn_wire_type type,
                 const void *message) {
    int64_t last_used_ns = runner->last_used_ns;
    rn_runner_post(control, runner, type, message);
    runner->last_used_ns = last_used_ns;
}

static void grant(struct rn_control *control, struct rn_runner *runner, int64_t bytes) {
    struct rn_wire_grant grant = {.number = runner->wish.number, .bytes = bytes};
    runner->gpu_bytes = bytes >= runner->wish.bytes ? runner->wish.bytes : 0;
    rn_log(RN_LOG_INFO, "runner %d: wants %lld MiB of %s, %s", (int)runner->process.pid,
           MIB(runner->wish.bytes), runner->gpu, runner->gpu_bytes > 0 ? "granted" : "refused");
    runner->wish.bytes = 0;
    tell(control, runner, RN_WIRE_GRANT, &grant);
    control->schedule_due = true; // it is the next one's turn
}

static bool waits(const struct rn_runner *runner) {
    return runner->wish.bytes > 0 && runner->state != RN_RUNNER_ENDING;
}

static bool is_next(const struct rn_control *control, const struct rn_runner *runner) {
    for (const struct rn_runner *r = control->runners; r != NULL; r = r->next)
        if (waits(r) && r->wish.patient && runner->wish.patient && r->turn < runner->turn &&
            strcmp(r->gpu, runner->gpu) == 0)
            return false;
    return true;
}

// Idle scenes rest until `left` bytes and what they hold are `wanted`.
static void make_room(struct rn_control *control, const char *gpu, int64_t left, int64_t wanted) {
    struct rn_wire_empty empty = {""};
    struct rn_runner *oldest;
    while (left < wanted && (oldest = rn_runner_oldest_idle(control, false, gpu)) != NULL) {
        rn_log(RN_LOG_INFO, "runner %d: makes room on %s: %lld MiB of scene %s",
               (int)oldest->process.pid, gpu, MIB(oldest->gpu_bytes), oldest->scene);
        left += oldest->gpu_bytes;
        control->stats.scenes_rested++;
        if (oldest->train != NULL) { // a paused one: it goes on in another runner
            rn_runner_shutdown(control, oldest);
        } else {
            tell(control, oldest, RN_WIRE_REST, &empty);
            oldest->rests = true;
        }
    }
}

static void consider(struct rn_control *control, struct rn_runner *runner) {
    struct held held = held_of(control, runner->gpu);
    int64_t all = capacity_of(control, runner, &held), wanted = runner->wish.bytes;
    int64_t reachable = all - held.staying + held.idle;
    if (wanted > all)
        grant(control, runner, all);
    else if (wanted <= all - held.all)
        grant(control, runner, wanted);
    else if (wanted <= reachable)
        make_room(control, runner->gpu, all - held.staying, wanted);
    else if (!runner->wish.patient)
        grant(control, runner, reachable > 0 ? reachable : 0);
}

void rn_gpu_share(struct rn_control *control) {
    for (struct rn_runner *r = control->runners; r != NULL; r = r->next) {
        if (!waits(r)) continue;
        if (r->state == RN_RUNNER_STARTING) r->deadline_ns = rn_clock_ns() + LOAD_NS;
        if (is_next(control, r)) consider(control, r);
    }
}

void rn_gpu_reserve(struct rn_control *control, struct rn_runner *runner,
                    const struct rn_wire_reserve *reserve) {
    if (runner->process.remote) { // Slurm has counted it
        runner->wish = *reserve;
        grant(control, runner, reserve->bytes);
        return;
    }
    bool smaller = strcmp(runner->gpu, reserve->device) == 0 && reserve->bytes <= runner->gpu_bytes;
    snprintf(runner->gpu, sizeof runner->gpu, "%s", reserve->device);
    runner->wish = *reserve;
    runner->turn = ++control->next_turn;
    runner->rests = false;
    if (smaller && reserve->bytes > 0)
        grant(control, runner, reserve->bytes);
    else
        runner->gpu_bytes = 0;
    if (!control->stopping) rn_gpu_share(control);
}

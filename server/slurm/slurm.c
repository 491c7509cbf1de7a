#include "server/slurm/slurm.h"

#include <errno.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/log.h"
#include "server/slurm/inside.h"

// Jobs of an earlier daemon that nobody has asked for by then are cancelled.
#define SPARE_NS (60 * 1000000000ll)

void rn_slurm_tell(struct rn_slurm *slurm) {
    pthread_mutex_lock(&slurm->lock);
    void (*news)(void *) = slurm->news;
    void *context = slurm->news_context;
    pthread_mutex_unlock(&slurm->lock);
    if (news != NULL) news(context);
}

static struct rn_place *find(struct rn_slurm *slurm, const struct rn_process *process) {
    struct rn_place *place = slurm->places;
    while (place != NULL && place->number != process->pid)
        place = place->next;
    return place;
}

// ---- start --------------------------------------------------------------------------------------

static enum rn_status name_it(struct rn_place *place, struct rn_error *err) {
    struct rn_join random;
    enum rn_status status = rn_join_make(&random, err);
    if (status == RN_OK) snprintf(place->name, sizeof place->name, "r%.16s", random.said);
    return status;
}

static enum rn_status copy_order(struct rn_place *place, const struct rn_order *order,
                                 struct rn_error *err) {
    if (order->dataset != NULL) place->dataset = strdup(order->dataset);
    if (order->train != NULL) place->train = strdup(order->train);
    if (order->log_path != NULL) place->log = strdup(order->log_path);
    bool copied = (order->dataset == NULL || place->dataset != NULL) &&
                  (order->train == NULL || place->train != NULL) &&
                  (order->log_path == NULL || place->log != NULL);
    return copied ? RN_OK : rn_error_set(err, RN_ERROR_NO_MEMORY, "slurm", "no memory");
}

static enum rn_status add_place(struct rn_slurm *slurm, const struct rn_order *order,
                                struct rn_place **ret_place, struct rn_error *err) {
    struct rn_place *place = calloc(1, sizeof *place);
    if (place == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "slurm", "no memory");
    snprintf(place->scene, sizeof place->scene, "%s", order->scene);
    place->fd = -1;
    place->helps = order->helps;
    place->gpus = -1;
    place->ranks = order->ranks > 1 ? order->ranks : 1;
    place->number = ++slurm->last_number;
    enum rn_status status = name_it(place, err);
    if (status == RN_OK) status = copy_order(place, order, err);
    if (status == RN_OK) status = rn_place_furnish(slurm, place, order->folder, err);
    if (status != RN_OK) {
        rn_place_free(place);
        return status;
    }
    struct rn_place **link = &slurm->places;
    while (*link != NULL)
        link = &(*link)->next;
    *link = place;
    *ret_place = place;
    return RN_OK;
}

// The job of an earlier daemon for the same scene, which waits in the queue or for a secret.
static struct rn_place *find_spare(struct rn_slurm *slurm, const struct rn_order *order) {
    for (struct rn_place *place = slurm->places; place != NULL; place = place->next)
        if (place->spare && !place->over && !order->helps &&
            strcmp(place->scene, order->scene) == 0)
            return place;
    return NULL;
}

static enum rn_status start(struct rn_executor *executor, const struct rn_order *order,
                            struct rn_process *ret_process, struct rn_error *err) {
    struct rn_slurm *slurm = (struct rn_slurm *)executor;
    if (order->here || strcmp(order->mode, "field") != 0)
        return slurm->local->start(slurm->local, order, ret_process, err);
    pthread_mutex_lock(&slurm->lock);
    struct rn_place *place = find_spare(slurm, order);
    bool found = place != NULL;
    enum rn_status status =
        found ? rn_place_invite(slurm, place, err) : add_place(slurm, order, &place, err);
    if (status == RN_OK) {
        place->spare = false;
        *ret_process = (struct rn_process){.pid = place->number, .fd = -1, .remote = true};
        pthread_cond_signal(&slurm->work);
    }
    pthread_mutex_unlock(&slurm->lock);
    return status;
}

// ---- look ---------------------------------------------------------------------------------------

// What a job's exit code says of the nodes.
static void judge(const struct rn_slurm *slurm, const struct rn_place *place,
                  struct rn_error *refusal) {
    const char *machine = place->machine[0] != '\0' ? place->machine : "its node";
    *refusal = place->refusal;
    if (place->exit_code == RN_JOIN_EXIT_NOT_SHARED)
        rn_error_set(refusal, RN_ERROR_INVALID, "shared",
                     "%s is not there on %s (Slurm job %" PRId64
                     "): --shared must be a folder that "
                     "all nodes see at the same path",
                     slurm->folder, machine, place->job);
    if (place->exit_code == RN_JOIN_EXIT_ALONE && slurm->cache != NULL)
        rn_error_set(refusal, RN_ERROR_UNAVAILABLE, "slurm-listen",
                     "a runner on %s (Slurm job %" PRId64 ") did not reach this daemon at %s:%u: "
                     "--slurm-listen says where it is",
                     machine, place->job, slurm->host, slurm->port);
    if (place->exit_code == RN_JOIN_EXIT_NO_CACHE)
        rn_error_set(refusal, RN_ERROR_INVALID, "slurm-cache",
                     "%s cannot be written on %s (Slurm job %" PRId64 "): --slurm-cache names a "
                     "folder of each node's own",
                     slurm->cache, machine, place->job);
    if (place->exit_code == RN_JOIN_EXIT_NO_RANKS)
        rn_error_set(
            refusal, RN_ERROR_UNSUPPORTED, "#/options/ranks",
            "the runners of Slurm job %" PRId64 " on %s cannot train together: the MPI "
            "module (ripnerf-mpi.so, built with libopenmpi-dev) and Slurm's PMIx (libpmix2) "
            "must be there on each node; the job's log has more",
            place->job, machine);
    if (place->exit_code == RN_JOIN_EXIT_NO_PROGRAM)
        rn_error_set(refusal, RN_ERROR_INVALID, "runner",
                     "%s is not there on %s (Slurm job %" PRId64 "): install the same version on "
                     "the nodes, or name one that is there with --runner",
                     slurm->runner, machine, place->job);
}

static void say_reason(const struct rn_place *place, char *reason, size_t size) {
    bool queued = strcmp(place->state, "PENDING") == 0;
    if (place->job == 0)
        snprintf(reason, size, "%s", place->reason[0] != '\0' ? place->reason : "being submitted");
    else if (queued)
        snprintf(reason, size, "%s", place->reason[0] != '\0' ? place->reason : "queued");
    else
        snprintf(reason, size, "%s", "starting");
}

static void look(struct rn_executor *executor, struct rn_process *process,
                 struct rn_whereabouts *ret) {
    struct rn_slurm *slurm = (struct rn_slurm *)executor;
    *ret = (struct rn_whereabouts){.where = RN_WHERE_GONE};
    pthread_mutex_lock(&slurm->lock);
    struct rn_place *place = find(slurm, process);
    if (place != NULL) {
        snprintf(ret->machine, sizeof ret->machine, "%s", place->machine);
        if (place->job > 0) snprintf(ret->job, sizeof ret->job, "%" PRId64, place->job);
        if (place->fd >= 0) process->fd = place->fd;
        place->fd = -1;
        if (place->over || place->refusal.status != RN_OK)
            judge(slurm, place, &ret->refusal);
        else if (place->joined)
            ret->where = RN_WHERE_THERE;
        else
            ret->where = RN_WHERE_WAITS;
        if (ret->where == RN_WHERE_WAITS) say_reason(place, ret->reason, sizeof ret->reason);
    }
    pthread_mutex_unlock(&slurm->lock);
}

static void hung_up(struct rn_executor *executor, const struct rn_process *process) {
    struct rn_slurm *slurm = (struct rn_slurm *)executor;
    pthread_mutex_lock(&slurm->lock);
    struct rn_place *place = find(slurm, process);
    if (place != NULL) place->hung_up = true;
    pthread_cond_signal(&slurm->work);
    pthread_mutex_unlock(&slurm->lock);
}

static void watch(struct rn_executor *executor, void (*news)(void *), void *context) {
    struct rn_slurm *slurm = (struct rn_slurm *)executor;
    pthread_mutex_lock(&slurm->lock);
    slurm->news = news;
    slurm->news_context = context;
    pthread_mutex_unlock(&slurm->lock);
}

static char *folder_of(struct rn_executor *executor, const struct rn_process *process) {
    struct rn_slurm *slurm = (struct rn_slurm *)executor;
    pthread_mutex_lock(&slurm->lock);
    struct rn_place *place = find(slurm, process);
    char *path = place != NULL ? rn_place_path(slurm, place, "scene") : NULL;
    pthread_mutex_unlock(&slurm->lock);
    return path;
}

// ---- end ----------------------------------------------------------------------------------------

// States in which a machine was taken from a job that did nothing wrong.
static bool was_taken(const struct rn_place *place) {
    static const char *const states[] = {"NODE_FAIL", "PREEMPTED", "BOOT_FAIL",
                                         "REQUEUE",   "PENDING",   "UNKNOWN"};
    for (size_t i = 0; i < sizeof states / sizeof states[0]; i++)
        if (strncmp(place->state, states[i], strlen(states[i])) == 0) return true;
    return false;
}

static void say_how(const struct rn_place *place, struct rn_ending *ret) {
    char code[40] = "";
    if (place->over && place->exit_code != 0)
        snprintf(code, sizeof code, ", exit code %d", place->exit_code);
    else if (place->over && place->exit_signal != 0)
        snprintf(code, sizeof code, ", signal %d", place->exit_signal);
    if (place->job == 0)
        snprintf(ret->how, sizeof ret->how, "it was not submitted to Slurm");
    else if (place->joined && !place->over)
        snprintf(ret->how, sizeof ret->how, "Slurm job %" PRId64 " on %s: the connection ended",
                 place->job, place->machine);
    else
        snprintf(ret->how, sizeof ret->how, "Slurm job %" PRId64 "%s%s: %s%s", place->job,
                 place->machine[0] != '\0' ? " on " : "", place->machine, place->state, code);
    ret->taken = was_taken(place);
}

static void end(struct rn_executor *executor, const struct rn_process *process, bool now,
                struct rn_ending *ret_ending) {
    struct rn_slurm *slurm = (struct rn_slurm *)executor;
    if (!process->remote) {
        slurm->local->end(slurm->local, process, now, ret_ending);
        return;
    }
    *ret_ending = (struct rn_ending){.how = "lost"};
    pthread_mutex_lock(&slurm->lock);
    struct rn_place *place = find(slurm, process);
    if (place != NULL) {
        say_how(place, ret_ending);
        rn_place_fence(slurm, place);
        place->given_up = true;
        place->not_before_ns = 0;
        pthread_cond_signal(&slurm->work);
    }
    pthread_mutex_unlock(&slurm->lock);
}

static int64_t memory(struct rn_executor *executor, const struct rn_process *process) {
    struct rn_slurm *slurm = (struct rn_slurm *)executor;
    return process->remote ? 0 : slurm->local->memory(slurm->local, process);
}

static int64_t used(struct rn_executor *executor, const struct rn_process *process,
                    bool *ret_ready) {
    struct rn_slurm *slurm = (struct rn_slurm *)executor;
    return process->remote ? -1 : slurm->local->used(slurm->local, process, ret_ready);
}

static void hold(struct rn_executor *executor, const struct rn_process *process, bool held) {
    struct rn_slurm *slurm = (struct rn_slurm *)executor;
    if (!process->remote) slurm->local->hold(slurm->local, process, held);
}

// ---- create and destroy -------------------------------------------------------------------------

static void destroy(struct rn_executor *executor) {
    struct rn_slurm *slurm = (struct rn_slurm *)executor;
    uint64_t one = 1;
    pthread_mutex_lock(&slurm->lock);
    slurm->quit = true;
    pthread_cond_signal(&slurm->work);
    pthread_mutex_unlock(&slurm->lock);
    if (slurm->door_runs && write(slurm->wake_fd, &one, sizeof one) > 0)
        pthread_join(slurm->door, NULL);
    if (slurm->clerk_runs) pthread_join(slurm->clerk, NULL);
    while (slurm->places != NULL) {
        struct rn_place *place = slurm->places;
        slurm->places = place->next;
        rn_place_free(place);
    }
    if (slurm->listener >= 0) close(slurm->listener);
    if (slurm->wake_fd >= 0) close(slurm->wake_fd);
    if (slurm->local != NULL) slurm->local->destroy(slurm->local);
    char *const texts[] = {slurm->data,    slurm->folder, slurm->runner, slurm->partition,
                           slurm->account, slurm->flags,  slurm->host,   slurm->cache};
    for (size_t i = 0; i < sizeof texts / sizeof texts[0]; i++)
        free(texts[i]);
    pthread_cond_destroy(&slurm->work);
    pthread_mutex_destroy(&slurm->lock);
    free(slurm);
}

static bool lies_in(const char *path, const char *folder) {
    size_t size = strlen(folder);
    while (size > 1 && folder[size - 1] == '/')
        size--;
    return strncmp(path, folder, size) == 0 &&
           (path[size] == '/' || path[size] == '\0' || size == 1);
}

static enum rn_status check_shared(const struct rn_slurm *slurm, const char *folder,
                                   struct rn_error *err) {
    char *shared = realpath(folder, NULL);
    if (shared == NULL) return rn_error_from_errno(err, errno, "shared", folder);
    enum rn_status status = RN_OK;
    if (!lies_in(slurm->data, shared))
        status = rn_error_set(err, RN_ERROR_INVALID, "data",
                              "%s is not in the shared folder %s: nodes could not read it; without "
                              "--shared what they need is sent to them",
                              slurm->data, shared);
    free(shared);
    return status;
}

static enum rn_status find_folders(struct rn_slurm *slurm, const struct rn_slurm_options *options,
                                   struct rn_error *err) {
    slurm->data = realpath(options->data, NULL);
    enum rn_status status =
        slurm->data == NULL ? rn_error_from_errno(err, errno, "data", options->data) : RN_OK;
    if (status == RN_OK && options->shared != NULL)
        status = check_shared(slurm, options->shared, err);
    else if (status == RN_OK)
        slurm->cache = strdup(options->cache);
    if (status == RN_OK && options->shared == NULL && slurm->cache == NULL)
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, "slurm", "no memory");
    if (status == RN_OK && asprintf(&slurm->folder, "%s/slurm", slurm->data) < 0) {
        slurm->folder = NULL;
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, "slurm", "no memory");
    }
    return status;
}

static enum rn_status copy_texts(struct rn_slurm *slurm, const struct rn_slurm_options *options,
                                 struct rn_error *err) {
    const char *const from[] = {options->partition, options->account, options->flags};
    char **const to[] = {&slurm->partition, &slurm->account, &slurm->flags};
    slurm->runner = realpath(options->runner, NULL);
    if (slurm->runner == NULL) slurm->runner = strdup(options->runner);
    bool copied = slurm->runner != NULL;
    for (int i = 0; i < 3 && copied; i++) {
        *to[i] = from[i] != NULL ? strdup(from[i]) : NULL;
        copied = from[i] == NULL || *to[i] != NULL;
    }
    return copied ? RN_OK : rn_error_set(err, RN_ERROR_NO_MEMORY, "slurm", "no memory");
}

static void init_lock(struct rn_slurm *slurm) {
    pthread_condattr_t clock;
    pthread_mutex_init(&slurm->lock, NULL);
    pthread_condattr_init(&clock);
    pthread_condattr_setclock(&clock, CLOCK_MONOTONIC);
    pthread_cond_init(&slurm->work, &clock);
    pthread_condattr_destroy(&clock);
}

static enum rn_status start_threads(struct rn_slurm *slurm, struct rn_error *err) {
    slurm->wake_fd = eventfd(0, EFD_CLOEXEC);
    slurm->door_runs =
        slurm->wake_fd >= 0 && pthread_create(&slurm->door, NULL, rn_door_serve, slurm) == 0;
    slurm->clerk_runs =
        slurm->door_runs && pthread_create(&slurm->clerk, NULL, rn_clerk_serve, slurm) == 0;
    return slurm->clerk_runs
               ? RN_OK
               : rn_error_set(err, RN_ERROR_IO, "slurm", "a thread cannot be started");
}

enum rn_status rn_slurm_executor_create(const struct rn_slurm_options *options,
                                        struct rn_executor *local,
                                        struct rn_executor **ret_executor, struct rn_error *err) {
    struct rn_slurm *slurm = calloc(1, sizeof *slurm);
    if (slurm == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "slurm", "no memory");
    slurm->base = (struct rn_executor){.spreads = true,
                                       .start = start,
                                       .look = look,
                                       .hung_up = hung_up,
                                       .watch = watch,
                                       .folder_of = folder_of,
                                       .end = end,
                                       .hold = hold,
                                       .memory = memory,
                                       .used = used,
                                       .destroy = destroy};
    slurm->time_s = options->time_s;
    slurm->gpus = options->gpus;
    slurm->memory_bytes = options->memory_bytes;
    slurm->threads = options->threads;
    slurm->cache_bytes = options->cache_bytes;
    slurm->base.keeps = options->shared != NULL;
    slurm->sandbox = options->sandbox;
    slurm->listener = slurm->wake_fd = -1;
    slurm->spares_until_ns = rn_clock_ns() + SPARE_NS;
    init_lock(slurm);
    enum rn_status status = rn_clerk_check(options->flags, err);
    if (status == RN_OK) status = copy_texts(slurm, options, err);
    if (status == RN_OK) status = find_folders(slurm, options, err);
    if (status == RN_OK) status = rn_place_find_all(slurm, err);
    if (status == RN_OK) status = rn_door_open(slurm, options->listen, err);
    if (status == RN_OK) status = start_threads(slurm, err);
    if (status != RN_OK) {
        destroy(&slurm->base);
        return status;
    }
    slurm->local = local;
    *ret_executor = &slurm->base;
    return RN_OK;
}

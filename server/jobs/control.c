// The supervising thread, and the control's beginning and end.
#include "server/jobs/control.h"

#include <errno.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <time.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/log.h"
#include "server/jobs/inside.h"

#define TICK_MS 500
#define READING_NS 20000000 // of all runners in a turn, but one message of each at least
#define MAX_RUNNERS 256

void rn_control_wake(struct rn_control *control) {
    uint64_t one = 1;
    if (write(control->wake_fd, &one, sizeof one) < 0 && errno != EAGAIN)
        rn_log(RN_LOG_ERROR, "eventfd: %s", strerror(errno));
}

// Reads what is there, one message at a time, until `until_ns`: what follows from a message may be
// written to a slow disk, and others wait for the lock.
static void read_runner(struct rn_control *control, struct rn_runner *runner, int64_t until_ns) {
    struct rn_error err = {0};
    bool ready = true;
    while (ready && !runner->broken) {
        struct rn_wire_message message;
        enum rn_status status = rn_wire_read(&runner->reader, &ready, &message, &err);
        if (status != RN_OK) {
            if (status != RN_ERROR_UNAVAILABLE)
                rn_log(RN_LOG_WARN, "runner %d: %s", (int)runner->process.pid, err.text);
            runner->broken = true;
        } else if (ready) {
            runner->heard_ns = rn_clock_ns();
            rn_runner_receive(control, runner, &message);
            rn_wire_message_finish(&message);
            if (rn_clock_ns() > until_ns) {
                control->unread = true;
                return;
            }
        }
    }
}

static void serve_runners(struct rn_control *control) {
    int64_t now_ns = rn_clock_ns(), until_ns = now_ns + READING_NS;
    struct rn_runner *next;
    for (struct rn_runner *runner = control->runners; runner != NULL; runner = next) {
        bool empty;
        next = runner->next;
        if (runner->process.remote && rn_remote_is_lost(control, runner)) {
            if (runner->state != RN_RUNNER_AWAITED)
                read_runner(control, runner, INT64_MAX); // its last words
            rn_runner_remove(control, runner, runner->state == RN_RUNNER_AWAITED);
            continue;
        }
        if (runner->state == RN_RUNNER_AWAITED) continue;
        if (!runner->broken) read_runner(control, runner, until_ns);
        if (!runner->broken && rn_wire_flush(&runner->writer, &empty, NULL) != RN_OK)
            read_runner(control, runner, INT64_MAX);
        bool late = rn_runner_is_late(control, runner, now_ns);
        if (late) runner->hangs = true;
        if (late || (runner->broken && rn_remote_is_settled(control, runner)))
            rn_runner_remove(control, runner, false);
    }
}

// What a runner holds decides who is evicted; asked for at every tick.
static void measure_memory(struct rn_control *control) {
    int64_t now_ns = rn_clock_ns();
    if (now_ns < control->next_measure_ns) return;
    control->next_measure_ns = now_ns + TICK_MS * 1000000ll;
    for (struct rn_runner *runner = control->runners; runner != NULL; runner = runner->next)
        runner->memory_bytes = control->executor->memory(control->executor, &runner->process);
}

static nfds_t fill_polls(struct rn_control *control, struct pollfd *polls) {
    nfds_t count = 0;
    polls[count++] = (struct pollfd){.fd = control->wake_fd, .events = POLLIN};
    for (struct rn_runner *runner = control->runners; runner != NULL && count <= MAX_RUNNERS;
         runner = runner->next) {
        bool waits = runner->writer.sent < runner->writer.pending.size;
        polls[count++] = (struct pollfd){.fd = runner->process.fd,
                                         .events = (short)(POLLIN | (waits ? POLLOUT : 0))};
    }
    return count;
}

static void *supervise(void *context) {
    struct rn_control *control = context;
    struct pollfd polls[MAX_RUNNERS + 1];
    rn_control_lock(control);
    while (!control->quit) {
        control->unread = false;
        serve_runners(control);
        rn_hold_others(control);
        measure_memory(control);
        rn_idle_work(control);
        rn_helpers_work(control);
        rn_retain_work(control);
        rn_ladders_work(control);
        rn_schedule(control);
        rn_tasks_tidy(control);
        nfds_t count = fill_polls(control, polls);
        bool at_once = control->schedule_due || control->unread;
        int timeout_ms = at_once ? 0 : rn_hold_timeout_ms(control, TICK_MS);
        rn_control_unlock(control);
        uint64_t wakes;
        if (poll(polls, count, timeout_ms) > 0 && polls[0].revents != 0 &&
            read(control->wake_fd, &wakes, sizeof wakes) < 0 && errno != EAGAIN)
            rn_log(RN_LOG_ERROR, "eventfd: %s", strerror(errno));
        rn_control_lock(control);
    }
    rn_control_unlock(control);
    return NULL;
}

static int by_seq(const void *a, const void *b) {
    const struct rn_job_row *left = a, *right = b;
    return left->seq < right->seq ? -1 : left->seq > right->seq;
}

// Unfinished jobs of the daemon before, or of a backup: those that had a runner have lost it.
static enum rn_status adopt(struct rn_control *control, struct rn_job_row *row,
                            struct rn_error *err) {
    struct rn_task *task;
    if (rn_task_find(control, row->id) != NULL) return RN_OK;
    enum rn_status status = rn_task_create(&task, err);
    if (status != RN_OK) return status;
    rn_task_add(control, task, row);
    task->progressed = true; // the daemon ended, not the runner
    // Each request has a trace: without one it is a curve of idle.c's.
    task->automatic = task->row.type == RN_JOB_CURVE && task->row.traceparent[0] == '\0';
    rn_task_announce(control, task);
    bool ending = task->row.type == RN_JOB_LADDER && task->row.state == RN_JOB_CANCELLING;
    if (ending) return RN_OK; // its jobs are still to be ended
    if (task->row.state == RN_JOB_RUNNING || task->row.state == RN_JOB_CANCELLING)
        rn_task_lost(control, task, NULL);
    else if (task->row.state == RN_JOB_INTERRUPTED)
        rn_task_happened(control, task, RN_JOB_REQUEUE);
    return RN_OK;
}

static enum rn_status adopt_all(struct rn_control *control, struct rn_error *err) {
    static const enum rn_job_state open_states[] = {RN_JOB_QUEUED, RN_JOB_RUNNING, RN_JOB_PAUSED,
                                                    RN_JOB_CANCELLING, RN_JOB_INTERRUPTED};
    struct rn_buf all;
    enum rn_status status = RN_OK;
    rn_buf_init(&all, 64u << 20);
    for (size_t i = 0; status == RN_OK && i < 5; i++) {
        struct rn_query query = {.equal = {{"state", rn_job_state_names[open_states[i]]}}};
        void *rows = NULL;
        size_t count = 0;
        status = rn_store_list(control->store, &rn_jobs_table, &query, &rows, &count, err);
        if (status != RN_OK) break;
        rn_buf_append(&all, rows, count * sizeof(struct rn_job_row));
        if (all.failed) {
            rn_rows_finish(&rn_jobs_table, rows, count);
            status = rn_buf_status(&all, "the list of jobs", err);
        }
        free(all.failed ? NULL : rows);
    }
    struct rn_job_row *rows = (void *)all.data;
    size_t count = all.size / sizeof(struct rn_job_row);
    if (count > 0) qsort(rows, count, sizeof rows[0], by_seq);
    for (size_t i = 0; i < count; i++) {
        if (status == RN_OK) status = adopt(control, &rows[i], err);
        rn_row_finish(&rn_jobs_table, &rows[i]);
    }
    rn_buf_finish(&all);
    return status;
}

enum rn_status rn_control_adopt(struct rn_control *control, struct rn_error *err) {
    rn_control_lock(control);
    enum rn_status status = adopt_all(control, err);
    control->schedule_due = true;
    rn_control_unlock(control);
    rn_control_wake(control);
    return status;
}

static void probe(struct rn_control *control) {
    const struct rn_order order = {.mode = "probe", .scene = "", .here = true};
    struct rn_runner *runner;
    struct rn_error err = {0};
    if (rn_runner_start(control, &order, &runner, &err) != RN_OK)
        rn_log(RN_LOG_ERROR, "no runner can be started: %s: %s", err.where, err.text);
}

static void on_news(void *control) {
    rn_control_wake(control);
}

enum rn_status rn_control_create(const struct rn_control_options *options, struct rn_store *store,
                                 struct rn_executor *executor, struct rn_control **ret_control,
                                 struct rn_error *err) {
    struct rn_control *control = calloc(1, sizeof *control);
    if (control == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "control", "no memory");
    control->options = *options;
    control->store = store;
    control->executor = executor;
    pthread_mutex_init(&control->lock, NULL);
    pthread_mutex_init(&control->turn, NULL);
    control->wake_fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    enum rn_status status =
        control->wake_fd < 0 ? rn_error_from_errno(err, errno, "eventfd", "create")
                             : rn_ring_create(RN_RING_EVENTS, RN_RING_BYTES, &control->ring, err);
    if (status == RN_OK) status = adopt_all(control, err);
    if (status == RN_OK) {
        rn_frames_clear(control);
        if (executor->watch != NULL) executor->watch(executor, on_news, control);
        probe(control);
        control->thread_runs = pthread_create(&control->thread, NULL, supervise, control) == 0;
        if (!control->thread_runs)
            status = rn_error_set(err, RN_ERROR_IO, "control", "a thread cannot be started");
    }
    if (status == RN_OK)
        *ret_control = control;
    else
        rn_control_destroy(&control);
    return status;
}

void rn_control_drain(struct rn_control *control, int64_t timeout_ms) {
    struct rn_error err = {.status = RN_ERROR_UNAVAILABLE, .text = "the daemon is shutting down"};
    int64_t deadline_ns = rn_clock_ns() + timeout_ms * 1000000;
    rn_control_lock(control);
    control->stopping = true;
    struct rn_runner *next;
    for (struct rn_runner *runner = control->runners; runner != NULL; runner = next) {
        next = runner->next;
        rn_render_fail_all(control, runner, &err);
        if (runner->helps[0] != '\0') {
            rn_runner_remove(control, runner, true);
            continue;
        }
        if (runner->process.remote && control->executor->keeps) {
            rn_runner_release(control, runner);
            continue;
        }
        rn_runner_shutdown(control, runner);
        runner->deadline_ns = deadline_ns;
    }
    rn_control_wake(control);
    while (control->runners != NULL && rn_clock_ns() < deadline_ns) {
        rn_control_unlock(control);
        nanosleep(&(struct timespec){.tv_nsec = 10000000}, NULL);
        rn_control_lock(control);
    }
    while (control->runners != NULL)
        rn_runner_remove(control, control->runners, true);
    rn_control_unlock(control);
}

void rn_control_destroy(struct rn_control **control_pointer) {
    struct rn_control *control = *control_pointer;
    *control_pointer = NULL;
    if (control == NULL) return;
    rn_control_lock(control);
    control->stopping = control->quit = true;
    rn_control_unlock(control);
    if (control->thread_runs) {
        rn_control_wake(control);
        pthread_join(control->thread, NULL);
    }
    while (control->runners != NULL)
        rn_runner_remove(control, control->runners, true);
    while (control->tasks != NULL) {
        struct rn_task *task = control->tasks;
        control->tasks = task->next;
        rn_task_free(task);
    }
    for (int i = 0; i < RN_MAX_RECENT; i++)
        rn_ring_unref(&control->recent[i].ring);
    rn_ring_unref(&control->ring);
    if (control->executor->watch != NULL) control->executor->watch(control->executor, NULL, NULL);
    if (control->wake_fd >= 0) close(control->wake_fd);
    pthread_mutex_destroy(&control->lock);
    pthread_mutex_destroy(&control->turn);
    free(control);
}

static struct rn_ring *find_ring(struct rn_control *control, const char *id) {
    struct rn_task *task = rn_task_find(control, id);
    if (task != NULL) return task->ring;
    for (int i = 0; i < RN_MAX_RECENT; i++)
        if (strcmp(control->recent[i].id, id) == 0) return control->recent[i].ring;
    return NULL;
}

// A job that ended long ago: its last state is all there is to tell.
static enum rn_status make_ring(struct rn_control *control, const char *id,
                                struct rn_ring **ret_ring, struct rn_error *err) {
    char *json = NULL;
    struct rn_ring *ring = NULL;
    enum rn_status status = rn_control_job_json(control, id, &json, err);
    if (status == RN_OK) status = rn_ring_create(1, RN_RING_BYTES, &ring, err);
    if (status == RN_OK) {
        rn_ring_publish(ring, rn_ring_next_id(), RN_EVENT_STATE, json, NULL);
        rn_ring_close(ring);
        *ret_ring = ring;
    }
    free(json);
    return status;
}

enum rn_status rn_control_events(struct rn_control *control, const char *id,
                                 struct rn_ring **ret_ring, struct rn_error *err) {
    rn_control_lock(control);
    struct rn_ring *ring = id == NULL ? control->ring : find_ring(control, id);
    if (ring != NULL) *ret_ring = rn_ring_ref(ring);
    rn_control_unlock(control);
    return ring != NULL ? RN_OK : make_ring(control, id, ret_ring, err);
}

void rn_control_stats(struct rn_control *control, struct rn_control_stats *ret_stats) {
    rn_control_lock(control);
    *ret_stats = control->stats;
    for (const struct rn_task *task = control->tasks; task != NULL; task = task->next)
        ret_stats->jobs_open[task->row.state] += !rn_job_is_over(task->row.state);
    for (const struct rn_runner *runner = control->runners; runner != NULL; runner = runner->next) {
        ret_stats->runners++;
        ret_stats->memory_bytes += runner->memory_bytes;
        ret_stats->gpu_memory_bytes += runner->gpu_bytes;
        ret_stats->scenes_loaded +=
            runner->state == RN_RUNNER_READY && strcmp(runner->mode, "field") == 0;
        for (const struct rn_render *render = runner->renders; render != NULL;
             render = render->next)
            ret_stats->renders_waiting++;
    }
    rn_control_unlock(control);
}

bool rn_control_spreads(const struct rn_control *control) {
    return control->executor->spreads;
}

void rn_control_device(struct rn_control *control, struct rn_runner_device *ret_device) {
    rn_control_lock(control);
    *ret_device = control->device;
    rn_control_unlock(control);
}

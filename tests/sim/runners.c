// Runners as the daemon sees them: processes that answer its messages, write to its folders, and
// fail, hang or die when it suits them.
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/file.h"
#include "common/base/seal.h"
#include "proto/wire_messages.h"
#include "tests/sim/calls.h"
#include "tests/sim/life.h"

#define SECOND_NS 1000000000ll
#define LOCK_WAIT_NS (15 * SECOND_NS) // as in server/runner/scene/lock.c, like the next one
#define HANGS_NS (3 * SECOND_NS)
#define PATIENCE_NS (180 * SECOND_NS) // with a runner that hangs, whose time limit is 20 s

// The runner's end of its connection.
static struct link {
    int fd;
    struct rn_wire_reader reader;
    struct rn_wire_writer writer;
} links[SIM_RUNNERS];

static struct link *link_of(const struct sim_runner *runner) {
    return &links[runner - sim->runners];
}

static void die(struct sim_runner *runner) {
    struct link *link = link_of(runner);
    sim_lost_with(runner);
    if (!runner->orphan) {
        rn_wire_reader_finish(&link->reader);
        rn_wire_writer_finish(&link->writer);
        sim_close(link->fd);
    }
    sim_tell("runner %d ends", runner->pid);
    *runner = (struct sim_runner){.alive = false};
}

static void post(struct sim_runner *runner, enum rn_wire_type type, const void *message) {
    struct rn_error err = {0};
    bool empty;
    struct rn_wire_writer *writer = &link_of(runner)->writer;
    enum rn_status status =
        rn_wire_post(writer, type, message, "picture", type == RN_WIRE_RENDERED ? 7 : 0, &err);
    if (status == RN_OK) status = rn_wire_flush(writer, &empty, &err);
    if (status != RN_OK && status != RN_ERROR_UNAVAILABLE)
        sim_violated("a runner cannot say %s: %s", rn_wire_type_name((int)type), err.text);
}

static void say_failed(struct sim_runner *runner, const char *job, int64_t request,
                       enum rn_status status) {
    struct rn_wire_failed failed = {.request = request, .text = "it was not to be"};
    snprintf(failed.job, sizeof failed.job, "%s", job);
    snprintf(failed.status, sizeof failed.status, "%s", rn_status_name(status));
    post(runner, RN_WIRE_FAILED, &failed);
}

static void may_fail(const char *id) {
    struct sim_job *job = sim_job_find(id);
    if (job != NULL) job->may_fail = true;
}

// ---- checkpoints ------------------------------------------------------------------------------

static int step_of(const char *name) {
    int step, end = 0;
    return sscanf(name, "step-%9d.safetensors%n", &step, &end) == 1 && name[end] == '\0' ? step
                                                                                         : -1;
}

// The newest one. None is ever damaged.
static int newest(const struct sim_runner *runner, char digest[65]) {
    char folder[160], path[512];
    struct dirent **entries;
    struct rn_error err;
    int found = 0;
    snprintf(folder, sizeof folder, "%s/checkpoints", runner->folder);
    int count = sim_scandir(folder, &entries);
    for (int i = count - 1; i >= 0; i--) {
        int step = step_of(entries[i]->d_name);
        snprintf(path, sizeof path, "%s/%s", folder, entries[i]->d_name);
        if (found == 0 && step >= 0 && rn_seal_check(path, digest, &err) == RN_OK) {
            found = step;
        } else if (found == 0 && step >= 0) {
            sim_violated("checkpoint %s is damaged", path);
        }
        free(entries[i]);
    }
    if (count >= 0) free(entries);
    return found;
}

static void prune(const char *folder) {
    struct dirent **entries;
    int count = sim_scandir(folder, &entries), kept = 0;
    for (int i = count - 1; i >= 0; i--) {
        char path[512];
        snprintf(path, sizeof path, "%s/%s", folder, entries[i]->d_name);
        if (step_of(entries[i]->d_name) >= 0 && ++kept > 2) sim_unlinkat(AT_FDCWD, path, 0);
        free(entries[i]);
    }
    if (count >= 0) free(entries);
}

// A temporary file, sealed, flushed, renamed, its folder flushed, as server/runner/field/saving.c
// does.
static bool write_checkpoint(struct sim_runner *runner, char name[64], char digest[65]) {
    char folder[160], fresh[200], path[512];
    static char text[12000];
    struct rn_error err;
    snprintf(folder, sizeof folder, "%s/checkpoints", runner->folder);
    snprintf(fresh, sizeof fresh, "%s/.fresh.tmp", folder);
    snprintf(name, 64, "step-%09d.safetensors", runner->step);
    snprintf(path, sizeof path, "%s/%s", folder, name);
    int size = snprintf(text, sizeof text, "{" RN_SEAL ",\"step\":%d,\"all\":\"", runner->step);
    for (int more = 100 + runner->step * 37 % 11000; more > 0; more--)
        text[size++] = (char)('a' + (runner->step + more) % 26);
    int fd = sim_open(fresh, O_RDWR | O_CREAT | O_TRUNC, 0600);
    if (fd < 0) return false;
    bool good = sim_write(fd, text, (size_t)size) == size &&
                rn_seal_close(fd, fresh, digest, &err) == RN_OK && sim_fsync(fd) == 0;
    sim_close(fd);
    if (!good || sim_rename(fresh, path) != 0) return false;
    fd = sim_open(folder, O_RDONLY | O_DIRECTORY);
    sim_fsync(fd);
    sim_close(fd);
    prune(folder);
    return true;
}

static void hash_step(int step, char sha256[65]) {
    snprintf(sha256, 65, "%064x", (unsigned)step * 2654435761u);
}

static bool save(struct sim_runner *runner, bool says) {
    struct rn_wire_checkpoint checkpoint = {.step = runner->step, .psnr = 30, .scene = NULL};
    if (runner->step == runner->saved_step) return true;
    if (!write_checkpoint(runner, checkpoint.file, checkpoint.digest)) return false;
    runner->saved_step = runner->step;
    if (!says) return true;
    static char empty[] = "{}";
    checkpoint.scene = empty;
    checkpoint.train_seconds = runner->step;
    checkpoint.size_bytes = 1000;
    snprintf(checkpoint.job, sizeof checkpoint.job, "%s", runner->train);
    hash_step(runner->step, checkpoint.parameters_sha256);
    post(runner, RN_WIRE_CHECKPOINT, &checkpoint);
    return true;
}

// ---- what it is told --------------------------------------------------------------------------

// No job runs twice at once, and no scene is trained twice.
static void check_alone(const struct sim_runner *runner, const char *id, bool trains) {
    const struct sim_job *job = sim_job_find(id);
    int training = 0;
    for (const struct sim_runner *other = sim->runners; other < sim->runners + SIM_RUNNERS;
         other++) {
        if (!other->alive || other->orphan) continue;
        if (strcmp(other->train, id) == 0 || strcmp(other->work, id) == 0)
            sim_violated("job %s is begun while runner %d works on it", id, other->pid);
        if (trains && other->train[0] != '\0' && strcmp(other->scene, runner->scene) == 0)
            sim_violated("scene %s is trained twice", runner->scene);
        const struct sim_job *trained = sim_job_find(other->train);
        training += trained != NULL && (trained->state == RN_JOB_RUNNING || // or is told to pause
                                        trained->state == RN_JOB_CANCELLING);
    }
    if (trains && training >= 2 && job != NULL && job->state != RN_JOB_PAUSED &&
        job->state != RN_JOB_QUEUED) // which is told to pause next
        sim_violated("more trainings run than there are slots");
    if (job == NULL) sim_violated("job %s was never announced, and is begun", id);
    if (job->state == RN_JOB_SUCCEEDED || job->state == RN_JOB_FAILED ||
        job->state == RN_JOB_CANCELLED)
        sim_violated("job %s is %s, and is begun", id, rn_job_state_names[job->state]);
}

static void say_opened(struct sim_runner *runner) {
    struct rn_wire_opened opened = {.loaded = false, .psnr = 30, .memory_bytes = 100 << 20};
    runner->step = runner->saved_step = newest(runner, opened.digest);
    if (runner->load && runner->step == 0) { // its training ended before the first checkpoint
        for (int i = 0; i < sim->job_count; i++)
            if (strcmp(sim->jobs[i].scene, runner->scene) == 0) sim->jobs[i].may_fail = true;
        say_failed(runner, "", RN_ABSENT, RN_ERROR_NOT_FOUND);
        return;
    }
    opened.loaded = runner->load;
    opened.steps = runner->step;
    if (runner->load) hash_step(runner->step, opened.parameters_sha256);
    if (!runner->load) opened.digest[0] = '\0';
    post(runner, RN_WIRE_OPENED, &opened);
}

// Another process that holds the scene is waited for; one that hangs without its daemon is killed.
static void try_to_lock(struct sim_runner *runner) {
    for (struct sim_runner *other = sim->runners; other < sim->runners + SIM_RUNNERS; other++) {
        if (!other->alive || !other->locked || strcmp(other->scene, runner->scene) != 0) continue;
        if (!other->orphan) sim_violated("two runners of one daemon want scene %s", runner->scene);
        bool patient = sim->now_ns < runner->give_up_ns - LOCK_WAIT_NS + HANGS_NS;
        if (other->hangs && !patient) {
            die(other);
            continue;
        }
        runner->next_ns = sim->now_ns + SECOND_NS / 2;
        if (sim->now_ns < runner->give_up_ns) return;
        runner->opening = false;
        say_failed(runner, "", RN_ABSENT, RN_ERROR_BUSY);
        return;
    }
    struct rn_error err;
    char folder[160];
    runner->opening = false;
    runner->locked = true;
    snprintf(folder, sizeof folder, "%s/checkpoints", runner->folder);
    if (rn_mkdirs(folder, 0700, &err) != RN_OK)
        say_failed(runner, "", RN_ABSENT, err.status);
    else
        say_opened(runner);
}

static void on_open(struct sim_runner *runner, const struct rn_wire_open *open) {
    snprintf(runner->folder, sizeof runner->folder, "%s", open->scene_folder);
    runner->load = open->load;
    runner->opening = true;
    runner->give_up_ns = sim->now_ns + LOCK_WAIT_NS;
    runner->next_ns = sim->now_ns + sim_below(2000) * 1000000ll;
}

static void on_train(struct sim_runner *runner, const struct rn_wire_train *train) {
    char digest[65];
    check_alone(runner, train->job, true);
    snprintf(runner->train, sizeof runner->train, "%s", train->job);
    runner->paused = false;
    runner->step = runner->saved_step = newest(runner, digest);
    runner->target = 300 + 100 * (train->job[5] % 16);
    runner->next_ns = sim->now_ns + sim_below(1000) * 1000000ll;
}

static void begin_work(struct sim_runner *runner, enum rn_job_type type, const char *job,
                       const char *place) {
    check_alone(runner, job, false);
    if (runner->work[0] != '\0') sim_violated("runner %d is given two jobs", runner->pid);
    snprintf(runner->work, sizeof runner->work, "%s", job);
    snprintf(runner->places[0], sizeof runner->places[0], "%s", place != NULL ? place : "");
    runner->work_type = type;
    runner->done = 0;
    runner->total = 1 + job[5] % 5;
    runner->next_ns = sim->now_ns + sim_below(1000) * 1000000ll;
}

static void on_ingest(struct sim_runner *runner, const struct rn_wire_ingest *ingest) {
    char expected[128], got[128] = "";
    begin_work(runner, ingest->validate ? RN_JOB_VALIDATE : RN_JOB_INGEST, ingest->job,
               ingest->source);
    runner->of_scene = ingest->scene;
    snprintf(runner->places[1], sizeof runner->places[1], "%s", ingest->target);
    snprintf(runner->places[2], sizeof runner->places[2], "%s", ingest->work);
    if (strncmp(ingest->source, SIM_DATA, sizeof SIM_DATA - 1) != 0) return;
    snprintf(expected, sizeof expected, "the upload of %s", ingest->name);
    int fd = sim_open(ingest->source, O_RDONLY);
    if (fd >= 0) sim_read(fd, got, sizeof got - 1);
    if (fd >= 0) sim_close(fd);
    if (strcmp(got, expected) != 0)
        sim_violated("the upload of job %s was acknowledged and is %s", ingest->job,
                     fd < 0 ? "lost" : "another");
}

static void on_cancel(struct sim_runner *runner, const struct rn_wire_cancel *cancel) {
    for (int i = 0; cancel->request != RN_ABSENT && i < runner->render_count; i++) {
        if (runner->renders[i] != cancel->request) continue;
        runner->renders[i] = runner->renders[--runner->render_count];
        say_failed(runner, "", cancel->request, RN_ERROR_CANCELLED);
    }
    char *jobs[] = {runner->train, runner->work};
    for (int i = 0; cancel->job[0] != '\0' && i < 2; i++) {
        if (strcmp(jobs[i], cancel->job) != 0) continue;
        if (i == 0) (void)save(runner, true);
        jobs[i][0] = '\0';
        say_failed(runner, cancel->job, RN_ABSENT, RN_ERROR_CANCELLED);
    }
}

static void say_done_with(struct sim_runner *runner, char job[RN_ID_MAX], char *result) {
    struct rn_wire_done done = {.result = result};
    snprintf(done.job, sizeof done.job, "%s", job);
    job[0] = '\0';
    post(runner, RN_WIRE_DONE, &done);
}

static void say_done(struct sim_runner *runner, char job[RN_ID_MAX]) {
    static char result[] = "{\"size_bytes\":1000}";
    say_done_with(runner, job, result);
}

static void finish_training(struct sim_runner *runner) {
    if (!save(runner, true)) {
        may_fail(runner->train);
        say_failed(runner, runner->train, RN_ABSENT, RN_ERROR_NO_SPACE);
        runner->train[0] = '\0';
    } else {
        say_done(runner, runner->train);
    }
}

union any {
    struct rn_wire_open open;
    struct rn_wire_train train;
    struct rn_wire_path path;
    struct rn_wire_eval eval;
    struct rn_wire_curve curve;
    struct rn_wire_export export;
    struct rn_wire_ingest ingest;
    struct rn_wire_cancel cancel;
    struct rn_wire_render render;
    struct rn_wire_job job;
    struct rn_wire_doctor doctor;
};

static void obey(struct sim_runner *runner, int type, const union any *any) {
    bool trains = runner->train[0] != '\0';
    switch (type) {
    case RN_WIRE_OPEN:
        on_open(runner, &any->open);
        break;
    case RN_WIRE_TRAIN:
        on_train(runner, &any->train);
        break;
    case RN_WIRE_PATH:
        begin_work(runner, RN_JOB_PATH, any->path.job, any->path.folder);
        break;
    case RN_WIRE_EXPORT:
        begin_work(runner, RN_JOB_EXPORT, any->export.job, any->export.folder);
        break;
    case RN_WIRE_EVAL:
        begin_work(runner, RN_JOB_EVAL, any->eval.job, NULL);
        break;
    case RN_WIRE_CURVE:
        begin_work(runner, RN_JOB_CURVE, any->curve.job, NULL);
        break;
    case RN_WIRE_DOCTOR:
        begin_work(runner, RN_JOB_DOCTOR, any->doctor.job, NULL);
        break;
    case RN_WIRE_INGEST:
        on_ingest(runner, &any->ingest);
        break;
    case RN_WIRE_PAUSE:
        runner->paused = trains;
        if (trains) (void)save(runner, true);
        break;
    case RN_WIRE_RESUME:
        runner->paused = false;
        break;
    case RN_WIRE_FINISH:
        if (trains) finish_training(runner);
        break;
    case RN_WIRE_CANCEL:
        on_cancel(runner, &any->cancel);
        break;
    case RN_WIRE_RENDER:
        if (runner->render_count < 8)
            runner->renders[runner->render_count++] = any->render.request;
        else
            say_failed(runner, "", any->render.request, RN_ERROR_BUSY);
        break;
    default:
        break;
    }
}

// ---- what it does -----------------------------------------------------------------------------

static void say_progress(struct sim_runner *runner, const char *job, const struct rn_table *table,
                         const void *progress) {
    struct rn_wire_progress message = {.progress = NULL};
    if (rn_encode(table, progress, &message.progress, NULL, NULL) != RN_OK) abort();
    snprintf(message.job, sizeof message.job, "%s", job);
    post(runner, RN_WIRE_PROGRESS, &message);
    free(message.progress);
}

// It has read all that it was told; the daemon may be about to say more.
static void check_asked(struct sim_runner *runner) {
    const struct sim_job *job = sim_job_find(runner->train);
    bool asked = job != NULL && (job->state == RN_JOB_RUNNING || job->state == RN_JOB_CANCELLING);
    runner->unasked = asked ? 0 : runner->unasked + 1;
    if (runner->unasked > 3)
        sim_violated("job %s is %s, and is trained", runner->train,
                     job != NULL ? rn_job_state_names[job->state] : "unknown");
}

static void train(struct sim_runner *runner) {
    struct rn_train_progress progress;
    check_asked(runner);
    struct rn_wire_metric metric = {.metric = {runner->step, runner->step, 30}};
    rn_message_init(&rn_train_progress_table, &progress);
    progress = (struct rn_train_progress){.step = runner->step, .max_steps = runner->target};
    runner->step += 100;
    if (runner->step >= runner->target) {
        finish_training(runner);
        return;
    }
    say_progress(runner, runner->train, &rn_train_progress_table, &progress);
    snprintf(metric.job, sizeof metric.job, "%s", runner->train);
    if (sim_chance(3)) post(runner, RN_WIRE_METRIC, &metric);
    if (sim_chance(3)) (void)save(runner, true);
}

// A film's frames and a scene's file are put in place one by one.
static bool write_picture(const struct sim_runner *runner, int number) {
    char path[160], text[96];
    struct rn_error err;
    struct rn_wire_frame frame = {.index = number};
    snprintf(path, sizeof path, "%s/%05d.png", runner->places[0], number);
    int size = snprintf(text, sizeof text, "picture %d of %s", number, runner->work);
    if (rn_file_write_atomic(path, text, (size_t)size, &err) != RN_OK) return false;
    snprintf(frame.job, sizeof frame.job, "%s", runner->work);
    post((struct sim_runner *)runner, RN_WIRE_FRAME, &frame);
    return true;
}

static bool write_dataset(const struct sim_runner *runner) {
    char path[160];
    struct rn_error err;
    snprintf(path, sizeof path, "%s/dataset.json", runner->places[1]);
    return rn_mkdirs(runner->places[1], 0700, &err) == RN_OK &&
           rn_file_write_atomic(path, "photographs", 11, &err) == RN_OK &&
           rn_remove_tree(runner->places[2], &err) == RN_OK;
}

// The checkpoint of a scene that came as a file, and what the daemon hears of it.
static bool take_scene(struct sim_runner *runner, char **ret_result) {
    static char empty[] = "{}";
    char folder[160];
    struct rn_error err;
    struct rn_wire_checkpoint taken = {.psnr = 30, .size_bytes = 1000, .scene = empty};
    snprintf(runner->folder, sizeof runner->folder, "%s", runner->places[1]);
    snprintf(folder, sizeof folder, "%s/checkpoints", runner->folder);
    runner->step = 100 * (1 + runner->work[5] % 7);
    if (rn_mkdirs(folder, 0700, &err) != RN_OK ||
        !write_checkpoint(runner, taken.file, taken.digest) ||
        rn_remove_tree(runner->places[2], &err) != RN_OK)
        return false;
    taken.step = taken.train_seconds = runner->step;
    hash_step(runner->step, taken.parameters_sha256);
    return rn_encode(rn_wire_table(RN_WIRE_CHECKPOINT), &taken, ret_result, NULL, NULL) == RN_OK;
}

static void work(struct sim_runner *runner) {
    struct rn_work_progress progress = {.done = runner->done, .total = runner->total};
    enum rn_job_type type = runner->work_type;
    bool good = true;
    char *result = NULL;
    if (type == RN_JOB_PATH || type == RN_JOB_EXPORT) good = write_picture(runner, runner->done);
    bool last = ++runner->done == runner->total;
    if (good && last && type == RN_JOB_INGEST)
        good = runner->of_scene ? take_scene(runner, &result) : write_dataset(runner);
    if (!good) {
        may_fail(runner->work);
        say_failed(runner, runner->work, RN_ABSENT, RN_ERROR_NO_SPACE);
        runner->work[0] = '\0';
    } else if (result != NULL) {
        say_done_with(runner, runner->work, result);
    } else if (last) {
        say_done(runner, runner->work);
    } else {
        progress.fraction = 0.5;
        progress.eta_seconds = 1;
        say_progress(runner, runner->work, &rn_work_progress_table, &progress);
    }
    free(result);
}

static void render(struct sim_runner *runner) {
    struct rn_wire_rendered rendered;
    rn_message_init(rn_wire_table(RN_WIRE_RENDERED), &rendered);
    rendered.request = runner->renders[--runner->render_count];
    rendered.step = runner->step;
    rendered.samples = rendered.width = rendered.height = 1;
    rendered.format = RN_FORMAT_PNG;
    rendered.queue_ms = rendered.render_ms = rendered.encode_ms = 1;
    rendered.training = runner->train[0] != '\0';
    rendered.cones = 0;
    rendered.missed = false;
    post(runner, RN_WIRE_RENDERED, &rendered);
}

// Something goes wrong with it; true when it is no more.
static bool suffers(struct sim_runner *runner) {
    if (sim->calm || strcmp(runner->mode, "probe") == 0) return false;
    char *job = runner->train[0] != '\0' ? runner->train : runner->work;
    if (sim_chance(120)) {
        sim_tell("runner %d dies", runner->pid);
        sim->figures.runners_lost++;
        die(runner);
        return true;
    }
    if (sim_chance(600)) {
        runner->hangs = true;
        runner->hangs_ns = sim->now_ns;
    } else if (job[0] != '\0' && sim_chance(150)) {
        may_fail(job);
        say_failed(runner, job, RN_ABSENT, RN_ERROR_IO);
        job[0] = '\0';
    }
    return runner->hangs;
}

// Its daemon is gone: it saves, if it can, and leaves.
static void leave(struct sim_runner *runner) {
    if (runner->hangs && !runner->orphan) return;
    if (runner->train[0] != '\0' && !runner->paused) {
        runner->step += sim_chance(2) ? 100 : 0;
        (void)save(runner, false);
    }
    die(runner);
}

static void say_hello(struct sim_runner *runner) {
    struct rn_wire_hello hello = {.version = "sim", .protocol = RN_WIRE_PROTOCOL};
    hello.pid = runner->pid;
    snprintf(hello.mode, sizeof hello.mode, "%s", runner->mode);
    post(runner, RN_WIRE_HELLO, &hello);
}

static void say_info(struct sim_runner *runner) {
    const struct rn_wire_info info = {.device = "cpu",
                                      .device_name = "a machine",
                                      .kernels = "plain",
                                      .available = "plain",
                                      .threads = 2};
    post(runner, RN_WIRE_INFO, &info);
}

// Reads one message; false when there is none. One that ends it does.
static bool listen_once(struct sim_runner *runner) {
    struct rn_wire_message message;
    struct rn_error err;
    bool ready;
    union any any;
    if (rn_wire_read(&link_of(runner)->reader, &ready, &message, &err) != RN_OK) {
        leave(runner);
        return false;
    }
    if (!ready) return false;
    int type = message.type;
    bool empty = type == RN_WIRE_SHUTDOWN || type == RN_WIRE_REST;
    if (!empty && rn_wire_take(&message, &any, &err) != RN_OK)
        sim_violated("the daemon's %s is no message: %s", rn_wire_type_name(type), err.text);
    rn_wire_message_finish(&message);
    if (type == RN_WIRE_SHUTDOWN) {
        if (runner->train[0] != '\0' && !runner->paused) (void)save(runner, true);
        die(runner);
        return false;
    }
    if (empty) return true;
    obey(runner, type, &any);
    rn_message_finish(rn_wire_table(type), &any);
    return true;
}

static void act(struct sim_runner *runner) {
    struct rn_wire_empty alive = {""};
    if (runner->orphan) {
        leave(runner);
        return;
    }
    if (runner->done < 0) { // it has only begun
        runner->done = 0;
        say_hello(runner);
        if (strcmp(runner->mode, "probe") == 0) {
            say_info(runner);
            die(runner);
            return;
        }
    }
    if (suffers(runner)) return;
    while (runner->alive && !runner->hangs && listen_once(runner))
        ;
    if (!runner->alive || runner->next_ns > sim->now_ns) return;
    runner->next_ns = sim->now_ns + (200 + sim_below(1500)) * 1000000ll;
    if (runner->opening)
        try_to_lock(runner);
    else if (runner->render_count > 0)
        render(runner);
    else if (runner->work[0] != '\0')
        work(runner);
    else if (runner->train[0] != '\0' && !runner->paused)
        train(runner);
    if (runner->alive) post(runner, RN_WIRE_ALIVE, &alive);
}

// ---- the executor -----------------------------------------------------------------------------

static enum rn_status start(struct rn_executor *executor, const struct rn_order *order,
                            struct rn_process *ret_process, struct rn_error *err) {
    struct sim_runner *runner = sim->runners;
    int ends[2];
    while (runner < sim->runners + SIM_RUNNERS && runner->alive)
        runner++;
    if (runner == sim->runners + SIM_RUNNERS) sim_violated("%d runners are there", SIM_RUNNERS);
    sim_connect(ends);
    *runner = (struct sim_runner){.alive = true, .pid = ++sim->next_pid, .done = -1};
    snprintf(runner->mode, sizeof runner->mode, "%s", order->mode);
    snprintf(runner->scene, sizeof runner->scene, "%s", order->scene);
    runner->next_ns = sim->now_ns + (1 + sim_below(500)) * 1000000ll;
    struct link *link = link_of(runner);
    link->fd = ends[1];
    rn_wire_reader_init(&link->reader, ends[1]);
    rn_wire_writer_init(&link->writer, ends[1], 0);
    *ret_process = (struct rn_process){.pid = runner->pid, .fd = ends[0]};
    sim->figures.runners++;
    return RN_OK;
}

static struct sim_runner *find_runner(const struct rn_process *process) {
    for (struct sim_runner *runner = sim->runners; runner < sim->runners + SIM_RUNNERS; runner++)
        if (runner->alive && runner->pid == process->pid) return runner;
    return NULL;
}

static void end(struct rn_executor *executor, const struct rn_process *process, bool now,
                struct rn_ending *ret_ending) {
    struct sim_runner *runner = find_runner(process);
    if (runner != NULL) die(runner);
    snprintf(ret_ending->how, sizeof ret_ending->how, "it is over");
    ret_ending->taken = false;
}

static int64_t memory(struct rn_executor *executor, const struct rn_process *process) {
    return 100 << 20;
}

static void destroy(struct rn_executor *executor) {}

struct rn_executor *sim_executor(void) {
    static struct rn_executor executor = {
        .start = start, .end = end, .memory = memory, .destroy = destroy};
    return &executor;
}

void sim_runners_survive(void) {
    for (struct sim_runner *runner = sim->runners; runner < sim->runners + SIM_RUNNERS; runner++) {
        if (!runner->alive) continue;
        if (sim->crash == SIM_NO_POWER || !runner->locked) {
            *runner = (struct sim_runner){.alive = false};
            continue;
        }
        runner->orphan = true;
        runner->next_ns = sim->now_ns + sim_below(20000) * 1000000ll;
        if (runner->hangs) runner->next_ns = INT64_MAX;
    }
}

// One that owes an answer is not waited for.
static void check_patience(const struct sim_runner *runner) {
    bool owes = (runner->train[0] != '\0' && !runner->paused) || runner->work[0] != '\0' ||
                runner->render_count > 0;
    if (owes && !runner->orphan && sim->now_ns > runner->hangs_ns + PATIENCE_NS)
        sim_violated("runner %d has hung for three minutes, and is waited for", runner->pid);
}

static bool is_due(const struct sim_runner *runner) {
    if (!runner->alive || runner->hangs) return false;
    return runner->next_ns <= sim->now_ns ||
           (!runner->orphan && runner->done >= 0 && sim_readable(link_of(runner)->fd));
}

int64_t sim_runners_due(void) {
    int64_t due_ns = INT64_MAX;
    for (const struct sim_runner *runner = sim->runners; runner < sim->runners + SIM_RUNNERS;
         runner++) {
        if (runner->alive && runner->hangs) check_patience(runner);
        if (is_due(runner)) return sim->now_ns;
        if (runner->alive && !runner->hangs && runner->next_ns < due_ns) due_ns = runner->next_ns;
    }
    return due_ns;
}

bool sim_runners_step(void) {
    struct sim_runner *due[SIM_RUNNERS];
    int count = 0;
    for (struct sim_runner *runner = sim->runners; runner < sim->runners + SIM_RUNNERS; runner++)
        if (is_due(runner)) due[count++] = runner;
    if (count == 0) return false;
    sim->in_runner = true;
    act(due[sim_below(count)]);
    sim->in_runner = false;
    return true;
}

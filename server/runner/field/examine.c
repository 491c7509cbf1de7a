// The doctor as a job: the scene's newest checkpoint and its dataset's cameras. It works on a
// thread of its own, so that pictures do not wait for it.
#include <limits.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>

#include "common/base/clock.h"
#include "server/runner/field/work.h"
#include "server/runner/scene/checkpoints.h"
#include "server/runner/tools/doctor.h"

#define LOOK_MS 20
#define SEEDS 1000000000 // fresh ones are below

struct examination {
    struct rn_work work;
    struct rn_doctor_job_options asked;
    char checkpoint[PATH_MAX];
    struct rn_camera *cameras;
    struct rn_incident incident;
    struct rn_doctor_options options;
    pthread_t thread;
    bool began;
    atomic_bool over;
    enum rn_status status; // the thread's, as the rest, until it is joined
    struct rn_error err;
    struct rn_doctor_result result;
};

static void *examine(void *context) {
    struct examination *e = context;
    e->status = rn_doctor_run(&e->options, NULL, &e->result, &e->err);
    atomic_store(&e->over, true);
    return NULL;
}

static enum rn_status take_cameras(struct examination *e, struct rn_error *err) {
    struct rn_host *host = e->work.host;
    if (!*host->place.dataset_folder) return RN_OK; // it came as a file: parameters only
    enum rn_status status = rn_host_need_dataset(host, err);
    if (status) return status;
    size_t count = host->dataset->frame_count;
    e->cameras = calloc(count + 1, sizeof *e->cameras);
    if (!e->cameras) return rn_error_set(err, RN_ERROR_NO_MEMORY, "doctor", "out of memory");
    for (size_t i = 0; i < count; i++)
        e->cameras[i] = host->dataset->frames[i].camera;
    e->options.cameras = e->cameras;
    e->options.camera_count = count;
    return RN_OK;
}

static enum rn_status take_incident(struct examination *e, struct rn_error *err) {
    char path[PATH_MAX];
    const char *folder = e->work.host->place.scene_folder;
    if (!*e->asked.incident) return RN_OK;
    if (snprintf(path, sizeof path, "%s/%s", folder, e->asked.incident) >= (int)sizeof path)
        return rn_error_set(err, RN_ERROR_LIMIT, folder, "the path is too long");
    e->options.incident = &e->incident;
    return rn_incident_read(path, &e->incident, err);
}

static enum rn_status take_checkpoint(struct examination *e, struct rn_error *err) {
    int64_t step;
    const char *folder = e->work.host->place.scene_folder;
    enum rn_status status = rn_checkpoints_newest(folder, INT64_MAX, &step, err);
    if (status == RN_ERROR_NOT_FOUND)
        return rn_error_set(err, RN_ERROR_CONFLICT, "#/scene",
                            "has no checkpoint yet; its training writes one soon");
    if (!status) status = rn_checkpoint_path(folder, step, e->checkpoint, err);
    e->options.checkpoint = e->checkpoint;
    return status;
}

static enum rn_status prepare(struct rn_work *work, struct rn_field *field, struct rn_error *err) {
    struct examination *e = (struct examination *)work;
    (void)field;
    work->total = 1;
    e->options.seed = (uint64_t)rn_int_or(e->asked.seed, rn_clock_wall_ms() % SEEDS);
    enum rn_status status = take_checkpoint(e, err);
    if (!status) status = take_cameras(e, err);
    return status ? status : take_incident(e, err);
}

static enum rn_status unit(struct rn_work *work, struct rn_field *field,
                           const struct rn_field_info *info, struct rn_error *err) {
    struct examination *e = (struct examination *)work;
    (void)field, (void)info;
    if (!e->began && pthread_create(&e->thread, NULL, examine, e) != 0)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "doctor", "a thread cannot be started");
    e->began = true;
    while (!atomic_load(&e->over)) {
        rn_link_pump(&work->host->link, LOOK_MS);
        if (!rn_work_keep_going(e)) return rn_error_set(err, RN_ERROR_CANCELLED, "", "cancelled");
    }
    if (e->status) *err = e->err;
    return e->status;
}

static enum rn_status result(struct rn_work *work, struct rn_field *field, char **ret_json,
                             struct rn_error *err) {
    (void)field;
    return rn_doctor_result_json(&((struct examination *)work)->result, ret_json, err);
}

static void release(struct rn_work *work) {
    struct examination *e = (struct examination *)work;
    if (e->began) pthread_join(e->thread, NULL); // seconds, where it was cancelled
    free(e->cameras);
}

static const struct rn_work_kind kind = {.size = sizeof(struct examination),
                                         .prepare = prepare,
                                         .unit = unit,
                                         .result = result,
                                         .release = release};

void rn_work_add_doctor(struct rn_host *host, const struct rn_wire_doctor *request) {
    struct rn_work *work = rn_work_append(host, &kind, request->job);
    if (work) ((struct examination *)work)->asked = request->options;
}

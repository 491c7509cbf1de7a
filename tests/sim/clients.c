// What clients of the daemon do, all at once and at random, and the pictures that they wait for.
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "proto/job.h"
#include "tests/sim/calls.h"
#include "tests/sim/life.h"

#define PICTURES 64
#define SECOND_NS 1000000000ll

static const char camera_path[] =
    "{\"axes\":\"opengl\",\"width\":8,\"height\":8,\"fps\":2,\"keys\":["
    "{\"time\":0,\"world_from_camera\":[[1,0,0,0],[0,1,0,0],[0,0,1,4]],\"fov_y_deg\":40},"
    "{\"time\":1,\"world_from_camera\":[[1,0,0,1],[0,1,0,0],[0,0,1,4]],\"fov_y_deg\":40}]}";

// ---- pictures: in place of server/http/park.c ---------------------------------------------------

struct rn_parked {
    bool used, answered, left;
    int64_t deadline_ns;
    void (*on_gone)(void *context, struct rn_parked *parked);
    void *context;
};
static struct rn_parked pictures[PICTURES];

struct rn_request {
    int64_t begin_ns;
};

int64_t rn_request_begin_ns(const struct rn_request *request) {
    return request->begin_ns;
}

enum rn_status rn_request_park(struct rn_request *request, int64_t timeout_ms,
                               void (*on_gone)(void *context, struct rn_parked *parked),
                               void *context, struct rn_parked **ret_parked, struct rn_error *err) {
    struct rn_parked *parked = pictures;
    while (parked < pictures + PICTURES && parked->used)
        parked++;
    if (parked == pictures + PICTURES)
        return rn_error_set(err, RN_ERROR_LIMIT, "", "too many pictures are waited for");
    *parked = (struct rn_parked){.used = true,
                                 .deadline_ns = sim->now_ns + timeout_ms * 1000000,
                                 .on_gone = on_gone,
                                 .context = context};
    *ret_parked = parked;
    return RN_OK;
}

void rn_parked_answer(struct rn_parked *parked, struct rn_reply *reply) {
    if (parked < pictures || parked >= pictures + PICTURES || !parked->used || parked->answered)
        sim_violated("a picture is answered twice");
    parked->answered = true;
    sim->figures.pictures++;
    if (reply != NULL) rn_reply_finish(reply);
}

// Clients lose patience; what was answered makes room.
static void keep(void *context) {
    for (;;) {
        sim_sleep(SECOND_NS / 2);
        for (struct rn_parked *parked = pictures; parked < pictures + PICTURES; parked++) {
            bool leaves = sim->now_ns > parked->deadline_ns || (!sim->calm && sim_chance(30));
            if (parked->used && !parked->answered && !parked->left && leaves && life.open) {
                parked->left = true;
                life.busy++;
                parked->on_gone(parked->context, parked);
                life.busy--;
            }
            if (parked->answered) parked->used = false;
        }
    }
}

void sim_pictures_check(void) {
    for (const struct rn_parked *parked = pictures; parked < pictures + PICTURES; parked++)
        if (parked->used && !parked->answered) sim_violated("a picture was never answered");
}

static void ask_for_picture(void) {
    struct rn_render_request picture;
    struct rn_scene_row scene;
    struct rn_request request = {.begin_ns = sim->now_ns};
    struct rn_reply reply = {0};
    struct rn_error err = {0};
    char name[16], etag[RN_ETAG_MAX];
    static const char json[] = "{\"view\":\"test:0\"}";
    snprintf(name, sizeof name, "s%d", sim_below(20));
    if (rn_store_resolve(life.store, &rn_scenes, RN_ID_SCENE, name, &scene, &err) != RN_OK) return;
    if (rn_render_request_decode(json, sizeof json - 1, &picture, NULL, &err) != RN_OK)
        sim_violated("a request for a picture: %s", err.text);
    rn_render_request_settle(&picture, RN_FORMAT_PNG);
    if (rn_control_etag(life.control, &scene, &picture, etag, &err) == RN_OK)
        rn_control_render(life.control, &scene, &picture, etag, &request, &reply);
    rn_reply_finish(&reply);
    rn_row_finish(&rn_scenes, &scene);
}

// ---- jobs -------------------------------------------------------------------------------------

static const char *upload(const char *name, char path[64]) {
    static int number;
    char text[96];
    snprintf(path, 64, SIM_DATA "/spool/upload-%d-%d", sim->next_pid, ++number);
    int fd = sim_open(path, O_WRONLY | O_CREAT | O_TRUNC, 0600);
    int size = snprintf(text, sizeof text, "the upload of %s", name);
    bool good = fd >= 0 && sim_write(fd, text, (size_t)size) == size && sim_fsync(fd) == 0;
    if (fd >= 0) sim_close(fd);
    return good ? path : NULL;
}

static void give_key(char key[24], char expected[RN_ID_MAX]) {
    expected[0] = '\0';
    if (sim->key_count > 0 && sim_chance(2)) {
        const struct sim_key *old = &sim->keys[sim_below(sim->key_count)];
        snprintf(key, 24, "%s", old->key);
        snprintf(expected, RN_ID_MAX, "%s", old->job);
    } else {
        snprintf(key, 24, "k%llu", (unsigned long long)sim_random());
    }
}

// A folder of photographs, an upload of them, or a scene as a file.
static bool choose_import(struct rn_submission *wanted, char path[64]) {
    bool of_scene = sim_chance(4);
    if (of_scene)
        wanted->dataset = NULL;
    else
        wanted->scene = NULL;
    if (of_scene || sim_chance(2))
        return (wanted->spooled = upload(of_scene ? wanted->scene : wanted->dataset, path)) != NULL;
    wanted->source = "/photos";
    return true;
}

static void submit(void) {
    static const enum rn_job_type types[] = {
        RN_JOB_INGEST, RN_JOB_TRAIN, RN_JOB_TRAIN,  RN_JOB_PATH,   RN_JOB_PATH,
        RN_JOB_EVAL,   RN_JOB_CURVE, RN_JOB_EXPORT, RN_JOB_DOCTOR, RN_JOB_VALIDATE};
    char scene[16], dataset[16], path[64], key[24], expected[RN_ID_MAX] = "", id[RN_ID_MAX];
    struct rn_submission wanted = {.type = types[sim_below((int)(sizeof types / sizeof *types))],
                                   .scene = scene,
                                   .dataset = dataset,
                                   .options = "{}"};
    struct rn_error err = {0};
    char *json = NULL;
    snprintf(scene, sizeof scene, "s%d", sim_below(20));
    snprintf(dataset, sizeof dataset, "d%d", sim_below(6));
    if (wanted.type == RN_JOB_EXPORT) wanted.options = "{\"as\":\"mesh\"}";
    if (wanted.type == RN_JOB_PATH) wanted.source = camera_path;
    if (wanted.type == RN_JOB_INGEST && !choose_import(&wanted, path)) return;
    if (wanted.type == RN_JOB_VALIDATE) { // of photographs that stay where they were sent to
        wanted.scene = wanted.dataset = NULL;
        wanted.source = "/photos.tar";
    }
    if (wanted.type == RN_JOB_EVAL && sim_chance(2)) {
        give_key(key, expected);
        wanted.key = key;
        wanted.digest = "digest";
    }
    enum rn_status status = rn_control_submit(life.control, &wanted, id, &json, &err);
    free(json);
    sim->figures.refused += status != RN_OK;
    if (status != RN_OK && wanted.spooled != NULL) sim_unlinkat(AT_FDCWD, path, 0);
    if (status != RN_OK) return;
    if (sim_job_find(id) == NULL) sim_violated("job %s was acknowledged and not announced", id);
    if (expected[0] != '\0' && strcmp(expected, id) != 0)
        sim_violated("key %s made job %s, and now %s", key, expected, id);
    if (wanted.key != NULL && expected[0] == '\0' && sim->key_count < SIM_THINGS) {
        struct sim_key *made = &sim->keys[sim->key_count++];
        snprintf(made->key, sizeof made->key, "%s", key);
        snprintf(made->job, sizeof made->job, "%s", id);
    }
}

static bool is_over(const struct sim_job *job) {
    return job->state == RN_JOB_SUCCEEDED || job->state == RN_JOB_FAILED ||
           job->state == RN_JOB_CANCELLED;
}

static struct sim_job *some_job(void) {
    int recent = sim->job_count < 24 ? sim->job_count : 24;
    return recent > 0 ? &sim->jobs[sim->job_count - 1 - sim_below(recent)] : NULL;
}

static void order(const struct sim_job *job, enum rn_job_event event) {
    struct rn_error err = {0};
    char *json = NULL;
    bool over = is_over(job);
    enum rn_status status = rn_control_command(life.control, job->id, event, &json, &err);
    if (status == RN_OK && over && event != RN_JOB_CANCEL)
        sim_violated("job %s is over and takes a command", job->id);
    free(json);
}

// Every other one who pauses a job thinks better of it, before its runner has heard of it at times.
static void command(void) {
    static const enum rn_job_event commands[] = {RN_JOB_PAUSE, RN_JOB_RESUME, RN_JOB_RESUME,
                                                 RN_JOB_FINISH, RN_JOB_CANCEL};
    const struct sim_job *job = some_job();
    if (job == NULL) return;
    enum rn_job_event event = commands[sim_below(5)];
    order(job, event);
    if (event != RN_JOB_PAUSE || sim_chance(2)) return;
    sim_sleep(sim_below(400) * 1000000ll);
    if (life.open) order(job, RN_JOB_RESUME);
}

static void look(void) {
    const struct sim_job *job = some_job();
    struct rn_error err = {0};
    char *json = NULL;
    if (job == NULL) return;
    if (rn_control_job_json(life.control, job->id, &json, &err) != RN_OK)
        sim_violated("job %s cannot be read: %s", job->id, err.text);
    free(json);
}

// ---- other records ----------------------------------------------------------------------------

static struct sim_thing *some_thing(struct sim_thing *things, int count) {
    struct sim_thing *thing = count > 0 ? &things[sim_below(count)] : NULL;
    return thing != NULL && thing->promise == SIM_KEPT ? thing : NULL;
}

static void check_without_runner(const char *scene) {
    for (int i = 0; i < SIM_RUNNERS; i++) {
        const struct sim_runner *runner = &sim->runners[i];
        if (runner->alive && !runner->orphan && strcmp(runner->scene, scene) == 0)
            sim_violated("scene %s is deleted, and runner %d goes on", scene, runner->pid);
    }
}

// Who is told that the disk is full asks again, until there is room.
static void delete_scene(void) {
    struct sim_thing *thing = some_thing(sim->scenes, sim->scene_count);
    enum rn_status status = RN_ERROR_NO_SPACE;
    struct rn_error err = {0};
    if (thing == NULL) return;
    thing->promise = SIM_IN_DOUBT;
    while (status == RN_ERROR_NO_SPACE && life.open) {
        status = rn_control_delete_scene(life.control, thing->id, &err);
        if (status == RN_ERROR_NO_SPACE) sim_sleep(50 * 1000000ll);
    }
    thing->promise = status == RN_OK ? SIM_GONE : SIM_KEPT;
    if (status == RN_OK) check_without_runner(thing->id);
}

static void delete_dataset(void) {
    struct sim_thing *thing = some_thing(sim->datasets, sim->dataset_count);
    struct rn_error err = {0};
    if (thing == NULL) return;
    thing->promise = SIM_IN_DOUBT;
    enum rn_status status = rn_control_delete_dataset(life.control, thing->id, &err);
    thing->promise = status == RN_OK ? SIM_GONE : SIM_KEPT;
}

// As server/api/camera_paths.c does.
static void remove_copy(const char *id) {
    char path[96];
    snprintf(path, sizeof path, SIM_DATA "/camera-paths/%s", id);
    (void)!rn_remove_tree(path, NULL);
}

static void change(const struct rn_store_table *table, struct sim_thing *things, int *count,
                   void *row, char id[RN_ID_MAX], const char *prefix) {
    struct rn_error err = {0};
    struct sim_thing *thing = some_thing(things, *count);
    if (thing != NULL && sim_chance(2)) {
        thing->promise = SIM_IN_DOUBT;
        enum rn_status status = rn_store_delete(life.store, table, thing->id, &err);
        thing->promise = status == RN_OK ? SIM_GONE : SIM_KEPT;
        if (status == RN_OK && table == &rn_camera_paths) remove_copy(thing->id);
    } else if (rn_store_new_id(prefix, id, &err) == RN_OK &&
               rn_store_insert(life.store, table, row, &err) == RN_OK) {
        sim_thing_promise(things, count, id, SIM_KEPT);
    }
}

static void change_path(void) {
    struct rn_camera_path_row row = {.document = (char *)camera_path};
    snprintf(row.name, sizeof row.name, "p%llu", (unsigned long long)sim_random());
    change(&rn_camera_paths, sim->paths, &sim->path_count, &row, row.id, RN_ID_PATH);
}

static void change_token(void) {
    struct rn_token_row row = {.scope = RN_SCOPE_READ};
    snprintf(row.name, sizeof row.name, "t%llu", (unsigned long long)sim_random());
    snprintf(row.sha256, sizeof row.sha256, "%016llx", (unsigned long long)sim_random());
    change(&rn_tokens, sim->tokens, &sim->token_count, &row, row.id, RN_ID_TOKEN);
}

// ---- all of it --------------------------------------------------------------------------------

static void do_something(void) {
    int choice = sim_below(100);
    sim->figures.requests++;
    if (choice < 45)
        submit();
    else if (choice < 62)
        command();
    else if (choice < 80)
        ask_for_picture();
    else if (choice < 86)
        look();
    else if (choice < 91)
        delete_scene();
    else if (choice < 94)
        delete_dataset();
    else if (choice < 97)
        change_path();
    else
        change_token();
}

static void be_client(void *context) {
    for (;;) {
        sim_sleep((20 + sim_below(sim->pause_ms)) * 1000000ll);
        if (!life.open || sim->calm) continue;
        life.busy++;
        do_something();
        life.busy--;
    }
}

static void fill_disk(void *context) {
    while (!sim->calm) {
        sim_sleep((10 + sim_below(300)) * SECOND_NS);
        if (sim->calm) return;
        sim->disk.full = true;
        sim->figures.full_disks++;
        sim_sleep((1 + sim_below(10)) * SECOND_NS);
        sim->disk.full = false;
    }
}

void sim_clients_begin(int count) {
    for (int i = 0; i < count; i++)
        sim_thread_begin(be_client, NULL);
    sim_thread_begin(keep, NULL);
    sim_thread_begin(fill_disk, NULL);
}

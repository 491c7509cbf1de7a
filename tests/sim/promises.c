// What the daemon has promised: kept apart from it, and held against what a later life finds.
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/file.h"
#include "common/base/seal.h"
#include "tests/sim/calls.h"
#include "tests/sim/life.h"

struct sim_job *sim_job_find(const char *id) {
    for (int i = sim->job_count - 1; i >= 0 && id[0] != '\0'; i--)
        if (strcmp(sim->jobs[i].id, id) == 0) return &sim->jobs[i];
    return NULL;
}

struct sim_thing *sim_thing_find(struct sim_thing *things, int count, const char *id) {
    for (int i = count - 1; i >= 0; i--)
        if (strcmp(things[i].id, id) == 0) return &things[i];
    return NULL;
}

void sim_thing_promise(struct sim_thing *things, int *count, const char *id,
                       enum sim_promise promise) {
    struct sim_thing *thing = sim_thing_find(things, *count, id);
    if (thing == NULL) {
        if (*count == SIM_THINGS) sim_violated("more is promised than can be remembered");
        thing = &things[(*count)++];
        snprintf(thing->id, sizeof thing->id, "%s", id);
    }
    thing->promise = promise;
}

// ---- the life of a job --------------------------------------------------------------------------

// Written down apart from server/jobs/machine.c, from what README says of it.
static bool may_follow(enum rn_job_state from, enum rn_job_state to) {
    static const unsigned next[] = {
        [RN_JOB_QUEUED] = 1u << RN_JOB_RUNNING | 1u << RN_JOB_PAUSED | 1u << RN_JOB_CANCELLED |
                          1u << RN_JOB_CANCELLING | 1u << RN_JOB_FAILED,
        [RN_JOB_RUNNING] = 1u << RN_JOB_SUCCEEDED | 1u << RN_JOB_FAILED | 1u << RN_JOB_CANCELLED |
                           1u << RN_JOB_CANCELLING | 1u << RN_JOB_PAUSED | 1u << RN_JOB_INTERRUPTED,
        [RN_JOB_PAUSED] = 1u << RN_JOB_QUEUED | 1u << RN_JOB_RUNNING | 1u << RN_JOB_CANCELLED |
                          1u << RN_JOB_CANCELLING | 1u << RN_JOB_SUCCEEDED | 1u << RN_JOB_FAILED,
        [RN_JOB_CANCELLING] = 1u << RN_JOB_CANCELLED | 1u << RN_JOB_SUCCEEDED | 1u << RN_JOB_FAILED,
        [RN_JOB_INTERRUPTED] = 1u << RN_JOB_QUEUED | 1u << RN_JOB_FAILED | 1u << RN_JOB_CANCELLED,
        [RN_JOB_SUCCEEDED] = 0,
        [RN_JOB_FAILED] = 0,
        [RN_JOB_CANCELLED] = 0,
    };
    return (next[from] & 1u << to) != 0;
}

static bool is_over(enum rn_job_state state) {
    return state == RN_JOB_SUCCEEDED || state == RN_JOB_FAILED || state == RN_JOB_CANCELLED;
}

static struct sim_job *remember(const char *id, enum rn_job_type type, enum rn_job_state state,
                                const char *scene, const char *dataset) {
    if (sim->job_count == SIM_JOBS) sim_violated("more jobs than can be remembered");
    struct sim_job *job = &sim->jobs[sim->job_count++];
    *job = (struct sim_job){.type = type, .state = state};
    snprintf(job->id, sizeof job->id, "%s", id);
    snprintf(job->scene, sizeof job->scene, "%s", scene);
    snprintf(job->dataset, sizeof job->dataset, "%s", dataset);
    if (type == RN_JOB_TRAIN) sim_thing_promise(sim->scenes, &sim->scene_count, scene, SIM_KEPT);
    return job;
}

static bool has_begun(const struct sim_runner *runner, const char *job) {
    return strcmp(job, runner->train) == 0 || strcmp(job, runner->work) == 0;
}

static bool is_begun_by_any(const char *job) {
    for (int i = 0; i < SIM_RUNNERS; i++)
        if (sim->runners[i].alive && has_begun(&sim->runners[i], job)) return true;
    return false;
}

// What it works at, and what it was started for and has not been told of yet.
static bool is_lost_with(const struct sim_job *job, const struct sim_runner *runner) {
    if (has_begun(runner, job->id)) return true;
    if (job->state != RN_JOB_RUNNING || is_begun_by_any(job->id)) return false;
    bool imports = job->type == RN_JOB_INGEST || job->type == RN_JOB_VALIDATE;
    return imports ? strcmp(runner->mode, "ingest") == 0 : strcmp(job->scene, runner->scene) == 0;
}

void sim_lost_with(const struct sim_runner *runner) {
    for (int i = 0; i < sim->job_count; i++)
        sim->jobs[i].losses += is_lost_with(&sim->jobs[i], runner);
}

static void check_failure(const struct sim_job *job) {
    if (job->state == RN_JOB_FAILED && !job->may_fail && job->losses < 3)
        sim_violated("job %s has failed, and nothing went wrong with it", job->id);
}

// The text at a key of an event; "" where there is none.
static const char *member(const char *json, const char *key, char text[64]) {
    char pattern[32];
    snprintf(pattern, sizeof pattern, "\"%s\":\"", key);
    const char *at = strstr(json, pattern);
    text[0] = '\0';
    if (at == NULL) return text;
    at += strlen(pattern);
    snprintf(text, 64, "%.*s", (int)strcspn(at, "\""), at);
    return text;
}

void sim_heard(const char *name, const char *json) {
    char id[64], state_name[64], type_name[64], scene[64], dataset[64];
    if (strcmp(name, "state") != 0) return;
    struct sim_job *job = sim_job_find(member(json, "id", id));
    int state = rn_name_index(rn_job_state_names, member(json, "state", state_name));
    int type = rn_name_index(rn_job_type_names, member(json, "type", type_name));
    if (state < 0 || type < 0) sim_violated("an event that is none: %s", json);
    if (job == NULL) {
        if (state != RN_JOB_QUEUED) sim_violated("job %s begins as %s", id, state_name);
        remember(id, (enum rn_job_type)type, (enum rn_job_state)state, member(json, "scene", scene),
                 member(json, "dataset", dataset));
        sim->figures.transitions++;
        return;
    }
    if (job->state == (enum rn_job_state)state) return;
    if (!may_follow(job->state, (enum rn_job_state)state))
        sim_violated("job %s goes from %s to %s", id, rn_job_state_names[job->state], state_name);
    sim_tell("job %s, %s: %s", id, type_name, state_name);
    sim->figures.transitions++;
    job->state = (enum rn_job_state)state;
    job->doubt = sim->disk.full;
    if (sim->disk.full) job->may_fail = true;
    check_failure(job);
    if (job->type != RN_JOB_INGEST || state != RN_JOB_SUCCEEDED) return;
    if (job->scene[0] != '\0')
        sim_thing_promise(sim->scenes, &sim->scene_count, job->scene, SIM_KEPT);
    else
        sim_thing_promise(sim->datasets, &sim->dataset_count, job->dataset, SIM_KEPT);
}

// ---- after a start ------------------------------------------------------------------------------

static void *rows_of(const struct rn_store_table *table, size_t *ret_count) {
    struct rn_query query = {.limit = 0};
    struct rn_error err;
    void *rows = NULL;
    if (rn_store_list(life.store, table, &query, &rows, ret_count, &err) != RN_OK)
        sim_violated("the records cannot be listed: %s", err.text);
    return rows;
}

static bool holds(const char *path, const char *text) {
    uint8_t *bytes = NULL;
    size_t size;
    bool same = rn_file_read(path, 1 << 20, &bytes, &size, NULL) == RN_OK &&
                strcmp((char *)bytes, text) == 0;
    free(bytes);
    return same;
}

static void check_pictures(const struct rn_job_row *row) {
    char path[160], text[96];
    if (sim->week) return; // they are removed after a day
    for (int i = 0; i < 1 + row->id[5] % 5; i++) {
        snprintf(path, sizeof path, SIM_DATA "/jobs/%s/frames/%05d.png", row->id, i);
        snprintf(text, sizeof text, "picture %d of %s", i, row->id);
        if (!holds(path, text)) sim_violated("%s is lost", path);
    }
}

static void check_upload(const struct rn_job_row *row) {
    char text[128];
    snprintf(text, sizeof text, "the upload of %s",
             row->scene[0] != '\0' ? row->scene_name : row->dataset_name);
    if (strncmp(row->source, SIM_DATA, sizeof SIM_DATA - 1) == 0 && !holds(row->source, text))
        sim_violated("the upload of job %s was acknowledged and is lost", row->id);
}

static void check_job(const struct rn_job_row *row) {
    struct sim_job *job = sim_job_find(row->id);
    if (job == NULL) { // written, and not acknowledged any more
        job = remember(row->id, row->type, row->state, row->scene, row->dataset);
        if (row->state != RN_JOB_QUEUED) sim_violated("job %s was never announced", row->id);
    }
    bool good = job->state == row->state || may_follow(job->state, row->state) || job->doubt;
    if (!good)
        sim_violated("job %s was %s and is %s", job->id, rn_job_state_names[job->state],
                     rn_job_state_names[row->state]);
    job->state = row->state;
    job->doubt = false;
    job->found = true;
    check_failure(job);
    bool pictures = row->type == RN_JOB_PATH || row->type == RN_JOB_EXPORT;
    if (pictures && row->state == RN_JOB_SUCCEEDED) check_pictures(row);
    if (row->type == RN_JOB_INGEST && !is_over(row->state)) check_upload(row);
}

static void check_jobs(void) {
    size_t count;
    struct rn_job_row *rows = rows_of(&rn_jobs_table, &count);
    for (int i = 0; i < sim->job_count; i++)
        sim->jobs[i].found = false;
    for (size_t i = count; i-- > 0;)
        check_job(&rows[i]);
    for (int i = 0; i < sim->job_count; i++)
        if (!sim->jobs[i].found) sim_violated("job %s is lost", sim->jobs[i].id);
    rn_rows_finish(&rn_jobs_table, rows, count);
}

// What is promised is there and what is gone is not; what was in doubt is settled.
static void check_things(const struct rn_store_table *table, struct sim_thing *things, int *count,
                         void (*check)(const void *row)) {
    size_t row_count, size = rn_store_row_size(table);
    char *rows = rows_of(table, &row_count);
    for (size_t i = 0; i < row_count; i++) {
        const char *id = rows + i * size + sizeof(int64_t);
        const struct sim_thing *thing = sim_thing_find(things, *count, id);
        if (thing != NULL && thing->promise == SIM_GONE)
            sim_violated("%s was deleted, and is back", id);
        sim_thing_promise(things, count, id, SIM_FOUND);
        if (check != NULL) check(rows + i * size);
    }
    for (int i = 0; i < *count; i++) {
        if (things[i].promise == SIM_KEPT) sim_violated("%s is lost", things[i].id);
        if (things[i].promise == SIM_IN_DOUBT) things[i].promise = SIM_GONE;
        if (things[i].promise == SIM_FOUND) things[i].promise = SIM_KEPT;
    }
    rn_rows_finish(table, rows, row_count);
}

// What an import made and its end are one.
static void check_import(const char *id) {
    for (int i = 0; i < sim->job_count; i++) {
        const struct sim_job *job = &sim->jobs[i];
        const char *made = job->scene[0] != '\0' ? job->scene : job->dataset;
        if (job->type == RN_JOB_INGEST && strcmp(made, id) == 0 && job->state != RN_JOB_SUCCEEDED)
            sim_violated("%s is there and its import is %s", id, rn_job_state_names[job->state]);
    }
}

static void check_dataset(const void *row) {
    const struct rn_dataset_row *dataset = row;
    char path[160];
    snprintf(path, sizeof path, SIM_DATA "/datasets/%s/dataset.json", dataset->id);
    if (!holds(path, "photographs")) sim_violated("dataset %s has no content", dataset->id);
    check_import(dataset->id);
}

static void check_scene(const void *row) {
    const struct rn_scene_row *scene = row;
    char folder[128], path[512], sha256[65];
    struct dirent **entries;
    int newest = 0;
    check_import(scene->id);
    snprintf(folder, sizeof folder, SIM_DATA "/scenes/%s/checkpoints", scene->id);
    int count = sim_scandir(folder, &entries);
    for (int i = 0; i < count; i++) {
        int step;
        snprintf(path, sizeof path, "%s/%s", folder, entries[i]->d_name);
        if (sscanf(entries[i]->d_name, "step-%9d", &step) == 1 &&
            rn_seal_check(path, sha256, NULL) == RN_OK && step > newest)
            newest = step;
        free(entries[i]);
    }
    if (count >= 0) free(entries);
    if (scene->sha256[0] != '\0' && newest < scene->steps)
        sim_violated("scene %s is recorded at step %lld and has step %d", scene->id,
                     (long long)scene->steps, newest);
}

static void check_keys(void) {
    for (int i = 0; i < sim->key_count; i++) {
        struct rn_key_row row;
        struct rn_error err;
        if (rn_store_find(life.store, &rn_keys, "id", sim->keys[i].key, &row, &err) != RN_OK)
            sim_violated("key %s is lost", sim->keys[i].key);
        if (strcmp(row.job, sim->keys[i].job) != 0)
            sim_violated("key %s is another job's", sim->keys[i].key);
    }
}

// Content without a record: it was lost, or will never be removed.
static void check_content(const char *folder, const struct rn_store_table *table) {
    char path[64];
    struct dirent **entries;
    snprintf(path, sizeof path, SIM_DATA "/%s", folder);
    int count = sim_scandir(path, &entries);
    for (int i = 0; i < count; i++) {
        const char *id = entries[i]->d_name;
        struct rn_query query = {.equal = {{"id", id}}, .limit = 1};
        size_t found = 0;
        void *rows = NULL;
        bool open_import = false;
        if (rn_store_list(life.store, table, &query, &rows, &found, NULL) != RN_OK)
            sim_violated("the records cannot be listed");
        rn_rows_finish(table, rows, found);
        for (int j = 0; j < sim->job_count; j++)
            open_import |=
                (strcmp(sim->jobs[j].dataset, id) == 0 ||
                 (sim->jobs[j].type == RN_JOB_INGEST && strcmp(sim->jobs[j].scene, id) == 0)) &&
                !is_over(sim->jobs[j].state);
        if (found == 0 && !open_import) sim_violated("%s/%s has no record", path, id);
        free(entries[i]);
    }
    if (count >= 0) free(entries);
}

void sim_promises_check(bool rebuilt) {
    check_jobs();
    check_things(&rn_datasets, sim->datasets, &sim->dataset_count, check_dataset);
    check_things(&rn_scenes, sim->scenes, &sim->scene_count, check_scene);
    check_things(&rn_camera_paths, sim->paths, &sim->path_count, NULL);
    check_content("datasets", &rn_datasets);
    check_content("scenes", &rn_scenes);
    check_content("jobs", &rn_jobs_table);
    if (rebuilt) return;
    check_things(&rn_tokens, sim->tokens, &sim->token_count, NULL);
    check_keys();
}

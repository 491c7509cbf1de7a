// The thread that talks to Slurm: submits, asks, cancels. It alone frees places.
#include <errno.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/log.h"
#include "common/base/program.h"
#include "server/slurm/inside.h"

#define SECOND_NS 1000000000ll
#define COMMAND_NS (60 * SECOND_NS) // a command that takes longer is ended
#define RETRY_NS (5 * SECOND_NS)    // of what Slurm does not answer
#define ASK_SOON_NS (1 * SECOND_NS) // while a runner is waited for, or has hung up
#define ASK_NS (5 * SECOND_NS)
#define MAX_FLAGS 32 // of --slurm-flags
#define MAX_WORDS (MAX_FLAGS + 24)
#define SAID_SIZE 96

// ---- a command ----------------------------------------------------------------------------------

struct command {
    struct rn_slurm *slurm;
    int64_t deadline_ns;
    bool full;
    char said[SAID_SIZE]; // the first line
};

static bool goes_on(void *context) {
    const struct command *command = context;
    return !command->slurm->quit && !command->full && rn_clock_ns() < command->deadline_ns;
}

// That Slurm has as many jobs as it takes, or as it takes of this user. Its commands would try the
// former again for minutes, and nothing else be done meanwhile.
static bool says_full(const char *line) {
    return strstr(line, "sleeping and retrying") != NULL || strstr(line, "MaxSubmit") != NULL;
}

static void take_line(void *context, const char *line) {
    struct command *command = context;
    command->full |= says_full(line);
    if (command->said[0] == '\0') snprintf(command->said, sizeof command->said, "%s", line);
}

static enum rn_status run(struct rn_slurm *slurm, const char *name, const char *const *words,
                          void (*line)(void *, const char *), char ret_said[SAID_SIZE],
                          struct rn_error *err) {
    struct command command = {.slurm = slurm, .deadline_ns = rn_clock_ns() + COMMAND_NS};
    const struct rn_program program = {.name = name,
                                       .package = "slurm-client",
                                       .line = line != NULL ? line : take_line,
                                       .keep_going = goes_on,
                                       .context = &command};
    enum rn_status status = rn_program_run(&program, words, err);
    if (command.full)
        return rn_error_set(err, RN_ERROR_UNAVAILABLE, name, "takes no more jobs: %s",
                            command.said);
    if (status == RN_ERROR_CANCELLED)
        return rn_error_set(err, RN_ERROR_UNAVAILABLE, name, "Slurm does not answer");
    if (ret_said != NULL) memcpy(ret_said, command.said, SAID_SIZE);
    return status;
}

static int count_words(const char *text) {
    int count = 0;
    for (; *text != '\0'; text += strcspn(text, " ")) {
        text += strspn(text, " ");
        count += *text != '\0';
    }
    return count;
}

enum rn_status rn_clerk_check(const char *flags, struct rn_error *err) {
    static const char *const names[] = {"sbatch", "squeue", "scancel"};
    if (flags != NULL && count_words(flags) > MAX_FLAGS)
        return rn_error_set(err, RN_ERROR_LIMIT, "slurm-flags", "more than %d flags of sbatch",
                            MAX_FLAGS);
    for (int i = 0; i < 3; i++)
        if (rn_program_find(names[i]) == NULL)
            return rn_error_set(err, RN_ERROR_UNSUPPORTED, "executor",
                                "%s is not installed here: apt-get install slurm-client munge, and "
                                "give this machine the cluster's slurm.conf and munge.key; or "
                                "--executor local",
                                names[i]);
    return RN_OK;
}

// ---- submitting ---------------------------------------------------------------------------------

// Whether trying again may help: Slurm is away or full, not against it.
static bool is_passing(const struct rn_error *err) {
    static const char *const signs[] = {"ontact slurm controller",
                                        "onnect",
                                        "timed out",
                                        "temporarily",
                                        "Zero Bytes",
                                        "inactive or drain",
                                        "try again",
                                        "munge",
                                        "Munge",
                                        "Protocol authentication"};
    if (err->status == RN_ERROR_UNAVAILABLE) return true;
    for (size_t i = 0; i < sizeof signs / sizeof signs[0]; i++)
        if (strstr(err->text, signs[i]) != NULL) return true;
    return false;
}

struct words {
    const char *list[MAX_WORDS + 1];
    int count;
    char texts[MAX_WORDS][512]; // of those made here
    int made;
    char *flags; // cut at its spaces
};

static void add(struct words *words, const char *word) {
    if (words->count < MAX_WORDS) words->list[words->count++] = word;
}

static void add_text(struct words *words, const char *name, const char *value) {
    if (value == NULL || value[0] == '\0') return;
    char *text = words->texts[words->made++];
    snprintf(text, sizeof words->texts[0], "--%s=%s", name, value);
    add(words, text);
}

static void add_number(struct words *words, const char *name, int64_t value, const char *unit) {
    char text[32];
    snprintf(text, sizeof text, "%" PRId64 "%s", value, unit);
    if (value > 0) add_text(words, name, text);
}

// ---- what a job needs ---------------------------------------------------------------------------

#define NEEDS "memory_bytes "

static void take_needs(void *context, const char *line) {
    if (strncmp(line, NEEDS, sizeof NEEDS - 1) == 0)
        take_line(context, line);
    else
        rn_log(RN_LOG_DEBUG, "needs: %s", line);
}

// Asks the runner's program on this machine, where its engine knows. Lets go of the lock meanwhile.
static void ask_needs(struct rn_slurm *slurm, struct rn_place *place) {
    char said[SAID_SIZE] = "", *scene = NULL, threads[16];
    struct rn_error err = {0};
    if (place->dataset == NULL) return;
    if (asprintf(&scene, "%s/scenes/%s", slurm->data, place->scene) < 0) return;
    snprintf(threads, sizeof threads, "%d", slurm->threads);
    struct words words = {.count = 0};
    const char *const fixed[] = {"--mode",  "needs", "--dataset", place->dataset,
                                 "--scene", scene,   "--threads", threads};
    for (size_t i = 0; i < sizeof fixed / sizeof fixed[0]; i++)
        add(&words, fixed[i]);
    if (slurm->sandbox) add(&words, "--sandbox");
    if (place->train != NULL) add(&words, "--train");
    if (place->train != NULL) add(&words, place->train);
    pthread_mutex_unlock(&slurm->lock);
    enum rn_status status = run(slurm, slurm->runner, words.list, take_needs, said, &err);
    pthread_mutex_lock(&slurm->lock);
    if (status != RN_OK ||
        sscanf(said, NEEDS "%" SCNd64 " gpus %d", &place->memory_bytes, &place->gpus) != 2)
        rn_log(RN_LOG_WARN, "runner %d: what it needs is not known: %s", place->number, err.text);
    free(scene);
}

// Nothing of the daemon's environment, and no secret, is among them. Before the time is over the
// script is told, so that its runner saves. A job that is lost is asked for again by the daemon,
// with another secret.
static void write_order(const struct rn_slurm *slurm, const struct rn_place *place,
                        struct words *words) {
    char name[64], signal[32], *rest = words->flags, *flag;
    int64_t memory = slurm->memory_bytes > 0 ? slurm->memory_bytes : place->memory_bytes;
    int64_t gpus = place->gpus >= 0 && slurm->gpus < place->gpus ? place->gpus : slurm->gpus;
    int64_t warning_s = slurm->time_s > 0 && slurm->time_s < 240 ? slurm->time_s / 4 : 60;
    snprintf(signal, sizeof signal, "B:TERM@%" PRId64, warning_s);
    snprintf(name, sizeof name, "ripnerf-%s", place->scene);
    add(words, "--parsable");
    add(words, "--export=NONE");
    add(words, "--no-requeue");
    add_number(words, "nodes", place->ranks, "");
    add(words, "--ntasks-per-node=1");
    add_text(words, "signal", signal);
    add(words, "--chdir=/");
    add(words, "--output=/dev/null");
    add(words, "--error=/dev/null");
    add_text(words, "job-name", name);
    add_text(words, "partition", slurm->partition);
    add_text(words, "account", slurm->account);
    add_number(words, "time", (slurm->time_s + 59) / 60, "");
    add_number(words, "gpus", place->gpus == 0 ? 0 : gpus, "");
    add_number(words, "mem", (memory + (1 << 20) - 1) >> 20, "M");
    add_number(words, "cpus-per-task", slurm->threads, "");
    while (rest != NULL && (flag = strsep(&rest, " ")) != NULL)
        if (*flag != '\0') add(words, flag);
}

static void submitted(struct rn_slurm *slurm, struct rn_place *place, enum rn_status status,
                      const char *said, const struct rn_error *err) {
    if (status == RN_OK) {
        place->job = strtoll(said, NULL, 10);
        snprintf(place->state, sizeof place->state, "PENDING");
        place->reason[0] = '\0';
        rn_log(RN_LOG_INFO, "runner %d: Slurm job %" PRId64, place->number, place->job);
        struct rn_error unsaid = {0};
        if (rn_place_sign(slurm, place, &unsaid) != RN_OK)
            rn_log(RN_LOG_WARN, "Slurm job %" PRId64 ": %s", place->job, unsaid.text);
    } else if (is_passing(err)) {
        snprintf(place->reason, sizeof place->reason, "%.30s %.120s", err->where, err->text);
        place->not_before_ns = rn_clock_ns() + RETRY_NS;
        rn_log(RN_LOG_WARN, "runner %d: %s: %s", place->number, err->where, err->text);
    } else {
        place->refusal = *err;
    }
}

static void submit(struct rn_slurm *slurm, struct rn_place *place) {
    ask_needs(slurm, place);
    if (place->given_up) return;
    struct words words = {.flags = slurm->flags != NULL ? strdup(slurm->flags) : NULL};
    struct rn_error err = {0};
    char said[SAID_SIZE] = "", *script = rn_place_path(slurm, place, "script");
    write_order(slurm, place, &words);
    add(&words, script);
    pthread_mutex_unlock(&slurm->lock);
    enum rn_status status = script == NULL
                                ? rn_error_set(&err, RN_ERROR_NO_MEMORY, "slurm", "no memory")
                                : run(slurm, "sbatch", words.list, NULL, said, &err);
    if (status == RN_OK && strtoll(said, NULL, 10) <= 0)
        status = rn_error_set(&err, RN_ERROR_IO, "sbatch", "said '%s', which is no job", said);
    pthread_mutex_lock(&slurm->lock);
    submitted(slurm, place, status, said, &err);
    free(words.flags);
    free(script);
}

// ---- asking -------------------------------------------------------------------------------------

// Columns of squeue, by their widths.
#define COLUMNS "JobID:20,State:20,exit_code:16,NodeList:64,Reason:128"
static const int widths[] = {20, 20, 16, 64, 128};
enum { COLUMN_JOB, COLUMN_STATE, COLUMN_EXIT, COLUMN_NODES, COLUMN_REASON, COLUMN_COUNT };

static void cut_columns(const char *line, char columns[COLUMN_COUNT][160]) {
    size_t size = strlen(line), at = 0;
    for (int i = 0; i < COLUMN_COUNT; i++) {
        size_t width = (size_t)widths[i], left = size > at ? size - at : 0;
        if (left > width) left = width;
        while (left > 0 && line[at + left - 1] == ' ')
            left--;
        snprintf(columns[i], 160, "%.*s", (int)left, left > 0 ? line + at : "");
        at += width;
    }
}

static bool is_over(const char *state) {
    static const char *const states[] = {"COMPLETED",     "FAILED",       "TIMEOUT",   "CANCELLED",
                                         "NODE_FAIL",     "PREEMPTED",    "BOOT_FAIL", "DEADLINE",
                                         "OUT_OF_MEMORY", "SPECIAL_EXIT", "REVOKED"};
    for (size_t i = 0; i < sizeof states / sizeof states[0]; i++)
        if (strncmp(state, states[i], strlen(states[i])) == 0) return true;
    return false;
}

// "3:0", or as wait(2) has it.
static void read_exit(struct rn_place *place, const char *text) {
    char *end;
    long code = strtol(text, &end, 10);
    place->exit_code = (int)(*end == ':' ? code : code >> 8);
    place->exit_signal = *end == ':' ? (int)strtol(end + 1, NULL, 10) : (int)(code & 127);
}

static void learn(void *context, const char *line) {
    struct rn_slurm *slurm = ((struct command *)context)->slurm;
    char columns[COLUMN_COUNT][160];
    cut_columns(line, columns);
    int64_t job = strtoll(columns[COLUMN_JOB], NULL, 10);
    pthread_mutex_lock(&slurm->lock);
    for (struct rn_place *place = slurm->places; place != NULL; place = place->next) {
        if (job <= 0 || place->job != job) continue;
        place->asked = false;
        snprintf(place->state, sizeof place->state, "%.23s", columns[COLUMN_STATE]);
        snprintf(place->reason, sizeof place->reason, "%.127s", columns[COLUMN_REASON]);
        if (columns[COLUMN_NODES][0] != '\0')
            snprintf(place->machine, sizeof place->machine, "%.63s", columns[COLUMN_NODES]);
        read_exit(place, columns[COLUMN_EXIT]);
        place->over = is_over(place->state);
    }
    pthread_mutex_unlock(&slurm->lock);
}

// What Slurm has forgotten ended long ago.
static void forget(struct rn_slurm *slurm) {
    for (struct rn_place *place = slurm->places; place != NULL; place = place->next) {
        if (!place->asked) continue;
        place->over = true;
        snprintf(place->state, sizeof place->state, "UNKNOWN");
    }
}

static void ask(struct rn_slurm *slurm) {
    struct rn_error err = {0};
    char user[32];
    snprintf(user, sizeof user, "--user=%u", (unsigned)geteuid());
    const char *const words[] = {"--noheader", "--states=all", user, "--Format=" COLUMNS, NULL};
    for (struct rn_place *place = slurm->places; place != NULL; place = place->next)
        place->asked = place->job > 0 && !place->over;
    pthread_mutex_unlock(&slurm->lock);
    enum rn_status status = run(slurm, "squeue", words, learn, NULL, &err);
    pthread_mutex_lock(&slurm->lock);
    if (status == RN_OK)
        forget(slurm);
    else
        rn_log(RN_LOG_WARN, "squeue: %s: %s", err.where, err.text);
}

// ---- cancelling ---------------------------------------------------------------------------------

static bool cancel(struct rn_slurm *slurm, struct rn_place *place) {
    struct rn_error err = {0};
    char job[24];
    snprintf(job, sizeof job, "%" PRId64, place->job);
    const char *const words[] = {"--quiet", job, NULL};
    pthread_mutex_unlock(&slurm->lock);
    enum rn_status status = run(slurm, "scancel", words, NULL, NULL, &err);
    pthread_mutex_lock(&slurm->lock);
    // One that is over already is refused.
    if (status == RN_OK || !is_passing(&err)) return true;
    place->not_before_ns = rn_clock_ns() + RETRY_NS;
    rn_log(RN_LOG_WARN, "Slurm job %s is not cancelled yet: %s", job, err.text);
    return false;
}

static void drop(struct rn_slurm *slurm, struct rn_place *place) {
    struct rn_place **link = &slurm->places;
    while (*link != place)
        link = &(*link)->next;
    *link = place->next;
    rn_place_free(place);
}

// ---- the loop -----------------------------------------------------------------------------------

static void give_up_spares(struct rn_slurm *slurm, int64_t now_ns) {
    if (now_ns < slurm->spares_until_ns) return;
    for (struct rn_place *place = slurm->places; place != NULL; place = place->next) {
        if (!place->spare) continue;
        place->spare = false;
        place->given_up = true;
        rn_place_fence(slurm, place);
    }
}

// Does one thing that is due; false when nothing is.
static bool do_one(struct rn_slurm *slurm, int64_t now_ns) {
    for (struct rn_place *place = slurm->places; place != NULL; place = place->next) {
        if (now_ns < place->not_before_ns) continue;
        if (place->given_up) {
            if (place->job == 0 || place->over || cancel(slurm, place)) drop(slurm, place);
            return true;
        }
        if (place->job == 0 && place->refusal.status == RN_OK) {
            submit(slurm, place);
            return true;
        }
    }
    return false;
}

// How long until Slurm is asked again; 0: there is nothing to ask about.
static int64_t ask_interval(const struct rn_slurm *slurm) {
    int64_t interval_ns = 0;
    for (const struct rn_place *place = slurm->places; place != NULL; place = place->next) {
        if (place->job == 0 || place->over || place->given_up) continue;
        if (!place->joined) return ASK_SOON_NS;
        interval_ns = place->hung_up ? ASK_SOON_NS : ASK_NS;
        if (place->hung_up) return interval_ns;
    }
    return interval_ns;
}

static void wait_for_work(struct rn_slurm *slurm) {
    struct timespec until;
    clock_gettime(CLOCK_MONOTONIC, &until);
    until.tv_nsec += 200000000;
    if (until.tv_nsec >= SECOND_NS) {
        until.tv_sec++;
        until.tv_nsec -= SECOND_NS;
    }
    if (slurm->places != NULL)
        pthread_cond_timedwait(&slurm->work, &slurm->lock, &until);
    else
        pthread_cond_wait(&slurm->work, &slurm->lock);
}

void *rn_clerk_serve(void *context) {
    struct rn_slurm *slurm = context;
    int64_t asked_ns = 0;
    pthread_mutex_lock(&slurm->lock);
    while (!slurm->quit) {
        int64_t now_ns = rn_clock_ns();
        give_up_spares(slurm, now_ns);
        bool did = do_one(slurm, now_ns);
        int64_t interval_ns = ask_interval(slurm);
        if (!slurm->quit && interval_ns > 0 && now_ns - asked_ns > interval_ns) {
            asked_ns = now_ns;
            ask(slurm);
            did = true;
        }
        if (did) {
            pthread_mutex_unlock(&slurm->lock);
            rn_slurm_tell(slurm);
            pthread_mutex_lock(&slurm->lock);
        } else {
            wait_for_work(slurm);
        }
    }
    pthread_mutex_unlock(&slurm->lock);
    return NULL;
}

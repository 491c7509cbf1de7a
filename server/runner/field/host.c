#include "server/runner/field/host.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/log.h"
#include "common/base/manifest.h"
#include "common/base/seal.h"
#include "common/image/lpips.h"
#include "server/runner/field/budget.h"
#include "server/runner/sandbox/sandbox.h"
#include "server/runner/scene/checkpoints.h"
#include "server/runner/scene/describe.h"
#include "server/runner/scene/lock.h"

// ---- memory of a GPU -----------------------------------------------------------------------

enum { GRANT_POLL_US = 1000 };

// Whether the grant with this number has arrived; those of reserves that were given up are dropped.
static bool take_grant(struct rn_host *host, int64_t number, size_t *ret_bytes) {
    struct rn_letter letter;
    while (rn_link_take_type(&host->link, RN_WIRE_GRANT, &letter)) {
        struct rn_wire_grant grant = {.number = -1};
        bool taken = rn_wire_take(&letter.message, &grant, NULL) == RN_OK;
        rn_wire_message_finish(&letter.message);
        if (!taken || grant.number != number) continue;
        *ret_bytes = (size_t)grant.bytes;
        return true;
    }
    return false;
}

// The daemon knows what other runners hold. As rn_engine_share wants it; `context`: the host.
static enum rn_status share_device(void *context, const struct rn_device_wish *wish,
                                   size_t *ret_granted, struct rn_error *err) {
    struct rn_host *host = context;
    struct rn_wire_reserve reserve = {.number = ++host->reserves,
                                      .bytes = (int64_t)wish->bytes,
                                      .free_bytes = (int64_t)wish->free_bytes,
                                      .patient = wish->patient};
    snprintf(reserve.device, sizeof reserve.device, "%s", wish->device);
    rn_link_post(&host->link, RN_WIRE_RESERVE, &reserve, NULL, 0);
    while (wish->bytes > 0 && !take_grant(host, reserve.number, ret_granted)) {
        rn_link_pump(&host->link, 0);
        if (host->watch ? !rn_watch_keep_going(host->watch) : rn_link_must_stop(&host->link))
            return rn_error_set(err, RN_ERROR_CANCELLED, "device",
                                "cancelled while it waited for a GPU's memory");
        usleep(GRANT_POLL_US);
    }
    return RN_OK;
}

// ---- turns ---------------------------------------------------------------------------------

// Whether what trains is to stop here. `context`: the host.
static bool is_wanted(void *context) {
    struct rn_host *host = context;
    enum rn_turn turn = rn_turns_at(&host->turns, rn_clock_ns());
    return turn == RN_TURN_WAITS || (turn == RN_TURN_FREE && rn_link_has_news(&host->link));
}

// Until so much later, or until something arrives.
static void stand_still(struct rn_host *host, int64_t now_ns, int64_t left_ns) {
    rn_link_pump(&host->link, (int)(left_ns / 1000000) + 1);
    rn_training_yielded(host, (double)(rn_clock_ns() - now_ns) * 1e-9);
}

// What trains stands still until its next turn; false: it is its turn.
static bool stands_still(struct rn_host *host) {
    int64_t now_ns = rn_clock_ns(), left_ns = rn_turns_next_ns(&host->turns, now_ns) - now_ns;
    if (rn_turns_at(&host->turns, now_ns) != RN_TURN_WAITS) return false;
    stand_still(host, now_ns, left_ns);
    return true;
}

// The same of a job's next picture, which is not cut short.
static bool rests(struct rn_host *host) {
    int64_t now_ns = rn_clock_ns(), left_ns = rn_turns_rest_ns(&host->turns, now_ns);
    if (left_ns == 0) return false;
    stand_still(host, now_ns, left_ns);
    return true;
}

// ---- what jobs and renders need ------------------------------------------------------------

enum rn_status rn_host_need_engine(struct rn_host *host, const char *device, const char *kernels,
                                   int threads, struct rn_error *err) {
    if (host->engine && strcmp(host->engine_device, device) == 0 &&
        strcmp(host->engine_kernels, kernels) == 0 && host->engine_options.threads == threads)
        return RN_OK;
    if (host->training)
        return rn_error_set(err, RN_ERROR_CONFLICT, "device",
                            "the engine is training; its device cannot be changed");
    if (host->loaded) rn_field_destroy(&host->loaded);
    if (host->marked) rn_field_destroy(&host->marked);
    if (host->engine) rn_engine_destroy(&host->engine);
    snprintf(host->engine_device, sizeof host->engine_device, "%s", device);
    snprintf(host->engine_kernels, sizeof host->engine_kernels, "%s", kernels);
    host->engine_options =
        (struct rn_engine_options){.device = *device ? host->engine_device : NULL,
                                   .kernels = *kernels ? host->engine_kernels : NULL,
                                   .threads = threads,
                                   .deterministic = host->place.gpu_deterministic};
    enum rn_status status = rn_engine_create(&host->engine_options, &host->engine, err);
    if (status) return status;
    struct rn_device_info about;
    rn_engine_describe(host->engine, &about);
    if (*about.checked) rn_log(RN_LOG_INFO, "device: %s", about.checked);
    rn_engine_yield_to(host->engine, is_wanted, host);
    rn_engine_share(host->engine, share_device, host);
    if (!host->exchange) rn_engine_keep_in(host->engine, host->place.scene_folder);
    return RN_OK;
}

enum rn_status rn_host_need_dataset(struct rn_host *host, struct rn_error *err) {
    if (!*host->place.dataset_folder)
        return rn_error_set(err, RN_ERROR_CONFLICT, "#/scene",
                            "its photographs are not here: it was imported without a dataset; "
                            "give a camera, or import it again with the dataset's name");
    return host->dataset ? RN_OK
                         : rn_dataset_read_whole(host->place.dataset_folder, &host->dataset, err);
}

static bool check_goes_on(void *context) {
    struct rn_host *host = context;
    if (host->watch) return rn_watch_keep_going(host->watch);
    rn_link_pump(&host->link, 0);
    return !rn_link_must_stop(&host->link);
}

enum rn_status rn_host_need_sound_dataset(struct rn_host *host, struct rn_error *err) {
    struct rn_error why = {0};
    enum rn_status status = RN_OK;
    if (!host->dataset_is_sound && *host->place.dataset_folder)
        status = rn_manifest_check(host->place.dataset_folder, check_goes_on, host, &why);
    if (status == RN_ERROR_CORRUPT)
        return rn_error_set(err, status, why.where, "%.300s; import the dataset again", why.text);
    if (status && status != RN_ERROR_NOT_FOUND) { // imported before there were lists
        if (err) *err = why;
        return status;
    }
    host->dataset_is_sound = true;
    return rn_host_need_dataset(host, err);
}

// The engine as it is, or as `open` wanted it.
static enum rn_status need_any_engine(struct rn_host *host, struct rn_error *err) {
    if (host->engine) return RN_OK;
    return rn_host_need_engine(host, host->place.device, host->place.kernels,
                               (int)rn_int_or(host->place.threads, 0), err);
}

enum rn_status rn_host_load(struct rn_host *host, struct rn_error *err) {
    if (host->loaded) return RN_OK;
    enum rn_status status = need_any_engine(host, err);
    while (!status) {
        int64_t step;
        char path[PATH_MAX];
        status = rn_checkpoints_newest(host->place.scene_folder, INT64_MAX, &step, err);
        if (!status) status = rn_checkpoint_path(host->place.scene_folder, step, path, err);
        if (status) break;
        status = rn_seal_check(path, host->digest, err);
        if (!status) status = rn_field_load(host->engine, path, &host->loaded, err);
        if (!rn_checkpoint_is_damaged(status, err, path)) break;
        rn_checkpoint_set_aside(host->place.scene_folder, step, err, host->set_aside);
        status = RN_OK;
    }
    return status;
}

enum rn_status rn_host_field(struct rn_host *host, struct rn_field **ret_field,
                             struct rn_error *err) {
    struct rn_field *field = host->training ? rn_training_field(host->training) : host->loaded;
    if (!field)
        return rn_error_set(err, RN_ERROR_CONFLICT, "scene",
                            "the scene has no parameters yet; wait until its training has begun");
    *ret_field = field;
    return RN_OK;
}

static enum rn_status load_mark(struct rn_host *host, const struct rn_mark *mark,
                                struct rn_field **ret_field, struct rn_error *err) {
    char path[PATH_MAX], digest[65];
    if (!host->marked || host->mark.step != mark->step) {
        if (host->marked) rn_field_destroy(&host->marked);
        enum rn_status status = rn_mark_path(host->place.scene_folder, mark, path, err);
        if (!status) status = rn_seal_check(path, digest, err);
        if (!status) status = rn_field_load(host->engine, path, &host->marked, err);
        if (status) return status;
        host->mark = *mark;
    }
    *ret_field = host->marked;
    return RN_OK;
}

enum rn_status rn_host_field_at(struct rn_host *host, double at, struct rn_field **ret_field,
                                struct rn_error *err) {
    struct rn_mark marks[RN_MARKS_KEPT + 1];
    struct rn_field_info now;
    size_t count, nearest;
    enum rn_status status = rn_host_field(host, ret_field, err);
    if (status || isnan(at)) return status;
    rn_field_describe(*ret_field, &now);
    count = rn_marks_list(host->place.scene_folder, marks);
    marks[count] = (struct rn_mark){.train_seconds = now.train_seconds, .step = now.steps};
    status = rn_mark_nearest(marks, count + 1, at, &nearest, err);
    if (status || nearest == count) return status;
    return load_mark(host, &marks[nearest], ret_field, err);
}

// ---- open ----------------------------------------------------------------------------------

static void post_opened(struct rn_host *host) {
    struct rn_wire_opened opened = {.loaded = host->loaded != NULL, .psnr = NAN, .memory_bytes = 0};
    if (host->loaded) {
        struct rn_field_info info;
        rn_field_describe(host->loaded, &info);
        opened.steps = info.steps;
        opened.train_seconds = info.train_seconds;
        opened.psnr = info.psnr;
        opened.memory_bytes = rn_resident_bytes();
        memcpy(opened.digest, host->digest, sizeof opened.digest);
        memcpy(opened.set_aside, host->set_aside, sizeof opened.set_aside);
        rn_field_sha256(host->loaded, opened.parameters_sha256);
    }
    rn_link_post(&host->link, RN_WIRE_OPENED, &opened, NULL, 0);
}

// The weights of LPIPS, while files that are no scene's can still be opened.
static void take_lpips(struct rn_host *host) {
    const char *path = getenv(RN_LPIPS_VARIABLE);
    struct rn_error err = {0};
    if (path && *path && rn_lpips_open(path, &host->lpips, &err) != RN_OK)
        rn_log(RN_LOG_WARN, "%s: %s; LPIPS is not told", err.where, err.text);
}

static void confine(const struct rn_host *host) {
    const struct rn_wire_open *place = &host->place;
    const char *dataset = *place->dataset_folder ? place->dataset_folder : NULL;
    const struct rn_sandbox_places places = {
        .paths = {[RN_PLACE_DATASET] = dataset, [RN_PLACE_SCENE] = place->scene_folder}};
    (void)rn_sandbox_confine(host->link.profile, &places); // it says so itself
}

// What two versions make of the same request may differ.
static enum rn_status check_version(const struct rn_wire_open *open, struct rn_error *err) {
    if (open->version[0] == '\0' || (strcmp(open->version, RIPNERF_VERSION) == 0 &&
                                     rn_int_or(open->protocol, 0) == RN_WIRE_PROTOCOL))
        return RN_OK;
    return rn_error_set(err, RN_ERROR_UNSUPPORTED, "version",
                        "the daemon is version %s (protocol %lld), this runner %s (protocol %d): "
                        "install the same",
                        open->version, (long long)rn_int_or(open->protocol, 0), RIPNERF_VERSION,
                        RN_WIRE_PROTOCOL);
}

static enum rn_status enter_scene(struct rn_host *host, struct rn_error *err) {
    const struct rn_wire_open *place = &host->place;
    enum rn_status status = check_version(place, err);
    if (!status && !place->helps) {
        status = rn_mkdir(place->scene_folder, 0777, err);
        if (!status) status = rn_lock_scene(place->scene_folder, &host->link, &host->lock_fd, err);
    }
    if (!status) take_lpips(host);
    if (!status && host->link.profile) confine(host);
    if (!status && !place->helps) status = rn_checkpoints_prepare(place->scene_folder, err);
    if (!status && place->load) status = rn_host_load(host, err);
    return status;
}

static void handle_open(struct rn_host *host, struct rn_wire_open *open, int64_t arrived_ns) {
    struct rn_error err = {0};
    enum rn_status status = RN_OK;
    if (host->opened) {
        status = rn_error_set(&err, RN_ERROR_CONFLICT, "open", "a scene is open already");
        rn_message_finish(rn_wire_table(RN_WIRE_OPEN), open);
    } else {
        host->place = *open; // with its texts
        host->opened = true;
        if (open->clock_ns != RN_ABSENT) host->clock_ns = arrived_ns - open->clock_ns;
        status = enter_scene(host, &err);
    }
    if (status)
        rn_link_fail(&host->link, "", RN_ABSENT, &err);
    else
        post_opened(host);
}

// ---- messages ------------------------------------------------------------------------------

// A message, decoded: the union of what field mode takes.
union request {
    struct rn_wire_open open;
    struct rn_wire_train train;
    struct rn_wire_path path;
    struct rn_wire_eval eval;
    struct rn_wire_curve curve;
    struct rn_wire_effects effects;
    struct rn_wire_doctor doctor;
    struct rn_wire_export export;
    struct rn_wire_job job;
    struct rn_wire_cancel cancel;
    struct rn_wire_render render;
    struct rn_wire_grant grant;
};

static void refuse(struct rn_host *host, const char *job, int64_t request, const char *text) {
    struct rn_error err;
    rn_error_set(&err, RN_ERROR_CONFLICT, "", "%s", text);
    rn_link_fail(&host->link, job, request, &err);
}

// pause, resume, finish: a training job's. A job that has just ended is no error.
static void handle_control(struct rn_host *host, int type, const char *job) {
    if (!rn_training_is(host, job)) {
        rn_log(RN_LOG_INFO, "%s of %s: no such training job", rn_wire_type_name(type), job);
        return;
    }
    if (type == RN_WIRE_PAUSE) rn_training_pause(host);
    if (type == RN_WIRE_RESUME) rn_training_resume(host);
    if (type == RN_WIRE_FINISH) rn_training_finish(host);
}

static void handle_cancel(struct rn_host *host, const struct rn_wire_cancel *cancel) {
    if (rn_training_is(host, cancel->job))
        rn_training_cancel(host);
    else if (!rn_work_cancel(host, cancel->job) &&
             !rn_calibration_cancel(host, cancel->job)) // also of a render that has been answered
        rn_log(RN_LOG_DEBUG, "cancel of what has ended");
}

// Nanoseconds that it took.
static int64_t serve(struct rn_host *host, struct rn_wire_render *render, int64_t arrived_ns) {
    int64_t begin_ns = rn_clock_ns();
    if (render->deadline_ns != RN_ABSENT) render->deadline_ns += host->clock_ns;
    rn_picture_serve(host, render, arrived_ns);
    int64_t end_ns = rn_clock_ns();
    rn_turns_end(&host->turns, begin_ns, end_ns, (int64_t)(RN_SLICE_MS * 1e6));
    return end_ns - begin_ns;
}

static void handle_render(struct rn_host *host, struct rn_wire_render *render, int64_t arrived_ns) {
    rn_training_yielded(host, (double)serve(host, render, arrived_ns) * 1e-9);
}

// The job that a message is about; "": none.
static const char *job_of(int type, const union request *request) {
    bool none = type == RN_WIRE_OPEN || type == RN_WIRE_RENDER || type == RN_WIRE_GRANT ||
                type == RN_WIRE_REST;
    return none ? "" : request->job.job; // where all of the others have it
}

static void dispatch(struct rn_host *host, const struct rn_letter *letter, union request *request) {
    switch ((enum rn_wire_type)letter->message.type) {
    case RN_WIRE_TRAIN:
        if (host->training)
            refuse(host, request->train.job, RN_ABSENT, "the scene is training already");
        else
            rn_training_start(host, &request->train);
        break;
    case RN_WIRE_ESTIMATE:
        if (host->training || host->calibrating)
            refuse(host, request->train.job, RN_ABSENT, "the runner trains already");
        else
            rn_calibration_start(host, &request->train);
        break;
    case RN_WIRE_PATH:
        rn_work_add_path(host, &request->path);
        break;
    case RN_WIRE_EVAL:
        rn_work_add_eval(host, &request->eval);
        break;
    case RN_WIRE_CURVE:
        rn_work_add_curve(host, &request->curve);
        break;
    case RN_WIRE_EFFECTS:
        rn_work_add_effects(host, &request->effects);
        break;
    case RN_WIRE_DOCTOR:
        rn_work_add_doctor(host, &request->doctor);
        break;
    case RN_WIRE_EXPORT:
        rn_work_add_export(host, &request->export);
        break;
    case RN_WIRE_PAUSE:
    case RN_WIRE_RESUME:
    case RN_WIRE_FINISH:
        handle_control(host, letter->message.type, request->job.job);
        break;
    case RN_WIRE_CANCEL:
        handle_cancel(host, &request->cancel);
        break;
    case RN_WIRE_RENDER:
        handle_render(host, &request->render, letter->arrived_ns);
        break;
    case RN_WIRE_GRANT: // of a reserve that was given up
        break;
    case RN_WIRE_REST:
        if (host->loaded) rn_field_rest(host->loaded);
        if (host->marked) rn_field_destroy(&host->marked);
        break;
    default:
        rn_log(RN_LOG_WARN, "a %s message is not for this mode",
               rn_wire_type_name(letter->message.type));
        break;
    }
}

static void handle(struct rn_host *host, struct rn_letter *letter) {
    union request request;
    struct rn_error err = {0};
    int type = letter->message.type;
    if (type >= RN_WIRE_HELLO || type == RN_WIRE_INGEST ||
        rn_wire_take(&letter->message, &request, &err)) {
        rn_log(RN_LOG_ERROR, "a message that cannot be read (%s): %s %s", rn_wire_type_name(type),
               err.where, err.text);
        host->link.closed = true; // the two programs do not fit together
        return;
    }
    if (type == RN_WIRE_OPEN) {
        handle_open(host, &request.open, letter->arrived_ns);
        return;
    }
    rn_link_log_of(&host->link, job_of(type, &request));
    if (host->opened)
        dispatch(host, letter, &request);
    else
        rn_log(RN_LOG_WARN, "%s before open", rn_wire_type_name(type));
    rn_message_finish(rn_wire_table(type), &request);
}

void rn_host_serve_render(struct rn_host *host) {
    struct rn_letter letter;
    struct rn_wire_render render;
    if (!rn_link_take_type(&host->link, RN_WIRE_RENDER, &letter)) return;
    const char *before = rn_log_set_trace(NULL);
    if (rn_wire_take(&letter.message, &render, NULL) == RN_OK) {
        host->lent_ns += serve(host, &render, letter.arrived_ns);
        rn_message_finish(rn_wire_table(RN_WIRE_RENDER), &render);
    }
    rn_wire_message_finish(&letter.message);
    rn_log_set_trace(before);
}

// Handles what has arrived, up to and including one render, so that training goes on between
// renders. false: the end was asked for.
static bool handle_letters(struct rn_host *host) {
    struct rn_letter letter;
    int type = 0;
    while (type != RN_WIRE_RENDER && !host->link.closed && rn_link_take(&host->link, &letter)) {
        type = letter.message.type;
        if (type != RN_WIRE_SHUTDOWN) handle(host, &letter);
        rn_wire_message_finish(&letter.message);
        if (type == RN_WIRE_SHUTDOWN) return false;
    }
    return true;
}

// ---- the loop ------------------------------------------------------------------------------

// Path and evaluation jobs go first, and a training waits: so all of their pictures show one step.
static void do_some_work(struct rn_host *host) {
    if (host->works && !rn_training_is_ending(host)) {
        if (rests(host)) return;
        int64_t begin_ns = rn_clock_ns(), lent_ns = host->lent_ns;
        rn_work_unit(host);
        int64_t end_ns = rn_clock_ns(), spent_ns = end_ns - begin_ns;
        rn_turns_worked(&host->turns, spent_ns - (host->lent_ns - lent_ns), end_ns);
        rn_training_yielded(host, (double)spent_ns * 1e-9);
    } else if (stands_still(host)) {
        return;
    } else if (rn_training_is_busy(host)) {
        rn_training_slice(host);
    } else if (host->calibrating) {
        rn_calibration_slice(host);
    }
}

static void finish(struct rn_host *host) {
    rn_work_drop_all(host);
    rn_training_drop(host);
    rn_calibration_drop(host);
    rn_pace_finish(&host->pace);
    if (host->loaded) rn_field_destroy(&host->loaded);
    if (host->marked) rn_field_destroy(&host->marked);
    rn_lpips_close(&host->lpips);
    if (host->dataset) rn_dataset_destroy(&host->dataset);
    if (host->engine) rn_engine_destroy(&host->engine);
    if (host->opened) rn_message_finish(rn_wire_table(RN_WIRE_OPEN), &host->place);
    if (host->lock_fd >= 0) close(host->lock_fd);
    rn_link_finish(&host->link);
}

int rn_host_run(int fd, const struct rn_profile *profile, const struct rn_exchange *exchange,
                bool *ret_told) {
    struct rn_host host = {.lock_fd = -1, .exchange = exchange};
    rn_link_init(&host.link, fd);
    host.link.profile = profile;
    struct rn_wire_hello hello = {
        .version = RIPNERF_VERSION, .protocol = RN_WIRE_PROTOCOL, .mode = "field", .pid = getpid()};
    rn_link_post(&host.link, RN_WIRE_HELLO, &hello, NULL, 0);
    bool go_on = true;
    while (go_on && !host.link.closed) {
        bool busy = host.works || host.calibrating || rn_training_is_busy(&host);
        rn_link_pump(&host.link, busy ? 0 : -1);
        go_on = handle_letters(&host);
        if (go_on && !host.link.closed) do_some_work(&host);
    }
    rn_training_save(&host); // also when the daemon has died
    *ret_told = !go_on;
    finish(&host);
    return 0;
}

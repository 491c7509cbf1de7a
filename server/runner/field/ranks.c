#include "server/runner/field/ranks.h"

#include <signal.h>
#include <stdio.h>
#include <string.h>

#include "common/base/log.h"
#include "server/runner/sandbox/sandbox.h"

// What rank 0 makes, for the others to make alike. Plain value: they run the same program.
struct errand {
    bool parts;                                                    // there is nothing more to make
    char dataset[PATH_MAX], scene[PATH_MAX], checkpoint[PATH_MAX]; // the last: "" = anew
    char kernels[32];
    int threads;
    size_t memory_limit_bytes;
    struct rn_train_config config;
};

// ---- rank 0 ----------------------------------------------------------------------------------

static void send_errand(const struct rn_host *host, const struct rn_train_config *config,
                        const char *path) {
    struct errand errand;
    struct rn_device_info device;
    memset(&errand, 0, sizeof errand);
    rn_engine_describe(host->engine, &device);
    snprintf(errand.dataset, sizeof errand.dataset, "%s", host->place.dataset_folder);
    snprintf(errand.scene, sizeof errand.scene, "%s", host->place.scene_folder);
    snprintf(errand.checkpoint, sizeof errand.checkpoint, "%s", path ? path : "");
    snprintf(errand.kernels, sizeof errand.kernels, "%s", device.kernels);
    errand.threads = host->engine_options.threads;
    errand.memory_limit_bytes = (size_t)rn_int_or(host->place.memory_limit_bytes, 0);
    if (!path) errand.config = *config;
    host->exchange->broadcast(&errand, sizeof errand);
}

enum rn_status rn_ranks_make_trainer(struct rn_host *host, const struct rn_train_config *config,
                                     const char *path, struct rn_trainer **ret_trainer,
                                     struct rn_error *err) {
    size_t limit = (size_t)rn_int_or(host->place.memory_limit_bytes, 0);
    if (host->exchange) send_errand(host, config, path);
    rn_engine_join(host->engine, host->exchange);
    enum rn_status status =
        path ? rn_trainer_restore(host->engine, host->dataset, path, limit, ret_trainer, err)
             : rn_trainer_create(host->engine, host->dataset, config, limit, ret_trainer, err);
    rn_engine_join(host->engine, NULL);
    if (status && host->exchange) rn_trainer_dismiss(host->exchange);
    return status;
}

void rn_ranks_part(const struct rn_exchange *exchange) {
    struct errand errand;
    memset(&errand, 0, sizeof errand);
    errand.parts = true;
    exchange->broadcast(&errand, sizeof errand);
    exchange->leave();
}

// ---- the others ------------------------------------------------------------------------------

// Returns when rank 0's training is over, or could not be begun.
static enum rn_status do_errand(const struct rn_exchange *exchange, const struct errand *errand,
                                struct rn_error *err) {
    const struct rn_engine_options options = {
        .device = "cpu", .kernels = errand->kernels, .threads = errand->threads};
    struct rn_dataset *dataset = NULL;
    struct rn_engine *engine = NULL;
    struct rn_trainer *trainer = NULL;
    enum rn_status status = rn_dataset_read_whole(errand->dataset, &dataset, err);
    if (!status) status = rn_engine_create(&options, &engine, err);
    if (!status) {
        rn_engine_join(engine, exchange);
        status = *errand->checkpoint ? rn_trainer_restore(engine, dataset, errand->checkpoint,
                                                          errand->memory_limit_bytes, &trainer, err)
                                     : rn_trainer_create(engine, dataset, &errand->config,
                                                         errand->memory_limit_bytes, &trainer, err);
    }
    if (!status) status = rn_trainer_follow(trainer, err);
    rn_trainer_destroy(&trainer);
    if (engine) rn_engine_destroy(&engine);
    if (dataset) rn_dataset_destroy(&dataset);
    return status;
}

int rn_ranks_run(const struct rn_exchange *exchange, const struct rn_profile *profile) {
    struct errand errand;
    struct rn_error err = {0};
    bool confined = false;
    signal(SIGTERM, SIG_IGN); // rank 0 saves, and parts
    signal(SIGUSR1, SIG_IGN);
    if (profile) rn_sandbox_begin(profile);
    for (;;) {
        exchange->broadcast(&errand, sizeof errand);
        if (errand.parts) break;
        const struct rn_sandbox_places places = {
            .paths = {[RN_PLACE_DATASET] = errand.dataset, [RN_PLACE_SCENE] = errand.scene}};
        if (profile && !confined) confined = rn_sandbox_confine(profile, &places);
        if (do_errand(exchange, &errand, &err)) {
            rn_log(RN_LOG_ERROR, "rank %d: %s: %s", exchange->rank, err.where, err.text);
            exchange->abandon();
        }
    }
    exchange->leave();
    return 0;
}

#include "server/runner/tools/needs.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/image/lpips.h"
#include "server/runner/sandbox/sandbox.h"
#include "server/runner/scene/checkpoints.h"
#include "server/runner/scene/describe.h"

#define OWN_BYTES (96u << 20)  // of the process, its threads and messages
#define LPIPS_BYTES (1u << 30) // of its networks, on a large photograph
#define PIXEL_BYTES 32         // of a photograph that is decoded, or a picture that is made
#define SPARE_PART 8           // of it all, for what is not counted

// Decoded by each thread, or rendered.
static size_t picture_bytes(const struct rn_dataset *dataset, int threads) {
    size_t most = 0;
    for (size_t i = 0; i < dataset->frame_count; i++) {
        const struct rn_camera *camera = &dataset->frames[i].camera;
        size_t pixels = (size_t)camera->width * (size_t)camera->height;
        if (pixels > most) most = pixels;
    }
    return most * PIXEL_BYTES * (size_t)threads;
}

static enum rn_status field_bytes(const char *scene, size_t *ret_bytes, struct rn_error *err) {
    int64_t step;
    char path[PATH_MAX];
    enum rn_status status = rn_checkpoints_newest(scene, INT64_MAX, &step, err);
    if (!status) status = rn_checkpoint_path(scene, step, path, err);
    if (!status) status = rn_field_need(path, ret_bytes, err);
    if (status == RN_ERROR_NOT_FOUND) *ret_bytes = 0;
    return status == RN_ERROR_NOT_FOUND ? RN_OK : status;
}

static enum rn_status training_bytes(struct rn_engine *engine, const struct rn_dataset *dataset,
                                     const char *scene, const struct rn_train_options *options,
                                     size_t *ret_bytes, struct rn_error *err) {
    struct rn_train_config config;
    bool alone = rn_int_or(options->ranks, 1) == 1;
    enum rn_status status = rn_configure(options, dataset->scale_count > 1, &config, err);
    rn_engine_keep_in(engine, alone ? scene : NULL); // as the runner does
    if (!status) status = rn_train_need(engine, dataset, &config, ret_bytes, err);
    return status;
}

static int count_gpus(const struct rn_train_options *options) {
    if (strncmp(options->device, "cuda", 4) == 0) return 1;
    return strcmp(options->device, "cpu") == 0 ? 0 : -1;
}

static enum rn_status add_up(const struct rn_runner_needs *asked,
                             const struct rn_train_options *options, size_t *ret_bytes,
                             struct rn_error *err) {
    struct rn_dataset *dataset = NULL;
    struct rn_engine *engine = NULL;
    struct rn_device_info device;
    const struct rn_engine_options wanted = {
        .device = "cpu", .threads = (int)rn_int_or(options->threads, asked->threads)};
    size_t field = 0, training = 0;
    const char *lpips = getenv(RN_LPIPS_VARIABLE);
    enum rn_status status = rn_dataset_read_whole(asked->dataset, &dataset, err);
    if (!status) status = rn_engine_create(&wanted, &engine, err);
    if (!status) status = field_bytes(asked->scene, &field, err);
    if (!status && asked->train)
        status = training_bytes(engine, dataset, asked->scene, options, &training, err);
    if (!status) {
        rn_engine_describe(engine, &device);
        size_t bytes = OWN_BYTES + (lpips && *lpips ? LPIPS_BYTES : 0) +
                       picture_bytes(dataset, device.threads) +
                       (training > field ? training : field);
        *ret_bytes = bytes + bytes / SPARE_PART;
    }
    if (engine) rn_engine_destroy(&engine);
    if (dataset) rn_dataset_destroy(&dataset);
    return status;
}

int rn_runner_needs(const struct rn_runner_needs *asked) {
    struct rn_train_options options;
    struct rn_error err = {0};
    size_t bytes = 0;
    const char *json = asked->train ? asked->train : "{}";
    const struct rn_profile *profile = rn_profile_of("needs");
    const struct rn_sandbox_places places = {
        .paths = {[RN_PLACE_DATASET] = asked->dataset, [RN_PLACE_SCENE] = asked->scene}};
    if (asked->sandbox) {
        rn_sandbox_begin(profile);
        (void)rn_sandbox_confine(profile, &places); // it says so itself
    }
    enum rn_status status =
        rn_decode(&rn_train_options_table, json, strlen(json), &options, NULL, &err);
    if (!status) status = add_up(asked, &options, &bytes, &err);
    if (status) {
        fprintf(stderr, "needs: %s: %s\n", err.where, err.text);
        return 1;
    }
    printf("memory_bytes %zu gpus %d\n", bytes, count_gpus(&options));
    rn_message_finish(&rn_train_options_table, &options);
    return 0;
}

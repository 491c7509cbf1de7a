#include "server/runner/ingest/adopt.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/file.h"
#include "common/base/seal.h"
#include "server/runner/scene/checkpoints.h"
#include "server/runner/scene/describe.h"

static enum rn_status load(const struct rn_wire_ingest *order, struct rn_engine **ret_engine,
                           struct rn_field **ret_field, struct rn_error *err) {
    const struct rn_engine_options options = {.device = "cpu",
                                              .threads = (int)rn_int_or(order->threads, 0)};
    struct rn_field_info info;
    enum rn_status status = rn_engine_create(&options, ret_engine, err);
    if (!status) status = rn_field_load(*ret_engine, order->source, ret_field, err);
    if (status) return status;
    rn_field_describe(*ret_field, &info);
    if (info.viewing.bits) return RN_OK;
    return rn_error_set(err, RN_ERROR_INVALID, order->source,
                        "is a checkpoint of a training; export the scene for viewing instead "
                        "(ripnerf export SCENE --as scene)");
}

static enum rn_status copy(const struct rn_wire_ingest *order, int64_t step, int64_t *ret_bytes,
                           struct rn_error *err) {
    char path[PATH_MAX];
    uint8_t *bytes = NULL;
    size_t size = 0;
    enum rn_status status = rn_mkdir(order->target, 0777, err);
    if (!status) status = rn_checkpoints_prepare(order->target, err);
    if (!status) status = rn_checkpoint_path(order->target, step, path, err);
    if (!status) status = rn_file_read(order->source, (size_t)order->max_bytes, &bytes, &size, err);
    if (!status) status = rn_file_write_atomic(path, bytes, size, err);
    free(bytes);
    *ret_bytes = (int64_t)size;
    return status;
}

static enum rn_status describe(const struct rn_wire_ingest *order, const struct rn_field *field,
                               struct rn_wire_checkpoint *taken, char **ret_json,
                               struct rn_error *err) {
    struct rn_field_info info;
    rn_field_describe(field, &info);
    memcpy(taken->job, order->job, sizeof taken->job);
    taken->step = info.steps;
    taken->train_seconds = info.train_seconds;
    taken->psnr = info.psnr;
    rn_checkpoint_name(info.steps, taken->file);
    rn_field_sha256(field, taken->parameters_sha256);
    enum rn_status status = copy(order, info.steps, &taken->size_bytes, err);
    if (!status) status = rn_describe_scene(&info, NULL, &taken->scene, err);
    if (!status) status = rn_encode(rn_wire_table(RN_WIRE_CHECKPOINT), taken, ret_json, NULL, err);
    return status;
}

// What is said of a checkpoint, as its sender can use it.
static void tell_of_file(const struct rn_wire_ingest *order, struct rn_error *err) {
    char *advice = strstr(err->text, "; use an older checkpoint");
    if (advice) strcpy(advice, "; export it again");
    if (strcmp(err->where, order->source) == 0)
        snprintf(err->where, sizeof err->where, "%s", "the file");
}

enum rn_status rn_scene_adopt(const struct rn_wire_ingest *order, char **ret_json,
                              struct rn_error *err) {
    struct rn_wire_checkpoint taken = {.scene = NULL};
    struct rn_engine *engine = NULL;
    struct rn_field *field = NULL;
    enum rn_status status = rn_seal_check(order->source, taken.digest, err);
    if (!status) status = load(order, &engine, &field, err);
    if (!status) status = describe(order, field, &taken, ret_json, err);
    if (status && err) tell_of_file(order, err);
    free(taken.scene);
    if (field) rn_field_destroy(&field);
    if (engine) rn_engine_destroy(&engine);
    return status;
}

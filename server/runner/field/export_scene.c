// Exports of a scene for viewing: of the forms that its planes may have, the smallest that loses no
// more than is allowed, or the finest that fits, measured as whoever opens the file will see it.
#include <errno.h>
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/file.h"
#include "common/base/manifest.h"
#include "server/runner/field/work.h"

#define VIEWS 6

// The first units render the scene's own pictures, then as many each form's.
struct scene_work {
    struct rn_work work;
    struct rn_wire_export request;
    enum rn_split split;
    const struct rn_frame *frames[VIEWS];
    int views;
    int forms[RN_VIEWING_FORMS]; // bits, from the smallest file on: those that are tried
    int form_count;
    double trained[VIEWS], psnr[VIEWS]; // of the scene, of the form that is tried
    double least_loss;                  // of the forms so far
    struct rn_field *tried;
    struct rn_viewing told; // what the last file says
    int64_t bytes;
};

static enum rn_status path_of(const struct scene_work *export, const char *name,
                              char ret_path[PATH_MAX], struct rn_error *err) {
    if (snprintf(ret_path, PATH_MAX, "%s/%s", export->request.folder, name) < PATH_MAX)
        return RN_OK;
    return rn_error_set(err, RN_ERROR_LIMIT, "export", "the path is too long");
}

static double allowed_loss(const struct rn_export_options *options) {
    if (!isnan(options->max_loss)) return options->max_loss;
    return options->max_bytes == RN_ABSENT ? RN_EXPORT_LOSS : INFINITY;
}

// ---- before the first picture -----------------------------------------------------------------

static enum rn_status take_views(struct scene_work *export, struct rn_error *err) {
    enum rn_status status = rn_host_need_sound_dataset(export->work.host, err);
    if (status) return status;
    const struct rn_dataset *dataset = export->work.host->dataset;
    static const enum rn_split splits[] = {RN_SPLIT_TEST, RN_SPLIT_VAL, RN_SPLIT_TRAIN};
    for (int i = 0; i < 3 && export->views == 0; i++) {
        export->split = splits[i];
        export->views = rn_work_choose_views(dataset, splits[i], VIEWS, export->frames);
    }
    return export->views ? RN_OK
                         : rn_error_set(err, RN_ERROR_INVALID, "#/scene",
                                        "its dataset has no views to measure the loss on");
}

// Those that fit; the finest of them alone, where any loss is allowed.
static enum rn_status take_forms(struct scene_work *export, const struct rn_field *field,
                                 struct rn_error *err) {
    const struct rn_export_options *options = &export->request.options;
    int64_t most = rn_int_or(options->max_bytes, INT64_MAX), least = INT64_MAX;
    for (int i = 0; i < RN_VIEWING_FORMS; i++) {
        int64_t bytes = (int64_t)rn_viewing_bytes(field, rn_viewing_bits[i]);
        if (bytes < least) least = bytes;
        if (bytes <= most) export->forms[export->form_count++] = rn_viewing_bits[i];
    }
    if (export->form_count == 0)
        return rn_error_set(err, RN_ERROR_INVALID, "#/options/max_bytes",
                            "the smallest file that this scene can be is %lld bytes",
                            (long long)least);
    if (isinf(allowed_loss(options))) {
        export->forms[0] = export->forms[export->form_count - 1];
        export->form_count = 1;
    }
    return RN_OK;
}

static enum rn_status prepare(struct rn_work *work, struct rn_field *field, struct rn_error *err) {
    struct scene_work *export = (struct scene_work *)work;
    enum rn_status status = take_views(export, err);
    if (!status) status = take_forms(export, field, err);
    if (!status)
        status = rn_mkdirs_in(work->host->place.scene_folder, export->request.folder, 0777, err);
    work->total = (size_t)((1 + export->form_count) * export->views);
    return status;
}

static enum rn_status begin(struct rn_work *work, struct rn_error *err) {
    struct scene_work *export = (struct scene_work *)work;
    (void)err;
    if (export->tried) rn_field_destroy(&export->tried);
    export->least_loss = INFINITY;
    return RN_OK;
}

// ---- pictures ---------------------------------------------------------------------------------

static enum rn_status score(struct scene_work *export, struct rn_field *field,
                            const struct rn_field_info *info, int view, double *ret_psnr,
                            struct rn_error *err) {
    struct rn_view_score found;
    enum rn_status status =
        rn_work_score(&export->work, field, info, export->frames[view], &found, err);
    if (!status) *ret_psnr = found.psnr;
    return status;
}

static double mean(const double *values, int count) {
    double sum = 0;
    for (int i = 0; i < count; i++)
        sum += values[i];
    return sum / count;
}

// ---- files ------------------------------------------------------------------------------------

static enum rn_status write_file(struct scene_work *export, struct rn_field *field, int bits,
                                 const char *name, struct rn_error *err) {
    char path[PATH_MAX];
    struct rn_viewing *told = &export->told;
    const struct rn_dataset *dataset = export->work.host->dataset;
    *told = (struct rn_viewing){.bits = bits,
                                .views = export->views,
                                .psnr = mean(export->psnr, export->views),
                                .trained = mean(export->trained, export->views)};
    snprintf(told->split, sizeof told->split, "%s", rn_split_names[export->split]);
    snprintf(told->dataset, sizeof told->dataset, "%.*s", RN_NAME_MAX - 1,
             dataset->name ? dataset->name : "");
    snprintf(told->version, sizeof told->version, "%s", RIPNERF_VERSION);
    const struct rn_frame *start = rn_dataset_start(dataset);
    told->has_start = start != NULL;
    if (start) told->start = rn_camera_without_lens(&start->camera);
    memcpy(told->up, dataset->lie.up, sizeof told->up);
    rn_field_sha256(field, told->sha256);
    enum rn_status status = path_of(export, name, path, err);
    return status ? status : rn_viewing_write(field, told, path, err);
}

// As whoever opens the file will have it.
static enum rn_status try_form(struct scene_work *export, struct rn_field *field, int bits,
                               struct rn_error *err) {
    char path[PATH_MAX];
    enum rn_status status = write_file(export, field, bits, ".tried", err);
    if (!status) status = path_of(export, ".tried", path, err);
    if (!status) status = rn_field_load(export->work.host->engine, path, &export->tried, err);
    if (!status) unlink(path);
    return status;
}

static enum rn_status keep_form(struct scene_work *export, struct rn_field *field, int bits,
                                struct rn_error *err) {
    char path[PATH_MAX];
    struct stat about;
    enum rn_status status = write_file(export, field, bits, RN_EXPORT_SCENE_FILE, err);
    if (!status) status = rn_manifest_write(export->request.folder, err);
    if (!status) status = path_of(export, RN_EXPORT_SCENE_FILE, path, err);
    if (!status && stat(path, &about) < 0) status = rn_error_from_errno(err, errno, path, "find");
    if (!status) export->bytes = about.st_size;
    return status;
}

static enum rn_status too_lossy(const struct scene_work *export, struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_INVALID, "#/options/max_loss",
                        "within %lld bytes it loses %.3f dB at least",
                        (long long)export->request.options.max_bytes, export->least_loss);
}

// After the last view of a form: it is kept, or the next one is tried.
static enum rn_status judge(struct scene_work *export, struct rn_field *field, int form,
                            struct rn_error *err) {
    double loss = mean(export->trained, export->views) - mean(export->psnr, export->views);
    double allowed = allowed_loss(&export->request.options);
    int bits = export->forms[form];
    rn_field_destroy(&export->tried);
    export->least_loss = fmin(export->least_loss, loss);
    // The finest one there is loses nothing: what is measured of it is rounding.
    if (!(loss <= allowed) && bits < 32)
        return form + 1 < export->form_count ? RN_OK : too_lossy(export, err);
    export->work.done = export->work.total - 1;
    return keep_form(export, field, bits, err);
}

static enum rn_status unit(struct rn_work *work, struct rn_field *field,
                           const struct rn_field_info *info, struct rn_error *err) {
    struct scene_work *export = (struct scene_work *)work;
    int turn = (int)work->done / export->views, view = (int)work->done % export->views;
    if (turn == 0) return score(export, field, info, view, &export->trained[view], err);
    enum rn_status status = RN_OK;
    if (view == 0) status = try_form(export, field, export->forms[turn - 1], err);
    if (!status) status = score(export, export->tried, info, view, &export->psnr[view], err);
    if (!status && view + 1 == export->views) status = judge(export, field, turn - 1, err);
    return status;
}

// ---- the kind of work -------------------------------------------------------------------------

static enum rn_status result(struct rn_work *work, struct rn_field *field, char **ret_json,
                             struct rn_error *err) {
    const struct scene_work *export = (struct scene_work *)work;
    const struct rn_viewing *told = &export->told;
    struct rn_export_result made;
    (void)field;
    rn_message_init(&rn_export_result_table, &made);
    snprintf(made.file, sizeof made.file, "%s", RN_EXPORT_SCENE_FILE);
    made.bytes = export->bytes;
    made.bits = told->bits;
    made.views = told->views;
    made.split = (int)export->split;
    made.psnr = told->psnr;
    made.trained = told->trained;
    made.loss = told->trained - told->psnr;
    return rn_encode(&rn_export_result_table, &made, ret_json, NULL, err);
}

static void release(struct rn_work *work) {
    struct scene_work *export = (struct scene_work *)work;
    if (export->tried) rn_field_destroy(&export->tried);
    rn_message_finish(rn_wire_table(RN_WIRE_EXPORT), &export->request);
}

static const struct rn_work_kind kind = {.size = sizeof(struct scene_work),
                                         .prepare = prepare,
                                         .begin = begin,
                                         .unit = unit,
                                         .result = result,
                                         .release = release};

void rn_work_add_scene_export(struct rn_host *host, struct rn_wire_export *request) {
    struct rn_work *work = rn_work_append(host, &kind, request->job);
    if (!work) return;
    ((struct scene_work *)work)->request = *request;
    rn_message_init(rn_wire_table(RN_WIRE_EXPORT), request);
}

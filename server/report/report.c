#include "server/report/report.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static void add(struct rn_ladder_figure *figure, double value) {
    if (!isfinite(value)) return;
    double sum = figure->count > 0 ? figure->mean * (double)figure->count : 0;
    figure->count++;
    figure->mean = (sum + value) / (double)figure->count;
    figure->low = fmin(figure->low, value);
    figure->high = fmax(figure->high, value);
}

static void add_whole(struct rn_ladder_figure *figure, int64_t value) {
    if (value != RN_ABSENT && value > 0) add(figure, (double)value);
}

static struct rn_ladder_figure none(void) {
    return (struct rn_ladder_figure){NAN, NAN, NAN, 0};
}

static void clear(struct rn_ladder_arm_record *arm) {
    struct rn_ladder_figure *figures[] = {
        &arm->psnr,          &arm->margin,        &arm->ssim,          &arm->render_ms,
        &arm->train_seconds, &arm->steps,         &arm->memory_bytes,  &arm->disk_bytes,
        &arm->field_bytes,   &arm->one_cone_psnr, &arm->one_cone_ssim, &arm->one_cone_render_ms};
    for (size_t i = 0; i < sizeof figures / sizeof *figures; i++)
        *figures[i] = none();
}

static enum rn_status add_scales(struct rn_ladder_arm_record *arm,
                                 const struct rn_ladder_cell *cell, struct rn_error *err) {
    if (arm->scales == NULL && cell->scale_count > 0) {
        arm->scales = calloc(cell->scale_count, sizeof *arm->scales);
        if (arm->scales == NULL)
            return rn_error_set(err, RN_ERROR_NO_MEMORY, "report", "no memory");
        arm->scale_count = cell->scale_count;
        for (size_t i = 0; i < cell->scale_count; i++)
            arm->scales[i] = (struct rn_ladder_arm_scale){cell->scales[i].scale, none(), none()};
    }
    for (size_t i = 0; i < arm->scale_count && i < cell->scale_count; i++) {
        add(&arm->scales[i].psnr, cell->scales[i].psnr);
        add(&arm->scales[i].ssim, cell->scales[i].ssim);
    }
    return RN_OK;
}

// The first arm's cell with that seed, which is done; NULL.
static const struct rn_ladder_cell *partner(const struct rn_ladder_record *record, int64_t seed) {
    for (size_t i = 0; i < record->count; i++) {
        const struct rn_ladder_cell *cell = &record->cells[i];
        if (cell->arm == 0 && cell->seed == seed && cell->state == RN_CELL_DONE) return cell;
    }
    return NULL;
}

static enum rn_status add_cell(const struct rn_ladder_record *record,
                               const struct rn_ladder_cell *cell, struct rn_ladder_arm_record *arm,
                               struct rn_error *err) {
    const struct rn_ladder_cell *first = partner(record, cell->seed);
    add(&arm->psnr, cell->psnr);
    add(&arm->ssim, cell->ssim);
    add(&arm->render_ms, cell->render_ms);
    add(&arm->train_seconds, cell->train_seconds);
    add_whole(&arm->steps, cell->steps);
    add_whole(&arm->memory_bytes, cell->memory_bytes);
    add_whole(&arm->disk_bytes, cell->disk_bytes);
    add_whole(&arm->field_bytes, cell->field_bytes);
    add(&arm->one_cone_psnr, cell->one_cone_psnr);
    add(&arm->one_cone_ssim, cell->one_cone_ssim);
    add(&arm->one_cone_render_ms, cell->one_cone_render_ms);
    if (first != NULL) add(&arm->margin, cell->psnr - first->psnr);
    return add_scales(arm, cell, err);
}

static enum rn_status add_arms(struct rn_ladder_report *report, struct rn_error *err) {
    const struct rn_ladder_record *record = &report->ladder;
    size_t count = 0;
    for (size_t i = 0; i < record->count; i++)
        if ((size_t)record->cells[i].arm >= count) count = (size_t)record->cells[i].arm + 1;
    report->arms = calloc(count + 1, sizeof *report->arms);
    if (report->arms == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "report", "no memory");
    report->arm_count = count;
    for (size_t i = 0; i < count; i++)
        clear(&report->arms[i]);
    enum rn_status status = RN_OK;
    for (size_t i = 0; status == RN_OK && i < record->count; i++) {
        const struct rn_ladder_cell *cell = &record->cells[i];
        struct rn_ladder_arm_record *arm = &report->arms[cell->arm];
        memcpy(arm->label, cell->label, sizeof arm->label);
        if (cell->state == RN_CELL_DONE) status = add_cell(record, cell, arm, err);
    }
    return status;
}

enum rn_status rn_report_make(struct rn_ladder_record *record, struct rn_ladder_report *ret_report,
                              struct rn_error *err) {
    const struct rn_paper_figure *figures;
    struct rn_ladder_report report = {.ladder = *record};
    size_t count = rn_report_paper(record->dataset_name, &figures);
    enum rn_status status = add_arms(&report, err);
    if (status == RN_OK && count > 0) {
        report.paper = malloc(count * sizeof *report.paper);
        if (report.paper == NULL) {
            status = rn_error_set(err, RN_ERROR_NO_MEMORY, "report", "no memory");
        } else {
            memcpy(report.paper, figures, count * sizeof *report.paper);
            report.paper_count = count;
        }
    }
    if (status == RN_OK)
        *ret_report = report;
    else
        rn_message_finish(&rn_ladder_report_table, &report);
    return status;
}

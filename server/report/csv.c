#include <math.h>
#include <string.h>

#include "server/report/report.h"

#define SCALES 16

// A label's spaces, equals signs and commas are text.
static void put_text(struct rn_buf *out, const char *text) {
    rn_buf_printf(out, "\"");
    for (; *text; text++) {
        if (*text == '"') rn_buf_append(out, text, 1);
        rn_buf_append(out, text, 1);
    }
    rn_buf_printf(out, "\"");
}

static void put_number(struct rn_buf *out, double number) {
    rn_buf_append(out, ",", 1);
    if (isfinite(number)) rn_buf_printf(out, "%.10g", number);
}

static void put_whole(struct rn_buf *out, int64_t number) {
    if (number == RN_ABSENT)
        rn_buf_printf(out, ",");
    else
        rn_buf_printf(out, ",%lld", (long long)number);
}

static void put_head(struct rn_buf *out, const struct rn_ladder_cell *cell, const char *at) {
    put_text(out, cell->label);
    rn_buf_printf(out, ",%lld,%s,%s", (long long)cell->seed, rn_cell_state_names[cell->state], at);
}

static size_t count_scales(const struct rn_ladder_record *record) {
    size_t most = 0;
    for (size_t i = 0; i < record->count; i++)
        if (record->cells[i].scale_count > most) most = record->cells[i].scale_count;
    return most;
}

static void put_end(struct rn_buf *out, const struct rn_ladder_cell *cell, size_t scales) {
    put_head(out, cell, "end");
    put_number(out, cell->train_seconds);
    put_whole(out, cell->steps);
    put_number(out, cell->psnr);
    put_number(out, cell->ssim);
    put_number(out, cell->render_ms);
    put_whole(out, cell->memory_bytes);
    put_whole(out, cell->disk_bytes);
    put_whole(out, cell->field_bytes);
    put_number(out, cell->one_cone_psnr);
    put_number(out, cell->one_cone_ssim);
    for (size_t i = 0; i < scales; i++)
        put_number(out, i < cell->scale_count ? cell->scales[i].psnr : NAN);
    rn_buf_printf(out, "\r\n");
}

static void put_moment(struct rn_buf *out, const struct rn_ladder_cell *cell,
                       const struct rn_ladder_moment *moment, size_t scales) {
    put_head(out, cell, "moment");
    put_number(out, moment->train_seconds);
    put_whole(out, moment->step);
    put_number(out, moment->psnr);
    put_number(out, moment->ssim);
    for (size_t i = 0; i < 6 + scales; i++)
        rn_buf_printf(out, ",");
    rn_buf_printf(out, "\r\n");
}

void rn_report_csv(const struct rn_ladder_report *report, struct rn_buf *out) {
    size_t scales = count_scales(&report->ladder);
    rn_buf_printf(out, "arm,seed,state,at,train_seconds,step,psnr,ssim,render_ms,memory_bytes,"
                       "disk_bytes,field_bytes,one_cone_psnr,one_cone_ssim");
    for (size_t i = 0; i < scales; i++)
        rn_buf_printf(out, ",psnr_scale_%zu", i);
    rn_buf_printf(out, "\r\n");
    for (size_t i = 0; i < report->ladder.count; i++) {
        const struct rn_ladder_cell *cell = &report->ladder.cells[i];
        for (size_t m = 0; m < cell->moment_count; m++)
            put_moment(out, cell, &cell->moments[m], scales);
        put_end(out, cell, scales);
    }
}

// What a ladder's trainings are summed up to, and how that is written.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "server/report/report.h"
#include "tests/support/suite.h"

// Two arms of two seeds; the second arm's first training failed. The label would be markup.
static void make_record(struct rn_ladder_record *record) {
    static const double psnr[] = {30, 31, 30.5, 31.2};
    rn_message_init(&rn_ladder_record_table, record);
    snprintf(record->job, sizeof record->job, "job_aaaaaaaaaaaa");
    snprintf(record->dataset, sizeof record->dataset, "ds_aaaaaaaaaaaa");
    snprintf(record->dataset_name, sizeof record->dataset_name, "lego-400");
    snprintf(record->created_at, sizeof record->created_at, "2026-03-01T09:30:00.000Z");
    snprintf(record->options.over, sizeof record->options.over, "planes=3,4");
    record->cells = calloc(4, sizeof *record->cells);
    record->count = 4;
    for (int i = 0; i < 4; i++) {
        struct rn_ladder_cell *cell = &record->cells[i];
        *cell = (struct rn_ladder_cell){.arm = i % 2,
                                        .seed = 1 + i / 2,
                                        .state = i == 1 ? RN_CELL_FAILED : RN_CELL_DONE,
                                        .steps = 100,
                                        .train_seconds = 15,
                                        .held_out = NAN,
                                        .memory_bytes = 1 << 20,
                                        .disk_bytes = 3 << 20,
                                        .field_bytes = RN_ABSENT,
                                        .psnr = psnr[i],
                                        .ssim = 0.9,
                                        .render_ms = 12,
                                        .one_cone_psnr = NAN,
                                        .one_cone_ssim = NAN,
                                        .one_cone_render_ms = NAN};
        snprintf(cell->label, sizeof cell->label, i % 2 ? "planes=<4>" : "planes=3");
        snprintf(cell->scene, sizeof cell->scene, "scene-%d", i);
        if (i == 1) snprintf(cell->problem, sizeof cell->problem, "it \"failed\", & why");
        cell->scales = calloc(2, sizeof *cell->scales);
        cell->scale_count = 2;
        for (int s = 0; s < 2; s++)
            cell->scales[s] = (struct rn_scale_score){s, psnr[i] + s, 0.9, 12};
        cell->moments = calloc(1, sizeof *cell->moments);
        cell->moment_count = 1;
        cell->moments[0] = (struct rn_ladder_moment){3.75, 25, 27, 0.8};
    }
}

static void make(struct rn_ladder_report *report) {
    struct rn_ladder_record record;
    make_record(&record);
    OK(rn_report_make(&record, report, &err));
}

START_TEST(arms_are_summed_up_in_pairs) {
    struct rn_ladder_report report;
    make(&report);
    ck_assert_uint_eq(report.arm_count, 2);
    const struct rn_ladder_arm_record *first = &report.arms[0], *second = &report.arms[1];
    ck_assert_double_eq_tol(first->psnr.mean, 30.25, 1e-12);
    ck_assert(first->psnr.low == 30 && first->psnr.high == 30.5 && first->psnr.count == 2);
    ck_assert(second->psnr.count == 1 && second->psnr.mean == 31.2);
    ck_assert_double_eq_tol(second->margin.mean, 31.2 - 30.5, 1e-12); // of its own seed
    ck_assert(second->margin.count == 1 && first->margin.mean == 0);
    ck_assert(first->field_bytes.count == 0 && isnan(first->field_bytes.mean));
    ck_assert(first->scale_count == 2 && first->scales[1].psnr.count == 2);
    ck_assert_double_eq_tol(first->scales[1].psnr.mean, 31.25, 1e-12);
    rn_message_finish(&rn_ladder_report_table, &report);
}
END_TEST

START_TEST(only_the_papers_scenes_have_figures) {
    static const char *const named[] = {"lego", "lego-400", "lego400", "ship_x"};
    static const char *const others[] = {"legolas", "mylego", "Lego", "", "micro"};
    const struct rn_paper_figure *figures;
    for (size_t i = 0; i < 4; i++)
        ck_assert_uint_gt(rn_report_paper(named[i], &figures), 2);
    for (size_t i = 0; i < 5; i++)
        ck_assert_uint_eq(rn_report_paper(others[i], &figures), 0);
    ck_assert_uint_eq(rn_report_paper("lego", &figures), 7);
    ck_assert(figures[0].psnr == 36.94 && figures[1].psnr == 38.36);
}
END_TEST

START_TEST(texts_are_no_markup) {
    struct rn_ladder_report report;
    struct rn_buf page, csv;
    char *json = NULL;
    make(&report);
    OK(rn_encode(&rn_ladder_report_table, &report, &json, NULL, &err));
    rn_buf_init(&page, 1 << 22);
    rn_buf_init(&csv, 1 << 20);
    rn_report_html(&report, json, &page);
    rn_report_csv(&report, &csv);
    const char *html = (const char *)page.data, *table = (const char *)csv.data;
    ck_assert(!page.failed && !csv.failed);
    ck_assert_ptr_null(strstr(html, "<4>"));
    ck_assert_ptr_nonnull(strstr(html, "planes=&lt;4&gt;"));
    ck_assert_ptr_nonnull(strstr(html, "it &quot;failed&quot;, &amp; why"));
    ck_assert_ptr_null(strstr(html, "nan"));
    ck_assert_ptr_nonnull(strstr(table, "\"planes=3\",1,done,end,15,100,30,0.9,12,1048576,3145728,"
                                        ",,,30,31\r\n"));
    free(json);
    rn_buf_finish(&page);
    rn_buf_finish(&csv);
    rn_message_finish(&rn_ladder_report_table, &report);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("report");
    TCase *all = tcase_create("all");
    tcase_add_test(all, arms_are_summed_up_in_pairs);
    tcase_add_test(all, only_the_papers_scenes_have_figures);
    tcase_add_test(all, texts_are_no_markup);
    suite_add_tcase(suite, all);
    return run_suite(suite);
}

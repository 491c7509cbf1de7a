#include <ctype.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/image/plot.h"
#include "proto/marks.h"
#include "server/report/report.h"

#define MIB 1048576.0

static const char head[] =
    "<!DOCTYPE html>\n<html lang='en'><head><meta charset='utf-8'>"
    "<meta name='viewport' content='width=device-width,initial-scale=1'>\n<style>"
    ":root{color-scheme:light dark}"
    "body{font:15px/1.5 system-ui,sans-serif;max-width:1180px;margin:2em auto;padding:0 1em}"
    "h1{font-size:1.5em}h2{font-size:1.15em;margin-top:2em}"
    ".wide{overflow-x:auto}table{border-collapse:collapse;font-variant-numeric:tabular-nums}"
    "th,td{padding:.25em .7em;text-align:right;border-bottom:1px solid #8884;white-space:nowrap}"
    "th:first-child,td:first-child{text-align:left}small{opacity:.7}"
    ".wide small{display:block}thead th{white-space:normal;vertical-align:bottom}"
    "@media print{.wide{overflow:visible;font-size:10px}.wide th,.wide td{padding:.2em .4em}}"
    ".plots{display:flex;flex-wrap:wrap;gap:1.2em}"
    ".legend{list-style:none;padding:0;columns:22em}.legend i{display:inline-block;width:1.1em;"
    "height:.7em;margin-right:.5em;border-radius:2px}"
    ".legend i.d{opacity:.55}";

// ---- texts ----------------------------------------------------------------------------------

RN_PRINTF(2, 3) static void cell(struct rn_buf *out, const char *fmt, ...) {
    char text[256];
    va_list args;
    va_start(args, fmt);
    vsnprintf(text, sizeof text, fmt, args);
    va_end(args);
    rn_buf_printf(out, "<td>");
    rn_plot_text(out, text);
    rn_buf_printf(out, "</td>");
}

// Mean, and where there is more than one the lowest and the highest.
static void figure_cell(struct rn_buf *out, const struct rn_ladder_figure *figure, double unit,
                        int digits, const char *plus) {
    if (figure->count == 0) {
        rn_buf_printf(out, "<td></td>");
        return;
    }
    double mean = figure->mean / unit;
    rn_buf_printf(out, "<td>%s%.*f", mean >= 0 ? plus : "", digits, mean);
    if (figure->count > 1)
        rn_buf_printf(out, " <small>%.*f to %.*f</small>", digits, figure->low / unit, digits,
                      figure->high / unit);
    rn_buf_printf(out, "</td>");
}

static void columns(struct rn_buf *out, const char *names) {
    rn_buf_printf(out, "<div class='wide'><table><thead><tr>");
    while (*names) {
        size_t size = strcspn(names, "|");
        rn_buf_printf(out, "<th>%.*s</th>", (int)size, names);
        names += size + (names[size] == '|');
    }
    rn_buf_printf(out, "</tr></thead><tbody>\n");
}

static void end_table(struct rn_buf *out) {
    rn_buf_printf(out, "</tbody></table></div>\n");
}

// ---- parts ----------------------------------------------------------------------------------

static void put_title(const struct rn_ladder_report *report, struct rn_buf *out) {
    const struct rn_ladder_record *l = &report->ladder;
    size_t done = 0;
    for (size_t i = 0; i < l->count; i++)
        done += l->cells[i].state == RN_CELL_DONE;
    rn_buf_printf(out, "<title>Ladder of ");
    rn_plot_text(out, l->dataset_name);
    rn_buf_printf(out, "</title></head><body>\n<h1>Ladder of ");
    rn_plot_text(out, l->dataset_name);
    rn_buf_printf(out, ": %zu of %zu trainings</h1>\n<p><code>", done, l->count);
    rn_plot_text(out, l->options.over);
    rn_buf_printf(out, "</code>, equal by %s, %lld seeds an arm.</p>\n",
                  rn_ladder_equal_names[rn_name_or(l->options.equal, RN_LADDER_EQUAL_TIME)],
                  (long long)rn_int_or(l->options.seeds, RN_LADDER_SEEDS));
}

static void put_arms(const struct rn_ladder_report *report, struct rn_buf *out) {
    bool cones = false;
    for (size_t i = 0; i < report->arm_count; i++)
        cones = cones || report->arms[i].one_cone_psnr.count > 0;
    rn_buf_printf(out, "<h2>Arms</h2>\n");
    columns(out, cones ? "arm|PSNR, dB|over the first, dB|SSIM|one cone a pixel, dB|training, "
                         "s|steps|a picture, ms|memory, MiB|checkpoint, MiB|without optimiser, MiB"
                       : "arm|PSNR, dB|over the first, dB|SSIM|training, s|steps|a picture, "
                         "ms|memory, MiB|checkpoint, MiB|without optimiser, MiB");
    for (size_t i = 0; i < report->arm_count; i++) {
        const struct rn_ladder_arm_record *arm = &report->arms[i];
        rn_buf_printf(out, "<tr>");
        cell(out, "%s", arm->label);
        figure_cell(out, &arm->psnr, 1, 2, "");
        figure_cell(out, &arm->margin, 1, 2, "+");
        figure_cell(out, &arm->ssim, 1, 4, "");
        if (cones) figure_cell(out, &arm->one_cone_psnr, 1, 2, "");
        figure_cell(out, &arm->train_seconds, 1, 1, "");
        figure_cell(out, &arm->steps, 1, 0, "");
        figure_cell(out, &arm->render_ms, 1, 1, "");
        figure_cell(out, &arm->memory_bytes, MIB, 0, "");
        figure_cell(out, &arm->disk_bytes, MIB, 1, "");
        figure_cell(out, &arm->field_bytes, MIB, 1, "");
        rn_buf_printf(out, "</tr>\n");
    }
    end_table(out);
    rn_buf_printf(out, "<p><small>Means over seeds, the lowest and the highest below them. What an "
                       "arm gains over the first is counted in pairs of one seed.</small></p>\n");
}

static void put_scales(const struct rn_ladder_report *report, struct rn_buf *out) {
    size_t scales = 0;
    for (size_t i = 0; i < report->arm_count; i++)
        if (report->arms[i].scale_count > scales) scales = report->arms[i].scale_count;
    if (scales < 2) return;
    rn_buf_printf(out, "<h2>PSNR by scale, dB</h2>\n");
    columns(out, "arm");
    for (size_t i = 0; i < report->arm_count; i++) {
        const struct rn_ladder_arm_record *arm = &report->arms[i];
        rn_buf_printf(out, "<tr>");
        cell(out, "%s", arm->label);
        for (size_t s = 0; s < arm->scale_count; s++)
            figure_cell(out, &arm->scales[s].psnr, 1, 2, "");
        rn_buf_printf(out, "</tr>\n");
    }
    end_table(out);
    rn_buf_printf(out, "<p><small>From the finest scale to the coarsest, each half as fine as the "
                       "one before.</small></p>\n");
}

// ---- plots ----------------------------------------------------------------------------------

enum { MOST_POINTS = RN_MARKS_KEPT + 1 };

// A training's figures over its seconds, its end among them; returns how many.
static size_t path_of(const struct rn_ladder_cell *c, bool ssim, double *seconds, double *values) {
    size_t count = 0;
    for (size_t i = 0; i < c->moment_count && count + 1 < MOST_POINTS; i++) {
        seconds[count] = c->moments[i].train_seconds;
        values[count++] = ssim ? c->moments[i].ssim : c->moments[i].psnr;
    }
    seconds[count] = c->train_seconds;
    values[count++] = ssim ? c->ssim : c->psnr;
    return count;
}

static void over_seconds(const struct rn_ladder_report *report, bool ssim, struct rn_buf *out) {
    const struct rn_ladder_record *l = &report->ladder;
    struct rn_plot plot = {.out = out,
                           .title = ssim ? "SSIM over training" : "PSNR over training",
                           .x = {"seconds of training", true, NAN, NAN},
                           .y = {ssim ? "SSIM" : "PSNR, dB", false, NAN, NAN}};
    double x[MOST_POINTS], y[MOST_POINTS];
    for (int pass = 0; pass < 2; pass++) {
        if (pass == 1) rn_plot_begin(&plot);
        for (size_t i = 0; i < l->count; i++) {
            const struct rn_ladder_cell *c = &l->cells[i];
            size_t count = path_of(c, ssim, x, y);
            char what[256];
            for (size_t k = 0; pass == 0 && k < count; k++) {
                rn_plot_cover(&plot.x, isfinite(y[k]) ? x[k] : NAN);
                rn_plot_cover(&plot.y, y[k]);
            }
            if (pass == 0) continue;
            rn_plot_line(&plot, (int)c->arm, x, y, count);
            for (size_t k = 0; k < count; k++) {
                snprintf(what, sizeof what, "%s, seed %lld: %.4g after %.1f s", c->label,
                         (long long)c->seed, y[k], x[k]);
                rn_plot_dot(&plot, (int)c->arm, x[k], y[k], what);
            }
        }
    }
    rn_plot_end(&plot);
}

enum measure { MS, MEMORY, DISK, MEASURES };
static const char *const measure_titles[] = {"PSNR and a picture's time", "PSNR and memory",
                                             "PSNR and bytes on disk"};
static const char *const measure_labels[] = {"milliseconds a picture", "MiB while training",
                                             "MiB of a checkpoint"};

static double measured(const struct rn_ladder_cell *c, enum measure measure) {
    int64_t bytes = measure == MEMORY ? c->memory_bytes : c->disk_bytes;
    if (measure == MS) return c->render_ms;
    return bytes > 0 ? (double)bytes / MIB : NAN;
}

static void over_measure(const struct rn_ladder_report *report, enum measure measure,
                         struct rn_buf *out) {
    const struct rn_ladder_record *l = &report->ladder;
    struct rn_plot plot = {.out = out,
                           .title = measure_titles[measure],
                           .x = {measure_labels[measure], true, NAN, NAN},
                           .y = {"PSNR, dB", false, NAN, NAN}};
    for (int pass = 0; pass < 2; pass++) {
        if (pass == 1) rn_plot_begin(&plot);
        for (size_t i = 0; i < l->count; i++) {
            const struct rn_ladder_cell *c = &l->cells[i];
            double x = measured(c, measure);
            char what[256];
            snprintf(what, sizeof what, "%s, seed %lld: %.2f dB, %.1f %s", c->label,
                     (long long)c->seed, c->psnr, x, measure == MS ? "ms" : "MiB");
            if (pass == 1)
                rn_plot_dot(&plot, (int)c->arm, x, c->psnr, what);
            else if (isfinite(x) && isfinite(c->psnr)) {
                rn_plot_cover(&plot.x, x);
                rn_plot_cover(&plot.y, c->psnr);
            }
        }
    }
    rn_plot_end(&plot);
}

static void put_plots(const struct rn_ladder_report *report, struct rn_buf *out) {
    rn_buf_printf(out, "<h2>Plots</h2>\n<ul class='legend'>\n");
    for (size_t i = 0; i < report->arm_count; i++) {
        rn_buf_printf(out, "<li><i class='s%d%s'></i>", (int)i % RN_PLOT_COLOURS,
                      i / RN_PLOT_COLOURS % 2 ? " d" : "");
        rn_plot_text(out, report->arms[i].label);
        rn_buf_printf(out, "</li>\n");
    }
    rn_buf_printf(out, "</ul>\n<div class='plots'>\n");
    over_seconds(report, false, out);
    over_seconds(report, true, out);
    for (int m = 0; m < MEASURES; m++)
        over_measure(report, (enum measure)m, out);
    rn_buf_printf(out, "</div>\n<p><small>A line a seed; what a dot stands for is said when it is "
                       "pointed at.</small></p>\n");
}

// ---- the rest -------------------------------------------------------------------------------

static void put_protocol(const struct rn_ladder_report *report, struct rn_buf *out) {
    const struct rn_ladder_record *l = &report->ladder;
    const struct rn_protocol *p = &l->protocol;
    rn_buf_printf(out, "<h2>Protocol</h2>\n<ul>\n<li>Dataset ");
    rn_plot_text(out, l->dataset_name);
    if (l->views != RN_ABSENT) {
        rn_buf_printf(out,
                      ": %lld views of its %s split, evenly spaced, at every scale; means over "
                      "views, then over scales.",
                      (long long)l->views, rn_split_names[rn_name_or(p->split, 2)]);
        rn_buf_printf(out, "</li>\n<li>Trained on the split %s over the background %g, %g, %g; ",
                      rn_train_split_names[rn_name_or(p->train_split, 0)], p->background[0],
                      p->background[1], p->background[2]);
        rn_plot_text(out, p->rounding);
    }
    rn_buf_printf(out,
                  "</li>\n<li>Preset %s and what each arm names; the same seeds for every arm; "
                  "one training at a time, evaluations apart from them.</li>\n",
                  rn_preset_names[rn_name_or(l->options.train.preset, RN_PRESET_STANDARD)]);
    rn_buf_printf(out, "<li>Cones a pixel: as many as a scene calls for by itself%s.</li>\n",
                  l->options.one_cone > 0 ? ", and one" : "");
    rn_buf_printf(out, "<li>ripnerf %s, ", l->version);
    rn_plot_text(out, l->machine);
    rn_buf_printf(out, ", kernels %s", l->kernels);
    if (l->threads != RN_ABSENT) rn_buf_printf(out, ", %lld threads", (long long)l->threads);
    rn_buf_printf(out, ", begun %s. Memory is what the training's process holds.</li>\n</ul>\n",
                  l->created_at);
}

static void put_paper(const struct rn_ladder_report *report, struct rn_buf *out) {
    if (report->paper_count == 0) return;
    rn_buf_printf(out, "<h2>The paper's figures of this scene</h2>\n");
    columns(out, "what|steps|minutes of an A100|PSNR, dB");
    for (size_t i = 0; i < report->paper_count; i++) {
        const struct rn_paper_figure *f = &report->paper[i];
        rn_buf_printf(out, "<tr>");
        cell(out, "%s", f->what);
        cell(out, "%lld", (long long)f->steps);
        if (isfinite(f->minutes))
            cell(out, "%.0f", f->minutes);
        else
            cell(out, "%s", "");
        cell(out, "%.2f", f->psnr);
        rn_buf_printf(out, "</tr>\n");
    }
    end_table(out);
    rn_buf_printf(out,
                  "<p><small>Liu et al. 2024, doi:10.1145/3641519.3657402: 200 test views, trained "
                  "on train and validation views, one cone a pixel, photographs scaled down with "
                  "colour and opacity apart. Beside a ladder of other sizes, splits or steps they "
                  "are a scale, not a competitor.</small></p>\n");
}

static void put_problems(const struct rn_ladder_report *report, struct rn_buf *out) {
    bool any = false;
    for (size_t i = 0; i < report->ladder.count; i++) {
        const struct rn_ladder_cell *c = &report->ladder.cells[i];
        if (c->problem[0] == '\0') continue;
        rn_buf_printf(out, "%s<li>", any ? "" : "<h2>What is missing</h2>\n<ul>\n");
        any = true;
        rn_plot_text(out, c->label);
        rn_buf_printf(out, ", seed %lld: ", (long long)c->seed);
        rn_plot_text(out, c->problem);
        rn_buf_printf(out, "</li>\n");
    }
    if (any) rn_buf_printf(out, "</ul>\n");
}

// A file that the page holds, to be saved from it.
static void put_file(struct rn_buf *out, const char *name, const char *type, const void *bytes,
                     size_t size) {
    const unsigned char *at = bytes;
    rn_buf_printf(out, " <a download='%s' href='data:%s,", name, type);
    for (size_t i = 0; i < size; i++)
        if (isalnum(at[i]) || strchr("-._~:/", at[i]) != NULL)
            rn_buf_append(out, &at[i], 1);
        else
            rn_buf_printf(out, "%%%02X", at[i]);
    rn_buf_printf(out, "'>%s</a>", name);
}

void rn_report_html(const struct rn_ladder_report *report, const char *json, struct rn_buf *out) {
    struct rn_buf csv;
    rn_buf_append(out, head, strlen(head));
    rn_buf_append(out, rn_plot_style, strlen(rn_plot_style));
    rn_buf_printf(out, "</style>\n");
    put_title(report, out);
    put_arms(report, out);
    put_scales(report, out);
    put_plots(report, out);
    put_paper(report, out);
    put_protocol(report, out);
    put_problems(report, out);
    rn_buf_init(&csv, out->max);
    rn_report_csv(report, &csv);
    rn_buf_printf(out, "<p>The figures:");
    put_file(out, "ladder.csv", "text/csv", csv.data, csv.size);
    put_file(out, "ladder.json", "application/json", json, strlen(json));
    rn_buf_printf(out, "</p>\n</body></html>\n");
    rn_buf_finish(&csv);
}

#include "common/image/plot.h"

#include <math.h>
#include <string.h>

#define WIDTH 560
#define HEIGHT 340
#define LEFT 62
#define RIGHT 14
#define TOP 34
#define BOTTOM 46
#define MARKS 7  // at most about so many on an axis
#define NARROW 8 // a logarithmic axis of less than that ratio is marked at equal steps

const char rn_plot_style[] =
    ".plot{font:12px sans-serif;max-width:100%;height:auto}.plot text{fill:currentColor}"
    ".plot .g{stroke:currentColor;opacity:.15;fill:none}"
    ".plot polyline{fill:none;stroke-width:1.6}.plot .d{stroke-dasharray:5 3}"
    ".plot circle{stroke:none}"
    ".s0{stroke:#2368a8;fill:#2368a8;background:#2368a8}"
    ".s1{stroke:#c4502b;fill:#c4502b;background:#c4502b}"
    ".s2{stroke:#2a8a57;fill:#2a8a57;background:#2a8a57}"
    ".s3{stroke:#8a4fb0;fill:#8a4fb0;background:#8a4fb0}"
    ".s4{stroke:#a8871b;fill:#a8871b;background:#a8871b}"
    ".s5{stroke:#1d8f99;fill:#1d8f99;background:#1d8f99}"
    ".s6{stroke:#c23b78;fill:#c23b78;background:#c23b78}"
    ".s7{stroke:#6b7d1e;fill:#6b7d1e;background:#6b7d1e}"
    ".s8{stroke:#7a6250;fill:#7a6250;background:#7a6250}"
    ".s9{stroke:#6a7380;fill:#6a7380;background:#6a7380}";

void rn_plot_text(struct rn_buf *out, const char *text) {
    for (; *text; text++)
        switch (*text) {
        case '<':
            rn_buf_printf(out, "&lt;");
            break;
        case '>':
            rn_buf_printf(out, "&gt;");
            break;
        case '&':
            rn_buf_printf(out, "&amp;");
            break;
        case '"':
            rn_buf_printf(out, "&quot;");
            break;
        case '\'':
            rn_buf_printf(out, "&#39;");
            break;
        default:
            rn_buf_append(out, text, 1);
        }
}

void rn_plot_cover(struct rn_plot_axis *axis, double value) {
    if (!isfinite(value) || (axis->logarithmic && value <= 0)) return;
    axis->low = fmin(axis->low, value); // NAN is no number: the other one
    axis->high = fmax(axis->high, value);
}

static double along(const struct rn_plot_axis *axis, double value) {
    if (axis->logarithmic) return log(value / axis->low) / log(axis->high / axis->low);
    return (value - axis->low) / (axis->high - axis->low);
}

static double place_x(const struct rn_plot *plot, double x) {
    return LEFT + (WIDTH - LEFT - RIGHT) * along(&plot->x, x);
}

static double place_y(const struct rn_plot *plot, double y) {
    return HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * along(&plot->y, y);
}

// 1, 2 or 5 times a power of ten: the distance of about MARKS marks in a range.
static double mark_step(double range) {
    double power = pow(10, floor(log10(range / MARKS))), part = range / MARKS / power;
    return power * (part <= 1 ? 1 : part <= 2 ? 2 : part <= 5 ? 5 : 10);
}

// Some room around what it covers.
static void settle(struct rn_plot_axis *axis) {
    if (!isfinite(axis->low)) axis->low = axis->high = axis->logarithmic ? 1 : 0;
    if (axis->logarithmic) {
        axis->low *= 0.85;
        axis->high *= 1.18;
        return;
    }
    double room = fmax(0.06 * (axis->high - axis->low), 1e-4 * fmax(fabs(axis->high), 1e-3));
    bool from_zero = axis->low == 0;
    axis->low -= from_zero ? 0 : room;
    axis->high += room;
}

static void mark(const struct rn_plot *plot, bool vertical, double value) {
    double at = vertical ? place_y(plot, value) : place_x(plot, value);
    if (vertical)
        rn_buf_printf(plot->out,
                      "<path class='g' d='M%d %.1fH%d'/><text x='%d' y='%.1f' "
                      "text-anchor='end'>%.6g</text>",
                      LEFT, at, WIDTH - RIGHT, LEFT - 6, at + 4, value);
    else
        rn_buf_printf(plot->out,
                      "<path class='g' d='M%.1f %dV%d'/><text x='%.1f' y='%d' "
                      "text-anchor='middle'>%.6g</text>",
                      at, TOP, HEIGHT - BOTTOM, at, HEIGHT - BOTTOM + 17, value);
}

static void mark_axis(const struct rn_plot *plot, bool vertical) {
    static const double parts[] = {1, 2, 5};
    const struct rn_plot_axis *axis = vertical ? &plot->y : &plot->x;
    if (!axis->logarithmic || axis->high < NARROW * axis->low) {
        double step = mark_step(axis->high - axis->low);
        for (double value = ceil(axis->low / step) * step; value <= axis->high; value += step)
            mark(plot, vertical, fabs(value) < 1e-9 * step ? 0 : value);
        return;
    }
    for (double power = pow(10, floor(log10(axis->low))); power <= axis->high; power *= 10)
        for (int i = 0; i < 3; i++)
            if (parts[i] * power >= axis->low && parts[i] * power <= axis->high)
                mark(plot, vertical, parts[i] * power);
}

void rn_plot_begin(struct rn_plot *plot) {
    settle(&plot->x);
    settle(&plot->y);
    rn_buf_printf(plot->out,
                  "<svg class='plot' viewBox='0 0 %d %d' width='%d' height='%d' role='img'>", WIDTH,
                  HEIGHT, WIDTH, HEIGHT);
    rn_buf_printf(plot->out, "<title>");
    rn_plot_text(plot->out, plot->title);
    rn_buf_printf(plot->out, "</title><text x='%d' y='18' font-size='14'>", LEFT);
    rn_plot_text(plot->out, plot->title);
    rn_buf_printf(plot->out, "</text>");
    mark_axis(plot, false);
    mark_axis(plot, true);
    rn_buf_printf(plot->out, "<text x='%d' y='%d' text-anchor='middle'>",
                  (LEFT + WIDTH - RIGHT) / 2, HEIGHT - 8);
    rn_plot_text(plot->out, plot->x.label);
    rn_buf_printf(plot->out,
                  "</text><text transform='translate(14 %d) rotate(-90)' "
                  "text-anchor='middle'>",
                  (TOP + HEIGHT - BOTTOM) / 2);
    rn_plot_text(plot->out, plot->y.label);
    rn_buf_printf(plot->out, "</text>\n");
}

static bool is_shown(const struct rn_plot *plot, double x, double y) {
    return isfinite(x) && isfinite(y) && !(plot->x.logarithmic && x <= 0) &&
           !(plot->y.logarithmic && y <= 0);
}

void rn_plot_line(const struct rn_plot *plot, int colour, const double *x, const double *y,
                  size_t count) {
    rn_buf_printf(plot->out, "<polyline class='s%d%s' style='fill:none' points='",
                  colour % RN_PLOT_COLOURS, colour / RN_PLOT_COLOURS % 2 ? " d" : "");
    for (size_t i = 0; i < count; i++)
        if (is_shown(plot, x[i], y[i]))
            rn_buf_printf(plot->out, "%.1f,%.1f ", place_x(plot, x[i]), place_y(plot, y[i]));
    rn_buf_printf(plot->out, "'/>\n");
}

void rn_plot_dot(const struct rn_plot *plot, int colour, double x, double y, const char *what) {
    if (!is_shown(plot, x, y)) return;
    rn_buf_printf(plot->out, "<circle class='s%d' cx='%.1f' cy='%.1f' r='3.4'><title>",
                  colour % RN_PLOT_COLOURS, place_x(plot, x), place_y(plot, y));
    rn_plot_text(plot->out, what);
    rn_buf_printf(plot->out, "</title></circle>\n");
}

void rn_plot_end(const struct rn_plot *plot) {
    rn_buf_printf(plot->out, "</svg>\n");
}

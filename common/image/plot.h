// Line plots as SVG: axes with round marks, lines, dots that say what they are when pointed at.
//
// Colours are classes (s0 to s9, and beyond these the same ones dashed), which the page that holds
// the plot defines with rn_plot_style.
#ifndef RN_COMMON_IMAGE_PLOT_H
#define RN_COMMON_IMAGE_PLOT_H

#include "common/base/buf.h"

#define RN_PLOT_COLOURS 10
// Of grid, text, lines and dots, by day and by night.
extern const char rn_plot_style[];

struct rn_plot_axis {
    const char *label;
    bool logarithmic;
    double low, high; // of what it covers; both NAN: nothing yet
};

// Plain value; begin, then lines and dots, then end. What is not finite is left out.
struct rn_plot {
    struct rn_buf *out;
    const char *title;
    struct rn_plot_axis x, y;
};

// Widens an axis so that it covers a value.
void rn_plot_cover(struct rn_plot_axis *axis, double value);
void rn_plot_begin(struct rn_plot *plot);
void rn_plot_line(const struct rn_plot *plot, int colour, const double *x, const double *y,
                  size_t count);
void rn_plot_dot(const struct rn_plot *plot, int colour, double x, double y, const char *what);
void rn_plot_end(const struct rn_plot *plot);

// Text as HTML and SVG take it.
void rn_plot_text(struct rn_buf *out, const char *text);

#endif

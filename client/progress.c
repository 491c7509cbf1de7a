#include "client/progress.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "common/base/clock.h"

#define BAR_MIN 4
#define BAR_MAX 24
#define REDRAW_NS 80000000 // a terminal is redrawn at most so often

static const char bar_full[] = "########################";
static const char bar_empty[] = "........................";
_Static_assert(sizeof bar_full == BAR_MAX + 1 && sizeof bar_empty == BAR_MAX + 1, "a bar's width");

void rn_progress_init(struct rn_progress *progress, bool shown) {
    memset(progress, 0, sizeof *progress);
    progress->shown = shown;
    progress->terminal = isatty(STDERR_FILENO);
    rn_progress_hurry(progress);
}

void rn_progress_hurry(struct rn_progress *progress) {
    progress->last_ns = INT64_MIN / 2;
}

static int terminal_columns(void) {
    struct winsize size;
    return ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 0 ? size.ws_col : 80;
}

// The bar takes the room that percentage and text leave, and goes without less than BAR_MIN.
static void draw(struct rn_progress *progress) {
    int columns = terminal_columns() - 1;
    fputs("\r\033[K", stderr);
    if (isfinite(progress->fraction)) {
        int width = columns - (int)strlen(progress->text) - (int)strlen("[] 100%  ");
        width = width < BAR_MAX ? width : BAR_MAX;
        int filled = (int)(progress->fraction * width + 0.5);
        if (width >= BAR_MIN)
            columns -= fprintf(stderr, "[%.*s%.*s] ", filled, bar_full, width - filled, bar_empty);
        columns -= fprintf(stderr, "%3d%%  ", (int)(progress->fraction * 100));
    }
    fprintf(stderr, "%.*s", columns > 0 ? columns : 0, progress->text);
    fflush(stderr);
    progress->drawn = true;
}

static void write_state(struct rn_progress *progress) {
    progress->last_ns = rn_clock_ns();
    progress->pending = false;
    if (progress->terminal)
        draw(progress);
    else if (isfinite(progress->fraction))
        fprintf(stderr, "%3d%%  %s\n", (int)(progress->fraction * 100), progress->text);
    else
        fprintf(stderr, "%s\n", progress->text);
}

void rn_progress_update(struct rn_progress *progress, double fraction, const char *fmt, ...) {
    va_list args;
    int64_t now = rn_clock_ns();
    int64_t interval = progress->terminal ? REDRAW_NS : (int64_t)RN_PROGRESS_LOG_S * 1000000000;
    va_start(args, fmt);
    vsnprintf(progress->text, sizeof progress->text, fmt, args);
    va_end(args);
    progress->fraction = isnan(fraction) ? NAN : fmin(fmax(fraction, 0), 1);
    progress->pending = true;
    if (progress->shown && now - progress->last_ns >= interval) write_state(progress);
}

void rn_progress_note(struct rn_progress *progress, const char *fmt, ...) {
    va_list args;
    if (!progress->shown) return;
    if (progress->drawn) fputs("\r\033[K", stderr);
    va_start(args, fmt);
    vfprintf(stderr, fmt, args);
    va_end(args);
    fputc('\n', stderr);
    if (progress->drawn) draw(progress);
}

void rn_progress_finish(struct rn_progress *progress) {
    if (progress->shown && progress->pending) write_state(progress);
    if (progress->drawn) fputc('\n', stderr);
    progress->drawn = false;
}

void rn_format_count(double value, char *ret_text, size_t capacity) {
    static const char units[] = " kMGTP";
    size_t unit = 0;
    while (fabs(value) >= 999.5 && units[unit + 1]) {
        value /= 1000;
        unit++;
    }
    int decimals = fabs(value) >= 99.95 ? 0 : fabs(value) >= 9.995 ? 1 : 2;
    if (unit)
        snprintf(ret_text, capacity, "%.*f%c", decimals, value, units[unit]);
    else
        snprintf(ret_text, capacity, "%.0f", value);
}

void rn_format_seconds(double seconds, char *ret_text, size_t capacity) {
    if (!isfinite(seconds) || seconds < 0)
        snprintf(ret_text, capacity, "-");
    else if (seconds < 99.95)
        snprintf(ret_text, capacity, "%.1f s", seconds);
    else if (seconds < 3600)
        snprintf(ret_text, capacity, "%d:%02d", (int)seconds / 60, (int)seconds % 60);
    else
        snprintf(ret_text, capacity, "%.0f:%02d:%02d", floor(seconds / 3600),
                 (int)fmod(seconds, 3600) / 60, (int)fmod(seconds, 60));
}

void rn_format_figure(double psnr, int64_t psnr_step, int64_t steps, char *ret_text,
                      size_t capacity) {
    bool of_the_last = psnr_step == steps || psnr_step < 0;
    if (isnan(psnr))
        snprintf(ret_text, capacity, "%s", "");
    else if (of_the_last)
        snprintf(ret_text, capacity, "%.2f dB", psnr);
    else
        snprintf(ret_text, capacity, "%.2f dB at step %lld", psnr, (long long)psnr_step);
}

void rn_format_bytes(double bytes, char *ret_text, size_t capacity) {
    char count[16];
    rn_format_count(bytes, count, sizeof count);
    size_t end = strlen(count) - 1;
    if (count[end] >= '0' && count[end] <= '9')
        snprintf(ret_text, capacity, "%s B", count);
    else
        snprintf(ret_text, capacity, "%.*s %cB", (int)end, count, count[end]);
}

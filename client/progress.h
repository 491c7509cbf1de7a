// One updating line on a terminal, or a line now and then in a log.
#ifndef RN_CLIENT_PROGRESS_H
#define RN_CLIENT_PROGRESS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "common/base/status.h"

// Thread-safety: one thread at a time. Writes to stderr, so that results on stdout stay clean.
struct rn_progress {
    bool shown;      // false: nothing is ever written
    bool terminal;   // one line, rewritten in place
    bool drawn;      // the terminal's cursor stands behind a line that is not ended
    bool pending;    // the text was not written yet
    int64_t last_ns; // when something was written last
    double fraction;
    char text[256];
};

// `shown` false silences it. Whether stderr is a terminal is found out here; a log gets a line at
// most every RN_PROGRESS_LOG_S seconds.
#define RN_PROGRESS_LOG_S 5
void rn_progress_init(struct rn_progress *progress, bool shown);
// `fraction` in [0, 1], or NAN where the end is not known.
void rn_progress_update(struct rn_progress *progress, double fraction, const char *fmt, ...)
    RN_PRINTF(3, 4);
// Has the next update written at once, however soon it follows the last.
void rn_progress_hurry(struct rn_progress *progress);
// A line of its own, above the bar.
void rn_progress_note(struct rn_progress *progress, const char *fmt, ...) RN_PRINTF(2, 3);
// Writes the last state where it was not, and ends the line.
void rn_progress_finish(struct rn_progress *progress);

// "1.2k", "3.10M": three digits and a unit prefix.
void rn_format_count(double value, char *ret_text, size_t capacity);
// "42.0 s", "3:25", "1:02:03"; "-" when it is not finite.
void rn_format_seconds(double seconds, char *ret_text, size_t capacity);
// A PSNR, and the step that it is of where that is not the last: "26.10 dB at step 1200"; "" of
// NAN.
void rn_format_figure(double psnr, int64_t psnr_step, int64_t steps, char *ret_text,
                      size_t capacity);
// "12.3 MB"
void rn_format_bytes(double bytes, char *ret_text, size_t capacity);

#endif

// The log: one line an event on stderr.
#ifndef RN_COMMON_BASE_LOG_H
#define RN_COMMON_BASE_LOG_H

#include "common/base/status.h"

enum rn_log_level { RN_LOG_ERROR, RN_LOG_WARN, RN_LOG_INFO, RN_LOG_DEBUG };

#define RN_LOG_TEXT_MAX 1000

// Writes "2026-01-31T12:00:00.123Z info text\n" in one write(2), so that lines of several threads
// and processes do not mix. Control characters in the text become '?'; texts are cut at 1000
// bytes. Keeps errno. Thread-safe, not for signal handlers.
void rn_log(enum rn_log_level level, const char *fmt, ...) RN_PRINTF(2, 3);

// Lines are JSON objects with time, level and text from now on; of a trace, with trace_id and
// span_id, as OpenTelemetry names them. Thread-safe.
void rn_log_set_json(void);

// Lines of the calling thread are of this trace (a traceparent, which stays until the next call)
// from now on, of none with NULL or "": " trace_id=... span_id=..." is put behind the text. The one
// before.
const char *rn_log_set_trace(const char *traceparent);

// Drops what is less urgent than `level`; RN_LOG_INFO at the start. Thread-safe.
void rn_log_set_level(enum rn_log_level level);

#endif

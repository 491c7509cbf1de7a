// W3C Trace Context: "00-TRACE-SPAN-FLAGS", of 32, 16 and 2 hexadecimal digits.
#ifndef RN_COMMON_BASE_TRACE_H
#define RN_COMMON_BASE_TRACE_H

#include <stdbool.h>

#define RN_TRACE_MAX 56    // of a traceparent, with its end
#define RN_TRACE_ID_MAX 33 // of a trace id, with its end

// Whether `text` (or NULL) is a traceparent of version 00 whose ids are not all zero. Thread-safe.
bool rn_trace_is_good(const char *text);

// A new span in the trace of `parent`, with its flags; in a new trace, sampled, where `parent` is
// none (NULL, "", malformed). Thread-safe.
void rn_trace_begin(const char *parent, char ret_traceparent[RN_TRACE_MAX]);

// The two ids of a good traceparent. Thread-safe.
void rn_trace_ids(const char *traceparent, char ret_trace[RN_TRACE_ID_MAX], char ret_span[17]);

#endif

#include "common/base/log.h"

#include <errno.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/trace.h"
#include "common/base/utf8.h"

#define MAX_TRACE 96 // of what is told of a trace

static const char *const level_names[] = {"error", "warn", "info", "debug"};
static atomic_int least_urgent = RN_LOG_INFO;

void rn_log_set_level(enum rn_log_level level) {
    atomic_store(&least_urgent, (int)level);
}

static atomic_bool is_json;

void rn_log_set_json(void) {
    atomic_store(&is_json, true);
}

static _Thread_local const char *trace_here;

const char *rn_log_set_trace(const char *traceparent) {
    const char *before = trace_here;
    trace_here = traceparent;
    return before;
}

// What is told of the trace, after the text: as `json` members or as words; "" of none.
static void tell_trace(bool json, char ret_text[MAX_TRACE]) {
    char trace[RN_TRACE_ID_MAX], span[17];
    ret_text[0] = '\0';
    if (!rn_trace_is_good(trace_here)) return;
    rn_trace_ids(trace_here, trace, span);
    snprintf(ret_text, MAX_TRACE,
             json ? "\",\"trace_id\":\"%s\",\"span_id\":\"%s" : " trace_id=%s span_id=%s", trace,
             span);
}

static size_t format_prefix(char *line, size_t capacity, enum rn_log_level level) {
    int64_t now_ms = rn_clock_wall_ms();
    time_t seconds = (time_t)(now_ms / 1000);
    struct tm utc = {0};
    gmtime_r(&seconds, &utc);
    size_t size = strftime(line, capacity, "%Y-%m-%dT%H:%M:%S", &utc);
    int more = snprintf(line + size, capacity - size, ".%03dZ %s ", (int)(now_ms % 1000),
                        level_names[level]);
    return size + (size_t)more;
}

// {"time":"…","level":"…","text":"…"} of a line as it is written else.
static size_t make_json(const char *line, size_t prefix, size_t size, char *ret_json) {
    const size_t time = strcspn(line, " "), level = prefix - time - 2;
    size_t at = (size_t)sprintf(ret_json, "{\"time\":\"%.*s\",\"level\":\"%.*s\",\"text\":\"",
                                (int)time, line, (int)level, line + time + 1);
    for (size_t i = prefix; i < size; i++) {
        if (line[i] == '"' || line[i] == '\\') ret_json[at++] = '\\';
        ret_json[at++] = line[i];
    }
    char trace[MAX_TRACE];
    tell_trace(true, trace);
    return at + (size_t)sprintf(ret_json + at, "%s\"}", trace);
}

void rn_log(enum rn_log_level level, const char *fmt, ...) {
    if ((int)level > atomic_load(&least_urgent)) return;
    int kept_errno = errno;
    char line[64 + RN_LOG_TEXT_MAX + MAX_TRACE + 1];
    size_t prefix = format_prefix(line, 64, level);
    va_list args;
    va_start(args, fmt);
    int length = vsnprintf(line + prefix, RN_LOG_TEXT_MAX, fmt, args);
    va_end(args);
    size_t size = prefix + (length < 0                 ? 0
                            : length < RN_LOG_TEXT_MAX ? (size_t)length
                                                       : RN_LOG_TEXT_MAX - 1);
    for (size_t i = prefix; i < size; i++)
        if ((unsigned char)line[i] < 0x20 || line[i] == 0x7f) line[i] = '?';
    char json[sizeof line + RN_LOG_TEXT_MAX + MAX_TRACE + 64];
    char *text = line;
    if (atomic_load(&is_json)) {
        line[size] = '\0';
        rn_utf8_clean(line);
        size = make_json(line, prefix, strlen(line), json);
        text = json;
    } else {
        tell_trace(false, line + size);
        size += strlen(line + size);
    }
    text[size++] = '\n';
    ssize_t put = write(STDERR_FILENO, text, size);
    (void)put; // a log that cannot be written has nowhere to complain
    errno = kept_errno;
}

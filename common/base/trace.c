#include "common/base/trace.h"

#include <inttypes.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/random.h>

#include "common/base/clock.h"

#define HEX "0123456789abcdef"

static bool is_hex(const char *text, size_t size) {
    return strspn(text, HEX) >= size;
}

static bool is_zero(const char *text, size_t size) {
    return strspn(text, "0") >= size;
}

bool rn_trace_is_good(const char *text) {
    return text != NULL && strlen(text) == RN_TRACE_MAX - 1 && strncmp(text, "00-", 3) == 0 &&
           is_hex(text + 3, 32) && text[35] == '-' && is_hex(text + 36, 16) && text[52] == '-' &&
           is_hex(text + 53, 2) && !is_zero(text + 3, 32) && !is_zero(text + 36, 16);
}

void rn_trace_begin(const char *parent, char ret_traceparent[RN_TRACE_MAX]) {
    uint64_t fresh[3] = {0};
    bool goes_on = rn_trace_is_good(parent);
    if (getrandom(fresh, sizeof fresh, GRND_NONBLOCK) != sizeof fresh)
        fresh[0] = fresh[1] = fresh[2] = (uint64_t)rn_clock_ns();
    char trace[RN_TRACE_ID_MAX];
    snprintf(trace, sizeof trace, "%016" PRIx64 "%016" PRIx64, fresh[0], fresh[1] | 1);
    snprintf(ret_traceparent, RN_TRACE_MAX, "00-%.32s-%016" PRIx64 "-%.2s",
             goes_on ? parent + 3 : trace, fresh[2] | 1, goes_on ? parent + 53 : "01");
}

void rn_trace_ids(const char *traceparent, char ret_trace[RN_TRACE_ID_MAX], char ret_span[17]) {
    snprintf(ret_trace, RN_TRACE_ID_MAX, "%.32s", traceparent + 3);
    snprintf(ret_span, 17, "%.16s", traceparent + 36);
}

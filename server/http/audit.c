// Who asked for what, and what came of it: the log, and a file that only grows.
#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/log.h"
#include "common/base/utf8.h"
#include "proto/audit.h"
#include "server/http/exchange.h"

enum rn_status rn_audit_open(struct rn_http *http, struct rn_error *err) {
    const char *path = http->options.audit;
    if (path == NULL) return RN_OK;
    http->audit_fd = open(path, O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC, 0600);
    return http->audit_fd < 0 ? rn_error_from_errno(err, errno, path, "open the audit") : RN_OK;
}

static const char *address_of(const struct rn_request *request, char text[INET6_ADDRSTRLEN]) {
    strcpy(text, "-");
    if (request->socket != NULL)
        inet_ntop(AF_INET6, request->socket->address, text, INET6_ADDRSTRLEN);
    return strncmp(text, "::ffff:", 7) == 0 ? text + 7 : text;
}

// One write(2), so that a line is whole or not there.
static bool add_line(int fd, const struct rn_audit_line *line) {
    struct rn_buf text;
    char *json = NULL;
    rn_buf_init(&text, 1 << 20);
    if (rn_encode(&rn_audit_line_table, line, &json, NULL, NULL) == RN_OK)
        rn_buf_printf(&text, "%s\n", json);
    bool good =
        json != NULL && !text.failed && write(fd, text.data, text.size) == (ssize_t)text.size;
    free(json);
    rn_buf_finish(&text);
    return good;
}

static void audit(const struct rn_request *request, const char *verb, const char *address) {
    struct rn_audit_line line = {.path = strdup(request->path), .status = request->status};
    if (line.path != NULL) rn_utf8_clean(line.path);
    rn_time_text(rn_clock_wall_ms(), line.time);
    snprintf(line.request, sizeof line.request, "%s", request->trace);
    snprintf(line.token, sizeof line.token, "%s", request->caller.name);
    snprintf(line.token_id, sizeof line.token_id, "%s", request->caller.id);
    snprintf(line.address, sizeof line.address, "%s", address);
    snprintf(line.verb, sizeof line.verb, "%s", verb);
    if (line.path == NULL || !add_line(request->http->audit_fd, &line))
        rn_log(RN_LOG_ERROR, "the audit cannot be written: %s %s %u %s %s", verb, request->path,
               request->status, request->trace, line.token);
    free(line.path);
}

// Writes are always told.
void rn_access_tell(const struct rn_request *request) {
    static const char *const names[] = {[RN_METHOD_GET] = "GET",
                                        [RN_METHOD_POST] = "POST",
                                        [RN_METHOD_DELETE] = "DELETE",
                                        [RN_METHOD_PATCH] = "PATCH"};
    char text[INET6_ADDRSTRLEN];
    unsigned method = request->method <= RN_METHOD_PATCH ? request->method : 0;
    const char *verb = names[method] != NULL ? names[method] : "-";
    const char *address = address_of(request, text);
    bool writes = method != 0 && request->method != RN_METHOD_GET;
    const char *before = rn_log_set_trace(request->traceparent);
    rn_log(writes ? RN_LOG_INFO : RN_LOG_DEBUG, "%s %s %u %.1f ms %s %s %s", verb, request->path,
           request->status, (double)(rn_clock_ns() - request->begin_ns) * 1e-6, address,
           request->trace, request->caller.name[0] != '\0' ? request->caller.name : "-");
    rn_log_set_trace(before);
    if (writes && request->http->audit_fd >= 0) audit(request, verb, address);
}

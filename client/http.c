#include "client/http.h"

#include <ctype.h>
#include <curl/curl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

struct rn_http {
    CURL *easy;
    CURLM *multi;
    char *host;
    char *authorization; // header line or NULL
};

static const char bearer[] = "Authorization: Bearer ";

// What libcurl's callbacks need of a running request.
struct transfer {
    const struct rn_http_request *request;
    struct rn_http_reply *reply;
    bool refused; // by `receive`
    bool aborted; // by `read`
};

// The URL of what is named without a scheme: a daemon's address, with its port or without.
// malloc'd.
static char *url_of_address(const char *address) {
    size_t size = strcspn(address, "/");
    const char *inner = memchr(address, ']', size), *from = inner ? inner : address; // of IPv6
    bool has_port = memchr(from, ':', size - (size_t)(from - address)) != NULL;
    char *url;
    return asprintf(&url, "http://%.*s%s%s", (int)size, address,
                    has_port ? "" : ":" RN_HTTP_DEFAULT_PORT, address + size) < 0
               ? NULL
               : url;
}

static char *join(const char *first, const char *second) {
    size_t size = strlen(first) + strlen(second) + 1;
    char *text = malloc(size);
    if (text) {
        memcpy(text, first, strlen(first));
        memcpy(text + strlen(first), second, strlen(second) + 1);
    }
    return text;
}

static enum rn_status not_an_address(const char *host, struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_INVALID, host,
                        "is not an http or https URL, such as " RN_HTTP_DEFAULT_HOST);
}

// Whether a request to it could be sent at all: libcurl would tell of one that could not as of a
// daemon that is away.
static bool is_url(const char *url) {
    CURLU *parsed = curl_url();
    bool is_one = parsed && curl_url_set(parsed, CURLUPART_URL, url, 0) == CURLUE_OK;
    curl_url_cleanup(parsed);
    return is_one;
}

enum rn_status rn_http_create(const char *host, const char *token, struct rn_http **ret_http,
                              struct rn_error *err) {
    const char *named = strstr(host, "://");
    const char *place = named ? named + 3 : host;
    if ((named && strncmp(host, "http://", 7) != 0 && strncmp(host, "https://", 8) != 0) ||
        !*place || strcspn(place, "/ ") == 0 || strchr(place, ' '))
        return not_an_address(host, err);
    if (token && strpbrk(token, "\r\n"))
        return rn_error_set(err, RN_ERROR_INVALID, "token", "holds a line break");
    struct rn_http *http = calloc(1, sizeof *http);
    if (!http) return rn_error_set(err, RN_ERROR_NO_MEMORY, "http", "memory ran out");
    http->host = named ? strdup(host) : url_of_address(host);
    http->authorization = token ? join(bearer, token) : NULL;
    if (curl_global_init(CURL_GLOBAL_DEFAULT) == CURLE_OK) {
        http->easy = curl_easy_init();
        http->multi = curl_multi_init();
    }
    if (!http->host || (token && !http->authorization) || !http->easy || !http->multi) {
        rn_http_destroy(&http);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "http", "memory ran out");
    }
    if (!is_url(http->host)) {
        rn_http_destroy(&http);
        return not_an_address(host, err);
    }
    for (size_t size = strlen(http->host); size && http->host[size - 1] == '/';)
        http->host[--size] = '\0';
    *ret_http = http;
    return RN_OK;
}

enum rn_status rn_http_create_twin(const struct rn_http *http, struct rn_http **ret_http,
                                   struct rn_error *err) {
    const char *token = http->authorization ? http->authorization + strlen(bearer) : NULL;
    return rn_http_create(http->host, token, ret_http, err);
}

void rn_http_destroy(struct rn_http **http) {
    if (!*http) return;
    curl_easy_cleanup((*http)->easy);
    if ((*http)->multi) curl_multi_cleanup((*http)->multi);
    free((*http)->host);
    free((*http)->authorization);
    free(*http);
    *http = NULL;
}

const char *rn_http_host(const struct rn_http *http) {
    return http->host;
}

void rn_http_reply_finish(struct rn_http_reply *reply) {
    rn_buf_finish(&reply->body);
}

void rn_http_escape(struct rn_buf *buf, const char *text) {
    for (; *text; text++) {
        unsigned char byte = (unsigned char)*text;
        if (isalnum(byte) || strchr("-_.~", byte))
            rn_buf_append(buf, text, 1);
        else
            rn_buf_printf(buf, "%%%02X", byte);
    }
}

// Copies a header's value when the line carries that header.
static void take_header(const char *line, size_t size, const char *name, char *ret_value,
                        size_t capacity) {
    size_t name_size = strlen(name);
    if (size <= name_size || line[name_size] != ':' || strncasecmp(line, name, name_size) != 0)
        return;
    const char *value = line + name_size + 1, *end = line + size;
    while (value < end && isspace((unsigned char)*value))
        value++;
    while (end > value && isspace((unsigned char)end[-1]))
        end--;
    size_t value_size = (size_t)(end - value);
    if (value_size >= capacity) value_size = capacity - 1;
    memcpy(ret_value, value, value_size);
    ret_value[value_size] = '\0';
}

static void take_budget(const char *line, size_t size, struct rn_http_reply *reply) {
    const struct {
        const char *name;
        char *value;
        size_t capacity;
    } headers[] = {
        {"X-Ripnerf-Asked-Ms", reply->budget.asked_ms, sizeof reply->budget.asked_ms},
        {"X-Ripnerf-Spent-Ms", reply->budget.spent_ms, sizeof reply->budget.spent_ms},
        {"X-Ripnerf-Setting", reply->budget.setting, sizeof reply->budget.setting},
        {"X-Ripnerf-Curve", reply->budget.curve, sizeof reply->budget.curve},
        {"X-Ripnerf-Expected-Psnr", reply->budget.expected_psnr,
         sizeof reply->budget.expected_psnr},
        {"X-Ripnerf-Expected-Spread", reply->budget.expected_spread,
         sizeof reply->budget.expected_spread},
        {"X-Ripnerf-Late", reply->budget.late, sizeof reply->budget.late},
    };
    for (size_t i = 0; i < sizeof headers / sizeof *headers; i++)
        take_header(line, size, headers[i].name, headers[i].value, headers[i].capacity);
}

static size_t on_header(char *line, size_t one, size_t size, void *context) {
    struct rn_http_reply *reply = ((struct transfer *)context)->reply;
    char retry_after[16] = "";
    const char *code = memchr(line, ' ', size);
    if (size > 5 && strncmp(line, "HTTP/", 5) == 0 && code) reply->status = atoi(code);
    take_header(line, size, "Content-Type", reply->content_type, sizeof reply->content_type);
    take_header(line, size, "Location", reply->location, sizeof reply->location);
    take_header(line, size, "Server-Timing", reply->server_timing, sizeof reply->server_timing);
    take_header(line, size, "X-Ripnerf-Step", reply->step, sizeof reply->step);
    take_header(line, size, "X-Ripnerf-At", reply->at, sizeof reply->at);
    take_header(line, size, "X-Ripnerf-Scale", reply->scale, sizeof reply->scale);
    take_budget(line, size, reply);
    take_header(line, size, "Retry-After", retry_after, sizeof retry_after);
    if (*retry_after) reply->retry_after_s = atoi(retry_after);
    return one * size;
}

static size_t on_read(char *buffer, size_t one, size_t size, void *context) {
    struct transfer *transfer = context;
    const struct rn_http_request *request = transfer->request;
    size_t got = request->read(request->context, buffer, one * size);
    transfer->aborted = got == SIZE_MAX;
    return transfer->aborted ? CURL_READFUNC_ABORT : got;
}

static size_t on_write(char *bytes, size_t one, size_t size, void *context) {
    struct transfer *transfer = context;
    const struct rn_http_request *request = transfer->request;
    if (request->receive && transfer->reply->status / 100 == 2) {
        transfer->refused = !request->receive(request->context, bytes, one * size);
        return transfer->refused ? 0 : one * size;
    }
    rn_buf_append(&transfer->reply->body, bytes, one * size);
    return transfer->reply->body.failed ? 0 : one * size;
}

static struct curl_slist *add_header(struct curl_slist *list, const char *name, const char *value,
                                     bool *failed) {
    char line[8192];
    if (!value) return list;
    int size = snprintf(line, sizeof line, "%s%s", name, value);
    struct curl_slist *longer = NULL;
    if (size > 0 && (size_t)size < sizeof line) longer = curl_slist_append(list, line);
    *failed = *failed || !longer;
    return longer ? longer : list;
}

static struct curl_slist *headers_of(const struct rn_http *http,
                                     const struct rn_http_request *request, bool *failed) {
    struct curl_slist *list = NULL;
    list = add_header(list, "", http->authorization, failed);
    list = add_header(list, "Content-Type:", request->content_type ? request->content_type : "",
                      failed);
    list = add_header(list, "Accept: ", request->accept, failed);
    list = add_header(list, "Upload-Offset: ", request->upload_offset, failed);
    return add_header(list, "Last-Event-ID: ", request->last_event_id, failed);
}

static void set_options(CURL *easy, struct transfer *transfer, const char *url,
                        struct curl_slist *headers) {
    const struct rn_http_request *request = transfer->request;
    curl_easy_reset(easy);
    curl_easy_setopt(easy, CURLOPT_URL, url);
    curl_easy_setopt(easy, CURLOPT_PATH_AS_IS, 1L);
    curl_easy_setopt(easy, CURLOPT_PROTOCOLS_STR, "http,https");
    curl_easy_setopt(easy, CURLOPT_PROXY, "");
    curl_easy_setopt(easy, CURLOPT_NOSIGNAL, 1L);
    curl_easy_setopt(easy, CURLOPT_CONNECTTIMEOUT, 10L);
    curl_easy_setopt(easy, CURLOPT_HTTPHEADER, headers);
    curl_easy_setopt(easy, CURLOPT_HEADERFUNCTION, on_header);
    curl_easy_setopt(easy, CURLOPT_HEADERDATA, transfer);
    curl_easy_setopt(easy, CURLOPT_WRITEFUNCTION, on_write);
    curl_easy_setopt(easy, CURLOPT_WRITEDATA, transfer);
    if (request->idle_s) {
        curl_easy_setopt(easy, CURLOPT_LOW_SPEED_LIMIT, 1L);
        curl_easy_setopt(easy, CURLOPT_LOW_SPEED_TIME, (long)request->idle_s);
    }
    if (request->read) {
        curl_easy_setopt(easy, CURLOPT_POST, 1L);
        curl_easy_setopt(easy, CURLOPT_READFUNCTION, on_read);
        curl_easy_setopt(easy, CURLOPT_READDATA, transfer);
    } else if (strcmp(request->method, "POST") == 0) {
        curl_easy_setopt(easy, CURLOPT_POSTFIELDS, request->body ? request->body : "");
    }
    curl_easy_setopt(easy, CURLOPT_POSTFIELDSIZE_LARGE, (curl_off_t)request->body_size);
    if (strcmp(request->method, "GET") != 0)
        curl_easy_setopt(easy, CURLOPT_CUSTOMREQUEST, request->method);
}

// Runs the transfer; CURLE_ABORTED_BY_CALLBACK when the interrupt came first.
static CURLcode run(struct rn_http *http, int interrupt_fd) {
    CURLcode result = CURLE_OUT_OF_MEMORY;
    struct curl_waitfd interrupt = {.fd = interrupt_fd, .events = CURL_WAIT_POLLIN};
    if (curl_multi_add_handle(http->multi, http->easy) != CURLM_OK) return result;
    for (int running = 1; running;) {
        int queued;
        CURLMsg *message = NULL;
        if (curl_multi_perform(http->multi, &running) != CURLM_OK) break;
        while (!running && (message = curl_multi_info_read(http->multi, &queued)))
            result = message->data.result;
        if (running &&
            curl_multi_poll(http->multi, &interrupt, interrupt_fd > 0, 1000, NULL) != CURLM_OK)
            break;
        if (running && interrupt_fd > 0 && interrupt.revents) {
            result = CURLE_ABORTED_BY_CALLBACK;
            break;
        }
    }
    curl_multi_remove_handle(http->multi, http->easy);
    return result;
}

static enum rn_status explain(const struct rn_http *http, const struct transfer *transfer,
                              CURLcode code, const char *detail, struct rn_error *err) {
    bool answered = transfer->reply->status / 100 > 2; // an upload refused on its way
    if (code == CURLE_OK || (transfer->refused && code == CURLE_WRITE_ERROR) ||
        (answered && code == CURLE_SEND_ERROR))
        return RN_OK;
    if (code == CURLE_ABORTED_BY_CALLBACK || transfer->aborted)
        return rn_error_set(err, RN_ERROR_CANCELLED, http->host, "the request was interrupted");
    if (transfer->reply->body.failed)
        return rn_buf_status(&transfer->reply->body, "the answer", err);
    if (code == CURLE_OUT_OF_MEMORY)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, http->host, "memory ran out");
    return rn_error_set(err, RN_ERROR_UNAVAILABLE, http->host,
                        "the daemon cannot be reached: %s; start it with ripnerfd --data DIR, or "
                        "name another with --host",
                        *detail ? detail : curl_easy_strerror(code));
}

enum rn_status rn_http_perform(struct rn_http *http, const struct rn_http_request *request,
                               struct rn_http_reply *ret_reply, struct rn_error *err) {
    struct transfer transfer = {.request = request, .reply = ret_reply};
    char detail[CURL_ERROR_SIZE] = "";
    bool failed = false;
    memset(ret_reply, 0, sizeof *ret_reply);
    rn_buf_init(&ret_reply->body, RN_HTTP_MAX_BODY);
    struct curl_slist *headers = headers_of(http, request, &failed);
    char *url = join(http->host, request->path);
    CURLcode code = CURLE_OUT_OF_MEMORY;
    if (url && !failed) {
        set_options(http->easy, &transfer, url, headers);
        curl_easy_setopt(http->easy, CURLOPT_ERRORBUFFER, detail);
        code = run(http, request->interrupt_fd);
        curl_easy_setopt(http->easy, CURLOPT_ERRORBUFFER, NULL);
    }
    free(url);
    curl_slist_free_all(headers);
    return explain(http, &transfer, code, detail, err);
}

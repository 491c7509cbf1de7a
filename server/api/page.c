// The web page's files.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/file.h"
#include "server/api/app.h"

static const char *type_of(const char *name) {
    static const struct {
        const char *ending, *type;
    } types[] = {
        {".html", "text/html; charset=utf-8"},
        {".js", "text/javascript; charset=utf-8"},
        {".css", "text/css; charset=utf-8"},
        {".svg", "image/svg+xml"},
        {".png", "image/png"},
        {".ico", "image/x-icon"},
        {".json", "application/json"},
        {".woff2", "font/woff2"},
    };
    const char *ending = strrchr(name, '.');
    for (size_t i = 0; ending != NULL && i < sizeof types / sizeof types[0]; i++)
        if (strcmp(types[i].ending, ending) == 0) return types[i].type;
    return NULL;
}

// Every component must be a safe name: nothing outside the folder can be reached.
static bool is_safe(const char *path) {
    char copy[RN_MAX_PARAM_BYTES], *rest = copy, *name;
    snprintf(copy, sizeof copy, "%s", path);
    while ((name = strsep(&rest, "/")) != NULL)
        if (!rn_path_is_safe_name(name)) return false;
    return true;
}

// The page's parts are kept for a moment, so that a page that lost one of them on its way, and is
// loaded anew, asks for that one alone.
static void send(struct rn_app *app, const char *name, const char *keep, struct rn_reply *reply) {
    char *path = NULL;
    const char *type = type_of(name);
    if (type == NULL || !is_safe(name)) {
        rn_reply_problem(reply, RN_PROBLEM_NOT_FOUND, "the page has no file '%.200s'", name);
    } else if (asprintf(&path, "%s/%s", app->web, name) < 0) {
        rn_reply_problem(reply, RN_PROBLEM_INTERNAL, "no memory for the page");
    } else {
        rn_reply_file(reply, type, path);
        if (reply->body != RN_BODY_FILE) {
            rn_reply_finish(reply);
            rn_reply_problem(reply, RN_PROBLEM_NOT_FOUND, "the page has no file '%.200s'", name);
        }
        free(path);
    }
    rn_reply_header(reply, "Cache-Control", "%s", reply->body == RN_BODY_FILE ? keep : "no-cache");
    rn_reply_header(
        reply, "Content-Security-Policy",
        "default-src 'self'; img-src 'self' blob:; media-src 'self' blob:; object-src 'none'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'");
    rn_reply_header(reply, "Referrer-Policy", "no-referrer");
}

void rn_get_page(void *context, struct rn_request *request, struct rn_reply *reply) {
    send(context, "index.html", "no-cache", reply);
}

void rn_get_page_file(void *context, struct rn_request *request, struct rn_reply *reply) {
    send(context, rn_request_param(request, 0), "max-age=20", reply);
}

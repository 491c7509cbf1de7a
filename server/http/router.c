#include "server/http/router.h"

#include <string.h>

static bool take_param(struct rn_match *match, const char *text, size_t size) {
    if (size == 0 || size >= RN_MAX_PARAM_BYTES || match->param_count == RN_MAX_PARAMS)
        return false;
    char *param = match->params[match->param_count++];
    memcpy(param, text, size);
    param[size] = '\0';
    return true;
}

static bool match_pattern(const char *pattern, const char *path, struct rn_match *match) {
    match->param_count = 0;
    while (*pattern != '\0') {
        if (*pattern == '*') return take_param(match, path, strlen(path));
        if (*pattern == '{') {
            size_t size = strcspn(path, "/");
            if (!take_param(match, path, size)) return false;
            path += size;
            pattern = strchr(pattern, '}') + 1;
        } else if (*pattern++ != *path++) {
            return false;
        }
    }
    return *path == '\0';
}

void rn_router_match(const struct rn_route *routes, unsigned method, const char *path,
                     struct rn_match *ret_match) {
    struct rn_match found = {0};
    for (const struct rn_route *route = routes; route->pattern != NULL; route++) {
        struct rn_match match = {0};
        if (!match_pattern(route->pattern, path, &match)) continue;
        found.allowed |= route->method;
        if (route->method != method || found.route != NULL) continue;
        unsigned allowed = found.allowed;
        found = match;
        found.allowed = allowed;
        found.route = route;
    }
    *ret_match = found;
}

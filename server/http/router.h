// Which handler answers a path: a table of patterns, matched segment by segment.
#ifndef RN_SERVER_HTTP_ROUTER_H
#define RN_SERVER_HTTP_ROUTER_H

#include "server/http/message.h"

enum {
    RN_ROUTE_OPEN = 1,   // needs no token
    RN_ROUTE_ALWAYS = 2, // answered over the limit of connections, too
    // What its caller's token must allow; to read, where none is given.
    RN_ROUTE_RENDER = 4,
    RN_ROUTE_TRAIN = 8,
    RN_ROUTE_ADMIN = 16,
    // What a link may ask for: its own scene or job, named by the first parameter; what concerns
    // none in particular.
    RN_ROUTE_OF_SCENE = 32,
    RN_ROUTE_OF_JOB = 64,
    RN_ROUTE_OF_NONE = 128,
};

// Immutable. `pattern` is absolute; "{…}" stands for one non-empty segment, a final "*" for the
// rest of the path (one parameter, may hold slashes).
struct rn_route {
    enum rn_method method;
    const char *pattern;
    unsigned flags;
    size_t max_body_bytes; // 0: the route takes no body
    void (*handle)(void *context, struct rn_request *request, struct rn_reply *reply);
    // Optional: called when only the headers are here. A reply filled here refuses the body.
    void (*begin)(void *context, struct rn_request *request, struct rn_reply *reply);
};

#define RN_MAX_PARAM_BYTES 256

struct rn_match {
    const struct rn_route *route; // NULL: none with this method
    unsigned allowed;             // methods that the path knows; 0: no such path
    int param_count;
    char params[RN_MAX_PARAMS][RN_MAX_PARAM_BYTES];
};

// `routes` ends with a pattern of NULL. The first match wins; method 0 matches no route but still
// fills `allowed`.
void rn_router_match(const struct rn_route *routes, unsigned method, const char *path,
                     struct rn_match *ret_match);

#endif

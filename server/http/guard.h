// Who may talk to the daemon: pure checks on header texts.
#ifndef RN_SERVER_HTTP_GUARD_H
#define RN_SERVER_HTTP_GUARD_H

#include <stdbool.h>

// The token of an Authorization header (may be NULL), "Bearer <token>"; NULL when it is none.
const char *rn_guard_bearer(const char *authorization);

// True when a Host header ("name", "name:port", "[::1]:port"; may be NULL) names this machine's
// loopback: localhost, 127.0.0.0/8 or ::1, at any port (ports may be forwarded). A page of a
// foreign site that was rebound to 127.0.0.1 still sends its own name.
bool rn_guard_host_is_loopback(const char *host);

// True when a browser's Origin (may be NULL: not a browser) is the host the request went to.
bool rn_guard_origin(const char *origin, const char *host);

// True when a listen address is loopback.
bool rn_guard_address_is_loopback(const char *address);

#endif

#include "server/http/guard.h"

#include <arpa/inet.h>
#include <string.h>
#include <strings.h>

const char *rn_guard_bearer(const char *authorization) {
    static const char scheme[] = "Bearer ";
    if (authorization == NULL || strncasecmp(authorization, scheme, sizeof scheme - 1) != 0)
        return NULL;
    const char *token = authorization + sizeof scheme - 1;
    return *token != '\0' ? token : NULL;
}

bool rn_guard_address_is_loopback(const char *address) {
    struct in_addr v4;
    struct in6_addr v6;
    if (inet_pton(AF_INET, address, &v4) == 1) return ntohl(v4.s_addr) >> 24 == 127;
    if (inet_pton(AF_INET6, address, &v6) == 1) return IN6_IS_ADDR_LOOPBACK(&v6);
    return strcasecmp(address, "localhost") == 0;
}

bool rn_guard_host_is_loopback(const char *host) {
    char name[256];
    if (host == NULL) return false;
    bool bracket = host[0] == '[';
    const char *start = bracket ? host + 1 : host;
    size_t size = strcspn(start, bracket ? "]" : ":");
    if (size == 0 || size >= sizeof name) return false;
    memcpy(name, start, size);
    name[size] = '\0';
    const char *rest = start + size;
    if (bracket && *rest++ != ']') return false;
    if (*rest != '\0' && (*rest != ':' || rest[1 + strspn(rest + 1, "0123456789")] != '\0'))
        return false;
    return rn_guard_address_is_loopback(name);
}

bool rn_guard_origin(const char *origin, const char *host) {
    if (origin == NULL) return true;
    const char *rest = strstr(origin, "://");
    return rest != NULL && host != NULL && strcasecmp(rest + 3, host) == 0;
}

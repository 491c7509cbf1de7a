// Who may ask for what: tokens with their scopes, links, rates. Used on the HTTP thread alone.
#ifndef RN_SERVER_API_ACCESS_H
#define RN_SERVER_API_ACCESS_H

#include "server/http/router.h"
#include "server/store/store.h"

struct rn_access; // the tokens, read once and kept as the store has them

struct rn_access_options {
    const char *own_token;           // --token-file's; NULL: none
    int64_t max_rate;                // requests a second of a token, but of the own one; 0: any
    int64_t quota_jobs, quota_bytes; // of tokens without quotas of their own; 0: none
};
enum rn_status rn_access_create(const struct rn_access_options *options, struct rn_store *store,
                                struct rn_access **ret_access, struct rn_error *err) RN_MUST_CHECK;
void rn_access_destroy(struct rn_access **access);

// Makes a token, writes its digest and tells its secret, this once. RN_ERROR_CONFLICT when the name
// is taken, RN_ERROR_LIMIT when there are too many.
#define RN_SECRET_MAX 40
enum rn_status rn_access_make(struct rn_access *access, struct rn_token_row *row,
                              char ret_secret[RN_SECRET_MAX], struct rn_error *err) RN_MUST_CHECK;
// Takes it away: no request of it is served from now on.
enum rn_status rn_access_revoke(struct rn_access *access, const char *id,
                                struct rn_error *err) RN_MUST_CHECK;

// struct rn_http_options' authorise; `app` is the struct rn_app.
bool rn_access_authorise(void *app, struct rn_request *request, const char *token,
                         struct rn_caller *ret_caller, struct rn_reply *reply);
// Its stays: false once the caller's token was revoked or has expired.
bool rn_access_stays(void *app, const struct rn_caller *caller);

static inline bool rn_caller_is_link(const struct rn_caller *caller) {
    return caller->scene[0] != '\0' || caller->job[0] != '\0';
}

#endif

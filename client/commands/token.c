// token: who may do what, and links that show one thing.

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "client/commands/submit.h"
#include "client/progress.h"
#include "proto/token.h"

struct token_options {
    const char *scope, *scene, *job;
    double expires_s, max_bytes;
    int64_t max_jobs;
};
#define TOKEN(m) .offset = offsetof(struct token_options, m)
static const struct rn_option token_table[] = {
    {.name = "scope",
     .kind = RN_OPTION_CHOICE,
     TOKEN(scope),
     .value = "SCOPE",
     .choices = rn_scope_names,
     .help = "what it allows, each with the ones before it: read"},
    {.name = "scene",
     .kind = RN_OPTION_TEXT,
     TOKEN(scene),
     .value = "SCENE",
     .help = "a link: it shows that scene, at any camera, and nothing else"},
    {.name = "job",
     .kind = RN_OPTION_TEXT,
     TOKEN(job),
     .value = "JOB",
     .help = "a link: it shows the frames and the film of that path and nothing else"},
    {.name = "expires",
     .kind = RN_OPTION_SECONDS,
     TOKEN(expires_s),
     .value = "TIME",
     .help = "from now, such as 720h; else it stays good until it is revoked",
     .min = 1,
     .max = 315576000},
    {.name = "max-jobs",
     .kind = RN_OPTION_INTEGER,
     TOKEN(max_jobs),
     .value = "N",
     .help = "unfinished jobs that it may have; else the daemon's --quota-jobs",
     .min = 1,
     .max = 10000},
    {.name = "max-bytes",
     .kind = RN_OPTION_BYTES,
     TOKEN(max_bytes),
     .value = "BYTES",
     .help = "of what its jobs make; else the daemon's --quota-disk",
     .min = 1,
     .max = 1e15},
    {0}};

// The secret alone, for scripts; the address of a link.
static enum rn_exit print_made(struct rn_client *client, const struct rn_api_reply *reply) {
    struct rn_token_record made;
    if (client->json) {
        puts((char *)reply->http.body.data);
        return RN_EXIT_OK;
    }
    enum rn_exit code = rn_api_decode(reply, &rn_token_table, &made);
    if (code != RN_EXIT_OK) return code;
    if (*made.scene || *made.job)
        printf("%s/#t=%s/%s/%s\n", rn_http_host(client->http), made.token,
               *made.scene ? "scene" : "job", *made.scene ? made.scene : made.job);
    else
        puts(made.token);
    fprintf(stderr, "token '%s' is told this once; to take it away: ripnerf token revoke %s\n",
            made.name, made.name);
    return RN_EXIT_OK;
}

static enum rn_exit make(struct rn_client *client, const struct token_options *options,
                         const char *name) {
    struct rn_token_request wanted;
    struct rn_api_reply reply;
    if (!name) return rn_client_usage("token", "make needs a name");
    rn_message_init(&rn_token_request_table, &wanted);
    if (!rn_take_text("NAME", name, NULL, wanted.name, sizeof wanted.name) ||
        !rn_take_text("--scene", options->scene, NULL, wanted.scene, sizeof wanted.scene) ||
        !rn_take_text("--job", options->job, NULL, wanted.job, sizeof wanted.job))
        return RN_EXIT_USAGE;
    if (options->scope) wanted.scope = rn_name_index(rn_scope_names, options->scope);
    if (!isnan(options->expires_s)) wanted.expires_s = (int64_t)options->expires_s;
    if (!isnan(options->max_bytes)) wanted.max_bytes = (int64_t)options->max_bytes;
    if (options->max_jobs != RN_OPTION_ABSENT) wanted.max_jobs = options->max_jobs;
    char *body = rn_api_encode(&rn_token_request_table, &wanted);
    if (!body) return RN_EXIT_FAILED;
    rn_api_send(client, "POST", "/v1/tokens", body, &reply);
    free(body);
    enum rn_exit code =
        reply.code == RN_EXIT_OK ? print_made(client, &reply) : rn_api_complain(&reply);
    rn_api_reply_finish(&reply);
    return code;
}

static void token_row(struct rn_text_table *table, const void *message) {
    const struct rn_token_record *token = message;
    char bytes[24];
    rn_format_bytes((double)token->bytes, bytes, sizeof bytes);
    rn_text_table_row(table, "%s|%s|%s|%s|%lld|%s|%s", token->name, token->id,
                      *token->scene || *token->job ? "link" : rn_scope_names[token->scope],
                      *token->scene ? token->scene : token->job, (long long)token->open_jobs, bytes,
                      *token->expires_at ? token->expires_at : "never");
}

static enum rn_exit list(struct rn_client *client) {
    static const struct rn_api_list tokens = {.kind = RN_KIND_TOKEN,
                                              .table = &rn_token_table,
                                              .heading = "NAME|ID|SCOPE|OF|>JOBS|>BYTES|EXPIRES",
                                              .row = token_row};
    return rn_api_print_list(client, &tokens);
}

static enum rn_exit revoke(struct rn_client *client, const char *name) {
    struct rn_api_reply reply;
    if (!name) return rn_client_usage("token", "revoke needs a token's name or id");
    char *path = rn_api_path("tokens", name, "");
    if (!path) return RN_EXIT_FAILED;
    rn_api_send(client, "DELETE", path, NULL, &reply);
    free(path);
    enum rn_exit code = reply.code == RN_EXIT_OK ? RN_EXIT_OK : rn_api_complain(&reply);
    if (code == RN_EXIT_OK && !client->json) printf("revoked %s\n", name);
    rn_api_reply_finish(&reply);
    return code;
}

static enum rn_exit run_token(struct rn_client *client, const void *options, const char **args) {
    const char *word = args[0];
    char given[64];
    if (strcmp(word, "make") == 0) return make(client, options, args[1]);
    if (rn_options_given(token_table, options, given, sizeof given))
        return rn_client_usage(given, "is of token make");
    if (strcmp(word, "revoke") == 0) return revoke(client, args[1]);
    if (strcmp(word, "ls") == 0 && !args[1]) return list(client);
    return rn_client_usage(word, "must be make NAME, ls or revoke NAME");
}

const struct rn_verb rn_verbs_token[] = {
    {.name = "token",
     .arguments = "make|ls|revoke ...",
     .summary = "tokens, which let others in as far as their scopes reach, and links",
     .details = "token make NAME prints a token, this once; the daemon keeps its digest. With\n"
                "--scene or --job it prints a link for a browser, with the token in the part of\n"
                "the address that is never sent to a server. token ls, token revoke NAME.",
     .args_min = 1,
     .args_max = 2,
     .table = token_table,
     .options_size = sizeof(struct token_options),
     .run = run_token},
    {0}};

// Submitting jobs, for the verbs that do.
#ifndef RN_CLIENT_COMMANDS_SUBMIT_H
#define RN_CLIENT_COMMANDS_SUBMIT_H

#include "client/api.h"
#include "client/follow.h"
#include "proto/job.h"

// POSTs a job request's JSON. Complains when it is refused. On success the job's id, and its JSON,
// malloc'd, the caller's to free.
enum rn_exit rn_submit(struct rn_client *client, const char *body, char ret_job[RN_ID_MAX],
                       char **ret_json);
// Takes up an earlier call's job; where that has failed or was cancelled, `job` becomes the one
// that goes on with its frames. Complains.
enum rn_exit rn_take_up(struct rn_client *client, char job[RN_ID_MAX]);
// As rn_submit, of a body that it frees (NULL: RN_EXIT_FAILED), and waits as rn_follow_job does.
// The follow is the caller's to finish, whatever is returned.
enum rn_exit rn_submit_and_follow(struct rn_client *client, char *body,
                                  struct rn_follow *ret_follow);
// An option's text into a field of a request, where it was given: checked as proto/checks.h does
// (NULL: by its length alone). false, with a complaint, where it does not do.
bool rn_take_text(const char *option, const char *text, const char *(*check)(const char *),
                  char *ret_field, size_t capacity);
// The quote that a shell needs around a word: "'", or "" where it needs none.
const char *rn_quote_of(const char *word);
// A usage error where --name is missing, with the command that has one: `ripnerf VERB SOURCE`, and
// the name of the source, a file or folder here or something of the daemon's.
enum rn_exit rn_name_missing(const char *verb, const char *source);
// --crop's box into a request, where there is one; false, with a complaint, where it is none.
bool rn_crop_option(const char *text, double ret_crop[6]);
// A usage error where settings ask for more than one budget, or for one beside others.
enum rn_exit rn_check_budget(const union rn_setting_value settings[RN_RENDER_SETTINGS]);

#endif

// Shells' completions, out of the tables of verbs and options.
#ifndef RN_CLIENT_COMPLETION_H
#define RN_CLIENT_COMPLETION_H

#include <stdbool.h>
#include <stddef.h>

#include "client/client.h"

// A script for "bash", "zsh" or "fish" on stdout; false: another shell.
bool rn_completion_print(const char *shell, const struct rn_verb *const *groups, size_t count,
                         const struct rn_option *globals);

#endif

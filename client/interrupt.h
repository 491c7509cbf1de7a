// Ctrl-C while waiting: it ends the wait, not the program.
#ifndef RN_CLIENT_INTERRUPT_H
#define RN_CLIENT_INTERRUPT_H

#include <stdbool.h>

#include "common/base/status.h"

// From here on SIGINT, SIGTERM and, unless it is ignored, SIGHUP only make rn_interrupt_fd
// readable, and end whatever request runs or comes; a second one ends the program at once. Called
// by the main thread; again: no more.
enum rn_status rn_interrupt_catch(struct rn_error *err) RN_MUST_CHECK;
// 0 before rn_interrupt_catch.
int rn_interrupt_fd(void);
bool rn_interrupt_seen(void);
// Waits; returns early, and true, when interrupted.
bool rn_interrupt_sleep(int milliseconds);

#endif

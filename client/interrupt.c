#include "client/interrupt.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <string.h>
#include <unistd.h>

static int interrupt_pipe[2];
static volatile sig_atomic_t interrupted;

static void on_signal(int number) {
    int saved = errno;
    interrupted = 1;
    if (write(interrupt_pipe[1], "", 1) < 0) {
        // The pipe is full: it is readable already.
    }
    errno = saved;
}

enum rn_status rn_interrupt_catch(struct rn_error *err) {
    struct sigaction action = {.sa_handler = on_signal,
                               .sa_flags = (int)(SA_RESETHAND | SA_RESTART)},
                     before;
    if (interrupt_pipe[0]) return RN_OK;
    sigemptyset(&action.sa_mask);
    if (pipe2(interrupt_pipe, O_CLOEXEC | O_NONBLOCK) != 0 ||
        sigaction(SIGINT, &action, NULL) != 0 || sigaction(SIGTERM, &action, NULL) != 0 ||
        sigaction(SIGHUP, NULL, &before) != 0 ||
        (before.sa_handler != SIG_IGN && sigaction(SIGHUP, &action, NULL) != 0)) // nohup ignores it
        return rn_error_from_errno(err, errno, "signals", "catch Ctrl-C");
    return RN_OK;
}

int rn_interrupt_fd(void) {
    return interrupt_pipe[0];
}

bool rn_interrupt_seen(void) {
    return interrupted;
}

bool rn_interrupt_sleep(int milliseconds) {
    struct pollfd wait = {.fd = interrupt_pipe[0], .events = POLLIN};
    if (!interrupted) (void)poll(&wait, interrupt_pipe[0] > 0, milliseconds);
    return interrupted;
}

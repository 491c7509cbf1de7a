// Preloaded in tests: clocks are set, while a program runs.
//
// RIPNERF_WALL_SHIFT names a file of sixteen bytes: the seconds by which the wall clock is ahead
// now, and those by which the monotonic one is. It is mapped at the start, since a confined runner
// opens no such file later.
#include <fcntl.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static const volatile int64_t *shift_s;

__attribute__((constructor(101))) static void begin(void) {
    const char *path = getenv("RIPNERF_WALL_SHIFT");
    int fd = path != NULL ? open(path, O_RDONLY | O_CLOEXEC) : -1;
    if (fd < 0) return;
    void *page = mmap(NULL, 2 * sizeof *shift_s, PROT_READ, MAP_SHARED, fd, 0);
    if (page == MAP_FAILED) abort();
    shift_s = page;
    close(fd);
}

static int64_t shift(int clock) {
    return shift_s != NULL ? shift_s[clock] : 0;
}

int clock_gettime(clockid_t id, struct timespec *ret_now) {
    int result = (int)syscall(SYS_clock_gettime, id, ret_now);
    if (result == 0 && (id == CLOCK_REALTIME || id == CLOCK_REALTIME_COARSE))
        ret_now->tv_sec += (time_t)shift(0);
    if (result == 0 && (id == CLOCK_MONOTONIC || id == CLOCK_MONOTONIC_COARSE))
        ret_now->tv_sec += (time_t)shift(1);
    return result;
}

int gettimeofday(struct timeval *restrict ret_now, void *restrict zone) {
    struct timespec now;
    (void)zone;
    if (clock_gettime(CLOCK_REALTIME, &now) != 0) return -1;
    *ret_now = (struct timeval){.tv_sec = now.tv_sec, .tv_usec = now.tv_nsec / 1000};
    return 0;
}

time_t time(time_t *ret_now) {
    struct timespec now;
    if (clock_gettime(CLOCK_REALTIME, &now) != 0) return (time_t)-1;
    if (ret_now != NULL) *ret_now = now.tv_sec;
    return now.tv_sec;
}

// Preloaded in tests: makes the n-th call of a kind fail, in one of the two programs.
//
// RIPNERF_FAULTS names a file that the test maps too; it holds a struct plan. `left` counts down
// with each call of the kind; the call that takes it to 0 fails, and with `for_good` all that
// follow do. `hits` counts failures.
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <unistd.h>

enum kind { NONE, MALLOC, WRITE, SHORT_WRITE, SYNC, OPEN, RENAME, MKDIR, SOCKET, ACCEPT, READ };

struct plan {
    atomic_int kind, left, hits, error, for_good;
    char program[16]; // as /proc/self/comm
};

static struct plan none, *plan = &none;

__attribute__((constructor)) static void begin(void) {
    const char *path = getenv("RIPNERF_FAULTS");
    int fd = path ? open(path, O_RDWR | O_CLOEXEC) : -1;
    void *mapped =
        fd < 0 ? MAP_FAILED : mmap(NULL, sizeof *plan, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (fd >= 0) close(fd);
    if (mapped == MAP_FAILED) return;
    const struct plan *wanted = mapped;
    const char *name = program_invocation_short_name;
    if (strncmp(name, wanted->program, sizeof wanted->program) == 0) plan = mapped;
}

static bool fails(enum kind kind) {
    if (atomic_load_explicit(&plan->kind, memory_order_relaxed) != (int)kind) return false;
    int left = atomic_fetch_sub(&plan->left, 1);
    if (left != 1 && !(left < 1 && atomic_load(&plan->for_good))) return false;
    atomic_fetch_add(&plan->hits, 1);
    errno = kind == MALLOC ? ENOMEM : atomic_load(&plan->error);
    return true;
}

// The next definition of this function.
#define NEXT(name) (__extension__(__typeof__(&name)) dlsym(RTLD_NEXT, #name))

// dlsym allocates: these go to the C library's own names.
void *__libc_malloc(size_t size);
void *__libc_calloc(size_t count, size_t size);
void *__libc_realloc(void *old, size_t size);

void *malloc(size_t size) {
    return fails(MALLOC) ? NULL : __libc_malloc(size);
}
void *calloc(size_t count, size_t size) {
    return fails(MALLOC) ? NULL : __libc_calloc(count, size);
}
void *realloc(void *old, size_t size) {
    return fails(MALLOC) ? NULL : __libc_realloc(old, size);
}

static bool is_file(int fd) {
    struct stat about;
    return fstat(fd, &about) == 0 && S_ISREG(about.st_mode);
}

ssize_t write(int fd, const void *data, size_t size) {
    static __typeof__(&write) next;
    if (!next) next = NEXT(write);
    if (is_file(fd) && fails(WRITE)) return -1;
    if (size > 1 && is_file(fd) && fails(SHORT_WRITE)) size /= 2;
    return next(fd, data, size);
}
ssize_t pwrite64(int fd, const void *data, size_t size, off64_t at) {
    static __typeof__(&pwrite64) next;
    if (!next) next = NEXT(pwrite64);
    if (fails(WRITE)) return -1;
    if (size > 1 && fails(SHORT_WRITE)) size /= 2;
    return next(fd, data, size, at);
}
int fsync(int fd) {
    return fails(SYNC) ? -1 : NEXT(fsync)(fd);
}
int fdatasync(int fd) {
    return fails(SYNC) ? -1 : NEXT(fdatasync)(fd);
}

#define OPEN_LIKE(name)                                                                            \
    int name(const char *path, int flags, ...) {                                                   \
        va_list args;                                                                              \
        va_start(args, flags);                                                                     \
        mode_t mode = va_arg(args, mode_t);                                                        \
        va_end(args);                                                                              \
        return fails(OPEN) ? -1 : NEXT(name)(path, flags, mode);                                   \
    }
OPEN_LIKE(open)
OPEN_LIKE(open64)

int rename(const char *from, const char *to) {
    return fails(RENAME) ? -1 : NEXT(rename)(from, to);
}
int mkdir(const char *path, mode_t mode) {
    return fails(MKDIR) ? -1 : NEXT(mkdir)(path, mode);
}
int socketpair(int domain, int type, int protocol, int pair[2]) {
    return fails(SOCKET) ? -1 : NEXT(socketpair)(domain, type, protocol, pair);
}
int accept4(int fd, __SOCKADDR_ARG address, socklen_t *size, int flags) {
    return fails(ACCEPT) ? -1 : NEXT(accept4)(fd, address, size, flags);
}
ssize_t recv(int fd, void *data, size_t size, int flags) {
    return fails(READ) ? -1 : NEXT(recv)(fd, data, size, flags);
}
ssize_t read(int fd, void *data, size_t size) {
    return fails(READ) ? -1 : NEXT(read)(fd, data, size);
}

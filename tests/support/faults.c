// Preloaded in tests: makes the n-th call of a kind fail, or each call once for every way that
// leads to it, in one of the two programs.
//
// RIPNERF_FAULTS names a file that the test maps too; it holds a struct plan. `left` counts down
// with each call of the kind; the call that takes it to 0 fails, and with `for_good` all that
// follow do. `hits` counts failures. Of kind DISTINCT, a call of any kind fails when its stack is
// none of those tried and `left` is not 0, which it takes one from; so the test sees one at a time.
// Those tried are in the file RIPNERF_FAULTS_TRIED, which several programs may share.
// Of kind SURVEY such a stack is noted as met and nothing fails.
#include <dirent.h>
#include <dlfcn.h>
#include <poll.h>
#include <pthread.h>
#include <spawn.h>
#include <errno.h>
#include <fcntl.h>
#include <link.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/random.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <sys/types.h>
#include <sys/wait.h>
#include <unistd.h>
#include <unwind.h>

enum kind {
    NONE,
    MALLOC,
    WRITE,
    SHORT_WRITE,
    SYNC,
    OPEN,
    RENAME,
    MKDIR,
    SOCKET,
    ACCEPT,
    READ,
    UNLINK,
    TRUNCATE,
    SEND,
    POLL,
    THREAD,
    MAP,
    SPAWN,
    CALL, // all others
    KINDS,
    DISTINCT,
    SURVEY
};

#define DEPTH 24 // frames of a stack that tell it from others
#define WALK 160
#define STACKS (1u << 16)

struct plan {
    atomic_int kind, left, hits, error, for_good;
    char program[16];         // as /proc/self/comm
    atomic_uint chance, seed; // of 256: which stacks are taken now
    int last_kind, last_depth;
    struct {
        uint64_t offset;
        char module[40];
    } last[DEPTH]; // the stack that failed
    _Atomic uint64_t met[STACKS];
};

static struct plan *plan;
static _Atomic uint64_t *tried;   // of STACKS
static struct dl_find_object own; // this library
static __thread bool inside;

// The file that a variable names; NULL: there is none.
static void *map_named(const char *variable, size_t size) {
    const char *path = getenv(variable);
    int fd = path ? open(path, O_RDWR | O_CLOEXEC) : -1;
    void *mapped =
        fd < 0 ? MAP_FAILED : mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (fd >= 0) close(fd);
    return mapped == MAP_FAILED ? NULL : mapped;
}

__attribute__((constructor)) static void begin(void) {
    struct plan *wanted = map_named("RIPNERF_FAULTS", sizeof *plan);
    tried = map_named("RIPNERF_FAULTS_TRIED", STACKS * sizeof *tried);
    if (wanted == NULL || tried == NULL || _dl_find_object(&own, &own) != 0) return;
    const char *name = program_invocation_short_name;
    if (strncmp(name, wanted->program, sizeof wanted->program) == 0) plan = wanted;
}

// ---- once for each stack ----------------------------------------------------------------------

struct walk {
    int depth;
    struct frame {
        uintptr_t pc, sp; // the word below sp is where pc returns from
    } frames[WALK];
};

// What a thread walked last, to its end: of its stack the outer part is mostly still as it was.
static __thread struct walk walked;

// Takes over the rest of the last walk from this frame on, if each return address is still there.
static bool goes_on_as_before(struct walk *walk, const struct frame *frame) {
    int from = 0;
    while (from < walked.depth && walked.frames[from].sp < frame->sp)
        from++;
    int count = walked.depth - from;
    if (count == 0 || walked.frames[from].sp != frame->sp || walk->depth + count > WALK)
        return false;
    for (int i = from; i < walked.depth; i++)
        if (*((uintptr_t *)walked.frames[i].sp - 1) != walked.frames[i].pc) return false;
    memcpy(&walk->frames[walk->depth], &walked.frames[from], (size_t)count * sizeof *frame);
    walk->depth += count;
    return true;
}

static _Unwind_Reason_Code take_frame(struct _Unwind_Context *context, void *to) {
    struct walk *walk = to;
    struct frame frame = {_Unwind_GetIP(context), _Unwind_GetCFA(context)};
    if (frame.pc == 0 || walk->depth == WALK) return _URC_END_OF_STACK;
    if (frame.pc >= (uintptr_t)own.dlfo_map_start && frame.pc < (uintptr_t)own.dlfo_map_end)
        return _URC_NO_REASON;
    if (goes_on_as_before(walk, &frame)) return _URC_END_OF_STACK;
    walk->frames[walk->depth++] = frame;
    return _URC_NO_REASON;
}

static void remember(const struct walk *walk, enum kind kind) {
    plan->last_kind = (int)kind;
    plan->last_depth = walk->depth < DEPTH ? walk->depth : DEPTH;
    for (int i = 0; i < plan->last_depth; i++) {
        struct dl_find_object found;
        uintptr_t pc = walk->frames[i].pc, base = 0;
        const char *name = "?";
        if (_dl_find_object((void *)pc, &found) == 0) {
            base = (uintptr_t)found.dlfo_map_start;
            const char *path = found.dlfo_link_map->l_name;
            name = strrchr(path, '/') ? strrchr(path, '/') + 1 : path;
            if (*name == '\0') name = program_invocation_short_name;
        }
        plan->last[i].offset = pc - base;
        snprintf(plan->last[i].module, sizeof plan->last[i].module, "%s", name);
    }
}

// Whether the stack is met for the first time; it is known from then on.
static bool is_new_stack(enum kind kind) {
    static __thread struct walk walk;
    walk.depth = 0;
    _Unwind_Backtrace(take_frame, &walk);
    walked.depth = walk.depth < WALK ? walk.depth : 0;
    memcpy(walked.frames, walk.frames, (size_t)walked.depth * sizeof *walk.frames);
    uint64_t hash = 1469598103934665603ull * (unsigned)(kind + 1);
    for (int i = 0; i < walk.depth && i < DEPTH; i++) {
        struct dl_find_object found;
        uintptr_t pc = walk.frames[i].pc;
        uintptr_t base =
            _dl_find_object((void *)pc, &found) == 0 ? (uintptr_t)found.dlfo_map_start : 0;
        hash = (hash ^ (pc - base)) * 1099511628211ull;
    }
    hash |= 1;
    if ((((hash >> 20) * (2 * plan->seed + 1)) >> 12 & 255) >= plan->chance) return false;
    _Atomic uint64_t *table = plan->kind == SURVEY ? plan->met : tried;
    for (uint64_t at = hash >> 7; plan->left > 0; at++) {
        uint64_t free_place = 0, known = table[at % STACKS];
        if (known == hash) return false;
        if (known != 0) continue;
        int left = plan->left;
        if (left <= 0 || !atomic_compare_exchange_strong(&plan->left, &left, left - 1))
            return false;
        if (!atomic_compare_exchange_strong(&table[at % STACKS], &free_place, hash)) {
            atomic_fetch_add(&plan->left, 1); // another has the place, perhaps for this stack
            return false;
        }
        remember(&walk, kind);
        return true;
    }
    return false;
}

static bool fails_by_stack(enum kind kind) {
    static const int errors[KINDS] = {
        [MALLOC] = ENOMEM, [WRITE] = ENOSPC,  [SYNC] = EIO,        [OPEN] = EMFILE,
        [RENAME] = EIO,    [MKDIR] = ENOSPC,  [SOCKET] = EMFILE,   [ACCEPT] = EMFILE,
        [READ] = EIO,      [UNLINK] = EACCES, [TRUNCATE] = ENOSPC, [SEND] = ENOBUFS,
        [POLL] = EINTR,    [THREAD] = EAGAIN, [MAP] = ENOMEM,      [SPAWN] = EAGAIN,
        [CALL] = EIO};
    if (inside || kind == SHORT_WRITE || plan->left <= 0) return false;
    int before = errno;
    inside = true;
    bool found = is_new_stack(kind) && plan->kind == DISTINCT;
    inside = false;
    errno = found ? errors[kind] : before;
    if (found) atomic_fetch_add(&plan->hits, 1);
    return found;
}

static bool fails(enum kind kind) {
    if (plan == NULL) return false;
    int wanted = atomic_load_explicit(&plan->kind, memory_order_relaxed);
    if (wanted == DISTINCT || wanted == SURVEY) return fails_by_stack(kind);
    if (wanted != (int)kind) return false;
    int left = atomic_fetch_sub(&plan->left, 1);
    if (left != 1 && !(left < 1 && atomic_load(&plan->for_good))) return false;
    atomic_fetch_add(&plan->hits, 1);
    errno = kind == MALLOC ? ENOMEM : atomic_load(&plan->error);
    return true;
}

// The next definition of this function.
#define NEXT(name) (__extension__(__typeof__(&name)) dlsym(RTLD_NEXT, #name))

#ifdef RN_SANITIZED
// To the sanitizer's; what dlsym asks for meanwhile is never given back.
static void *early(size_t size) {
    static _Alignas(16) char room[1 << 16];
    static atomic_size_t used;
    size_t at = atomic_fetch_add(&used, (size + 15) & ~(size_t)15);
    return at + size <= sizeof room ? room + at : NULL;
}
#define NEXT_ALLOCATION(name, during, ...)                                                         \
    static __typeof__(&name) next;                                                                 \
    static __thread bool looking;                                                                  \
    if (looking) return during;                                                                    \
    if (!next) {                                                                                   \
        looking = true;                                                                            \
        next = NEXT(name);                                                                         \
        looking = false;                                                                           \
    }                                                                                              \
    return fails(MALLOC) ? NULL : next(__VA_ARGS__)
void *malloc(size_t size) {
    NEXT_ALLOCATION(malloc, early(size), size);
}
void *calloc(size_t count, size_t size) {
    NEXT_ALLOCATION(calloc, early(count * size), count, size);
}
void *realloc(void *old, size_t size) {
    NEXT_ALLOCATION(realloc, NULL, old, size);
}
#else
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

#endif

// These have one hook and many ways; what they give is checked like malloc's.
int posix_memalign(void **result, size_t alignment, size_t size) {
    static __typeof__(&posix_memalign) next;
    if (!next) next = NEXT(posix_memalign);
    return fails(MALLOC) ? ENOMEM : next(result, alignment, size);
}
void *aligned_alloc(size_t alignment, size_t size) {
    static __typeof__(&aligned_alloc) next;
    if (!next) next = NEXT(aligned_alloc);
    return fails(MALLOC) ? NULL : next(alignment, size);
}
void *mmap(void *address, size_t size, int protection, int flags, int fd, off_t at) {
    static __typeof__(&mmap) next;
    if (!next) next = NEXT(mmap);
    return plan && fails(MAP) ? MAP_FAILED : next(address, size, protection, flags, fd, at);
}

void *mmap64(void *address, size_t size, int protection, int flags, int fd, off64_t at) {
    static __typeof__(&mmap64) next;
    if (!next) next = NEXT(mmap64);
    return plan && fails(MAP) ? MAP_FAILED : next(address, size, protection, flags, fd, at);
}

static bool is_file(int fd) {
    struct stat about;
    return NEXT(fstat)(fd, &about) == 0 && S_ISREG(about.st_mode);
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
FILE *fopen64(const char *path, const char *mode) {
    return fails(OPEN) ? NULL : NEXT(fopen64)(path, mode);
}

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
// A socket is only interrupted: what else can happen to it is the peer's leaving.
static bool fails_to_read(int fd) {
    if (!fails(READ)) return false;
    if (plan->kind == DISTINCT && !is_file(fd)) errno = EINTR;
    return true;
}
ssize_t recv(int fd, void *data, size_t size, int flags) {
    return fails_to_read(fd) ? -1 : NEXT(recv)(fd, data, size, flags);
}
ssize_t read(int fd, void *data, size_t size) {
    return fails_to_read(fd) ? -1 : NEXT(read)(fd, data, size);
}
ssize_t pread64(int fd, void *data, size_t size, off64_t at) {
    return fails_to_read(fd) ? -1 : NEXT(pread64)(fd, data, size, at);
}
int unlink(const char *path) {
    return fails(UNLINK) ? -1 : NEXT(unlink)(path);
}
int ftruncate64(int fd, off64_t size) {
    return fails(TRUNCATE) ? -1 : NEXT(ftruncate64)(fd, size);
}
ssize_t send(int fd, const void *data, size_t size, int flags) {
    if (fails(SEND)) {
        errno = EINTR;
        return -1;
    }
    return NEXT(send)(fd, data, size, flags);
}
int poll(struct pollfd *polls, nfds_t count, int timeout_ms) {
    return fails(POLL) ? -1 : NEXT(poll)(polls, count, timeout_ms);
}
int pthread_create(pthread_t *thread, const pthread_attr_t *attributes, void *(*run)(void *),
                   void *context) {
    return fails(THREAD) ? EAGAIN : NEXT(pthread_create)(thread, attributes, run, context);
}
int posix_spawn(pid_t *pid, const char *path, const posix_spawn_file_actions_t *actions,
                const posix_spawnattr_t *attributes, char *const argv[],
                char *const environment[]) {
    return fails(SPAWN) ? EAGAIN
                        : NEXT(posix_spawn)(pid, path, actions, attributes, argv, environment);
}

// ---- calls of all other kinds -------------------------------------------------------------------

// name(...) fails with `error`, as `result`.
#define CALL_LIKE(type, name, error, result, declared, given)                                      \
    type name declared {                                                                           \
        static __typeof__(&name) next;                                                             \
        if (!next) next = NEXT(name);                                                              \
        if (plan == NULL || !fails(CALL)) return next given;                                       \
        errno = error;                                                                             \
        return result;                                                                             \
    }
CALL_LIKE(DIR *, opendir, EMFILE, NULL, (const char *path), (path))
CALL_LIKE(DIR *, fdopendir, ENOMEM, NULL, (int fd), (fd))
CALL_LIKE(struct dirent64 *, readdir64, EIO, NULL, (DIR * folder), (folder))
CALL_LIKE(int, scandir64, EMFILE, -1,
          (const char *path, struct dirent64 ***names, int (*filter)(const struct dirent64 *),
           int (*compare)(const struct dirent64 **, const struct dirent64 **)),
          (path, names, filter, compare))
CALL_LIKE(int, stat64, EIO, -1, (const char *path, struct stat64 *about), (path, about))
CALL_LIKE(int, lstat64, EIO, -1, (const char *path, struct stat64 *about), (path, about))
CALL_LIKE(int, fstat64, EIO, -1, (int fd, struct stat64 *about), (fd, about))
CALL_LIKE(int, fstatat64, EIO, -1, (int fd, const char *path, struct stat64 *about, int flags),
          (fd, path, about, flags))
CALL_LIKE(int, access, EIO, -1, (const char *path, int mode), (path, mode))
CALL_LIKE(int, faccessat, EIO, -1, (int fd, const char *path, int mode, int flags),
          (fd, path, mode, flags))
CALL_LIKE(int, statvfs64, EIO, -1, (const char *path, struct statvfs64 *about), (path, about))
CALL_LIKE(off64_t, lseek64, EIO, -1, (int fd, off64_t at, int from), (fd, at, from))
CALL_LIKE(int, fseeko64, EIO, -1, (FILE * file, off64_t at, int from), (file, at, from))
CALL_LIKE(int, mkdirat, ENOSPC, -1, (int fd, const char *path, mode_t mode), (fd, path, mode))
CALL_LIKE(int, mkostemp64, ENOSPC, -1, (char *path, int flags), (path, flags))
CALL_LIKE(char *, mkdtemp, ENOSPC, NULL, (char *path), (path))
CALL_LIKE(int, link, ENOSPC, -1, (const char *from, const char *to), (from, to))
CALL_LIKE(int, linkat, ENOSPC, -1, (int a, const char *from, int b, const char *to, int flags),
          (a, from, b, to, flags))
CALL_LIKE(int, symlink, ENOSPC, -1, (const char *from, const char *to), (from, to))
CALL_LIKE(int, unlinkat, EIO, -1, (int fd, const char *path, int flags), (fd, path, flags))
CALL_LIKE(int, rmdir, EIO, -1, (const char *path), (path))
CALL_LIKE(ssize_t, readlink, EIO, -1, (const char *path, char *to, size_t size), (path, to, size))
CALL_LIKE(int, syncfs, EIO, -1, (int fd), (fd))
CALL_LIKE(int, flock, ENOLCK, -1, (int fd, int operation), (fd, operation))
CALL_LIKE(int, posix_fallocate64, ENOSPC, ENOSPC, (int fd, off64_t at, off64_t size),
          (fd, at, size))
CALL_LIKE(int, socket, EMFILE, -1, (int domain, int type, int protocol), (domain, type, protocol))
CALL_LIKE(int, pipe2, EMFILE, -1, (int pair[2], int flags), (pair, flags))
CALL_LIKE(int, eventfd, EMFILE, -1, (unsigned count, int flags), (count, flags))
CALL_LIKE(int, epoll_create1, EMFILE, -1, (int flags), (flags))
CALL_LIKE(int, epoll_wait, EINTR, -1,
          (int fd, struct epoll_event *events, int most, int timeout_ms),
          (fd, events, most, timeout_ms))
CALL_LIKE(int, setsockopt, ENOBUFS, -1,
          (int fd, int level, int name, const void *value, socklen_t size),
          (fd, level, name, value, size))
CALL_LIKE(ssize_t, sendmsg, EINTR, -1, (int fd, const struct msghdr *message, int flags),
          (fd, message, flags))
CALL_LIKE(ssize_t, getrandom, EINTR, -1, (void *to, size_t size, unsigned flags), (to, size, flags))
CALL_LIKE(pid_t, waitpid, EINTR, -1, (pid_t pid, int *status, int options), (pid, status, options))
CALL_LIKE(int, posix_spawn_file_actions_adddup2, ENOMEM, ENOMEM,
          (posix_spawn_file_actions_t * actions, int from, int to), (actions, from, to))

// Only what is added needs memory.
int epoll_ctl(int fd, int what, int of, struct epoll_event *event) {
    if (plan == NULL || what != EPOLL_CTL_ADD || !fails(CALL))
        return NEXT(epoll_ctl)(fd, what, of, event);
    errno = ENOMEM;
    return -1;
}

// What a stream does inside of the C library; the stream remembers an error.
static bool stream_fails(FILE *file) {
    if (plan == NULL || file == stdout || file == stderr || !fails(CALL)) return false;
    file->_flags |= _IO_ERR_SEEN;
    errno = EIO;
    return true;
}
size_t fread(void *to, size_t size, size_t count, FILE *file) {
    return stream_fails(file) ? 0 : NEXT(fread)(to, size, count, file);
}
ssize_t getdelim(char **line, size_t *size, int end, FILE *file) {
    return stream_fails(file) ? -1 : NEXT(getdelim)(line, size, end, file);
}
ssize_t __getdelim(char **line, size_t *size, int end, FILE *file);
ssize_t __getdelim(char **line, size_t *size, int end, FILE *file) {
    return stream_fails(file) ? -1 : NEXT(getdelim)(line, size, end, file);
}
int fflush(FILE *file) {
    return file != NULL && stream_fails(file) ? EOF : NEXT(fflush)(file);
}
// Closed all the same.
int fclose(FILE *file) {
    bool failed = stream_fails(file);
    int result = NEXT(fclose)(file);
    return failed ? EOF : result;
}
int close(int fd) {
    bool failed = plan != NULL && is_file(fd) && fails(CALL);
    int result = NEXT(close)(fd);
    if (failed) errno = EIO;
    return failed ? -1 : result;
}

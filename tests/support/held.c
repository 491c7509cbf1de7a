// Preloaded in tests, before faults.c: what a process of the program RIPNERF_HELD_OF has allocated
// and not given back when it ends is written to RIPNERF_HELD.PID, a line for each block:
// MODULE+OFFSET of who asked for it; then a line that says "whole". The loader's own, which go with
// threads, are left out. The file is opened at the start: a confined program could not.
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <link.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#define PLACES (1u << 22) // more than a test's programs ever hold
#define GONE 1            // in the place of a block that was given back

struct block {
    _Atomic uintptr_t at, asked; // the block, and where its caller goes on
};

static struct block *blocks;
static bool counts;
static int report = -1;

// The next definition of this function.
#define NEXT(name) (__extension__(__typeof__(&name)) dlsym(RTLD_NEXT, #name))

void *__libc_malloc(size_t size);
void *__libc_calloc(size_t count, size_t size);
void *__libc_realloc(void *old, size_t size);
void __libc_free(void *block);

static __typeof__(&malloc) next_malloc;
static __typeof__(&calloc) next_calloc;
static __typeof__(&realloc) next_realloc;
static __typeof__(&posix_memalign) next_memalign;
static __typeof__(&aligned_alloc) next_aligned;

// dlsym allocates: until this is done all go to the C library.
__attribute__((constructor)) static void find(void) {
    if (next_malloc) return;
    __typeof__(&malloc) first = NEXT(malloc);
    next_calloc = NEXT(calloc);
    next_realloc = NEXT(realloc);
    next_memalign = NEXT(posix_memalign);
    next_aligned = NEXT(aligned_alloc);
    next_malloc = first;
}

__attribute__((constructor)) static void begin(void) {
    const char *program = getenv("RIPNERF_HELD_OF");
    const char *path = getenv("RIPNERF_HELD");
    char own[PATH_MAX];
    if (program == NULL || path == NULL || strcmp(program, program_invocation_short_name) != 0)
        return;
    snprintf(own, sizeof own, "%s.%d", path, (int)getpid());
    report = open(own, O_WRONLY | O_CREAT | O_TRUNC | O_APPEND | O_CLOEXEC, 0600);
    void *room = mmap(NULL, PLACES * sizeof *blocks, PROT_READ | PROT_WRITE,
                      MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (room == MAP_FAILED) return;
    blocks = room;
    counts = true;
}

static struct block *place_of(const void *block, unsigned tries) {
    return &blocks[(((uintptr_t)block / 16 * 0x9e3779b97f4a7c15u >> 40) + tries) % PLACES];
}

static void *take(void *block, void *asked) {
    uintptr_t free_place;
    for (unsigned i = 0; counts && block != NULL; i++) {
        struct block *place = place_of(block, i);
        if ((free_place = place->at) > GONE) continue;
        if (!atomic_compare_exchange_strong(&place->at, &free_place, (uintptr_t)block)) continue;
        place->asked = (uintptr_t)asked;
        break;
    }
    return block;
}

// Before another thread may have the same block.
static void give_back(const void *block) {
    for (unsigned i = 0; counts && block != NULL && i < PLACES; i++) {
        if (place_of(block, i)->at == 0) break;
        if (place_of(block, i)->at != (uintptr_t)block) continue;
        place_of(block, i)->at = GONE;
        break;
    }
}

void *malloc(size_t size) {
    return take(next_malloc ? next_malloc(size) : __libc_malloc(size), __builtin_return_address(0));
}
void *calloc(size_t count, size_t size) {
    return take(next_malloc ? next_calloc(count, size) : __libc_calloc(count, size),
                __builtin_return_address(0));
}
void *realloc(void *old, size_t size) {
    give_back(old);
    void *block = next_malloc ? next_realloc(old, size) : __libc_realloc(old, size);
    take(block == NULL && size > 0 ? old : block, __builtin_return_address(0));
    return block;
}
int posix_memalign(void **result, size_t alignment, size_t size) {
    find();
    int error = next_memalign(result, alignment, size);
    if (error == 0) take(*result, __builtin_return_address(0));
    return error;
}
void *aligned_alloc(size_t alignment, size_t size) {
    find();
    return take(next_aligned(alignment, size), __builtin_return_address(0));
}
void free(void *block) {
    give_back(block);
    __libc_free(block);
}

__attribute__((destructor)) static void end(void) {
    if (!counts || report < 0) return;
    counts = false;
    for (size_t i = 0; i < PLACES; i++) {
        struct dl_find_object found;
        if (blocks[i].at <= GONE || _dl_find_object((void *)blocks[i].asked, &found) != 0) continue;
        const char *name = strrchr(found.dlfo_link_map->l_name, '/');
        if (name != NULL && strncmp(name, "/ld-", 4) == 0) continue;
        dprintf(report, "%s+%#lx\n", name ? name + 1 : program_invocation_short_name,
                (unsigned long)(blocks[i].asked - (uintptr_t)found.dlfo_map_start));
    }
    dprintf(report, "whole\n");
    close(report);
}

#include "server/engine/scene/paged.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#define PAGE 4096

static enum rn_status refuse(const char *folder, size_t size, int why, struct rn_error *err) {
    bool full = why == ENOSPC || why == EDQUOT || why == EFBIG;
    return rn_error_set(err,
                        full            ? RN_ERROR_NO_SPACE
                        : why == ENOMEM ? RN_ERROR_NO_MEMORY
                                        : RN_ERROR_IO,
                        folder, "%zu MiB of photographs cannot be kept here: %s", size >> 20,
                        strerror(why));
}

// A file of that size whose name is gone again; -1 with errno.
static int open_nameless(const char *folder, size_t size) {
    char path[PATH_MAX];
    snprintf(path, sizeof path, "%s/.pages-XXXXXX", folder);
    int fd = mkostemp(path, O_CLOEXEC);
    if (fd < 0) return -1;
    (void)unlink(path);
    int why = posix_fallocate(fd, 0, (off_t)size);
    if (why == 0) return fd;
    close(fd);
    errno = why;
    return -1;
}

enum rn_status rn_paged_create(const char *folder, size_t size, struct rn_paged *ret_paged,
                               struct rn_error *err) {
    int fd = open_nameless(folder, size);
    if (fd < 0) return refuse(folder, size, errno, err);
    void *bytes = mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    int why = errno;
    close(fd);
    if (bytes == MAP_FAILED) return refuse(folder, size, why, err);
    (void)madvise(bytes, size, MADV_RANDOM);
    *ret_paged = (struct rn_paged){bytes, size};
    return RN_OK;
}

void rn_paged_destroy(struct rn_paged *paged) {
    if (paged->bytes) munmap(paged->bytes, paged->size);
    *paged = (struct rn_paged){NULL, 0};
}

void rn_paged_let_go(const struct rn_paged *paged) {
    if (paged->bytes) (void)madvise(paged->bytes, paged->size, MADV_DONTNEED);
}

// Pages of files in this process's memory; SIZE_MAX where that cannot be read.
static size_t resident_pages(void) {
    char text[128] = "";
    unsigned long all, resident, shared;
    int fd = open("/proc/self/statm", O_RDONLY | O_CLOEXEC);
    if (fd < 0) return SIZE_MAX;
    ssize_t n = read(fd, text, sizeof text - 1);
    close(fd);
    if (n <= 0 || sscanf(text, "%lu %lu %lu", &all, &resident, &shared) != 3) return SIZE_MAX;
    return shared;
}

// Of them those of no block, the program's and its libraries': the fewest that were left when a
// block had let go of all of its own. 0: not known yet.
static atomic_size_t others;

void rn_paged_hold_at_most(const struct rn_paged *paged, size_t bytes) {
    size_t before = atomic_load(&others);
    if (!paged->bytes || resident_pages() <= before + bytes / PAGE) return;
    rn_paged_let_go(paged);
    size_t left = resident_pages();
    if (left != SIZE_MAX && (before == 0 || left < before)) atomic_store(&others, left);
}

void rn_paged_expect(const void *byte) {
    (void)madvise((void *)((uintptr_t)byte / PAGE * PAGE), PAGE, MADV_WILLNEED);
}

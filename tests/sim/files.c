// Descriptors of the daemon's process: files and folders of the simulated disk, the ends of its
// connections with runners, its wake-up counter.
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>

#include "tests/sim/calls.h"
#include "tests/sim/life.h"
#include "tests/sim/world.h"

#define FIRST 100
#define DESCRIPTORS 1024

enum { NOTHING, INODE, COUNTER, STREAM };

struct stream {
    uint8_t *bytes;
    size_t size, at;
    bool closed; // by the writer
};

static struct descriptor {
    int kind;
    uint32_t inode;
    size_t at;
    bool appends;
    uint64_t count;
    int peer; // STREAM: the other end, -1 when it is closed
    struct stream in;
} descriptors[DESCRIPTORS];

// An open folder, behind a DIR.
struct listing {
    int fd;
    size_t at, count;
    struct sim_name *names;
    struct dirent entry;
};

// Calls that change the disk: each may be the last one.
static void changes(void) {
    if (sim->in_runner && sim->crash == SIM_KILLED) return; // the daemon is killed, not the runner
    if (sim->crash_after > 0 && --sim->crash_after == 0) sim_crash(sim->crash);
}

static struct descriptor *get(int fd) {
    if (fd < FIRST || fd >= FIRST + DESCRIPTORS || descriptors[fd - FIRST].kind == NOTHING)
        sim_violated("descriptor %d is used and not open", fd);
    return &descriptors[fd - FIRST];
}

static int new_descriptor(int kind) {
    for (int i = 0; i < DESCRIPTORS; i++) {
        if (descriptors[i].kind != NOTHING) continue;
        descriptors[i] = (struct descriptor){.kind = kind, .peer = -1};
        return FIRST + i;
    }
    sim_violated("%d descriptors are open", DESCRIPTORS);
}

int sim_open_descriptors(void) {
    int open = 0;
    for (int i = 0; i < DESCRIPTORS; i++)
        open += descriptors[i].kind != NOTHING;
    return open;
}

static uint32_t folder_of(int fd) {
    return fd == AT_FDCWD ? SIM_ROOT : get(fd)->inode;
}

static int fail(int error) {
    errno = error;
    return -1;
}

// ---- files and folders ------------------------------------------------------------------------

static uint32_t create(uint32_t folder, const char *path) {
    const char *name;
    uint32_t parent = sim_disk_parent(&sim->disk, folder, path, &name);
    if (parent == SIM_NONE) return SIM_NONE;
    changes();
    uint32_t made = sim_disk_make(&sim->disk, SIM_FILE);
    if (made != SIM_NONE && !sim_disk_link(&sim->disk, parent, name, made)) return SIM_NONE;
    return made;
}

static int open_at(uint32_t folder, const char *path, int flags) {
    struct sim_disk *disk = &sim->disk;
    uint32_t inode = sim_disk_find(disk, folder, path);
    if (inode == SIM_NONE && (errno != ENOENT || !(flags & O_CREAT))) return -1;
    if (inode == SIM_NONE) inode = create(folder, path);
    if (inode == SIM_NONE) return -1;
    bool is_folder = disk->inodes[inode].kind == SIM_FOLDER;
    if (is_folder && (flags & O_ACCMODE) != O_RDONLY) return fail(EISDIR);
    if (!is_folder && (flags & O_DIRECTORY)) return fail(ENOTDIR);
    if ((flags & O_TRUNC) && disk->inodes[inode].now.size > 0) {
        changes();
        sim_disk_truncate(disk, inode, 0);
    }
    int fd = new_descriptor(INODE);
    get(fd)->inode = inode;
    get(fd)->appends = (flags & O_APPEND) != 0;
    disk->inodes[inode].opens++;
    return fd;
}

int sim_open(const char *path, int flags, ...) {
    return open_at(SIM_ROOT, path, flags);
}

int sim_openat(int folder, const char *path, int flags, ...) {
    return open_at(folder_of(folder), path, flags);
}

static void hang_up(struct descriptor *end) {
    if (end->peer >= 0) {
        get(end->peer)->peer = -1;
        get(end->peer)->in.closed = true;
    }
    free(end->in.bytes);
}

int sim_close(int fd) {
    struct descriptor *descriptor = get(fd);
    if (descriptor->kind == STREAM) hang_up(descriptor);
    if (descriptor->kind == INODE) {
        sim->disk.inodes[descriptor->inode].opens--;
        sim_disk_release(&sim->disk, descriptor->inode);
    }
    *descriptor = (struct descriptor){.kind = NOTHING};
    return 0;
}

ssize_t sim_pread(int fd, void *bytes, size_t size, off_t at) {
    const struct descriptor *file = get(fd);
    if (sim->disk.inodes[file->inode].kind == SIM_FOLDER) return fail(EISDIR);
    return (ssize_t)sim_disk_read(&sim->disk, file->inode, bytes, size, (size_t)at);
}

ssize_t sim_pwrite(int fd, const void *bytes, size_t size, off_t at) {
    changes();
    return sim_disk_write(&sim->disk, get(fd)->inode, bytes, size, (size_t)at) ? (ssize_t)size : -1;
}

ssize_t sim_read(int fd, void *bytes, size_t size) {
    struct descriptor *descriptor = get(fd);
    if (descriptor->kind == COUNTER) {
        if (descriptor->count == 0) return fail(EAGAIN);
        memcpy(bytes, &descriptor->count, sizeof descriptor->count);
        descriptor->count = 0;
        return sizeof descriptor->count;
    }
    ssize_t got = sim_pread(fd, bytes, size, (off_t)descriptor->at);
    if (got > 0) descriptor->at += (size_t)got;
    return got;
}

ssize_t sim_write(int fd, const void *bytes, size_t size) {
    struct descriptor *descriptor = get(fd);
    if (descriptor->kind == COUNTER) {
        uint64_t more;
        memcpy(&more, bytes, sizeof more);
        descriptor->count += more;
        return sizeof more;
    }
    if (descriptor->appends) descriptor->at = sim->disk.inodes[descriptor->inode].now.size;
    ssize_t put = sim_pwrite(fd, bytes, size, (off_t)descriptor->at);
    if (put > 0) descriptor->at += (size_t)put;
    return put;
}

int sim_fsync(int fd) {
    changes();
    sim_disk_flush(&sim->disk, get(fd)->inode);
    return 0;
}

// One daemon at a time is the simulation's own doing.
int sim_flock(int fd, int how) {
    return get(fd)->kind == INODE ? 0 : fail(EBADF);
}

int sim_rename(const char *from, const char *to) {
    struct sim_disk *disk = &sim->disk;
    const char *old_name, *new_name;
    uint32_t old = sim_disk_parent(disk, SIM_ROOT, from, &old_name);
    uint32_t new = sim_disk_parent(disk, SIM_ROOT, to, &new_name);
    if (old == SIM_NONE || new == SIM_NONE) return -1;
    uint32_t inode = sim_disk_look(disk, old, old_name);
    uint32_t there = sim_disk_look(disk, new, new_name);
    if (inode == SIM_NONE) return fail(ENOENT);
    bool is_folder = disk->inodes[inode].kind == SIM_FOLDER;
    if (there != SIM_NONE && there != inode) {
        bool onto_folder = disk->inodes[there].kind == SIM_FOLDER;
        if (is_folder != onto_folder) return fail(onto_folder ? EISDIR : ENOTDIR);
        if (onto_folder && disk->inodes[there].names.count > 0) return fail(ENOTEMPTY);
    }
    changes();
    if (there == inode) return 0;
    disk->inodes[inode].opens++; // while it has no name
    sim_disk_unlink(disk, old, old_name);
    bool linked = sim_disk_link(disk, new, new_name, inode);
    disk->inodes[inode].opens--;
    return linked ? 0 : -1;
}

int sim_unlinkat(int folder, const char *path, int flags) {
    struct sim_disk *disk = &sim->disk;
    const char *name;
    uint32_t parent = sim_disk_parent(disk, folder_of(folder), path, &name);
    if (parent == SIM_NONE) return -1;
    uint32_t inode = sim_disk_look(disk, parent, name);
    if (inode == SIM_NONE) return fail(ENOENT);
    bool is_folder = disk->inodes[inode].kind == SIM_FOLDER;
    if (is_folder && !(flags & AT_REMOVEDIR)) return fail(EISDIR);
    if (!is_folder && (flags & AT_REMOVEDIR)) return fail(ENOTDIR);
    if (is_folder && disk->inodes[inode].names.count > 0) return fail(ENOTEMPTY);
    changes();
    sim_disk_unlink(disk, parent, name);
    return 0;
}

int sim_mkdir(const char *path, mode_t mode) {
    struct sim_disk *disk = &sim->disk;
    const char *name;
    uint32_t parent = sim_disk_parent(disk, SIM_ROOT, path, &name);
    if (parent == SIM_NONE) return -1;
    if (sim_disk_look(disk, parent, name) != SIM_NONE) return fail(EEXIST);
    changes();
    uint32_t made = sim_disk_make(disk, SIM_FOLDER);
    return made != SIM_NONE && sim_disk_link(disk, parent, name, made) ? 0 : -1;
}

static void describe(uint32_t inode, struct stat *about) {
    const struct sim_inode *it = &sim->disk.inodes[inode];
    *about = (struct stat){
        .st_ino = inode,
        .st_mode = it->kind == SIM_FOLDER ? S_IFDIR | 0700 : S_IFREG | 0600,
        .st_nlink = it->linked,
        .st_size = (off_t)it->now.size,
        .st_mtim = {.tv_sec = it->changed_ms / 1000, .tv_nsec = it->changed_ms % 1000 * 1000000}};
}

int sim_fstat(int fd, struct stat *about) {
    describe(get(fd)->inode, about);
    return 0;
}

int sim_fstatat(int folder, const char *path, struct stat *about, int flags) {
    uint32_t inode = sim_disk_find(&sim->disk, folder_of(folder), path);
    if (inode == SIM_NONE) return -1;
    describe(inode, about);
    return 0;
}

int sim_access(const char *path, int mode) {
    return sim_disk_find(&sim->disk, SIM_ROOT, path) == SIM_NONE ? -1 : 0;
}

// ---- listings ---------------------------------------------------------------------------------

DIR *sim_fdopendir(int fd) {
    const struct sim_names *names = &sim->disk.inodes[get(fd)->inode].names;
    struct listing *listing = calloc(1, sizeof *listing);
    listing->fd = fd;
    listing->count = names->count;
    listing->names = calloc(names->count + 1, sizeof *listing->names);
    if (names->count > 0) memcpy(listing->names, names->items, names->count * sizeof *names->items);
    return (DIR *)(void *)listing;
}

DIR *sim_opendir(const char *path) {
    int fd = open_at(SIM_ROOT, path, O_RDONLY | O_DIRECTORY);
    return fd < 0 ? NULL : sim_fdopendir(fd);
}

struct dirent *sim_readdir(DIR *folder) {
    struct listing *listing = (struct listing *)(void *)folder;
    if (listing->at == listing->count) return NULL;
    snprintf(listing->entry.d_name, sizeof listing->entry.d_name, "%s",
             listing->names[listing->at++].text);
    return &listing->entry;
}

int sim_dirfd(DIR *folder) {
    return ((struct listing *)(void *)folder)->fd;
}

int sim_closedir(DIR *folder) {
    struct listing *listing = (struct listing *)(void *)folder;
    sim_close(listing->fd);
    free(listing->names);
    free(listing);
    return 0;
}

static int by_name(const void *a, const void *b) {
    const struct dirent *const *left = a, *const *right = b;
    return strcmp((*left)->d_name, (*right)->d_name);
}

int sim_scandir(const char *path, struct dirent ***ret_entries) {
    DIR *folder = sim_opendir(path);
    if (folder == NULL) return -1;
    int count = 0;
    struct dirent *entry,
        **entries = calloc(((struct listing *)(void *)folder)->count + 1, sizeof *entries);
    while ((entry = sim_readdir(folder)) != NULL) {
        entries[count] = malloc(sizeof *entry);
        *entries[count++] = *entry;
    }
    sim_closedir(folder);
    qsort(entries, (size_t)count, sizeof *entries, by_name);
    *ret_entries = entries;
    return count;
}

// ---- connections ------------------------------------------------------------------------------

int sim_eventfd(unsigned value) {
    int fd = new_descriptor(COUNTER);
    get(fd)->count = value;
    return fd;
}

void sim_connect(int ret_ends[2]) {
    ret_ends[0] = new_descriptor(STREAM);
    ret_ends[1] = new_descriptor(STREAM);
    get(ret_ends[0])->peer = ret_ends[1];
    get(ret_ends[1])->peer = ret_ends[0];
}

ssize_t sim_recv(int fd, void *bytes, size_t size) {
    struct stream *in = &get(fd)->in;
    size_t there = in->size - in->at;
    if (there == 0) return in->closed ? 0 : fail(EAGAIN);
    if (size > there) size = there;
    if (size > 1 && sim_chance(8)) size = 1 + (size_t)sim_below((int)(size - 1)); // in pieces
    memcpy(bytes, in->bytes + in->at, size);
    in->at += size;
    if (in->at == in->size) in->at = in->size = 0;
    return (ssize_t)size;
}

ssize_t sim_send(int fd, const void *bytes, size_t size) {
    struct descriptor *end = get(fd);
    if (end->peer < 0) return fail(EPIPE);
    struct stream *out = &get(end->peer)->in;
    out->bytes = realloc(out->bytes, out->size + size);
    memcpy(out->bytes + out->size, bytes, size);
    out->size += size;
    return (ssize_t)size;
}

bool sim_readable(int fd) {
    const struct descriptor *descriptor = &descriptors[fd - FIRST];
    if (descriptor->kind == NOTHING) return true; // closed by another thread: there is news
    return descriptor->kind == COUNTER ? descriptor->count > 0
                                       : descriptor->in.closed || descriptor->in.size > 0;
}

// SQLite's files on the simulated disk, as its own VFS for Unix would have them: the name of a
// journal or log is flushed with the first bytes that are. The index of the log is memory of the
// process.
#include <errno.h>
#include <fcntl.h>
#include <sqlite3.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/sim/calls.h"
#include "tests/sim/life.h"

#define REGIONS 64

struct file {
    sqlite3_file base;
    int fd;
    bool flushes_folder, goes;
    char path[128];
    void *regions[REGIONS];
};

static int read_file(sqlite3_file *base, void *bytes, int size, sqlite3_int64 at) {
    ssize_t got = sim_pread(((struct file *)base)->fd, bytes, (size_t)size, at);
    if (got == size) return SQLITE_OK;
    memset((char *)bytes + got, 0, (size_t)(size - got));
    return SQLITE_IOERR_SHORT_READ;
}

static int write_file(sqlite3_file *base, const void *bytes, int size, sqlite3_int64 at) {
    return sim_pwrite(((struct file *)base)->fd, bytes, (size_t)size, at) < 0 ? SQLITE_FULL
                                                                              : SQLITE_OK;
}

static int truncate_file(sqlite3_file *base, sqlite3_int64 size) {
    char none = 0;
    struct stat about;
    struct file *file = (struct file *)base;
    sim_fstat(file->fd, &about);
    // Through the calls that may be the last ones.
    if (about.st_size < size) return sim_pwrite(file->fd, &none, 1, size - 1) < 0 ? SQLITE_FULL : 0;
    uint32_t inode = sim_disk_find(&sim->disk, SIM_ROOT, file->path);
    if (inode != SIM_NONE) sim_disk_truncate(&sim->disk, inode, (size_t)size);
    return SQLITE_OK;
}

static int flush_file(sqlite3_file *base, int flags) {
    struct file *file = (struct file *)base;
    sim_fsync(file->fd);
    if (!file->flushes_folder) return SQLITE_OK;
    int folder = sim_open(SIM_DATA, O_RDONLY | O_DIRECTORY);
    sim_fsync(folder);
    sim_close(folder);
    file->flushes_folder = false;
    return SQLITE_OK;
}

static int file_size(sqlite3_file *base, sqlite3_int64 *ret_size) {
    struct stat about;
    sim_fstat(((struct file *)base)->fd, &about);
    *ret_size = about.st_size;
    return SQLITE_OK;
}

// One connection: its locks are its own.
static int lock_file(sqlite3_file *base, int level) {
    return SQLITE_OK;
}

static int is_reserved(sqlite3_file *base, int *ret_reserved) {
    *ret_reserved = 0;
    return SQLITE_OK;
}

static int control_file(sqlite3_file *base, int what, void *argument) {
    return SQLITE_NOTFOUND;
}

static int sector_size(sqlite3_file *base) {
    return SIM_PAGE;
}

static int characteristics(sqlite3_file *base) {
    return SQLITE_IOCAP_POWERSAFE_OVERWRITE;
}

static int map_index(sqlite3_file *base, int region, int size, int extend, void volatile **ret) {
    struct file *file = (struct file *)base;
    if (region >= REGIONS) return SQLITE_NOMEM;
    if (file->regions[region] == NULL && extend) file->regions[region] = calloc(1, (size_t)size);
    *ret = file->regions[region];
    return SQLITE_OK;
}

static int lock_index(sqlite3_file *base, int offset, int count, int flags) {
    return SQLITE_OK;
}

static void barrier(sqlite3_file *base) {}

static int unmap_index(sqlite3_file *base, int remove) {
    struct file *file = (struct file *)base;
    for (int i = 0; i < REGIONS; i++) {
        free(file->regions[i]);
        file->regions[i] = NULL;
    }
    return SQLITE_OK;
}

static int close_file(sqlite3_file *base) {
    struct file *file = (struct file *)base;
    unmap_index(base, 0);
    sim_close(file->fd);
    if (file->goes) sim_unlinkat(AT_FDCWD, file->path, 0);
    return SQLITE_OK;
}

static const sqlite3_io_methods methods = {.iVersion = 2,
                                           .xClose = close_file,
                                           .xRead = read_file,
                                           .xWrite = write_file,
                                           .xTruncate = truncate_file,
                                           .xSync = flush_file,
                                           .xFileSize = file_size,
                                           .xLock = lock_file,
                                           .xUnlock = lock_file,
                                           .xCheckReservedLock = is_reserved,
                                           .xFileControl = control_file,
                                           .xSectorSize = sector_size,
                                           .xDeviceCharacteristics = characteristics,
                                           .xShmMap = map_index,
                                           .xShmLock = lock_index,
                                           .xShmBarrier = barrier,
                                           .xShmUnmap = unmap_index};

static int open_file(sqlite3_vfs *vfs, const char *name, sqlite3_file *base, int flags,
                     int *ret_flags) {
    struct file *file = (struct file *)base;
    static int temporary;
    *file = (struct file){.fd = -1};
    if (name == NULL)
        snprintf(file->path, sizeof file->path, "/sqlite-%d", temporary++);
    else
        snprintf(file->path, sizeof file->path, "%s", name);
    file->goes = name == NULL || (flags & SQLITE_OPEN_DELETEONCLOSE);
    file->fd = sim_open(file->path, flags & SQLITE_OPEN_CREATE ? O_RDWR | O_CREAT : O_RDWR, 0600);
    if (file->fd < 0) return errno == ENOSPC ? SQLITE_FULL : SQLITE_CANTOPEN;
    file->flushes_folder =
        (flags & SQLITE_OPEN_CREATE) && (flags & (SQLITE_OPEN_MAIN_JOURNAL | SQLITE_OPEN_WAL));
    file->base.pMethods = &methods;
    if (ret_flags != NULL) *ret_flags = flags;
    return SQLITE_OK;
}

static int delete_file(sqlite3_vfs *vfs, const char *name, int flush_folder) {
    if (sim_unlinkat(AT_FDCWD, name, 0) != 0) return SQLITE_IOERR_DELETE_NOENT;
    if (!flush_folder) return SQLITE_OK;
    int folder = sim_open(SIM_DATA, O_RDONLY | O_DIRECTORY);
    sim_fsync(folder);
    sim_close(folder);
    return SQLITE_OK;
}

static int look_at(sqlite3_vfs *vfs, const char *name, int flags, int *ret_there) {
    struct stat about;
    *ret_there = sim_fstatat(AT_FDCWD, name, &about, 0) == 0 &&
                 (flags != SQLITE_ACCESS_EXISTS || about.st_size > 0);
    return SQLITE_OK;
}

static int full_name(sqlite3_vfs *vfs, const char *name, int size, char *ret_name) {
    snprintf(ret_name, (size_t)size, "%s", name);
    return SQLITE_OK;
}

static int randomness(sqlite3_vfs *vfs, int size, char *ret_bytes) {
    sim_getrandom(ret_bytes, (size_t)size);
    return size;
}

static int sleep_us(sqlite3_vfs *vfs, int us) {
    return us;
}

static int day_ms(sqlite3_vfs *vfs, sqlite3_int64 *ret_ms) {
    *ret_ms = 210866760000000ll + sim->wall_ms + sim->now_ns / 1000000;
    return SQLITE_OK;
}

static int last_error(sqlite3_vfs *vfs, int size, char *text) {
    return errno;
}

void sim_vfs_register(void) {
    static sqlite3_vfs vfs = {.iVersion = 2,
                              .szOsFile = sizeof(struct file),
                              .mxPathname = 120,
                              .zName = "sim",
                              .xOpen = open_file,
                              .xDelete = delete_file,
                              .xAccess = look_at,
                              .xFullPathname = full_name,
                              .xRandomness = randomness,
                              .xSleep = sleep_us,
                              .xCurrentTimeInt64 = day_ms,
                              .xGetLastError = last_error};
    if (sqlite3_vfs_register(&vfs, 1) != SQLITE_OK) sim_violated("SQLite takes no VFS");
}

int64_t sim_vfs_memory(void) {
    return sqlite3_memory_used();
}

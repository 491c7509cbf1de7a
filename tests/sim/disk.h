// A disk: what programs see, and what of it a loss of power would leave.
//
// A file's bytes and a folder's names are kept as of their last flush, beside the live ones. It
// lies in one block of memory with an allocator of its own.
#ifndef RN_SIM_DISK_H
#define RN_SIM_DISK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define SIM_PAGE 4096
#define SIM_INODES 65536
#define SIM_NAME 72
#define SIM_CLASSES 28

struct sim_bytes {
    uint8_t *data;
    size_t size, capacity;
};

struct sim_name {
    uint32_t inode, hash;
    char text[SIM_NAME];
};
struct sim_names {
    struct sim_name *items;
    size_t count, capacity;
};

enum sim_kind { SIM_FREE, SIM_FILE, SIM_FOLDER };

struct sim_inode {
    enum sim_kind kind;
    bool flushed; // there is something of it on the disk
    bool linked;  // it has a name
    bool marked;
    int opens, kept_links; // kept_links: flushed names of it
    int64_t changed_ms;
    size_t dirty_from, dirty_to; // bytes that differ from the flushed ones
    struct sim_bytes now, kept;
    struct sim_names names, kept_names;
};

struct sim_disk {
    struct sim_inode inodes[SIM_INODES];
    uint32_t inode_count, next_free;
    bool full; // nothing can grow
    uint8_t *block, *top, *end;
    void *spare[SIM_CLASSES]; // by size
};

#define SIM_ROOT 0u
#define SIM_NONE UINT32_MAX

void sim_disk_reset(struct sim_disk *disk, uint8_t *block, size_t size);
// The power is lost: of what was not flushed some is dropped, torn, or there before the rest.
void sim_disk_lose_power(struct sim_disk *disk);
// All that the daemon's process had open is closed.
void sim_disk_close_all(struct sim_disk *disk);
// Forgets it when it has neither a name nor a reader.
void sim_disk_release(struct sim_disk *disk, uint32_t inode);
// Bytes of live files, and how many there are.
void sim_disk_usage(const struct sim_disk *disk, int64_t *ret_bytes, int64_t *ret_files);

// The inode at a path from a folder ("/..." from the root); SIM_NONE and errno.
uint32_t sim_disk_find(struct sim_disk *disk, uint32_t folder, const char *path);
// The folder that holds it, which must be there, and its last component.
uint32_t sim_disk_parent(struct sim_disk *disk, uint32_t folder, const char *path,
                         const char **ret_name);
uint32_t sim_disk_look(const struct sim_disk *disk, uint32_t folder, const char *name);
// SIM_NONE and ENOSPC.
uint32_t sim_disk_make(struct sim_disk *disk, enum sim_kind kind);
bool sim_disk_link(struct sim_disk *disk, uint32_t folder, const char *name, uint32_t inode);
void sim_disk_unlink(struct sim_disk *disk, uint32_t folder, const char *name);
size_t sim_disk_read(const struct sim_disk *disk, uint32_t inode, void *bytes, size_t size,
                     size_t at);
// False and ENOSPC when it would grow and the disk is full.
bool sim_disk_write(struct sim_disk *disk, uint32_t inode, const void *bytes, size_t size,
                    size_t at);
void sim_disk_truncate(struct sim_disk *disk, uint32_t inode, size_t size);
void sim_disk_flush(struct sim_disk *disk, uint32_t inode);

#endif

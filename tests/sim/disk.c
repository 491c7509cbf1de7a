#include "tests/sim/disk.h"

#include <errno.h>
#include <string.h>

#include "tests/sim/world.h"

// ---- memory -----------------------------------------------------------------------------------

static int class_of(size_t size) {
    int class = 6;
    while (((size_t)1 << class) < size)
        class ++;
    return class;
}

static void *take(struct sim_disk *disk, size_t size, size_t *ret_capacity) {
    int class = class_of(size);
    *ret_capacity = (size_t)1 << class;
    if (class < SIM_CLASSES && disk->spare[class] != NULL) {
        void *block = disk->spare[class];
        memcpy(&disk->spare[class], block, sizeof(void *));
        return block;
    }
    if (class >= SIM_CLASSES || (size_t)(disk->end - disk->top) < *ret_capacity)
        sim_violated("the simulated disk has no room for %zu bytes", size);
    void *block = disk->top;
    disk->top += *ret_capacity;
    return block;
}

static void give(struct sim_disk *disk, void *block, size_t capacity) {
    if (block == NULL) return;
    int class = class_of(capacity);
    memcpy(block, &disk->spare[class], sizeof(void *));
    disk->spare[class] = block;
}

// Room for `size`; what is new is zero.
static void reserve(struct sim_disk *disk, struct sim_bytes *bytes, size_t size) {
    if (size <= bytes->capacity) return;
    size_t capacity;
    uint8_t *data = take(disk, size, &capacity);
    if (bytes->size > 0) memcpy(data, bytes->data, bytes->size);
    memset(data + bytes->size, 0, capacity - bytes->size);
    give(disk, bytes->data, bytes->capacity);
    bytes->data = data;
    bytes->capacity = capacity;
}

static void drop_bytes(struct sim_disk *disk, struct sim_bytes *bytes) {
    give(disk, bytes->data, bytes->capacity);
    *bytes = (struct sim_bytes){0};
}

static void drop_names(struct sim_disk *disk, struct sim_names *names) {
    give(disk, names->items, names->capacity * sizeof *names->items);
    *names = (struct sim_names){0};
}

static void reserve_names(struct sim_disk *disk, struct sim_names *names, size_t count) {
    if (count <= names->capacity) return;
    size_t bytes, want = count < 8 ? 8 : 2 * count;
    struct sim_name *items = take(disk, want * sizeof *items, &bytes);
    if (names->count > 0) memcpy(items, names->items, names->count * sizeof *items);
    if (names->items != NULL) give(disk, names->items, names->capacity * sizeof *items);
    names->items = items;
    names->capacity = want;
}

static void forget(struct sim_disk *disk, uint32_t at) {
    struct sim_inode *inode = &disk->inodes[at];
    struct sim_names kept = inode->kept_names;
    drop_bytes(disk, &inode->now);
    drop_bytes(disk, &inode->kept);
    drop_names(disk, &inode->names);
    *inode = (struct sim_inode){0};
    if (at < disk->next_free) disk->next_free = at;
    for (size_t i = 0; i < kept.count; i++) {
        disk->inodes[kept.items[i].inode].kept_links--;
        sim_disk_release(disk, kept.items[i].inode);
    }
    drop_names(disk, &kept);
}

void sim_disk_release(struct sim_disk *disk, uint32_t at) {
    const struct sim_inode *inode = &disk->inodes[at];
    if (inode->kind != SIM_FREE && !inode->linked && inode->opens == 0 && inode->kept_links == 0)
        forget(disk, at);
}

void sim_disk_close_all(struct sim_disk *disk) {
    for (uint32_t i = 0; i < disk->inode_count; i++) {
        disk->inodes[i].opens = 0;
        sim_disk_release(disk, i);
    }
}

void sim_disk_reset(struct sim_disk *disk, uint8_t *block, size_t size) {
    memset(disk, 0, sizeof *disk);
    disk->block = disk->top = block;
    disk->end = block + size;
    disk->inodes[SIM_ROOT] =
        (struct sim_inode){.kind = SIM_FOLDER, .flushed = true, .linked = true};
    disk->inode_count = 1;
    disk->next_free = 1;
}

// ---- names ------------------------------------------------------------------------------------

static uint32_t hash_of(const char *text) {
    uint32_t hash = 2166136261u;
    for (; *text != '\0'; text++)
        hash = (hash ^ (uint8_t)*text) * 16777619u;
    return hash;
}

static struct sim_name *find_name(const struct sim_names *names, const char *text) {
    uint32_t hash = hash_of(text);
    for (size_t i = 0; i < names->count; i++)
        if (names->items[i].hash == hash && strcmp(names->items[i].text, text) == 0)
            return &names->items[i];
    return NULL;
}

uint32_t sim_disk_look(const struct sim_disk *disk, uint32_t folder, const char *name) {
    if (strcmp(name, ".") == 0) return folder;
    const struct sim_name *found = find_name(&disk->inodes[folder].names, name);
    return found != NULL ? found->inode : SIM_NONE;
}

static uint32_t walk(struct sim_disk *disk, uint32_t at, const char *path, bool to_parent,
                     const char **ret_name) {
    if (path[0] == '/') at = SIM_ROOT;
    for (;;) {
        char name[SIM_NAME];
        path += strspn(path, "/");
        size_t size = strcspn(path, "/");
        if (size >= sizeof name) {
            errno = ENAMETOOLONG;
            return SIM_NONE;
        }
        if (size == 0 && !to_parent) return at;
        if (disk->inodes[at].kind != SIM_FOLDER) {
            errno = ENOTDIR;
            return SIM_NONE;
        }
        if (to_parent && path[size + strspn(path + size, "/")] == '\0') {
            *ret_name = path;
            return at;
        }
        memcpy(name, path, size);
        name[size] = '\0';
        at = sim_disk_look(disk, at, name);
        if (at == SIM_NONE) {
            errno = ENOENT;
            return SIM_NONE;
        }
        path += size;
    }
}

uint32_t sim_disk_find(struct sim_disk *disk, uint32_t folder, const char *path) {
    return walk(disk, folder, path, false, NULL);
}

uint32_t sim_disk_parent(struct sim_disk *disk, uint32_t folder, const char *path,
                         const char **ret_name) {
    return walk(disk, folder, path, true, ret_name);
}

uint32_t sim_disk_make(struct sim_disk *disk, enum sim_kind kind) {
    if (disk->full) {
        errno = ENOSPC;
        return SIM_NONE;
    }
    while (disk->next_free < SIM_INODES && disk->inodes[disk->next_free].kind != SIM_FREE)
        disk->next_free++;
    if (disk->next_free == SIM_INODES) sim_violated("the simulated disk has too many files");
    uint32_t made = disk->next_free++;
    if (made >= disk->inode_count) disk->inode_count = made + 1;
    disk->inodes[made] = (struct sim_inode){.kind = kind};
    return made;
}

bool sim_disk_link(struct sim_disk *disk, uint32_t folder, const char *name, uint32_t inode) {
    struct sim_names *names = &disk->inodes[folder].names;
    struct sim_name *found = find_name(names, name);
    uint32_t replaced = SIM_NONE;
    if (strlen(name) >= SIM_NAME) {
        errno = ENAMETOOLONG;
        return false;
    }
    if (found == NULL) {
        reserve_names(disk, names, names->count + 1);
        found = &names->items[names->count++];
        strcpy(found->text, name);
        found->hash = hash_of(name);
    } else if (found->inode != inode) {
        replaced = found->inode;
        disk->inodes[replaced].linked = false;
    }
    found->inode = inode;
    disk->inodes[inode].linked = true;
    if (replaced != SIM_NONE) sim_disk_release(disk, replaced);
    return true;
}

void sim_disk_unlink(struct sim_disk *disk, uint32_t folder, const char *name) {
    struct sim_names *names = &disk->inodes[folder].names;
    struct sim_name *found = find_name(names, name);
    if (found == NULL) return;
    uint32_t inode = found->inode;
    disk->inodes[inode].linked = false;
    *found = names->items[--names->count];
    sim_disk_release(disk, inode);
}

// ---- bytes ------------------------------------------------------------------------------------

static void soil(struct sim_inode *inode, size_t from, size_t to) {
    if (from >= to) return;
    bool clean = inode->dirty_from >= inode->dirty_to;
    if (clean || from < inode->dirty_from) inode->dirty_from = from;
    if (clean || to > inode->dirty_to) inode->dirty_to = to;
}

size_t sim_disk_read(const struct sim_disk *disk, uint32_t inode, void *bytes, size_t size,
                     size_t at) {
    const struct sim_bytes *now = &disk->inodes[inode].now;
    if (at >= now->size) return 0;
    if (size > now->size - at) size = now->size - at;
    memcpy(bytes, now->data + at, size);
    return size;
}

bool sim_disk_write(struct sim_disk *disk, uint32_t inode, const void *bytes, size_t size,
                    size_t at) {
    struct sim_inode *file = &disk->inodes[inode];
    if (at + size > file->now.size && disk->full) {
        errno = ENOSPC;
        return false;
    }
    reserve(disk, &file->now, at + size);
    memcpy(file->now.data + at, bytes, size);
    soil(file, at < file->now.size ? at : file->now.size, at + size);
    if (at + size > file->now.size) file->now.size = at + size;
    file->changed_ms = sim->wall_ms + sim->now_ns / 1000000;
    return true;
}

void sim_disk_truncate(struct sim_disk *disk, uint32_t inode, size_t size) {
    struct sim_inode *file = &disk->inodes[inode];
    size_t old = file->now.size;
    reserve(disk, &file->now, size);
    if (size < old) memset(file->now.data + size, 0, old - size);
    file->now.size = size;
    soil(file, size < old ? size : old, size < old ? old : size);
}

// A name that was moved is there or here, and never in both: the rename is whole.
static void forget_old_name(struct sim_disk *disk, uint32_t inode) {
    for (uint32_t i = 0; i < disk->inode_count && disk->inodes[inode].kept_links > 0; i++) {
        struct sim_names *names = &disk->inodes[i].kept_names;
        for (size_t n = 0; n < names->count; n++) {
            if (names->items[n].inode != inode) continue;
            names->items[n--] = names->items[--names->count];
            disk->inodes[inode].kept_links--;
        }
    }
}

static void flush_names(struct sim_disk *disk, struct sim_inode *folder) {
    struct sim_names before = folder->kept_names, *kept = &folder->kept_names;
    for (size_t i = 0; i < folder->names.count; i++) {
        const struct sim_name *name = &folder->names.items[i], *old = &before.items[i];
        if (disk->inodes[name->inode].kept_links == 0) continue; // it is new
        if (i >= before.count || old->inode != name->inode) old = find_name(&before, name->text);
        if (old == NULL || old->inode != name->inode) forget_old_name(disk, name->inode);
    }
    before = folder->kept_names; // of which some are forgotten
    *kept = (struct sim_names){0};
    reserve_names(disk, kept, folder->names.count);
    kept->count = folder->names.count;
    for (size_t i = 0; i < kept->count; i++) {
        kept->items[i] = folder->names.items[i];
        disk->inodes[kept->items[i].inode].kept_links++;
    }
    for (size_t i = 0; i < before.count; i++) {
        disk->inodes[before.items[i].inode].kept_links--;
        sim_disk_release(disk, before.items[i].inode);
    }
    drop_names(disk, &before);
}

void sim_disk_flush(struct sim_disk *disk, uint32_t at) {
    struct sim_inode *inode = &disk->inodes[at];
    inode->flushed = true;
    if (inode->kind == SIM_FOLDER) {
        flush_names(disk, inode);
        return;
    }
    size_t to = inode->dirty_to < inode->now.size ? inode->dirty_to : inode->now.size;
    reserve(disk, &inode->kept, inode->now.size);
    if (inode->dirty_from < to)
        memcpy(inode->kept.data + inode->dirty_from, inode->now.data + inode->dirty_from,
               to - inode->dirty_from);
    if (inode->now.size < inode->kept.size)
        memset(inode->kept.data + inode->now.size, 0, inode->kept.size - inode->now.size);
    inode->kept.size = inode->now.size;
    inode->dirty_from = inode->dirty_to = 0;
}

// ---- the loss of power ------------------------------------------------------------------------

enum loss { DROPPED, TORN, ANY };

// Of each page the flushed bytes or the newer ones; the size of either.
static void tear(struct sim_disk *disk, struct sim_inode *file) {
    size_t size = sim_chance(2) ? file->now.size : file->kept.size;
    reserve(disk, &file->kept, size);
    reserve(disk, &file->now, size);
    if (file->kept.size < size)
        memset(file->kept.data + file->kept.size, 0, size - file->kept.size);
    for (size_t at = 0; at < size; at += SIM_PAGE) {
        size_t end = at + SIM_PAGE < size ? at + SIM_PAGE : size;
        if (at >= file->dirty_to || end <= file->dirty_from || sim_chance(2)) continue;
        memcpy(file->kept.data + at, file->now.data + at, end - at);
    }
    if (size < file->kept.size) memset(file->kept.data + size, 0, file->kept.size - size);
    file->kept.size = size;
}

static void settle_file(struct sim_disk *disk, struct sim_inode *file, enum loss loss) {
    bool newer = loss == ANY && sim_chance(2);
    if (loss == TORN) tear(disk, file);
    if (newer) {
        sim_disk_flush(disk, (uint32_t)(file - disk->inodes));
        return;
    }
    reserve(disk, &file->now, file->kept.size);
    size_t from = file->dirty_from < file->kept.size ? file->dirty_from : file->kept.size;
    if (loss == TORN) from = 0;
    if (file->kept.size > from)
        memcpy(file->now.data + from, file->kept.data + from, file->kept.size - from);
    if (file->now.size > file->kept.size)
        memset(file->now.data + file->kept.size, 0, file->now.size - file->kept.size);
    file->now.size = file->kept.size;
    file->dirty_from = file->dirty_to = 0;
    file->flushed = true;
}

// What the disk has of a folder becomes what there is, and so on below it.
static void settle(struct sim_disk *disk, uint32_t at, enum loss loss, bool names_kept) {
    struct sim_inode *inode = &disk->inodes[at];
    inode->marked = inode->linked = true;
    inode->opens = 0;
    if (inode->kind == SIM_FILE) {
        settle_file(disk, inode, loss);
        return;
    }
    const struct sim_names *from = &inode->kept_names;
    if (!names_kept) {
        reserve_names(disk, &inode->names, from->count);
        if (from->count > 0)
            memcpy(inode->names.items, from->items, from->count * sizeof *from->items);
        inode->names.count = from->count;
    }
    sim_disk_flush(disk, at);
    for (size_t i = 0; i < inode->names.count; i++) {
        const struct sim_name *name = &inode->names.items[i];
        if (disk->inodes[name->inode].kind == SIM_FREE || disk->inodes[name->inode].marked)
            inode->names.items[i--] = inode->names.items[--inode->names.count];
        else
            settle(disk, name->inode, loss, names_kept);
    }
    sim_disk_flush(disk, at);
}

static void forget_unmarked(struct sim_disk *disk) {
    for (uint32_t i = 0; i < disk->inode_count; i++) {
        struct sim_inode *inode = &disk->inodes[i];
        if (inode->kind == SIM_FREE || inode->marked) continue;
        drop_bytes(disk, &inode->now);
        drop_bytes(disk, &inode->kept);
        drop_names(disk, &inode->names);
        drop_names(disk, &inode->kept_names);
        *inode = (struct sim_inode){0};
    }
    disk->next_free = 1;
}

static void count_links(struct sim_disk *disk) {
    for (uint32_t i = 0; i < disk->inode_count; i++) {
        disk->inodes[i].kept_links = 0;
        disk->inodes[i].marked = false;
    }
    for (uint32_t i = 0; i < disk->inode_count; i++)
        for (size_t n = 0; n < disk->inodes[i].kept_names.count; n++)
            disk->inodes[disk->inodes[i].kept_names.items[n].inode].kept_links++;
}

void sim_disk_lose_power(struct sim_disk *disk) {
    enum loss loss = (enum loss)sim_below(3);
    bool names_kept = sim_chance(2);
    for (uint32_t i = 0; i < disk->inode_count; i++) {
        disk->inodes[i].opens = 0;
        disk->inodes[i].linked = true; // nothing is forgotten before all is settled
    }
    settle(disk, SIM_ROOT, loss, names_kept);
    forget_unmarked(disk);
    count_links(disk);
}

void sim_disk_usage(const struct sim_disk *disk, int64_t *ret_bytes, int64_t *ret_files) {
    *ret_bytes = *ret_files = 0;
    for (uint32_t i = 0; i < disk->inode_count; i++) {
        if (disk->inodes[i].kind != SIM_FILE || !disk->inodes[i].linked) continue;
        *ret_bytes += (int64_t)disk->inodes[i].now.size;
        ++*ret_files;
    }
}

// Preloaded in tests: keeps beside the live files what a disk that loses its power would still
// have.
//
// RIPNERF_SHADOW names a folder. Each file and folder that is flushed gets an id (an extended
// attribute, which dies with its inode); SHADOW/<id> is then a file's bytes as of its last fsync,
// or a folder's entries, "<id> <d|f> <name>" a line. What was never flushed is not there. The flush
// itself is left out: nobody pulls the plug.
#include <dirent.h>
#include <fcntl.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/xattr.h>
#include <unistd.h>

#define NAME "user.ripnerf.id"

static const char *shadow;
static atomic_uint count;

__attribute__((constructor)) static void begin(void) {
    shadow = getenv("RIPNERF_SHADOW");
}

static void id_of(int folder, const char *name, char id[48]) {
    char path[4200];
    snprintf(path, sizeof path, "/proc/self/fd/%d%s%s", folder, *name ? "/" : "", name);
    ssize_t size = getxattr(path, NAME, id, 47);
    if (size <= 0) {
        size = snprintf(id, 48, "%d-%u", (int)getpid(), ++count);
        if (setxattr(path, NAME, id, (size_t)size, 0) != 0) abort();
    }
    id[size] = '\0';
}

// A file of the shadow, to be renamed to its name once it is whole.
static FILE *begin_file(const char *id, char temporary[4200]) {
    snprintf(temporary, 4200, "%s/.%s.%d-%u", shadow, id, (int)getpid(), ++count);
    FILE *file = fopen(temporary, "we");
    if (file == NULL) abort();
    return file;
}

static void end_file(FILE *file, const char *temporary, const char *id) {
    char path[4200];
    snprintf(path, sizeof path, "%s/%s", shadow, id);
    if (fclose(file) != 0 || rename(temporary, path) != 0) abort();
}

static void keep_file(int fd) {
    char id[48], temporary[4200], bytes[65536], path[64];
    ssize_t got;
    id_of(fd, "", id);
    FILE *file = begin_file(id, temporary);
    snprintf(path, sizeof path, "/proc/self/fd/%d", fd);
    int copy = open(path, O_RDONLY | O_CLOEXEC);
    while (copy >= 0 && (got = read(copy, bytes, sizeof bytes)) > 0)
        fwrite(bytes, 1, (size_t)got, file);
    if (copy >= 0) close(copy);
    end_file(file, temporary, id);
}

static void keep_folder(int fd) {
    char id[48], inner[48], temporary[4200];
    struct dirent *entry;
    int copy = openat(fd, ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    DIR *folder = copy >= 0 ? fdopendir(copy) : NULL;
    if (folder == NULL) return;
    id_of(fd, "", id);
    FILE *file = begin_file(id, temporary);
    while ((entry = readdir(folder)) != NULL) {
        struct stat about;
        if (strcmp(entry->d_name, ".") == 0 || strcmp(entry->d_name, "..") == 0) continue;
        if (fstatat(fd, entry->d_name, &about, AT_SYMLINK_NOFOLLOW) != 0) continue;
        if (!S_ISREG(about.st_mode) && !S_ISDIR(about.st_mode)) continue;
        id_of(fd, entry->d_name, inner);
        fprintf(file, "%s %c %s\n", inner, S_ISDIR(about.st_mode) ? 'd' : 'f', entry->d_name);
    }
    closedir(folder);
    end_file(file, temporary, id);
}

// RIPNERF_FORGETS: a part of the paths whose flushes are left out, as a program that forgot them.
static bool is_forgotten(int fd) {
    const char *part = getenv("RIPNERF_FORGETS");
    char link[64], path[4200];
    if (part == NULL) return false;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t size = readlink(link, path, sizeof path - 1);
    path[size > 0 ? size : 0] = '\0';
    return strstr(path, part) != NULL;
}

static int keep(int fd) {
    struct stat about;
    if (shadow == NULL || is_forgotten(fd) || fstat(fd, &about) != 0) return 0;
    if (S_ISREG(about.st_mode)) keep_file(fd);
    if (S_ISDIR(about.st_mode)) keep_folder(fd);
    return 0;
}

static void keep_all(int fd) {
    struct dirent *entry;
    int copy = openat(fd, ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    DIR *folder = copy >= 0 ? fdopendir(copy) : NULL;
    while (folder != NULL && (entry = readdir(folder)) != NULL) {
        if (strcmp(entry->d_name, ".") == 0 || strcmp(entry->d_name, "..") == 0) continue;
        int inner = openat(fd, entry->d_name, O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC);
        struct stat about;
        if (inner < 0) continue;
        if (fstat(inner, &about) == 0 && S_ISDIR(about.st_mode))
            keep_all(inner);
        else
            keep(inner);
        close(inner);
    }
    if (folder != NULL) closedir(folder);
    keep(fd);
}

int fsync(int fd);
int fdatasync(int fd);
int syncfs(int fd);

int fsync(int fd) {
    return keep(fd);
}

int fdatasync(int fd) {
    return keep(fd);
}

// All of the disk; the tests' disk is the data folder.
int syncfs(int fd) {
    const char *data = getenv("RIPNERF_SHADOW_OF");
    int root = data != NULL ? open(data, O_RDONLY | O_DIRECTORY | O_CLOEXEC) : -1;
    if (root >= 0) {
        keep_all(root);
        close(root);
    }
    return 0;
}

// The system calls of the simulation, as the shipped sources see them: semantics and errno as of
// the calls that they stand for.
#ifndef RN_SIM_CALLS_H
#define RN_SIM_CALLS_H

#include <dirent.h>
#include <poll.h>
#include <pthread.h>
#include <stdint.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <time.h>

// ---- files.c ----
int sim_open(const char *path, int flags, ...);
int sim_openat(int folder, const char *path, int flags, ...);
int sim_close(int fd);
ssize_t sim_read(int fd, void *bytes, size_t size);
ssize_t sim_write(int fd, const void *bytes, size_t size);
ssize_t sim_pread(int fd, void *bytes, size_t size, off_t at);
ssize_t sim_pwrite(int fd, const void *bytes, size_t size, off_t at);
int sim_fsync(int fd);
int sim_flock(int fd, int how);
int sim_rename(const char *from, const char *to);
int sim_unlinkat(int folder, const char *path, int flags);
int sim_mkdir(const char *path, mode_t mode);
int sim_fstat(int fd, struct stat *about);
int sim_fstatat(int folder, const char *path, struct stat *about, int flags);
int sim_access(const char *path, int mode);
DIR *sim_opendir(const char *path);
DIR *sim_fdopendir(int fd);
struct dirent *sim_readdir(DIR *folder);
int sim_closedir(DIR *folder);
int sim_dirfd(DIR *folder);
int sim_scandir(const char *path, struct dirent ***ret_entries); // by name
ssize_t sim_recv(int fd, void *bytes, size_t size);
ssize_t sim_send(int fd, const void *bytes, size_t size);
int sim_eventfd(unsigned value);

// ---- threads.c ----
int sim_poll(struct pollfd *polls, nfds_t count, int timeout_ms);
int sim_nanosleep(const struct timespec *time);
ssize_t sim_getrandom(void *bytes, size_t size);
int sim_mutex_init(pthread_mutex_t *mutex);
int sim_mutex_lock(pthread_mutex_t *mutex);
int sim_mutex_unlock(pthread_mutex_t *mutex);
int sim_thread_create(pthread_t *thread, void *(*run)(void *context), void *context);
int sim_thread_join(pthread_t thread);

#endif

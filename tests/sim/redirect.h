// Put in front of the shipped sources when they are built for the simulation (gcc's -include):
// their system calls become the simulation's. Function-like macros leave members and variables of
// the same names alone.
#ifndef RN_SIM_REDIRECT_H
#define RN_SIM_REDIRECT_H

#include <dirent.h>
#include <fcntl.h>
#include <poll.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/eventfd.h>
#include <sys/file.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

// Sources that know nothing of sockets have functions of their own with such names.
#define bind socket_bind
#include <sys/socket.h>
#undef bind

#include "tests/sim/calls.h"

#define open(...) sim_open(__VA_ARGS__)
#define openat(...) sim_openat(__VA_ARGS__)
#define close(fd) sim_close(fd)
#define read(fd, bytes, size) sim_read(fd, bytes, size)
#define write(fd, bytes, size) sim_write(fd, bytes, size)
#define pread(fd, bytes, size, at) sim_pread(fd, bytes, size, at)
#define pwrite(fd, bytes, size, at) sim_pwrite(fd, bytes, size, at)
#define fsync(fd) sim_fsync(fd)
#define flock(fd, how) sim_flock(fd, how)
#define rename(from, to) sim_rename(from, to)
#define unlink(path) sim_unlinkat(AT_FDCWD, path, 0)
#define unlinkat(folder, path, flags) sim_unlinkat(folder, path, flags)
#define rmdir(path) sim_unlinkat(AT_FDCWD, path, AT_REMOVEDIR)
#define mkdir(path, mode) sim_mkdir(path, mode)
#define stat(path, about) sim_fstatat(AT_FDCWD, path, about, 0)
#define fstat(fd, about) sim_fstat(fd, about)
#define fstatat(folder, path, about, flags) sim_fstatat(folder, path, about, flags)
#define access(path, mode) sim_access(path, mode)
#define opendir(path) sim_opendir(path)
#define fdopendir(fd) sim_fdopendir(fd)
#define readdir(folder) sim_readdir(folder)
#define closedir(folder) sim_closedir(folder)
#define dirfd(folder) sim_dirfd(folder)
#define scandir(path, list, filter, compare) sim_scandir(path, list)
#define recv(fd, bytes, size, flags) sim_recv(fd, bytes, size)
#define send(fd, bytes, size, flags) sim_send(fd, bytes, size)
#define eventfd(value, flags) sim_eventfd(value)
#define poll(polls, count, timeout_ms) sim_poll(polls, count, timeout_ms)
#define nanosleep(time, left) sim_nanosleep(time)
#define getrandom(bytes, size, flags) sim_getrandom(bytes, size)
#define pthread_mutex_init(mutex, attributes) sim_mutex_init(mutex)
#define pthread_mutex_lock(mutex) sim_mutex_lock(mutex)
#define pthread_mutex_unlock(mutex) sim_mutex_unlock(mutex)
#define pthread_mutex_destroy(mutex) ((void)(mutex))
#define pthread_create(thread, attributes, run, context) sim_thread_create(thread, run, context)
#define pthread_join(thread, result) sim_thread_join(thread)

// Sources of server/jobs are heard: each event, before anyone else has it.
#ifdef RN_SIM_HEARD
#include "server/http/ring.h"
void sim_heard(const char *name, const char *json);
#define rn_ring_publish(ring, id, name, json, key)                                                 \
    (sim_heard(name, json), rn_ring_publish(ring, id, name, json, key))
#endif

#endif

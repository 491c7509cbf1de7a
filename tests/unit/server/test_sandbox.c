// What a sandboxed process can still do, tried in one.
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "common/base/file.h"
#include "server/runner/sandbox/sandbox.h"
#include "tests/support/suite.h"

static char folder[64], mine[128], theirs[128];

static void enter(void) {
    strcpy(folder, "/tmp/test_sandbox.XXXXXX");
    ck_assert_ptr_nonnull(mkdtemp(folder));
    snprintf(mine, sizeof mine, "%s/mine", folder);
    snprintf(theirs, sizeof theirs, "%s/theirs", folder);
    ck_assert_int_eq(mkdir(mine, 0700) | mkdir(theirs, 0700), 0);
    char path[160];
    snprintf(path, sizeof path, "%s/secret", folder);
    ck_assert_int_eq(rn_file_write_atomic(path, "x", 1, NULL), RN_OK);
    snprintf(path, sizeof path, "%s/given", theirs);
    ck_assert_int_eq(rn_file_write_atomic(path, "x", 1, NULL), RN_OK);
}

static void leave(void) {
    ck_assert_int_eq(rn_remove_tree(folder, NULL), RN_OK);
}

// Runs `body` in a process of its own; it returns the number of what went wrong, 0 for nothing.
static void in_child(int (*body)(void)) {
    pid_t pid = fork();
    int status;
    ck_assert_int_ge(pid, 0);
    if (pid == 0) _exit(body());
    ck_assert_int_eq(waitpid(pid, &status, 0), pid);
    ck_assert_msg(WIFEXITED(status) && WEXITSTATUS(status) == 0, "attempt %d was not as it should",
                  WEXITSTATUS(status));
}

static bool fails(long result, int errnum) {
    return result == -1 && errno == errnum;
}

static void *nothing(void *context) {
    return context;
}

static int try_calls(void) {
    char *argv[] = {(char *)"true", NULL};
    pthread_t thread;
    int status;
    rn_sandbox_begin(rn_profile_of("field"));
    if (!fails(execv("/bin/true", argv), EPERM)) return 1;
    if (!fails(socket(AF_INET, SOCK_STREAM, 0), EPERM)) return 2;
    if (!fails(socket(AF_UNIX, SOCK_STREAM, 0), EPERM)) return 3;
    if (!fails(ptrace(PTRACE_TRACEME, 0, NULL, NULL), EPERM)) return 4;
    if (!fails(unshare(CLONE_NEWUSER), EPERM)) return 5;
    if (!fails(setuid(1), EPERM)) return 6;
    if (!fails(mknod("/tmp/never", S_IFIFO | 0600, 0), EPERM)) return 7;
    // What it needs goes on: threads, and the processes of a debugger's or sanitizer's kind.
    if (pthread_create(&thread, NULL, nothing, NULL) != 0 || pthread_join(thread, NULL) != 0)
        return 8;
    pid_t pid = fork();
    if (pid == 0) _exit(execv("/bin/true", argv) == -1 && errno == EPERM ? 0 : 1);
    if (waitpid(pid, &status, 0) != pid || status != 0) return 9; // it holds for children
    if (!fails(syscall(__NR_timerfd_create, CLOCK_MONOTONIC, 0), ENOSYS)) return 11; // not listed
    struct rlimit core;
    if (getrlimit(RLIMIT_CORE, &core) != 0 || core.rlim_max != 0) return 10;
    return 0;
}

START_TEST(test_calls) {
    in_child(try_calls);
}
END_TEST

static int open_at(const char *parent, const char *name, int flags) {
    char path[256];
    snprintf(path, sizeof path, "%s/%s", parent, name);
    int fd = open(path, flags | O_CLOEXEC, 0600);
    if (fd >= 0) close(fd);
    return fd >= 0 ? 0 : -1;
}

static int try_disk(void) {
    char from[256], to[256];
    const struct rn_profile *field = rn_profile_of("field");
    struct rn_sandbox_places places = {.paths = {[RN_PLACE_DATASET] = theirs,
                                                 [RN_PLACE_SCENE] = mine,
                                                 [RN_PLACE_WORK] = "/no/such/place"},
                                       .memory_bytes = 64 << 20,
                                       .file_bytes = 1 << 20};
    rn_sandbox_begin(field);
    if (!rn_sandbox_confine(field, &places)) return 77;
    if (open_at(mine, "made", O_RDWR | O_CREAT) != 0) return 1;
    if (open_at(mine, "made", O_WRONLY | O_TRUNC) != 0) return 2;
    if (open_at(theirs, "given", O_RDONLY) != 0) return 3;
    if (!fails(open_at(theirs, "given", O_WRONLY), EACCES)) return 4;
    if (!fails(open_at(theirs, "made", O_WRONLY | O_CREAT), EACCES)) return 5;
    if (!fails(open_at(folder, "secret", O_RDONLY), EACCES)) return 6;
    if (!fails(open_at(folder, "made", O_WRONLY | O_CREAT), EACCES)) return 7;
    if (!fails(open_at("/root", ".", O_RDONLY | O_DIRECTORY), EACCES)) return 8;
    if (!fails(open_at("/etc", "passwd", O_RDONLY), EACCES)) return 17;
    if (!fails(open_at("/dev", "ptmx", O_RDWR | O_NOCTTY), EACCES)) return 18;
    snprintf(from, sizeof from, "%s/made", mine);
    snprintf(to, sizeof to, "%s/renamed", mine);
    if (rename(from, to) != 0 || unlink(to) != 0) return 9;
    snprintf(to, sizeof to, "%s/made", folder);
    if (rename(from, to) == 0) return 10;
    if (open_at("/usr", "bin", O_RDONLY | O_DIRECTORY) != 0) return 11; // libraries are found
    if (open_at("/proc/self", "statm", O_RDONLY) != 0) return 12;
    if (!fails(symlink("/etc/passwd", from), ENOSYS)) return 13;
    if (malloc(256u << 20) != NULL) return 14;
    int fd = open(from, O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    if (fd < 0 || pwrite(fd, "x", 1, 1 << 19) != 1) return 15;
    if (!fails(pwrite(fd, "x", 1, 1 << 21), EFBIG)) return 16;
    return 0;
}

static void in_child_with_landlock(int (*body)(void)) {
    pid_t pid = fork();
    int status;
    if (pid == 0) _exit(body());
    ck_assert_int_eq(waitpid(pid, &status, 0), pid);
    if (WIFEXITED(status) && WEXITSTATUS(status) == 77) {
        printf("skipped: this kernel has no Landlock\n");
        return;
    }
    ck_assert_msg(status == 0, "attempt %d was not as it should (%d)", WEXITSTATUS(status), status);
}

START_TEST(test_disk) {
    in_child_with_landlock(try_disk);
}
END_TEST

static int run(const char *program) {
    const char *argv[] = {program, "--version", NULL};
    int status;
    pid_t pid = fork();
    if (pid == 0) _exit(execv(program, (char **)argv) == -1 && errno == EACCES ? 66 : 67);
    return waitpid(pid, &status, 0) == pid && WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

// A mode starts the programs of its row of the table and no others; what they may is no more.
static int try_programs(void) {
    const struct rn_profile profile = {.mode = "test", .programs = {"id"}, .write = 1};
    struct rn_sandbox_places places = {.paths = {mine}};
    rn_sandbox_begin(&profile);
    if (!rn_sandbox_confine(&profile, &places)) return 77;
    if (kill(getppid(), SIGSTOP) == 0 || kill(getpid(), 0) != 0) return 5;
    if (run("/usr/bin/id") != 0) return 1;
    if (run("/usr/bin/env") != 66) return 2;
    if (!fails(socket(AF_INET, SOCK_STREAM, 0), EPERM)) return 3;
    if (!fails(open_at(folder, "secret", O_RDONLY), EACCES)) return 4;
    char link[256];
    snprintf(link, sizeof link, "%s/link", mine);
    if (!fails(symlink("/etc/passwd", link), EACCES)) return 6;
    return 0;
}

START_TEST(test_programs) {
    in_child_with_landlock(try_programs);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("sandbox");
    TCase *tcase = tcase_create("sandbox");
    tcase_add_checked_fixture(tcase, enter, leave);
    tcase_add_test(tcase, test_calls);
    tcase_add_test(tcase, test_disk);
    tcase_add_test(tcase, test_programs);
    suite_add_tcase(suite, tcase);
    return run_suite(suite);
}

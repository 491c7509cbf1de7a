#include "server/runner/sandbox/sandbox.h"

#include <errno.h>
#include <fcntl.h>
#include <glob.h>
#include <libgen.h>
#include <limits.h>
#include <linux/landlock.h>
#include <signal.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "common/base/log.h"
#include "common/base/program.h"
#include "server/runner/sandbox/calls.h"

// ---- privileges and limits --------------------------------------------------------------------

static void limit(int what, rlim_t most) {
    struct rlimit now;
    if (getrlimit((__rlimit_resource_t)what, &now) != 0) return;
    if (now.rlim_max != RLIM_INFINITY && now.rlim_max < most) most = now.rlim_max;
    now.rlim_cur = now.rlim_max = most;
    if (setrlimit((__rlimit_resource_t)what, &now) != 0)
        rn_log(RN_LOG_WARN, "a limit cannot be set: %s", strerror(errno));
}

void rn_sandbox_begin(const struct rn_profile *profile) {
    if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0)
        rn_log(RN_LOG_WARN, "no_new_privs is not to be had: %s", strerror(errno));
    limit(RLIMIT_CORE, 0);
    limit(RLIMIT_NOFILE, 4096);
    rn_calls_filter(profile);
}

// ---- the disk ---------------------------------------------------------------------------------

#define READ_FILE LANDLOCK_ACCESS_FS_READ_FILE
#define READ (READ_FILE | LANDLOCK_ACCESS_FS_READ_DIR)
#define WRITE_FILE LANDLOCK_ACCESS_FS_WRITE_FILE
#define WRITE                                                                                      \
    (READ | WRITE_FILE | LANDLOCK_ACCESS_FS_REMOVE_DIR | LANDLOCK_ACCESS_FS_REMOVE_FILE |          \
     LANDLOCK_ACCESS_FS_MAKE_DIR | LANDLOCK_ACCESS_FS_MAKE_REG)
#define ALL                                                                                        \
    (WRITE | LANDLOCK_ACCESS_FS_EXECUTE | LANDLOCK_ACCESS_FS_MAKE_CHAR |                           \
     LANDLOCK_ACCESS_FS_MAKE_SOCK | LANDLOCK_ACCESS_FS_MAKE_FIFO | LANDLOCK_ACCESS_FS_MAKE_BLOCK | \
     LANDLOCK_ACCESS_FS_MAKE_SYM)
#define FILE_RIGHTS (READ_FILE | WRITE_FILE | LANDLOCK_ACCESS_FS_EXECUTE | TRUNCATE)
// Of later kernels than these headers': moving between folders, cutting files, TCP.
#define REFER (1ull << 13)
#define TRUNCATE (1ull << 14)
#define TCP 3ull

// A process outside is sent no signal and reached by no abstract socket (Linux 6.12).
#define SCOPES 3ull

struct ruleset {
    uint64_t files, net, scopes;
};

static uint64_t handled_files(int abi) {
    return ALL | (abi >= 2 ? REFER : 0) | (abi >= 3 ? TRUNCATE : 0);
}

static void allow(int rules, const char *path, uint64_t access, uint64_t handled) {
    struct stat about;
    int fd = open(path, O_PATH | O_CLOEXEC);
    if (fd < 0 || fstat(fd, &about) != 0) {
        if (fd >= 0) close(fd);
        return;
    }
    if (!S_ISDIR(about.st_mode)) access &= FILE_RIGHTS;
    struct landlock_path_beneath_attr beneath = {.allowed_access = access & handled,
                                                 .parent_fd = fd};
    if (syscall(__NR_landlock_add_rule, rules, LANDLOCK_RULE_PATH_BENEATH, &beneath, 0) != 0)
        rn_log(RN_LOG_WARN, "%s stays closed: %s", path, strerror(errno));
    close(fd);
}

static void allow_all(int rules, const char *pattern, uint64_t access, uint64_t handled) {
    glob_t found;
    if (glob(pattern, 0, NULL, &found) == 0)
        for (size_t i = 0; i < found.gl_pathc; i++)
            allow(rules, found.gl_pathv[i], access, handled);
    globfree(&found);
}

// Libraries, the modules beside the program, what the kernel tells, and devices of GPUs.
static void allow_system(int rules, uint64_t handled) {
    static const char *const read[] = {"/usr",
                                       "/lib",
                                       "/lib64",
                                       "/opt",
                                       "/proc",
                                       "/sys",
                                       "/etc/ld.so.*",
                                       "/etc/localtime",
                                       "/etc/alternatives",
                                       "/etc/fonts",
                                       NULL};
    static const char *const devices[] = {
        "/dev/null", "/dev/zero", "/dev/random", "/dev/urandom", "/dev/shm", "/dev/nvidia*", NULL};
    char program[PATH_MAX];
    ssize_t size = readlink("/proc/self/exe", program, sizeof program - 1);
    for (int i = 0; read[i] != NULL; i++)
        allow_all(rules, read[i], READ, handled);
    for (int i = 0; devices[i] != NULL; i++)
        allow_all(rules, devices[i], READ | WRITE_FILE, handled);
    if (size <= 0) return;
    program[size] = '\0';
    allow(rules, dirname(dirname(program)), READ, handled);
    static const char *const modules[] = {"RIPNERF_CUDA_MODULE", "RIPNERF_FILM_MODULE", NULL};
    for (int i = 0; modules[i] != NULL; i++) {
        const char *module = getenv(modules[i]);
        if (module != NULL) allow(rules, module, READ, handled);
    }
}

// A program that is a script is run by the one that its first line names.
static void allow_program(int rules, const char *path, uint64_t handled) {
    char line[PATH_MAX + 3] = "", *interpreter = line + 2;
    FILE *file = fopen(path, "re");
    allow(rules, path, READ | LANDLOCK_ACCESS_FS_EXECUTE, handled);
    if (file == NULL) return;
    if (fgets(line, sizeof line, file) != NULL && line[0] == '#' && line[1] == '!') {
        interpreter += strspn(interpreter, " ");
        interpreter[strcspn(interpreter, " \n")] = '\0';
        allow(rules, interpreter, READ | LANDLOCK_ACCESS_FS_EXECUTE, handled);
    }
    fclose(file);
}

// The programs of the profile, and the loader that runs them.
static void allow_programs(int rules, const struct rn_profile *profile, uint64_t handled) {
    static const char *const loaders[] = {"/lib64/ld-linux-*", "/lib/ld-linux-*", NULL};
    for (int i = 0; profile->programs[i] != NULL; i++) {
        const char *program = rn_program_find(profile->programs[i]);
        if (program != NULL) allow_program(rules, program, handled);
    }
    for (int i = 0; profile->programs[0] != NULL && loaders[i] != NULL; i++)
        allow_all(rules, loaders[i], READ | LANDLOCK_ACCESS_FS_EXECUTE, handled);
}

static void allow_places(int rules, const struct rn_profile *profile,
                         const struct rn_sandbox_places *places, uint64_t handled) {
    for (int i = 0; i < RN_PLACE_COUNT; i++) {
        const unsigned bit = 1u << i;
        const char *path = places->paths[i];
        char above[PATH_MAX];
        if (path == NULL) continue;
        if (profile->read & bit) allow(rules, path, READ, handled);
        if (profile->write & bit) allow(rules, path, WRITE | REFER | TRUNCATE, handled);
        if (!(profile->tidy & bit)) continue;
        snprintf(above, sizeof above, "%s", path);
        allow(rules, dirname(above), LANDLOCK_ACCESS_FS_REMOVE_DIR, handled);
    }
}

static bool lock_disk(const struct rn_profile *profile, const struct rn_sandbox_places *places) {
    int abi = (int)syscall(__NR_landlock_create_ruleset, NULL, 0, LANDLOCK_CREATE_RULESET_VERSION);
    if (abi < 1) return false;
    struct ruleset ruleset = {.files = handled_files(abi), .net = TCP, .scopes = SCOPES};
    size_t size = abi >= 6   ? sizeof ruleset
                  : abi >= 4 ? offsetof(struct ruleset, scopes)
                             : sizeof ruleset.files;
    int rules = (int)syscall(__NR_landlock_create_ruleset, &ruleset, size, 0);
    if (rules < 0) return false;
    allow_system(rules, ruleset.files);
    allow_programs(rules, profile, ruleset.files);
    allow_places(rules, profile, places, ruleset.files);
    bool ok = syscall(__NR_landlock_restrict_self, rules, 0) == 0;
    close(rules);
    return ok;
}

// What RLIMIT_DATA counts of this process by now: libraries alone may be megabytes.
static rlim_t own_data(void) {
    unsigned long long pages = 0;
    FILE *file = fopen("/proc/self/statm", "re");
    if (!file) return 0;
    if (fscanf(file, "%*u %*u %*u %*u %*u %llu", &pages) != 1) pages = 0;
    (void)fclose(file);
    return (rlim_t)pages * (rlim_t)sysconf(_SC_PAGESIZE);
}

bool rn_sandbox_confine(const struct rn_profile *profile, const struct rn_sandbox_places *places) {
    if (places->memory_bytes > 0) limit(RLIMIT_DATA, own_data() + (rlim_t)places->memory_bytes);
    signal(SIGXFSZ, SIG_IGN); // a file that grows too large is an error like a full disk
    if (places->file_bytes > 0) limit(RLIMIT_FSIZE, (rlim_t)places->file_bytes);
    bool ok = lock_disk(profile, places);
    if (!ok) rn_log(RN_LOG_WARN, "the disk is not confined: Landlock: %s", strerror(errno));
    return ok;
}

#include "server/runner/sandbox/calls.h"

#include <errno.h>
#include <linux/audit.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <sched.h>
#include <stddef.h>
#include <string.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "common/base/log.h"

#if defined(__x86_64__)
#define ARCH AUDIT_ARCH_X86_64
#elif defined(__aarch64__)
#define ARCH AUDIT_ARCH_AARCH64
#endif

// ---- the lists --------------------------------------------------------------------------------

// What a mode with listed calls may do: files that are open or that it can open, memory, threads,
// time, signals, and looking at itself.
static const int listed[] = {
    __NR_read,
    __NR_write,
    __NR_readv,
    __NR_writev,
    __NR_pread64,
    __NR_pwrite64,
    __NR_preadv,
    __NR_pwritev,
    __NR_lseek,
    __NR_close,
    __NR_close_range,
    __NR_openat,
    __NR_fstat,
    __NR_newfstatat,
    __NR_statx,
    __NR_faccessat,
    __NR_faccessat2,
    __NR_readlinkat,
    __NR_getdents64,
    __NR_getcwd,
    __NR_fcntl,
    __NR_flock,
    __NR_ftruncate,
    __NR_fallocate,
    __NR_fsync,
    __NR_fdatasync,
    __NR_sync_file_range,
    __NR_syncfs,
    __NR_fadvise64,
    __NR_renameat2,
    __NR_unlinkat,
    __NR_mkdirat,
    __NR_ioctl,
    __NR_dup,
    __NR_dup3,
    __NR_pipe2,
    __NR_eventfd2,
    __NR_copy_file_range,
    __NR_sendfile,
    __NR_umask,
    __NR_statfs,
    __NR_fstatfs,
    __NR_memfd_create,
    __NR_mmap,
    __NR_mprotect,
    __NR_munmap,
    __NR_mremap,
    __NR_madvise,
    __NR_brk,
    __NR_mlock,
    __NR_mlock2,
    __NR_munlock,
    __NR_mincore,
    __NR_msync,
    __NR_mbind,
    __NR_get_mempolicy,
    __NR_set_mempolicy,
    __NR_membarrier,
    __NR_clone,
    __NR_futex,
    __NR_set_robust_list,
    __NR_get_robust_list,
    __NR_set_tid_address,
    __NR_rseq,
    __NR_exit,
    __NR_exit_group,
    __NR_gettid,
    __NR_getpid,
    __NR_getppid,
    __NR_tgkill,
    __NR_sched_yield,
    __NR_sched_getaffinity,
    __NR_sched_setaffinity,
    __NR_sched_getparam,
    __NR_sched_getscheduler,
    __NR_sched_setscheduler,
    __NR_sched_get_priority_max,
    __NR_sched_get_priority_min,
    __NR_getpriority,
    __NR_setpriority,
    __NR_getcpu,
    __NR_prctl,
    __NR_prlimit64,
    __NR_getrusage,
    __NR_wait4,
    __NR_waitid,
    __NR_rt_sigaction,
    __NR_rt_sigprocmask,
    __NR_rt_sigreturn,
    __NR_rt_sigtimedwait,
    __NR_rt_sigsuspend,
    __NR_rt_sigpending,
    __NR_sigaltstack,
    __NR_restart_syscall,
    __NR_pidfd_open,
    __NR_pidfd_send_signal,
    __NR_clock_gettime,
    __NR_clock_getres,
    __NR_clock_nanosleep,
    __NR_nanosleep,
    __NR_gettimeofday,
    __NR_times,
    __NR_ppoll,
    __NR_pselect6,
    __NR_epoll_create1,
    __NR_epoll_ctl,
    __NR_epoll_pwait,
    __NR_recvfrom,
    __NR_recvmsg,
    __NR_sendto,
    __NR_sendmsg,
    __NR_shutdown,
    __NR_getsockopt,
    __NR_getsockname,
    __NR_uname,
    __NR_sysinfo,
    __NR_getuid,
    __NR_geteuid,
    __NR_getgid,
    __NR_getegid,
    __NR_getrandom,
    __NR_landlock_create_ruleset,
    __NR_landlock_add_rule,
    __NR_landlock_restrict_self,
#ifdef __NR_open // of older architectures
    __NR_open,
    __NR_creat,
    __NR_stat,
    __NR_lstat,
    __NR_access,
    __NR_readlink,
    __NR_rename,
    __NR_unlink,
    __NR_mkdir,
    __NR_rmdir,
    __NR_dup2,
    __NR_pipe,
    __NR_eventfd,
    __NR_poll,
    __NR_select,
    __NR_epoll_create,
    __NR_epoll_wait,
    __NR_time,
    __NR_getrlimit,
    __NR_setrlimit,
    __NR_fork,
    __NR_vfork,
    __NR_arch_prctl,
#endif
};

// Refused to modes that start no program.
static const int programs[] = {__NR_execve, __NR_execveat};

// Refused to all.
static const int refused[] = {
    __NR_socket,
    __NR_socketpair,
    __NR_bind,
    __NR_connect,
    __NR_listen,
    __NR_accept,
    __NR_accept4,
    __NR_ptrace,
    __NR_process_vm_readv,
    __NR_process_vm_writev,
    __NR_kcmp,
    __NR_unshare,
    __NR_setns,
    __NR_mount,
    __NR_umount2,
    __NR_pivot_root,
    __NR_chroot,
    __NR_move_mount,
    __NR_open_tree,
    __NR_fsopen,
    __NR_fsmount,
    __NR_swapon,
    __NR_swapoff,
    __NR_reboot,
    __NR_kexec_load,
    __NR_init_module,
    __NR_finit_module,
    __NR_delete_module,
    __NR_bpf,
    __NR_perf_event_open,
    __NR_userfaultfd,
    __NR_fanotify_init,
    __NR_name_to_handle_at,
    __NR_open_by_handle_at,
    __NR_io_uring_setup,
    __NR_io_uring_enter,
    __NR_io_uring_register,
    __NR_add_key,
    __NR_request_key,
    __NR_keyctl,
    __NR_setuid,
    __NR_setgid,
    __NR_setreuid,
    __NR_setregid,
    __NR_setresuid,
    __NR_setresgid,
    __NR_setgroups,
    __NR_setfsuid,
    __NR_setfsgid,
    __NR_capset,
    __NR_settimeofday,
    __NR_clock_settime,
    __NR_clock_adjtime,
    __NR_adjtimex,
    __NR_sethostname,
    __NR_setdomainname,
    __NR_syslog,
    __NR_acct,
    __NR_quotactl,
    __NR_personality,
    __NR_vhangup,
    __NR_pidfd_getfd,
#ifdef __NR_iopl
    __NR_iopl,
    __NR_ioperm,
    __NR_modify_ldt,
    __NR_mknod,
#endif
    __NR_mknodat,
};
enum {
    LISTED = sizeof listed / sizeof listed[0],
    PROGRAMS = sizeof programs / sizeof programs[0],
    REFUSED = sizeof refused / sizeof refused[0],
    RULES = 2 * (LISTED + PROGRAMS + REFUSED) + 20
};

#define DENY (SECCOMP_RET_ERRNO | EPERM)
#define UNKNOWN (SECCOMP_RET_ERRNO | ENOSYS)
#define NAMESPACES                                                                                 \
    (CLONE_NEWNS | CLONE_NEWCGROUP | CLONE_NEWUTS | CLONE_NEWIPC | CLONE_NEWUSER | CLONE_NEWPID |  \
     CLONE_NEWNET)

static void add(struct sock_filter *rules, unsigned short *count, struct sock_filter rule) {
    rules[(*count)++] = rule;
}

static void add_all(struct sock_filter *rules, unsigned short *count, const int *calls,
                    int call_count, unsigned verdict) {
    for (int i = 0; i < call_count; i++) {
        add(rules, count,
            (struct sock_filter)BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, (unsigned)calls[i], 0, 1));
        add(rules, count, (struct sock_filter)BPF_STMT(BPF_RET | BPF_K, verdict));
    }
}

// Threads are made without namespaces; clone3 hides its flags: the C library takes clone instead.
static void add_clone(struct sock_filter *rules, unsigned short *count) {
    const struct sock_filter thread[] = {
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, __NR_clone, 0, 3),
        BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, args[0])),
        BPF_JUMP(BPF_JMP | BPF_JSET | BPF_K, NAMESPACES, 0, 1),
        BPF_STMT(BPF_RET | BPF_K, DENY),
        BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, nr)),
    };
    const int clone3_call = __NR_clone3;
    add_all(rules, count, &clone3_call, 1, UNKNOWN);
    for (size_t i = 0; i < sizeof thread / sizeof thread[0]; i++)
        add(rules, count, thread[i]);
}

// A program for the kernel: another architecture's numbers are refused, then each number by the
// lists. What is not listed looks as if the kernel had no such call: the C library does without.
static unsigned short write_filter(const struct rn_profile *profile,
                                   struct sock_filter rules[RULES]) {
    const struct sock_filter begin[] = {
        BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, arch)),
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, ARCH, 1, 0),
        BPF_STMT(BPF_RET | BPF_K, DENY),
        BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, nr)),
        BPF_JUMP(BPF_JMP | BPF_JGE | BPF_K, 0x40000000, 0, 1), // x32
        BPF_STMT(BPF_RET | BPF_K, DENY),
    };
    unsigned short n = 0;
    for (size_t i = 0; i < sizeof begin / sizeof begin[0]; i++)
        add(rules, &n, begin[i]);
    add_clone(rules, &n);
    if (profile->listed_calls) add_all(rules, &n, listed, LISTED, SECCOMP_RET_ALLOW);
    if (profile->programs[0] == NULL) add_all(rules, &n, programs, PROGRAMS, DENY);
    add_all(rules, &n, refused, REFUSED, DENY);
    add(rules, &n,
        (struct sock_filter)BPF_STMT(BPF_RET | BPF_K,
                                     profile->listed_calls ? UNKNOWN : SECCOMP_RET_ALLOW));
    return n;
}

// SPEC_ALLOW: without it some kernels slow the processor's speculation down for the filter.
void rn_calls_filter(const struct rn_profile *profile) {
    struct sock_filter rules[RULES];
    struct sock_fprog program = {.len = write_filter(profile, rules), .filter = rules};
    if (syscall(__NR_seccomp, SECCOMP_SET_MODE_FILTER,
                SECCOMP_FILTER_FLAG_TSYNC | SECCOMP_FILTER_FLAG_SPEC_ALLOW, &program) != 0)
        rn_log(RN_LOG_WARN, "system calls are not filtered: %s", strerror(errno));
}

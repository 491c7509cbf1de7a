// ripnerf-runner: the process that owns one scene, does one import or describes the device.
// Started by ripnerfd, which holds the other end of the socket.
#include <getopt.h>
#include <malloc.h>
#include <signal.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/log.h"
#include "proto/join.h"
#include "server/engine/engine.h"
#include "server/runner/field/film.h"
#include "server/runner/field/host.h"
#include "server/runner/field/ranks.h"
#include "server/runner/ingest/ingest.h"
#include "server/runner/link/carry.h"
#include "server/runner/link/join.h"
#include "server/runner/sandbox/sandbox.h"
#include "server/runner/tools/bench.h"
#include "server/runner/tools/doctor.h"
#include "server/runner/tools/needs.h"

static int probe(int fd) {
    struct rn_link link;
    struct rn_engine *engine = NULL;
    struct rn_error err = {0};
    rn_link_init(&link, fd);
    struct rn_wire_hello hello = {
        .version = RIPNERF_VERSION, .protocol = RN_WIRE_PROTOCOL, .mode = "probe", .pid = getpid()};
    rn_link_post(&link, RN_WIRE_HELLO, &hello, NULL, 0);
    struct rn_engine_options options = {.device = NULL};
    if (rn_engine_create(&options, &engine, &err)) {
        rn_link_fail(&link, "", RN_ABSENT, &err);
    } else {
        struct rn_device_info device;
        rn_engine_describe(engine, &device);
        if (*device.checked) fprintf(stderr, "device: %s\n", device.checked);
        struct rn_wire_info info = {.threads = device.threads, .films = rn_film_is_installed()};
        snprintf(info.device, sizeof info.device, "%s", device.device);
        snprintf(info.device_name, sizeof info.device_name, "%s", device.name);
        snprintf(info.kernels, sizeof info.kernels, "%s", device.kernels);
        snprintf(info.available, sizeof info.available, "%s", device.available);
        rn_link_post(&link, RN_WIRE_INFO, &info, NULL, 0);
        rn_engine_destroy(&engine);
    }
    rn_link_finish(&link);
    return 0;
}

static int usage(const char *program) {
    fprintf(
        stderr,
        "usage: %s --mode field|ingest|poses|probe --fd N [--sandbox]\n"
        "       %s --mode remote --join DIR [--ranks] [--sandbox]\n"
        "       %s --mode carry --join NAME --cache DIR --cache-bytes N [--sandbox]\n"
        "       %s --mode needs --dataset DIR --scene DIR [--train JSON] [--threads N] "
        "[--sandbox]\n"
        "       %s --mode bench [--preset NAME] [--kernels SET] [--threads N] [--seconds S]\n"
        "       %s --mode doctor [--seed N] [--checkpoint FILE [--cameras FILE] [--replay FILE]]\n"
        "Started by ripnerfd, N a connected stream socket, DIR a folder shared with it; or by "
        "ripnerf\n"
        "bench and doctor.\n",
        program, program, program, program, program, program);
    return 2;
}

// Mode field for a daemon on another machine; `exchange`: other ranks, or NULL.
static int run_remote(const char *folder, const struct rn_exchange *exchange, bool sandbox) {
    struct rn_error err = {0};
    bool told;
    int fd;
    enum rn_status status = rn_join_daemon(folder, &fd, &err);
    if (status) {
        rn_log(RN_LOG_ERROR, "%s: %s", err.where, err.text);
        return status == RN_ERROR_UNAVAILABLE ? RN_JOIN_EXIT_LOST : RN_JOIN_EXIT_ALONE;
    }
    const struct rn_profile *profile = sandbox ? rn_profile_of("remote") : NULL;
    if (profile) rn_sandbox_begin(profile);
    rn_host_run(fd, profile, exchange, &told);
    return told ? 0 : RN_JOIN_EXIT_LOST;
}

// The same by one of several ranks, of which the first has a daemon.
static int run_rank(const char *folder, bool sandbox) {
    const struct rn_exchange *exchange;
    struct rn_error err = {0};
    if (rn_exchange_open(&exchange, &err)) {
        rn_log(RN_LOG_ERROR, "%s: %s", err.where, err.text);
        return RN_JOIN_EXIT_NO_RANKS;
    }
    if (exchange->rank > 0) return rn_ranks_run(exchange, sandbox ? rn_profile_of("rank") : NULL);
    int code = run_remote(folder, exchange, sandbox);
    rn_ranks_part(exchange);
    return code;
}

// A Ctrl-C at the terminal is the daemon's to deal with; it then tells its runners.
static void ignore_terminal(void) {
    signal(SIGINT, SIG_IGN);
    signal(SIGPIPE, SIG_IGN);
}

static bool is_socket(int fd) {
    struct stat about;
    return fstat(fd, &about) == 0 && S_ISSOCK(about.st_mode);
}

// What the command line says; what it does not is zero.
struct command {
    const char *mode;
    int fd;
    bool sandbox, ranks, version;
    struct rn_bench_options bench;
    struct rn_runner_doctor doctor;
    struct rn_runner_needs needs;
    struct rn_carry_options carry; // its name is the folder in mode remote
};

enum kind { TEXT, WHOLE, WHOLE_64, SEED, NUMBER, FLAG };
#define TO(member) offsetof(struct command, member)
static const struct argument {
    const char *name;
    enum kind kind;
    size_t to;
} arguments[] = {
    {"mode", TEXT, TO(mode)},
    {"fd", WHOLE, TO(fd)},
    {"sandbox", FLAG, TO(sandbox)},
    {"ranks", FLAG, TO(ranks)},
    {"version", FLAG, TO(version)},
    {"preset", TEXT, TO(bench.preset)},
    {"kernels", TEXT, TO(bench.kernels)},
    {"threads", WHOLE, TO(bench.threads)},
    {"seconds", NUMBER, TO(bench.seconds)},
    {"seed", SEED, TO(doctor.seed)},
    {"checkpoint", TEXT, TO(doctor.checkpoint)},
    {"cameras", TEXT, TO(doctor.cameras)},
    {"replay", TEXT, TO(doctor.replay)},
    {"dataset", TEXT, TO(needs.dataset)},
    {"scene", TEXT, TO(needs.scene)},
    {"train", TEXT, TO(needs.train)},
    {"join", TEXT, TO(carry.name)},
    {"cache", TEXT, TO(carry.cache)},
    {"cache-bytes", WHOLE_64, TO(carry.cache_bytes)},
};
#define ARGUMENTS ((int)(sizeof arguments / sizeof *arguments))

// False when the text is no such number.
static bool take(const struct argument *argument, const char *text, struct command *command) {
    void *to = (char *)command + argument->to;
    char *end = "";
    switch (argument->kind) {
    case TEXT:
        *(const char **)to = text;
        break;
    case WHOLE:
        *(int *)to = (int)strtol(text, &end, 10);
        break;
    case WHOLE_64:
        *(int64_t *)to = strtoll(text, &end, 10);
        break;
    case SEED:
        *(uint64_t *)to = strtoull(text, &end, 10);
        break;
    case NUMBER:
        *(double *)to = strtod(text, &end);
        break;
    case FLAG:
        *(bool *)to = true;
        break;
    }
    return !*end;
}

static bool parse(int argc, char **argv, struct command *command) {
    struct option options[ARGUMENTS + 1] = {{NULL, 0, NULL, 0}};
    for (int i = 0; i < ARGUMENTS; i++) {
        int has = arguments[i].kind == FLAG ? no_argument : required_argument;
        options[i] = (struct option){arguments[i].name, has, NULL, i};
    }
    int option;
    while ((option = getopt_long(argc, argv, "", options, NULL)) != -1)
        if (option == '?' || !take(&arguments[option], optarg, command)) return false;
    command->needs.threads = command->bench.threads;
    command->needs.sandbox = command->carry.sandbox = command->sandbox;
    return optind == argc;
}

// The modes that no daemon listens to. False: it is none of them, or lacks an argument.
static bool run_tool(const struct command *c, int *ret_code) {
    const struct rn_runner_doctor *d = &c->doctor;
    if (strcmp(c->mode, "bench") == 0)
        *ret_code = rn_runner_bench(&c->bench);
    else if (strcmp(c->mode, "doctor") == 0 && (d->checkpoint || (!d->cameras && !d->replay)))
        *ret_code = rn_runner_doctor(d);
    else if (strcmp(c->mode, "needs") == 0 && c->needs.dataset && c->needs.scene)
        *ret_code = rn_runner_needs(&c->needs);
    else
        return false;
    return true;
}

// Those that find their daemon over the network; likewise.
static bool run_afar(const struct command *c, int *ret_code) {
    const char *name = c->carry.name;
    if (strcmp(c->mode, "carry") == 0 && name && c->carry.cache) {
        signal(SIGPIPE, SIG_IGN);
        *ret_code = rn_runner_carry(&c->carry);
    } else if (strcmp(c->mode, "remote") == 0 && name) {
        ignore_terminal();
        *ret_code = c->ranks ? run_rank(name, c->sandbox) : run_remote(name, NULL, c->sandbox);
    } else {
        return false;
    }
    return true;
}

// Those that a daemon on this machine has started; likewise.
static bool run_here(const struct command *c, int *ret_code) {
    if (c->carry.name || !is_socket(c->fd)) return false;
    ignore_terminal();
    // One that is stopped when its daemon dies goes on, finds the socket closed, saves and leaves.
    prctl(PR_SET_PDEATHSIG, SIGCONT);
    const struct rn_profile *profile = c->sandbox ? rn_profile_of(c->mode) : NULL;
    if (profile) rn_sandbox_begin(profile);
    bool told;
    if (strcmp(c->mode, "field") == 0)
        *ret_code = rn_host_run(c->fd, profile, NULL, &told);
    else if (strcmp(c->mode, RN_MODE_INGEST) == 0 || strcmp(c->mode, RN_MODE_POSES) == 0)
        *ret_code = rn_ingest_run(c->fd, c->mode, profile);
    else if (strcmp(c->mode, "probe") == 0)
        *ret_code = probe(c->fd);
    else
        return false;
    return true;
}

int main(int argc, char **argv) {
    struct command command = {.mode = "", .fd = -1, .bench = {.seconds = 5}};
    int code;
    // What is given back is the system's at once: else blocks of a field whose planes have grown,
    // and of photographs that were decoded, leave gaps that a larger one does not fit.
    mallopt(M_MMAP_THRESHOLD, 1 << 20);
    bool sound = parse(argc, argv, &command);
    if (command.version) {
        puts("ripnerf-runner " RIPNERF_VERSION);
        return 0;
    }
    if (sound &&
        (run_tool(&command, &code) || run_afar(&command, &code) || run_here(&command, &code)))
        return code;
    return usage(argv[0]);
}

// ripnerf-runner: the process that owns one scene, does one import or describes the device.
// Started by ripnerfd, which holds the other end of the socket.
#include <getopt.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/log.h"
#include "proto/join.h"
#include "server/engine/engine.h"
#include "server/runner/bench.h"
#include "server/runner/carry.h"
#include "server/runner/doctor.h"
#include "server/runner/host.h"
#include "server/runner/ingest.h"
#include "server/runner/join.h"
#include "server/runner/needs.h"
#include "server/runner/ranks.h"
#include "server/runner/sandbox.h"

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
        struct rn_wire_info info = {.threads = device.threads};
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

static bool is_socket(int fd) {
    struct stat about;
    return fstat(fd, &about) == 0 && S_ISSOCK(about.st_mode);
}

int main(int argc, char **argv) {
    static const struct option options[] = {
        {"mode", required_argument, NULL, 'm'},    {"preset", required_argument, NULL, 'p'},
        {"kernels", required_argument, NULL, 'k'}, {"threads", required_argument, NULL, 't'},
        {"seconds", required_argument, NULL, 's'}, {"fd", required_argument, NULL, 'f'},
        {"seed", required_argument, NULL, 'e'},    {"checkpoint", required_argument, NULL, 'c'},
        {"cameras", required_argument, NULL, 'a'}, {"replay", required_argument, NULL, 'r'},
        {"join", required_argument, NULL, 'j'},    {"dataset", required_argument, NULL, 'd'},
        {"scene", required_argument, NULL, 'S'},   {"train", required_argument, NULL, 'T'},
        {"cache", required_argument, NULL, 'C'},   {"cache-bytes", required_argument, NULL, 'b'},
        {"sandbox", no_argument, NULL, 'x'},       {"ranks", no_argument, NULL, 'R'},
        {"version", no_argument, NULL, 'v'},       {NULL, 0, NULL, 0}};
    const char *mode = "", *join = NULL;
    struct rn_bench_options bench = {.seconds = 5};
    struct rn_runner_doctor doctor = {.seed = 0};
    struct rn_runner_needs needs = {.threads = 0};
    struct rn_carry_options carry = {.cache_bytes = 0};
    bool sandbox = false, ranks = false;
    int fd = -1, option;
    while ((option = getopt_long(argc, argv, "", options, NULL)) != -1) {
        char *end = "";
        if (option == 'm') mode = optarg;
        if (option == 'f') fd = (int)strtol(optarg, &end, 10);
        if (option == 'p') bench.preset = optarg;
        if (option == 'k') bench.kernels = optarg;
        if (option == 't') bench.threads = (int)strtol(optarg, &end, 10);
        if (option == 's') bench.seconds = strtod(optarg, &end);
        if (option == 'e') doctor.seed = strtoull(optarg, &end, 10);
        if (option == 'c') doctor.checkpoint = optarg;
        if (option == 'a') doctor.cameras = optarg;
        if (option == 'r') doctor.replay = optarg;
        if (option == 'j') join = optarg;
        if (option == 'd') needs.dataset = optarg;
        if (option == 'S') needs.scene = optarg;
        if (option == 'T') needs.train = optarg;
        if (option == 'C') carry.cache = optarg;
        if (option == 'b') carry.cache_bytes = strtoll(optarg, &end, 10);
        if (option == 'x') sandbox = true;
        if (option == 'R') ranks = true;
        if (option == 'v') {
            puts("ripnerf-runner " RIPNERF_VERSION);
            return 0;
        }
        if (option == '?' || *end) return usage(argv[0]);
    }
    if (optind == argc && strcmp(mode, "bench") == 0) return rn_runner_bench(&bench);
    if (optind == argc && strcmp(mode, "doctor") == 0 &&
        (doctor.checkpoint || (!doctor.cameras && !doctor.replay)))
        return rn_runner_doctor(&doctor);
    needs.threads = bench.threads;
    needs.sandbox = sandbox;
    if (optind == argc && strcmp(mode, "needs") == 0 && needs.dataset && needs.scene)
        return rn_runner_needs(&needs);
    carry.name = join;
    carry.sandbox = sandbox;
    if (optind == argc && strcmp(mode, "carry") == 0 && carry.name && carry.cache) {
        signal(SIGPIPE, SIG_IGN);
        return rn_runner_carry(&carry);
    }
    bool remote = strcmp(mode, "remote") == 0;
    if (optind != argc || remote != (join != NULL) || (!remote && !is_socket(fd)))
        return usage(argv[0]);
    // A Ctrl-C at the terminal is the daemon's to deal with; it then tells its runners.
    signal(SIGINT, SIG_IGN);
    signal(SIGPIPE, SIG_IGN);
    if (remote) return ranks ? run_rank(join, sandbox) : run_remote(join, NULL, sandbox);
    // One that is stopped when its daemon dies goes on, finds the socket closed, saves and leaves.
    prctl(PR_SET_PDEATHSIG, SIGCONT);
    const struct rn_profile *profile = sandbox ? rn_profile_of(mode) : NULL;
    if (profile) rn_sandbox_begin(profile);
    bool told;
    if (strcmp(mode, "field") == 0) return rn_host_run(fd, profile, NULL, &told);
    if (strcmp(mode, RN_MODE_INGEST) == 0 || strcmp(mode, RN_MODE_POSES) == 0)
        return rn_ingest_run(fd, mode, profile);
    if (strcmp(mode, "probe") == 0) return probe(fd);
    return usage(argv[0]);
}

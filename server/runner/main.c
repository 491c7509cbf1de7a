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
#include "server/engine/engine.h"
#include "server/runner/bench.h"
#include "server/runner/doctor.h"
#include "server/runner/host.h"
#include "server/runner/ingest.h"
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
        "       %s --mode bench [--preset NAME] [--kernels SET] [--threads N] [--seconds S]\n"
        "       %s --mode doctor [--seed N] [--checkpoint FILE [--cameras FILE] [--replay FILE]]\n"
        "Started by ripnerfd, N a connected stream socket; or by ripnerf bench and doctor.\n",
        program, program, program);
    return 2;
}

static bool is_socket(int fd) {
    struct stat about;
    return fstat(fd, &about) == 0 && S_ISSOCK(about.st_mode);
}

int main(int argc, char **argv) {
    static const struct option options[] = {{"mode", required_argument, NULL, 'm'},
                                            {"preset", required_argument, NULL, 'p'},
                                            {"kernels", required_argument, NULL, 'k'},
                                            {"threads", required_argument, NULL, 't'},
                                            {"seconds", required_argument, NULL, 's'},
                                            {"fd", required_argument, NULL, 'f'},
                                            {"seed", required_argument, NULL, 'e'},
                                            {"checkpoint", required_argument, NULL, 'c'},
                                            {"cameras", required_argument, NULL, 'a'},
                                            {"replay", required_argument, NULL, 'r'},
                                            {"sandbox", no_argument, NULL, 'x'},
                                            {"version", no_argument, NULL, 'v'},
                                            {NULL, 0, NULL, 0}};
    const char *mode = "";
    struct rn_bench_options bench = {.seconds = 5};
    struct rn_runner_doctor doctor = {.seed = 0};
    bool sandbox = false;
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
        if (option == 'x') sandbox = true;
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
    if (optind != argc || !is_socket(fd)) return usage(argv[0]);
    // A Ctrl-C at the terminal is the daemon's to deal with; it then tells its runners.
    signal(SIGINT, SIG_IGN);
    signal(SIGPIPE, SIG_IGN);
    // One that is stopped when its daemon dies goes on, finds the socket closed, saves and leaves.
    prctl(PR_SET_PDEATHSIG, SIGCONT);
    const struct rn_profile *profile = sandbox ? rn_profile_of(mode) : NULL;
    if (profile) rn_sandbox_begin(profile);
    if (strcmp(mode, "field") == 0) return rn_host_run(fd, profile);
    if (strcmp(mode, RN_MODE_INGEST) == 0 || strcmp(mode, RN_MODE_POSES) == 0)
        return rn_ingest_run(fd, mode, profile);
    if (strcmp(mode, "probe") == 0) return probe(fd);
    return usage(argv[0]);
}

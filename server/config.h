// The daemon's options: one table; a file is overridden by the environment, that by flags.
#ifndef RN_SERVER_CONFIG_H
#define RN_SERVER_CONFIG_H

#include <stdint.h>

#include "common/base/status.h"

#define RN_CONFIG_MAX_ROOTS 64

// Owner: whoever loaded it; rn_config_finish. Strings are owned, NULL when not given.
struct rn_config {
    char *data;
    char *listen; // ADDR:PORT
    char *config;
    char *roots[RN_CONFIG_MAX_ROOTS]; // canonical absolute paths of folders
    int root_count;
    char *token_file, *web, *runner, *log_level, *log_format, *audit, *lpips;
    char *executor, *shared;
    char *slurm_listen, *slurm_partition, *slurm_account, *slurm_flags, *slurm_cache;
    int64_t slurm_cache_bytes;
    int64_t slurm_time_s, slurm_gpus, slurm_memory_bytes; // of a runner; 0: as Slurm has it
    int64_t slurm_path_runners;
    int64_t threads; // 0: all cores
    int64_t memory_limit_bytes, max_upload_bytes, max_upload_entries;
    int64_t gpu_memory_bytes, gpu_deterministic, sandbox;
    int64_t max_frames, max_pixels, import_time_s;
    int64_t training_slots, max_queued, max_loaded, max_connections, max_per_address;
    int64_t header_timeout_s, least_rate, answer_bytes;
    int64_t max_rate, quota_jobs, quota_bytes; // of a token
    int64_t retain_pictures_s, retain_bytes;
    int64_t keep_alive_s, runner_timeout_s, drain_s, curve_after_s;
    // Made from the above:
    char address[64];
    uint16_t port;
    char *token; // NULL: none
    int64_t scrub_interval_s;
    bool rebuild, scrub, help, version;
};

// `get_env` is getenv, or a test's. RN_ERROR_INVALID names flag, variable or file:line.
enum rn_status rn_config_load(int argc, char **argv, const char *(*get_env)(const char *name),
                              struct rn_config *ret_config, struct rn_error *err) RN_MUST_CHECK;
void rn_config_finish(struct rn_config *config);
// The help text: usage and every option with its default. malloc; NULL when memory is short.
char *rn_config_help(void);

#endif

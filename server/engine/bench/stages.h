// Recorded inputs of the stages, and what each stage's work is made of.
#ifndef RN_ENGINE_BENCH_STAGES_H
#define RN_ENGINE_BENCH_STAGES_H

#include "server/engine/bench/bench.h"
#include "server/engine/train/trainer.h"

// One packet of a training step, as the kernels left it.
struct rn_bench_packet {
    const struct rn_march_ray *rays;
    int ray_count;
    int looked_at, found; // candidates: that the packet needed, and of its rays to their ends
    int returned;         // samples whose gradient was backpropagated
    int heads;            // rows of the colour network
    struct rn_workspace *workspace;
    struct rn_group *group; // its slab
};

// Thread-safety: one thread. Owner: the caller; rn_bench_recording_finish.
struct rn_bench_recording {
    struct rn_trainer *trainer; // borrowed
    const struct rn_cpu_field *field;
    const struct rn_kernels *kernels;
    int packet_count;
    struct rn_bench_packet packets[RN_GROUPS];
    char *memory;   // workspaces
    uint8_t *marks; // as the trainer's touched tiles
};

// Runs `train` on one packet of each group of the trainer's last step. The trainer must have
// finished a step; its optimiser's state is of no use afterwards. RN_ERROR_NO_MEMORY;
// RN_ERROR_INVALID when no ray met anything.
enum rn_status rn_bench_record(struct rn_trainer *trainer, struct rn_bench_recording *ret_recording,
                               struct rn_error *err) RN_MUST_CHECK;
void rn_bench_recording_finish(struct rn_bench_recording *recording);

// One stage of one packet.
void rn_bench_stage_run(const struct rn_bench_recording *recording,
                        const struct rn_bench_packet *packet, enum rn_stage stage,
                        const float **ret_grad);
// Adds all slabs to the trainer's gradient maps, which must be clear, band by band.
void rn_bench_scatter(const struct rn_bench_recording *recording);
// The optimiser over what the slabs touched, dense or sparse as configured.
void rn_bench_optimise(const struct rn_bench_recording *recording);
// The update of one plane's touched texels.
void rn_bench_update(const struct rn_bench_recording *recording, int plane,
                     const struct rn_adamw *options);
// Numbers of the base maps that it visits.
size_t rn_bench_touched(const struct rn_bench_recording *recording);

// Pulls the pyramids' gradients down and builds the pyramids again.
void rn_bench_pyramid(const struct rn_bench_recording *recording);

// Checks and times every stage on the recording, about `seconds` in all.
void rn_bench_stages(struct rn_bench_recording *recording, const struct rn_bench_machine *machine,
                     double seconds, struct rn_bench_result *result);

#endif

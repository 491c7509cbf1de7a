// The scene that benchmarks train on: a few photographs of a procedural scene.
#ifndef RN_ENGINE_BENCH_SCENE_H
#define RN_ENGINE_BENCH_SCENE_H

#include "common/dataset/dataset.h"
#include "server/engine/cpu/pool.h"

#define RN_BENCH_VIEWS 16
#define RN_BENCH_SIZE 400 // pixels a side

// Thread-safety: one thread. Owner: the caller; rn_bench_scene_finish removes the folder.
struct rn_bench_scene {
    char folder[512];
    struct rn_dataset dataset;
    struct rn_frame frames[RN_BENCH_VIEWS];
    char paths[RN_BENCH_VIEWS][544];
};

// Renders and writes the photographs under $TMPDIR or /tmp. Errors as of files and memory.
enum rn_status rn_bench_scene_init(struct rn_pool *pool, struct rn_bench_scene *scene,
                                   struct rn_error *err) RN_MUST_CHECK;
void rn_bench_scene_finish(struct rn_bench_scene *scene);

// View `index` of `count` on a spiral around the scene.
enum rn_status rn_bench_camera(int index, int count, struct rn_camera *ret_camera) RN_MUST_CHECK;

#endif

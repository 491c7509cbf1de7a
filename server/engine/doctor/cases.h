// The doctor's cases, by file.
#ifndef RN_ENGINE_DOCTOR_CASES_H
#define RN_ENGINE_DOCTOR_CASES_H

#include "server/engine/doctor/doctor.h"
#include "server/engine/scene/scene.h"

// A case under way: the result's next one, with its worst error so far.
struct rn_doctor_case *rn_doctor_open(struct rn_doctor_result *result, const char *name,
                                      const char *kernels, double bound, const char *unit);
// One input's error; NAN counts as the worst there is.
void rn_doctor_see(struct rn_doctor_case *c, double error, const char *where, ...) RN_PRINTF(3, 4);
// Nothing seen is not passed.
void rn_doctor_close(struct rn_doctor_result *result, struct rn_doctor_case *c);

// Fresh random numbers of the seed. Thread-safety: one thread.
struct rn_doctor_random {
    uint64_t seed, count;
};
double rn_doctor_uniform(struct rn_doctor_random *random, double low, double high);
double rn_doctor_spread(struct rn_doctor_random *random, double low, double high); // of the log

// float64.c: the code of the reference. kernels.c: every kernel set of this machine.
void rn_doctor_float64(struct rn_doctor_random *random, struct rn_doctor_result *result);
void rn_doctor_kernels(struct rn_doctor_random *random, struct rn_doctor_result *result);
// scene.c: a scene's parameters, cameras, and some of their rays on every kernel set.
enum rn_status rn_doctor_scene(const struct rn_doctor_options *options,
                               struct rn_doctor_random *random, struct rn_engine *engine,
                               struct rn_field *field, struct rn_doctor_result *result,
                               struct rn_error *err) RN_MUST_CHECK;
// replay.c: an incident's rays, with the parameters as they are and as they were.
enum rn_status rn_doctor_replay(const struct rn_incident *incident, struct rn_engine *engine,
                                struct rn_field *field, struct rn_doctor_result *result,
                                struct rn_error *err) RN_MUST_CHECK;

#endif

// Is the mathematics of this build sound on this machine, and on this scene? The quick numerics
// cases, each against a higher precision that every build has: float64 or long double.
#ifndef RN_ENGINE_DOCTOR_DOCTOR_H
#define RN_ENGINE_DOCTOR_DOCTOR_H

#include "server/engine/engine.h"

struct rn_doctor_case {
    char name[64];
    char kernels[32]; // the kernel set it ran on; "" for the float64 code and the scene
    char unit[40];    // of worst and bound: "ULP", ...
    double worst;     // the largest error; NAN or infinite when something is not a number
    double bound;     // NAN: shown for information
    bool passed;      // worst <= bound
    bool skipped;     // not on this machine; `where` says why, and `passed` is false
    char where[160];  // the input of the worst error
};
#define RN_DOCTOR_CASES 128

struct rn_doctor_options {
    uint64_t seed;                   // of the random inputs
    const char *checkpoint;          // of a scene; NULL = the machine only
    const struct rn_camera *cameras; // of the scene's dataset; may be none
    size_t camera_count;
    const struct rn_incident *incident; // to replay with the scene's parameters; NULL = none
};
// Thread-safety: one thread. Plain value.
struct rn_doctor_result {
    uint64_t seed;
    char kernels[128]; // comma separated sets that this machine has
    bool passed;       // every case that was not skipped
    int case_count;
    struct rn_doctor_case cases[RN_DOCTOR_CASES];
};

// Seconds of work on one thread. Says on `progress` (may be NULL) what begins. Errors of reading
// the checkpoint; a bound that does not hold is no error: see `passed`.
enum rn_status rn_doctor_run(const struct rn_doctor_options *options,
                             void (*progress)(const char *what),
                             struct rn_doctor_result *ret_result,
                             struct rn_error *err) RN_MUST_CHECK;

#endif

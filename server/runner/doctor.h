// The runner's doctor mode: no connection; the numerics cases on standard output.
#ifndef RN_RUNNER_DOCTOR_H
#define RN_RUNNER_DOCTOR_H

#include <stdint.h>

// Files; NULL = not given.
struct rn_runner_doctor {
    uint64_t seed;
    const char *checkpoint; // a scene's
    const char *cameras;    // JSON list, as the API gives it
    const char *replay;     // proto/incident.h
};

// Prints one JSON object (proto/doctor.h) on stdout, what is under way and errors on stderr.
// Returns an exit code: 0, 1 when something failed, a bound included, 2 for a wrong file.
int rn_runner_doctor(const struct rn_runner_doctor *options);

#endif

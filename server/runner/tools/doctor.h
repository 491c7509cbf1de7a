// The runner's doctor mode: no connection; the numerics cases on standard output. Of an open scene
// the same is a job: examine.c.
#ifndef RN_SERVER_RUNNER_TOOLS_DOCTOR_H
#define RN_SERVER_RUNNER_TOOLS_DOCTOR_H

#include "server/engine/doctor/doctor.h"

// Files; NULL = not given.
struct rn_runner_doctor {
    uint64_t seed;
    const char *checkpoint; // a scene's
    const char *cameras;    // JSON list, as the API gives it
    const char *replay;     // proto/incident.h
};

// Prints one JSON object (proto/doctor.h) on stdout, what is under way and errors on stderr.
// Returns an exit code, as ripnerf's: 0, 1 when something failed, a bound included, 3 for a file
// that is missing, 4 for a wrong one.
int rn_runner_doctor(const struct rn_runner_doctor *options);

// JSON of rn_doctor_table, to be freed.
enum rn_status rn_doctor_result_json(const struct rn_doctor_result *result, char **ret_json,
                                     struct rn_error *err) RN_MUST_CHECK;
// A record of proto/incident.h; errors name the file.
enum rn_status rn_incident_read(const char *path, struct rn_incident *ret_incident,
                                struct rn_error *err) RN_MUST_CHECK;

#endif

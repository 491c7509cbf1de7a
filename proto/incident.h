// What went wrong in a training: the event, and the file in the scene's folder that replays it.
#ifndef RN_PROTO_INCIDENT_H
#define RN_PROTO_INCIDENT_H

#include "proto/codec.h"

#define RN_INCIDENT_RECORD_MOST 32

extern const char *const rn_incident_kind_names[]; // "rays", "rejected", "rollback"
extern const char *const rn_ray_fault_names[];     // "none", "colour", "gradient"
extern const char *const rn_wild_names[];          // "nan", "inf", "-inf"

// Data of an `incident` event.
struct rn_incident_event {
    int kind;
    int64_t step;
    int64_t rays, parameters; // that were not finite
    char file[64];            // under the scene's folder
};
extern const struct rn_table rn_incident_event_table;

// As struct rn_incident_ray: normalised frame.
struct rn_incident_ray_record {
    int64_t id;
    int fault; // rn_ray_fault_names
    int split;
    int64_t index, scale, x, y;
    double origin[3], direction[3], target[3];
    double near, length, radius, weight;
    int64_t stride;
};
struct rn_incident_parameter_record {
    int64_t index;
    int value; // rn_wild_names
};

// The file's content.
struct rn_incident_record {
    int kind;
    int64_t step, seed;
    double rate;
    int64_t nonfinite_rays, nonfinite_parameters;
    double march_step, background[3];
    char kernels[32];
    struct rn_incident_ray_record *rays; // owned
    size_t ray_count;
    struct rn_incident_parameter_record *parameters; // owned
    size_t parameter_count;
};
extern const struct rn_table rn_incident_table;

// A record as GET /v1/scenes/{id}/incidents lists it.
struct rn_incident_entry {
    char file[64]; // under the scene's folder
    struct rn_incident_record incident;
};
#define RN_INCIDENTS_LISTED 16
struct rn_incident_list {
    int64_t count;                   // of all records, listed or not
    struct rn_incident_entry *items; // owned; those of the latest steps, latest first
    size_t item_count;
};
extern const struct rn_table rn_incident_list_table;

// "incidents/step-000000123-rays.json". NULL when it is such a name, else what is wrong.
const char *rn_check_incident_file(const char *text);

#endif

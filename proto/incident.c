#include "proto/incident.h"

#include <string.h>

#include "proto/job.h"

const char *const rn_incident_kind_names[] = {"rays", "rejected", "rollback", NULL};
const char *const rn_ray_fault_names[] = {"none", "colour", "gradient", NULL};
const char *const rn_wild_names[] = {"nan", "inf", "-inf", NULL};

#define S struct rn_incident_event
static const struct rn_field_spec event[] = {
    RN_F_NAME(S, kind, RN_REQUIRED, rn_incident_kind_names),
    RN_F_INT(S, step, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, rays, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, parameters, RN_REQUIRED, 0, INFINITY),
    RN_F_TEXT(S, file, RN_REQUIRED, NULL),
};
const struct rn_table rn_incident_event_table = RN_TABLE(S, "an incident", event);
#undef S

#define S struct rn_incident_ray_record
static const struct rn_field_spec ray[] = {
    RN_F_INT(S, id, RN_REQUIRED, 0, 4294967295.0),
    RN_F_NAME(S, fault, RN_REQUIRED, rn_ray_fault_names),
    RN_F_NAME(S, split, RN_REQUIRED, rn_split_names),
    RN_F_INT(S, index, RN_REQUIRED, 0, 1e6),
    RN_F_INT(S, scale, RN_REQUIRED, 0, 15),
    RN_F_INT(S, x, RN_REQUIRED, 0, 1e6),
    RN_F_INT(S, y, RN_REQUIRED, 0, 1e6),
    RN_F_NUMBERS(S, origin, RN_REQUIRED, -1e30, 1e30),
    RN_F_NUMBERS(S, direction, RN_REQUIRED, -2, 2),
    RN_F_NUMBERS(S, target, RN_REQUIRED, -1e30, 1e30),
    RN_F_NUMBER(S, near, RN_REQUIRED, -1e30, 1e30),
    RN_F_NUMBER(S, length, RN_REQUIRED, -1e30, 1e30),
    RN_F_NUMBER(S, radius, RN_REQUIRED, 0, 1e30),
    RN_F_NUMBER(S, weight, RN_REQUIRED, 0, 1e30),
    RN_F_INT(S, stride, RN_REQUIRED, 1, 8),
};
static const struct rn_table ray_table = RN_TABLE(S, "a ray", ray);
#undef S

#define S struct rn_incident_parameter_record
static const struct rn_field_spec parameter[] = {
    RN_F_INT(S, index, RN_REQUIRED, 0, INFINITY),
    RN_F_NAME(S, value, RN_REQUIRED, rn_wild_names),
};
static const struct rn_table parameter_table = RN_TABLE(S, "a parameter", parameter);
#undef S

#define S struct rn_incident_record
static const struct rn_field_spec record[] = {
    RN_F_NAME(S, kind, RN_REQUIRED, rn_incident_kind_names),
    RN_F_INT(S, step, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, seed, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, rate, RN_REQUIRED, 0, 1e30),
    RN_F_INT(S, nonfinite_rays, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, nonfinite_parameters, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, march_step, RN_REQUIRED, 1e-6, 10),
    RN_F_NUMBERS(S, background, RN_REQUIRED, -1e30, 1e30),
    RN_F_TEXT(S, kernels, RN_REQUIRED, NULL),
    RN_F_OBJECTS(S, rays, ray_count, RN_REQUIRED, &ray_table, RN_INCIDENT_RECORD_MOST),
    RN_F_OBJECTS(S, parameters, parameter_count, RN_REQUIRED, &parameter_table,
                 RN_INCIDENT_RECORD_MOST),
};
const struct rn_table rn_incident_table = RN_TABLE(S, "an incident's record", record);
#undef S

#define S struct rn_incident_entry
static const struct rn_field_spec entry[] = {
    RN_F_TEXT(S, file, RN_REQUIRED, rn_check_incident_file),
    RN_F_OBJECT(S, incident, RN_REQUIRED, &rn_incident_table),
};
static const struct rn_table entry_table = RN_TABLE(S, "an incident", entry);
#undef S

#define S struct rn_incident_list
static const struct rn_field_spec list[] = {
    RN_F_INT(S, count, RN_REQUIRED, 0, INFINITY),
    RN_F_OBJECTS(S, items, item_count, RN_REQUIRED, &entry_table, RN_INCIDENTS_LISTED),
};
const struct rn_table rn_incident_list_table = RN_TABLE(S, "incidents", list);
#undef S

const char *rn_check_incident_file(const char *text) {
    static const char wrong[] = "must be the name of an incident's record";
    static const char before[] = "incidents/step-";
    size_t digits;
    if (strncmp(text, before, sizeof before - 1) != 0) return wrong;
    text += sizeof before - 1;
    digits = strspn(text, "0123456789");
    if (digits == 0 || text[digits] != '-') return wrong;
    text += digits + 1;
    for (int i = 0; rn_incident_kind_names[i]; i++) {
        size_t size = strlen(rn_incident_kind_names[i]);
        if (strncmp(text, rn_incident_kind_names[i], size) == 0 &&
            strcmp(text + size, ".json") == 0)
            return NULL;
    }
    return wrong;
}

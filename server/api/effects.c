// What a scene's effects bring, and the job that measures it.
#include "proto/effects.h"
#include "server/api/app.h"

static enum rn_status read_effects(const char *folder, void *record, struct rn_error *err) {
    return rn_effects_read(folder, record, err);
}

void rn_get_effects(void *context, struct rn_request *request, struct rn_reply *reply) {
    static const struct rn_measured kind = {.what = "what the effects",
                                            .does = " bring",
                                            .verb = "effects",
                                            .table = &rn_effects_record_table,
                                            .read = read_effects};
    struct rn_effects_record effects;
    rn_api_get_measured(context, request, &kind, &effects, reply);
}

void rn_measure_effects(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_effects_options wanted;
    rn_api_measure(context, request, RN_JOB_EFFECTS, &rn_effects_options_table, &wanted, reply);
}

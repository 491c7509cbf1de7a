// Incidents of a training: a file each in SCENE/incidents, and a message to the daemon.
#ifndef RN_SERVER_RUNNER_FIELD_INCIDENTS_H
#define RN_SERVER_RUNNER_FIELD_INCIDENTS_H

#include "server/runner/field/host.h"

// Takes what the trainer has noted, writes SCENE/incidents/step-NNNNNNNNN-KIND.json (see
// proto/incident.h) and tells the daemon. What cannot be written is logged; training goes on.
void rn_incidents_report(struct rn_host *host, struct rn_trainer *trainer, const char *job);

#endif

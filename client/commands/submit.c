#include "client/commands/submit.h"

#include <string.h>

enum rn_exit rn_submit(struct rn_client *client, const char *body, char ret_job[RN_ID_MAX],
                       char **ret_json) {
    struct rn_api_reply reply;
    struct rn_job job;
    rn_api_send(client, "POST", "/v1/jobs", body, &reply);
    enum rn_exit code = reply.code == RN_EXIT_OK ? rn_api_decode(&reply, &rn_job_table, &job)
                                                 : rn_api_complain(&reply);
    if (code == RN_EXIT_OK) {
        memcpy(ret_job, job.id, sizeof job.id);
        rn_message_finish(&rn_job_table, &job);
        *ret_json = (char *)rn_buf_take(&reply.http.body, &(size_t){0});
    }
    rn_api_reply_finish(&reply);
    return code;
}

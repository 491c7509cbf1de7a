#include "proto/camera.h"

#include "proto/job.h"
#include "proto/json_text.h"

#define S struct rn_dataset_camera
static const struct rn_field_spec dataset_camera[] = {
    RN_F_NAME(S, split, RN_REQUIRED, rn_split_names),
    RN_F_INT(S, index, RN_REQUIRED, 0, INFINITY),
    RN_F_TEXT(S, name, RN_REQUIRED, NULL),
    RN_F_INT(S, scale, RN_REQUIRED, 0, INFINITY),
    RN_F_CAMERA(S, camera, RN_REQUIRED),
};
const struct rn_table rn_dataset_camera_table = RN_TABLE(S, "a dataset's camera", dataset_camera);
#undef S

#define S struct rn_scene_start
static const struct rn_field_spec scene_start[] = {
    RN_F_CAMERA(S, camera, RN_REQUIRED),
    RN_F_NUMBERS(S, up, RN_REQUIRED, -1.01, 1.01),
};
const struct rn_table rn_scene_start_table = RN_TABLE(S, "where to begin", scene_start);
#undef S

static void put_lens(struct rn_buf *buf, const struct rn_camera *camera) {
    const struct rn_lens_model *model = &rn_lens_models[camera->lens];
    rn_buf_printf(buf, ",\"lens\":{\"model\":\"%s\"", rn_lens_names[camera->lens]);
    for (int i = 0; i < model->count; i++) {
        rn_buf_printf(buf, ",\"%s\":", model->parameters[i]);
        rn_json_put_number(buf, camera->lens_k[i]);
    }
    rn_buf_printf(buf, "}");
}

void rn_json_put_camera(struct rn_buf *buf, const struct rn_camera *camera) {
    const struct {
        const char *name;
        double value;
    } intrinsics[] = {
        {"fx", camera->fx}, {"fy", camera->fy}, {"cx", camera->cx}, {"cy", camera->cy}};
    rn_buf_printf(buf, "{\"world_from_camera\":[");
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 4; j++) {
            rn_buf_printf(buf, "%s", j > 0 ? "," : i > 0 ? ",[" : "[");
            rn_json_put_number(buf, camera->world_from_camera[i][j] + 0.0); // no -0: equal texts
        }
        rn_buf_printf(buf, "]");
    }
    rn_buf_printf(buf, "],\"axes\":\"opencv\",\"width\":%d,\"height\":%d", camera->width,
                  camera->height);
    for (int i = 0; i < 4; i++) {
        rn_buf_printf(buf, ",\"%s\":", intrinsics[i].name);
        rn_json_put_number(buf, intrinsics[i].value);
    }
    if (camera->lens) put_lens(buf, camera);
    rn_buf_printf(buf, "}");
}

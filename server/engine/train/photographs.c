#include "server/engine/train/photographs.h"

#include "server/engine/train/trainer.h"
#include "server/engine/train/withheld.h"

int rn_train_reduced(const struct rn_train_config *config) {
    return config->train_scale > 1 ? config->train_scale : 1;
}

// Again where a lens turns out to make no difference.
static void place_cameras(const struct rn_trainer *t, struct rn_pixels *pixels) {
    const struct rn_field *field = t->field;
    for (int f = 0; f < pixels->frame_count; f++) {
        struct rn_pixel_frame *frame = &pixels->frames[f];
        struct rn_camera *camera = &frame->camera;
        struct rn_camera as_stored = rn_field_camera(field, frame->frame);
        *camera = rn_camera_reduced(&as_stored, rn_train_reduced(&field->config));
        if (pixels == &t->train) *camera = rn_trainer_pose(t, f, camera);
        frame->parts = rn_camera_resized(camera, 2 * camera->width, 2 * camera->height);
        frame->view = rn_field_view(field, camera);
        frame->fine = rn_field_view(field, &frame->parts);
    }
}

void rn_trainer_place_cameras(struct rn_trainer *t) {
    place_cameras(t, &t->train);
    place_cameras(t, &t->held);
}

// What the effects make of the photographs.
static void take_effects(struct rn_trainer *t) {
    rn_trainer_place_cameras(t);
    rn_effects_take(t->field, &t->train, t->engine);
}

enum rn_status rn_trainer_load_photographs(struct rn_trainer *t,
                                           const struct rn_effect_record *records, size_t limit,
                                           struct rn_error *err) {
    struct rn_selection s = {t->dataset, &t->field->config, false};
    const struct rn_train_config *config = &t->field->config;
    struct rn_pixel_treatment treatment = {.reduced = rn_train_reduced(config),
                                           .memory_bytes = (size_t)config->pixel_memory << 20};
    rn_effects_treat(config, records, false, &treatment);
    enum rn_status status = rn_pixels_load(t->dataset, rn_selection_wants, &s, t->engine, treatment,
                                           limit, &t->train, err);
    if (status != RN_OK) return status;
    size_t used = t->train.paged.bytes ? 0 : rn_pixels_bytes(t->train.pixel_count, t->train.used);
    if (limit) limit = limit > used ? limit - used : 1;
    treatment.taken_bytes = t->train.paged.bytes ? treatment.memory_bytes : used;
    s.held = true;
    rn_effects_treat(config, records, true, &treatment);
    status = rn_pixels_load(t->dataset, rn_selection_wants, &s, t->engine, treatment, limit,
                            &t->held, err);
    if (status == RN_ERROR_INVALID) status = RN_OK; // nothing to hold out
    take_effects(t);
    rn_trainer_note_withheld(t);
    return status;
}

void rn_trainer_detect_effects(struct rn_trainer *t) {
    struct rn_evidence evidence = rn_trainer_evidence(t, &t->step.march);
    rn_effects_detect(&evidence);
    take_effects(t);
}

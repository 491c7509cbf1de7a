#include <math.h>

#include "common/dataset/survey.h"
#include "common/settings/train.h"

#define FIELD_BYTES 330e6 // memory of a training with `standard` beside its photographs
#define PIXEL_BYTES 4.0
#define LOAD_SECONDS 15e-9 // CPU time that a pixel takes: 3 to 5 ns in a JPEG, 18 to 33 in a PNG

static double standard(const char *setting) {
    return rn_settings_find(&rn_train_settings, setting)->standard;
}

struct rn_training_cost rn_training_cost(const struct rn_dataset *dataset,
                                         const struct rn_import_options *kept) {
    struct rn_import_options as = rn_import_settle(dataset, kept, NULL);
    struct rn_training_cost cost = {.scales = as.scales > 1 ? as.scales : dataset->scale_count,
                                    .seconds = standard("max_seconds")};
    double pixels = 0;
    for (size_t i = 0; i < dataset->frame_count; i++)
        for (int level = 0; level < as.scales; level++) {
            struct rn_frame frame = rn_import_place(&dataset->frames[i], &as, level);
            int width = frame.camera.width, height = frame.camera.height;
            if (frame.scale == 0) cost.views[frame.split]++;
            if (frame.split == RN_SPLIT_TRAIN) pixels += (double)width * height;
            if ((double)width * height <= (double)cost.width * cost.height) continue;
            cost.width = width;
            cost.height = height;
        }
    int side = cost.width > cost.height ? cost.width : cost.height;
    cost.reduced = cost.scales > 1 ? 1 : rn_train_scale_by_time(1e-6 * pixels, side, cost.seconds);
    double trained = pixels / (cost.reduced * cost.reduced);
    cost.bytes = FIELD_BYTES + fmin(PIXEL_BYTES * trained, standard("pixel_memory") * 1048576);
    cost.load_seconds = LOAD_SECONDS * pixels;
    return cost;
}

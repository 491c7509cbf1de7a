// Whether the images are what their headers promise.
#include <stdlib.h>
#include <string.h>

#include "common/dataset/output.h"
#include "common/dataset/reader.h"
#include "common/dataset/survey.h"

struct check {
    const struct rn_dataset *dataset;
    struct rn_error *faults; // of each frame; status RN_OK where none
    struct rn_survey *survey;
};

// Whether a frame's mask is what its header promises, and uses anything.
static enum rn_status look_at_mask(const struct rn_frame *frame, bool *ret_hidden,
                                   struct rn_error *err) {
    size_t count = (size_t)frame->camera.width * (size_t)frame->camera.height;
    uint8_t *used = frame->mask_path ? malloc(count) : NULL;
    *ret_hidden = false;
    if (!frame->mask_path) return RN_OK;
    if (!used) return rn_error_set(err, RN_ERROR_NO_MEMORY, frame->mask_path, "out of memory");
    enum rn_status status = rn_mask_read(frame, used, err);
    *ret_hidden = status == RN_OK && !memchr(used, 1, count);
    free(used);
    return status;
}

static void cut_off(struct rn_image *image, const int bars[4]) {
    int width = image->width - bars[0] - bars[2], height = image->height - bars[1] - bars[3];
    if (width == image->width && height == image->height) return;
    for (int y = 0; y < height; y++) {
        size_t from = (size_t)(y + bars[1]) * (size_t)image->width + (size_t)bars[0];
        memmove(image->pixels + 4 * (size_t)y * (size_t)width, image->pixels + 4 * from,
                4 * (size_t)width);
    }
    image->width = width;
    image->height = height;
}

enum rn_status rn_frame_decode(const struct rn_frame *frame, struct rn_survey *survey,
                               struct rn_image *ret_image, struct rn_error *err) {
    bool hidden;
    struct rn_image image;
    enum rn_status status = rn_image_read(frame->path, &rn_image_default_limits, &image, err);
    if (status == RN_OK && frame->turn > 1 &&
        (status = rn_image_turn(&image, frame->turn, err)) != RN_OK)
        rn_image_finish(&image);
    if (status) return status;
    const int *bars = frame->bars;
    int width = frame->camera.width + bars[0] + bars[2];
    int height = frame->camera.height + bars[1] + bars[3];
    if (image.width != width || image.height != height) {
        status = rn_error_set(err, RN_ERROR_INVALID, frame->path, "is %dx%d pixels, not %dx%d",
                              image.width, image.height, width, height);
        rn_image_finish(&image);
        return status;
    }
    cut_off(&image, bars);
    if (frame->backdrop.to_cut) status = rn_backdrop_cut(frame->backdrop.colour, &image, err);
    if (status || (status = look_at_mask(frame, &hidden, err))) {
        rn_image_finish(&image);
        return status;
    }
    image.has_alpha &= frame->has_alpha; // an alpha channel that cuts nothing out is none
    rn_survey_look(survey, frame, &image, hidden);
    *ret_image = image;
    return RN_OK;
}

static enum rn_status check_frame(void *context, size_t index, struct rn_error *err) {
    struct check *check = context;
    struct rn_error *fault = &check->faults[index];
    struct rn_image image;
    if (rn_frame_decode(&check->dataset->frames[index], check->survey, &image, fault) == RN_OK) {
        rn_image_finish(&image);
    } else if (fault->status == RN_ERROR_NO_MEMORY) {
        *err = *fault;
        return fault->status;
    }
    return RN_OK;
}

// Takes the faulty frames out and reports them.
static void drop_faulty(struct rn_dataset *dataset, const struct rn_error *faults,
                        struct rn_problems *problems) {
    size_t kept = 0;
    for (size_t i = 0; i < dataset->frame_count; i++) {
        struct rn_frame *frame = &dataset->frames[i];
        if (faults[i].status == RN_OK) {
            dataset->frames[kept++] = *frame;
            continue;
        }
        rn_problems_add(problems, RN_SEVERITY_ERROR, faults[i].where, "%s", faults[i].text);
        dataset->unusable[frame->split]++;
        rn_frame_finish(frame);
    }
    dataset->frame_count = kept;
}

enum rn_status rn_dataset_check_images(struct rn_dataset *dataset, int threads,
                                       struct rn_problems *problems, struct rn_survey *survey,
                                       bool (*progress)(void *context, size_t done, size_t total),
                                       void *context, struct rn_error *err) {
    struct check check = {.dataset = dataset, .survey = survey};
    check.faults = calloc(dataset->frame_count, sizeof *check.faults);
    if (!check.faults) return rn_error_set(err, RN_ERROR_NO_MEMORY, dataset->name, "out of memory");
    rn_dataset_cut_bars(dataset, problems);
    enum rn_status status = rn_output_run(threads, dataset->frame_count, check_frame, &check,
                                          progress, context, dataset->name, err);
    if (status == RN_OK) {
        drop_faulty(dataset, check.faults, problems);
        status = rn_dataset_seal(dataset, dataset->name, problems, err);
    }
    free(check.faults);
    return status;
}

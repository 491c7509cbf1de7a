// From documents, image headers and, where they are sent along, small pictures of the photographs.
#include "server/runner/ingest/validate.h"

#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/dataset/output.h"
#include "common/dataset/photos.h"
#include "server/runner/scene/describe.h"

// RN_PHOTOS_LOOKS has PATH.jpg of the photograph at PATH.
static const struct rn_image_limits look_limits = {.max_width = 2048,
                                                   .max_height = 2048,
                                                   .max_pixels = (size_t)1 << 22,
                                                   .max_file_bytes = (size_t)1 << 23};

static void under(const char *path, const char *root, char ret_file[256]) {
    char text[4096];
    snprintf(text, sizeof text, "%s", path ? path : "");
    rn_make_relative(text, root);
    snprintf(ret_file, 256, "%.255s", text);
}

static struct rn_validated_view describe_view(const struct rn_frame *view, const char *root,
                                              const struct rn_import_options *options) {
    struct rn_frame place = rn_import_place(view, options, 0);
    struct rn_validated_view item = {.split = (int)place.split, .camera = place.camera};
    under(view->path, root, item.file);
    under(view->mask_path, root, item.mask);
    return item;
}

static void count_view(struct rn_split_counts *views, int split) {
    views->train += split == RN_SPLIT_TRAIN;
    views->val += split == RN_SPLIT_VAL;
    views->test += split == RN_SPLIT_TEST;
}

// Views of the finest scale; every one is counted, and so many are listed as there is room for.
static void list_views(const struct rn_dataset *source, const char *root,
                       const struct rn_import_options *options,
                       struct rn_validation_record *record) {
    size_t views = source->frame_count / (size_t)source->scale_count, seen = 0;
    size_t most = views < RN_VALIDATED_VIEWS ? views : RN_VALIDATED_VIEWS;
    for (size_t i = 0; i < source->frame_count; i++) {
        const struct rn_frame *view = &source->frames[i];
        if (i > 0 && view->split == view[-1].split && view->index == view[-1].index) continue;
        struct rn_validated_view item = describe_view(view, root, options);
        count_view(&record->views, item.split);
        if (record->item_count < most && seen == record->item_count * views / most)
            record->items[record->item_count++] = item;
        seen++;
    }
}

struct looks {
    const struct rn_dataset *source;
    const char *root;
    struct rn_survey *survey;
};

// A small picture stands upright, as EXIF has it; photographs are looked at as they are decoded.
static enum rn_status lay_down(const struct rn_frame *frame, struct rn_image *image,
                               struct rn_error *err) {
    static const int back[] = {1, 1, 2, 3, 4, 5, 8, 7, 6};
    bool lies = frame->turn <= 1 && frame->held >= 2 && frame->held <= 8;
    return lies ? rn_image_turn(image, back[frame->held], err) : RN_OK;
}

// One that is not there, or cannot be read, is not looked at.
static enum rn_status look_at(void *context, size_t index, struct rn_error *err) {
    const struct looks *looks = context;
    const struct rn_frame *frame = &looks->source->frames[index];
    char file[256], path[PATH_MAX];
    struct rn_image image;
    (void)err;
    under(frame->path, looks->root, file);
    snprintf(path, sizeof path, "%s/%s/%s.jpg", looks->root, RN_PHOTOS_LOOKS, file);
    if (rn_image_read(path, &look_limits, &image, NULL) != RN_OK) return RN_OK;
    if (lay_down(frame, &image, NULL) == RN_OK) rn_survey_look(looks->survey, frame, &image, false);
    rn_image_finish(&image);
    return RN_OK;
}

// A survey of the small pictures that are there.
static enum rn_status look_at_all(const struct rn_dataset *source, const char *root, int threads,
                                  struct rn_survey **ret_survey, struct rn_error *err) {
    struct looks looks = {.source = source, .root = root};
    enum rn_status status = rn_survey_create(source, &looks.survey, err);
    if (!status)
        status =
            rn_output_run(threads, source->frame_count, look_at, &looks, NULL, NULL, root, err);
    if (status)
        rn_survey_destroy(&looks.survey);
    else
        *ret_survey = looks.survey;
    return status;
}

static enum rn_status survey(struct rn_dataset *source, const char *root,
                             const struct rn_import_options *options, struct rn_problems *problems,
                             struct rn_findings *ret_found, struct rn_error *err) {
    struct rn_survey *survey = NULL;
    enum rn_status status = look_at_all(source, root, options->threads, &survey, err);
    if (!status) status = rn_survey_conclude(survey, source, options, problems, ret_found, err);
    rn_survey_destroy(&survey);
    return status;
}

enum rn_status rn_describe_validation(struct rn_dataset *source, const char *root,
                                      const struct rn_import_options *options,
                                      struct rn_problems *problems, char **ret_json,
                                      struct rn_error *err) {
    struct rn_import_options chosen = rn_import_settle(source, options, problems);
    struct rn_validation_record record = {
        .bounds = rn_describe_bounds(&source->bounds),
        .scales = chosen.scales > 1 ? chosen.scales : source->scale_count,
        .items = calloc(RN_VALIDATED_VIEWS, sizeof *record.items)};
    memcpy(record.up, source->lie.up, sizeof record.up);
    struct rn_findings found;
    enum rn_status status =
        record.items ? RN_OK
                     : rn_error_set(err, RN_ERROR_NO_MEMORY, root, "no memory for its views");
    if (!status) status = survey(source, root, &chosen, problems, &found, err);
    if (!status)
        status = rn_describe_report(source, root, problems, &found, options, &record.report, err);
    if (!status) list_views(source, root, &chosen, &record);
    if (!status) status = rn_encode(&rn_validation_table, &record, ret_json, NULL, err);
    free(record.report);
    free(record.items);
    return status;
}

enum rn_status rn_describe_photos(const char *root, const char *name, const char *masks,
                                  int threads, struct rn_problems *problems, char **ret_json,
                                  struct rn_error *err) {
    struct rn_photos photos = {0};
    struct rn_dataset *frames = NULL;
    struct rn_survey *survey = NULL;
    struct rn_findings found;
    struct rn_validation_record record;
    rn_message_init(&rn_validation_table, &record);
    enum rn_status status = rn_photos_read(root, masks, problems, &photos, err);
    if (!status) rn_photos_tell(&photos, name, problems);
    if (!status) status = rn_photos_frames(&photos, name, &frames, err);
    if (!status) status = look_at_all(frames, root, threads, &survey, err);
    if (!status) status = rn_survey_conclude_photos(survey, frames, problems, &found, err);
    record.views = (struct rn_split_counts){.train = (int64_t)photos.count};
    record.scales = 1;
    if (!status)
        status = rn_describe_photos_report(frames, root, problems, &found, &record.report, err);
    if (!status) status = rn_encode(&rn_validation_table, &record, ret_json, NULL, err);
    free(record.report);
    rn_survey_destroy(&survey);
    rn_dataset_destroy(&frames);
    rn_photos_finish(&photos);
    return status;
}

// Import: every view is decoded, scaled and encoded by one task; dataset.json comes last.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/file.h"
#include "common/dataset/calls.h"
#include "common/dataset/exposure.h"
#include "common/dataset/output.h"
#include "common/dataset/points.h"
#include "common/dataset/reader.h"
#include "common/dataset/survey.h"
#include "common/dataset/triangulate.h"

#define PNG_LEVEL 1

struct import {
    const struct rn_import_options *options;
    const char *target;
    int levels;                    // images written for each source image
    const struct rn_frame **views; // source images, view_count of them
    size_t view_count;
    struct rn_frame *outputs; // view_count * levels, then without those left out
    size_t output_count;
    struct rn_error *faults;                // of each view; status RN_OK where none
    struct rn_exposures *exposures;         // NULL: there are no points to measure them by
    struct rn_triangulation *triangulation; // NULL: not called for
    // What is found says how bright photographs are and nothing else, as trainings of cameras that
    // look one way between known depths gain nothing by it; points of the source's own.
    bool gains_alone;
    size_t own_points;
};

static void scaled_size(const struct rn_frame *view, const struct rn_import_options *options,
                        int level, int *ret_width, int *ret_height) {
    const struct rn_camera *camera = &view->camera;
    int longest = camera->width > camera->height ? camera->width : camera->height;
    double full = ldexp(longest, view->scale), shrink = 1;
    if (options->max_size && full > options->max_size) shrink = options->max_size / full;
    *ret_width = (int)floor(ldexp(floor(camera->width * shrink + 0.5), -level) + 0.5);
    *ret_height = (int)floor(ldexp(floor(camera->height * shrink + 0.5), -level) + 0.5);
}

static enum rn_status check_options(const struct rn_dataset *source,
                                    const struct rn_import_options *options, struct rn_error *err) {
    if (options->max_size < 0 || options->max_size > RN_CAMERA_MAX_SIZE)
        return rn_error_set(err, RN_ERROR_INVALID, "max_size", "must be 1 to %d pixels",
                            RN_CAMERA_MAX_SIZE);
    if (options->scales < 1 || options->scales > RN_DATASET_MAX_SCALE)
        return rn_error_set(err, RN_ERROR_INVALID, "scales", "must be 1 to %d",
                            RN_DATASET_MAX_SCALE);
    if (options->test_every < 0 || options->test_every == 1)
        return rn_error_set(err, RN_ERROR_INVALID, "split",
                            "every:N wants N of 2 or more: some views must be left to train on");
    for (size_t i = 0; i < source->frame_count; i++) {
        const struct rn_frame *view = &source->frames[i];
        int width, height;
        scaled_size(view, options, options->scales - 1, &width, &height);
        if (width < 1 || height < 1)
            return rn_error_set(err, RN_ERROR_INVALID, "scales",
                                "%d scales leave nothing of %s (%dx%d pixels)", options->scales,
                                view->path, view->camera.width, view->camera.height);
    }
    return RN_OK;
}

struct rn_frame rn_import_place(const struct rn_frame *view,
                                const struct rn_import_options *options, int level) {
    int width, height, every = options->test_every;
    struct rn_frame place = *view;
    scaled_size(view, options, level, &width, &height);
    if (every && view->split == RN_SPLIT_TRAIN && view->index % every == 0) {
        place.split = RN_SPLIT_TEST;
        place.index = view->index / every;
    }
    place.scale = view->scale + level;
    place.loss_weight = ldexp(view->loss_weight, 2 * level);
    place.camera = rn_camera_resized(&view->camera, width, height);
    place.backdrop.to_cut = false;
    place.name = place.path = place.mask_path = NULL;
    return place;
}

// Level `level` of a view: its place in the new dataset, its camera, its file.
static enum rn_status describe_output(const struct import *import, const struct rn_frame *view,
                                      int level, const char *extension, struct rn_frame *output,
                                      struct rn_error *err) {
    *output = rn_import_place(view, import->options, level);
    output->name = strdup(view->name);
    if (asprintf(&output->path, "%s/images/%s_%05d_d%d%s", import->target,
                 rn_split_name(output->split), output->index, output->scale, extension) < 0)
        output->path = NULL;
    if (output->name && output->path) return RN_OK;
    rn_frame_finish(output);
    return rn_error_set(err, RN_ERROR_NO_MEMORY, view->path, "out of memory");
}

// What is used of a view by its mask: white, opaque; else black.
static enum rn_status read_mask(const struct rn_frame *view, struct rn_image *ret_mask,
                                struct rn_error *err) {
    size_t count = (size_t)view->camera.width * (size_t)view->camera.height;
    uint8_t *used = malloc(count);
    if (!used) return rn_error_set(err, RN_ERROR_NO_MEMORY, view->mask_path, "out of memory");
    enum rn_status status = rn_mask_read(view, used, err);
    if (!status) status = rn_image_init(view->camera.width, view->camera.height, ret_mask, err);
    for (size_t i = 0; i < count && !status; i++) {
        memset(ret_mask->pixels + 4 * i, used[i] ? 255 : 0, 3);
        ret_mask->pixels[4 * i + 3] = 255;
    }
    free(used);
    return status;
}

// Where any part of a pixel is left out, all of it is.
static void keep_whole_pixels(struct rn_image *mask) {
    size_t bytes = 4 * (size_t)mask->width * (size_t)mask->height;
    for (size_t i = 0; i < bytes; i += 4)
        memset(mask->pixels + i, mask->pixels[i] == 255 ? 255 : 0, 3);
}

// The view's mask at an output's size, beside the output's image.
static enum rn_status write_mask(const struct rn_frame *view, struct rn_frame *output,
                                 struct rn_error *err) {
    struct rn_image mask, scaled;
    int width = output->camera.width, height = output->camera.height;
    size_t stem = (size_t)(strrchr(output->path, '.') - output->path);
    if (asprintf(&output->mask_path, "%.*s_mask.png", (int)stem, output->path) < 0) {
        output->mask_path = NULL;
        return rn_error_set(err, RN_ERROR_NO_MEMORY, view->path, "out of memory");
    }
    enum rn_status status = read_mask(view, &mask, err);
    if (status) return status;
    if (mask.width != width || mask.height != height) {
        status = rn_image_downscale(&mask, width, height, RN_DOWNSCALE_PREMULTIPLIED, &scaled, err);
        rn_image_finish(&mask);
        if (status) return status;
        mask = scaled;
        keep_whole_pixels(&mask);
    }
    status = rn_output_png(&mask, output->mask_path, PNG_LEVEL, err);
    rn_image_finish(&mask);
    return status;
}

// The photograph's own file, where that is what an output shows: smaller than a PNG by far, and
// written and read in less time. NULL: the output is another picture, or the file is not kept.
static uint8_t *keep_file(const struct import *import, const struct rn_frame *view, int level,
                          size_t *ret_size) {
    struct rn_error why;
    uint8_t *bytes;
    int width, height;
    scaled_size(view, import->options, level, &width, &height);
    static const int none[4];
    bool same = width == view->camera.width && height == view->camera.height && view->turn <= 1 &&
                !view->backdrop.to_cut && memcmp(view->bars, none, sizeof none) == 0;
    return same && rn_image_strip(view->path, NULL, &bytes, ret_size, &why) == RN_OK ? bytes : NULL;
}

static enum rn_status write_scaled(const struct import *import, const struct rn_image *image,
                                   const struct rn_frame *output, struct rn_error *err) {
    int width = output->camera.width, height = output->camera.height;
    if (image->width == width && image->height == height)
        return rn_output_png(image, output->path, PNG_LEVEL, err);
    struct rn_image scaled;
    enum rn_status status =
        rn_image_downscale(image, width, height, import->options->downscale, &scaled, err);
    if (status) return status;
    status = rn_output_png(&scaled, output->path, PNG_LEVEL, err);
    rn_image_finish(&scaled);
    return status;
}

static enum rn_status write_level(const struct import *import, const struct rn_frame *view,
                                  const struct rn_image *image, int level, struct rn_frame *output,
                                  struct rn_error *err) {
    size_t size;
    uint8_t *kept = keep_file(import, view, level, &size);
    enum rn_status status =
        describe_output(import, view, level, kept ? ".jpg" : ".png", output, err);
    if (status == RN_OK && view->mask_path) status = write_mask(view, output, err);
    if (status == RN_OK)
        status = kept ? rn_output_file(output->path, kept, size, err)
                      : write_scaled(import, image, output, err);
    free(kept);
    return status;
}

static enum rn_status write_legacy(const struct import *import, const struct rn_frame *view,
                                   const struct rn_image *full, struct rn_frame *outputs,
                                   struct rn_error *err) {
    struct rn_image levels[RN_DATASET_MAX_SCALE] = {{0}};
    struct rn_error inner;
    enum rn_status status = rn_image_legacy_pyramid(full, import->levels, levels, &inner);
    if (status)
        return rn_error_set(err, status, view->path, "cannot make %d straight scales: %s",
                            import->levels, inner.text);
    for (int level = 0; level < import->levels; level++) {
        if (status == RN_OK)
            status = write_level(import, view, &levels[level], level, &outputs[level], err);
        rn_image_finish(&levels[level]);
    }
    return status;
}

static enum rn_status write_levels(const struct import *import, const struct rn_frame *view,
                                   const struct rn_image *full, struct rn_frame *outputs,
                                   struct rn_error *err) {
    if (import->levels > 1 && import->options->downscale == RN_DOWNSCALE_STRAIGHT)
        return write_legacy(import, view, full, outputs, err);
    enum rn_status status = RN_OK;
    for (int level = 0; level < import->levels && status == RN_OK; level++)
        status = write_level(import, view, full, level, &outputs[level], err);
    return status;
}

static enum rn_status import_view(void *context, size_t index, struct rn_error *err) {
    struct import *import = context;
    const struct rn_frame *view = import->views[index];
    struct rn_error *fault = &import->faults[index];
    struct rn_image image;
    enum rn_status status = rn_frame_decode(view, import->options->survey, &image,
                                            fault); // its fault, not the import's
    if (status == RN_ERROR_NO_MEMORY) {
        *err = *fault;
        return status;
    }
    if (status) return RN_OK;
    rn_exposures_look(import->exposures, view, &image);
    rn_triangulation_look(import->triangulation, view, &image);
    int width, height;
    scaled_size(view, import->options, 0, &width, &height);
    if (width != image.width || height != image.height) {
        struct rn_image full;
        status = rn_image_downscale(&image, width, height, import->options->downscale, &full, err);
        rn_image_finish(&image);
        if (status) return status;
        image = full;
    }
    status =
        write_levels(import, view, &image, import->outputs + index * (size_t)import->levels, err);
    rn_image_finish(&image);
    return status;
}

static json_t *frame_to_json(const struct rn_frame *frame, bool with_points, const char *target) {
    json_t *photo = with_points ? json_integer(frame->photo) : NULL;
    json_t *near = frame->far > 0 ? json_real(frame->near) : NULL;
    json_t *far = frame->far > 0 ? json_real(frame->far) : NULL;
    const double *g = frame->gain;
    json_t *gain = g[0] > 0 ? json_pack("[fff]", g[0], g[1], g[2]) : NULL;
    json_t *light = frame->light > 0 ? json_real(frame->light) : NULL;
    const char *mask = frame->mask_path ? frame->mask_path + strlen(target) + 1 : NULL;
    return json_pack("{s:s s:s s:s s:i s:i s:f s:o s:o* s:o* s:s* s:o* s:o* s:o*}", "name",
                     frame->name, "file", frame->path + strlen(target) + 1, "split",
                     rn_split_name(frame->split), "index", frame->index, "scale", frame->scale,
                     "loss_weight", frame->loss_weight, "camera",
                     rn_json_from_camera(&frame->camera), "near", near, "far", far, "mask", mask,
                     "photo", photo, "gain", gain, "light", light);
}

static json_t *lie_to_json(const struct rn_lie *lie) {
    const double *low = lie->crop.low, *high = lie->crop.high;
    json_t *crop = lie->cropped ? json_pack("{s:[fff] s:[fff]}", "low", low[0], low[1], low[2],
                                            "high", high[0], high[1], high[2])
                                : NULL;
    return json_pack("{s:s s:[fff] s:b s:o*}", "kind", rn_capture_names[lie->kind], "up",
                     lie->up[0], lie->up[1], lie->up[2], "up_given", lie->up_given, "crop", crop);
}

static json_t *backdrop_to_json(const struct rn_backdrop *backdrop) {
    const uint8_t *c = backdrop->colour;
    return backdrop->known ? json_pack("[iii]", c[0], c[1], c[2]) : NULL;
}

static json_t *dataset_to_json(const struct rn_dataset *dataset, const char *target) {
    const struct rn_bounds *bounds = &dataset->bounds;
    json_t *frames = json_array();
    for (size_t i = 0; i < dataset->frame_count; i++)
        if (json_array_append_new(frames, frame_to_json(&dataset->frames[i],
                                                        dataset->points.count > 0, target)) != 0) {
            json_decref(frames);
            return NULL;
        }
    return json_pack("{s:s s:i s:s s:{s:s s:s} s:{s:[fff] s:f s:s} s:o s:s* s:o* s:o* s:o}",
                     "format", RN_NATIVE_FORMAT, "version", RN_NATIVE_VERSION, "name",
                     dataset->name, "source", "layout", dataset->format->name, "downscale",
                     rn_downscale_names[dataset->premultiplied_scales ? RN_DOWNSCALE_PREMULTIPLIED
                                                                      : RN_DOWNSCALE_STRAIGHT],
                     "bounds", "centre", bounds->centre[0], bounds->centre[1], bounds->centre[2],
                     "radius", bounds->radius, "source", rn_bounds_source_names[bounds->source],
                     "lie", lie_to_json(&dataset->lie), "points",
                     dataset->points.count ? RN_POINTS_DOCUMENT : NULL, "points_found",
                     dataset->points.found ? json_true() : NULL, "backdrop",
                     backdrop_to_json(&dataset->frames[0].backdrop), "frames", frames);
}

static enum rn_status write_json(const struct rn_dataset *dataset, const char *target,
                                 struct rn_error *err) {
    json_t *root = dataset_to_json(dataset, target);
    char *text = root ? json_dumps(root, JSON_INDENT(1) | JSON_REAL_PRECISION(17)) : NULL, *path;
    json_decref(root);
    enum rn_status status;
    if (!text || asprintf(&path, "%s/dataset.json", target) < 0) {
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, target,
                              "cannot describe the dataset: out of memory, or a name that is not "
                              "UTF-8");
    } else {
        status = rn_file_write_atomic(path, text, strlen(text), err);
        free(path);
    }
    free(text);
    return status;
}

// Drops the outputs of views that could not be decoded and reports those.
static void drop_faulty(struct import *import, struct rn_problems *problems, int *unusable) {
    size_t levels = (size_t)import->levels;
    import->output_count = 0;
    for (size_t i = 0; i < import->view_count; i++) {
        const struct rn_error *fault = &import->faults[i];
        if (fault->status) {
            rn_problems_add(problems, RN_SEVERITY_ERROR, fault->where, "%s", fault->text);
            unusable[import->views[i]->split]++;
            continue;
        }
        for (size_t level = 0; level < levels; level++)
            import->outputs[import->output_count++] = import->outputs[i * levels + level];
    }
}

// Takes the views that could not be decoded out of the source as well.
static enum rn_status drop_from_source(const struct import *import, struct rn_dataset *source,
                                       struct rn_error *err) {
    size_t kept = 0, view = 0;
    for (size_t i = 0; i < source->frame_count; i++) {
        struct rn_frame *frame = &source->frames[i];
        bool looked_at = view < import->view_count && import->views[view] == frame;
        if (looked_at && import->faults[view++].status) {
            source->unusable[frame->split]++;
            rn_frame_finish(frame);
        } else {
            source->frames[kept++] = *frame;
        }
    }
    if (kept == source->frame_count) return RN_OK;
    source->frame_count = kept;
    return rn_dataset_seal(source, source->name, NULL, err);
}

static enum rn_status write_points(const struct rn_dataset *source, const char *target,
                                   struct rn_error *err) {
    char *path;
    if (!source->points.count) return RN_OK;
    if (asprintf(&path, "%s/" RN_POINTS_DOCUMENT, target) < 0)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, target, "out of memory");
    enum rn_status status = rn_points_write(&source->points, path, err);
    free(path);
    return status;
}

static enum rn_status conclude(struct import *import, struct rn_dataset *source, const char *name,
                               struct rn_problems *problems, struct rn_error *err) {
    const struct rn_import_options *options = import->options;
    struct rn_dataset result = {.name = (char *)name, .format = source->format, .lie = source->lie};
    drop_faulty(import, problems, result.unusable);
    rn_exposures_solve(import->exposures, import->outputs, import->output_count);
    if (import->gains_alone) rn_points_cut(&source->points, import->own_points);
    result.points = source->points;
    result.frames = import->outputs;
    result.frame_count = import->output_count;
    result.bounds = source->bounds;
    result.premultiplied_scales = options->downscale == RN_DOWNSCALE_PREMULTIPLIED &&
                                  (import->levels > 1 || source->premultiplied_scales);
    enum rn_status status = rn_dataset_seal(&result, import->target, problems, err);
    if (status || (status = drop_from_source(import, source, err)) ||
        (status = write_points(source, import->target, err)) ||
        (status = rn_output_sync(import->target, err)))
        return status;
    return write_json(&result, import->target, err);
}

// What an import has shown of its progress stays: the points are its last part.
struct last_part {
    rn_output_progress progress;
    void *context;
    size_t views;
};

static bool go_on(void *context, size_t done, size_t total) {
    const struct last_part *part = context;
    (void)done;
    (void)total;
    return part->progress(part->context, part->views, part->views);
}

static enum rn_status triangulate(struct import *import, struct rn_dataset *source,
                                  struct rn_problems *problems, rn_output_progress progress,
                                  void *context, struct rn_error *err) {
    struct last_part part = {progress, context, import->view_count};
    size_t count, levels = (size_t)import->levels;
    bool depths = rn_faces_one_way(source);
    import->own_points = source->points.count;
    enum rn_status status =
        rn_triangulation_solve(import->triangulation, import->options->threads, source,
                               progress ? go_on : NULL, &part, &count, err);
    if (status || !count) return status;
    import->gains_alone = depths;
    if ((status = rn_dataset_find_depths(source, err)) ||
        (status = rn_exposures_create(source, &import->exposures, err)))
        return status;
    rn_triangulation_show(import->triangulation, import->exposures);
    for (size_t i = 0; i < import->view_count * levels; i++) {
        import->outputs[i].near = import->views[i / levels]->near;
        import->outputs[i].far = import->views[i / levels]->far;
    }
    if (!import->gains_alone)
        rn_problems_add(
            problems, RN_SEVERITY_INFO, "points",
            "no file says which photographs see which points: %zu were found where "
            "photographs look alike, each seen by %.1f of them; what they are seen through "
            "begins empty",
            count, (double)source->points.sighting_count / (double)count);
    return RN_OK;
}

static enum rn_status choose_views(struct import *import, const struct rn_dataset *source,
                                   struct rn_error *err) {
    size_t count = source->frame_count, levels = (size_t)import->levels;
    if (count * levels > RN_DATASET_MAX_FRAMES)
        return rn_error_set(err, RN_ERROR_LIMIT, import->target, "would have more than %d images",
                            RN_DATASET_MAX_FRAMES);
    import->views = calloc(count + 1, sizeof *import->views);
    import->outputs = calloc(count * levels + 1, sizeof *import->outputs);
    import->faults = calloc(count + 1, sizeof *import->faults);
    if (!import->views || !import->outputs || !import->faults)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, import->target, "out of memory");
    for (size_t i = 0; i < count; i++)
        if (levels == 1 || source->frames[i].scale == 0)
            import->views[import->view_count++] = &source->frames[i];
    import->output_count = import->view_count * levels;
    return RN_OK;
}

static enum rn_status make_folders(const char *target, struct rn_error *err) {
    char *images;
    if (asprintf(&images, "%s/images", target) < 0)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, target, "out of memory");
    enum rn_status status = rn_mkdirs(images, 0777, err);
    free(images);
    return status;
}

struct rn_import_options rn_import_settle(const struct rn_dataset *source,
                                          const struct rn_import_options *options,
                                          struct rn_problems *problems) {
    struct rn_import_options chosen = *options;
    if (source->view_count[RN_SPLIT_TEST] && chosen.test_every > 0) {
        rn_problems_add(problems, RN_SEVERITY_INFO, "split",
                        "the files name %d test views; --split every:%d was not needed",
                        source->view_count[RN_SPLIT_TEST], chosen.test_every);
        chosen.test_every = 0;
    }
    return chosen;
}

enum rn_status rn_dataset_import(struct rn_dataset *source, const char *name,
                                 const struct rn_import_options *options, const char *target,
                                 struct rn_problems *problems,
                                 bool (*progress)(void *context, size_t done, size_t total),
                                 void *context, struct rn_error *err) {
    struct rn_import_options chosen = rn_import_settle(source, options, problems);
    struct import import = {.options = &chosen, .target = target, .levels = options->scales};
    enum rn_status status;
    rn_dataset_cut_bars(source, problems);
    if ((status = check_options(source, &chosen, err)) ||
        (status = rn_output_check_new(target, err)) || (status = make_folders(target, err)) ||
        (status = choose_views(&import, source, err)) ||
        (status = rn_exposures_create(source, &import.exposures, err)) ||
        (status = rn_triangulation_create(source, chosen.test_every, &import.triangulation, err)) ||
        (status = rn_output_run(options->threads, import.view_count, import_view, &import, progress,
                                context, target, err)) ||
        (status = triangulate(&import, source, problems, progress, context, err)))
        goto done;
    status = conclude(&import, source, name, problems, err);
done:
    for (size_t i = 0; i < import.output_count; i++)
        rn_frame_finish(&import.outputs[i]);
    free(import.outputs);
    free(import.views);
    free(import.faults);
    rn_exposures_destroy(&import.exposures);
    rn_triangulation_destroy(&import.triangulation);
    return status;
}

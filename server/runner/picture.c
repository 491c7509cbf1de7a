#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "server/runner/budget.h"

#define INTERACTIVE_PNG_LEVEL 2 // zlib: quick rather than small

static double elapsed_ms(int64_t since_ns) {
    return (double)(rn_clock_ns() - since_ns) * 1e-6;
}

double rn_depth_scale(const struct rn_camera *camera, const struct rn_bounds *bounds) {
    double squared = 0;
    for (int i = 0; i < 3; i++) {
        double d = camera->world_from_camera[i][3] - bounds->centre[i];
        squared += d * d;
    }
    return sqrt(squared) + bounds->radius;
}

enum rn_status rn_picture_encode(const struct rn_render_result *result, enum rn_output_kind output,
                                 enum rn_picture_format format, int quality, int png_level,
                                 double depth_scale, uint8_t **ret_bytes, size_t *ret_size,
                                 struct rn_error *err) {
    if (output == RN_OUTPUT_KIND_DEPTH)
        return rn_picture_encode_depth_png(&result->depth, (float)depth_scale, png_level, ret_bytes,
                                           ret_size, err);
    const struct rn_picture *picture = output == RN_OUTPUT_KIND_RGB ? &result->rgb : &result->alpha;
    struct rn_image image;
    enum rn_status status = rn_picture_to_image(picture, &image, err);
    if (status) return status;
    status = format == RN_FORMAT_JPEG
                 ? rn_image_encode_jpeg(&image, quality, ret_bytes, ret_size, err)
                 : rn_image_encode_png(&image, png_level, ret_bytes, ret_size, err);
    rn_image_finish(&image);
    return status;
}

static enum rn_status find_camera(struct rn_host *host, const struct rn_render_request *request,
                                  struct rn_camera *ret_camera, struct rn_error *err) {
    const struct rn_frame *frame;
    if (request->camera.width) {
        *ret_camera = request->camera;
        return RN_OK;
    }
    enum rn_status status = rn_host_need_dataset(host, err);
    if (status) return status;
    status = rn_dataset_find_view(host->dataset, request->view, (int)rn_int_or(request->scale, 0),
                                  &frame, err);
    if (status) {
        if (err) snprintf(err->where, sizeof err->where, "#/view");
        return status;
    }
    *ret_camera = frame->camera;
    if (rn_name_or(request->lens, RN_LENS_CHOICE_PINHOLE) == RN_LENS_CHOICE_PINHOLE)
        *ret_camera = rn_camera_without_lens(&frame->camera);
    return RN_OK;
}

// The engine's options of a request.
static enum rn_status render_options(struct rn_host *host, const struct rn_render_request *request,
                                     const struct rn_field_info *info,
                                     struct rn_render_options *ret_options, struct rn_error *err) {
    static const unsigned outputs[] = {[RN_OUTPUT_KIND_RGB] = RN_OUTPUT_RGB,
                                       [RN_OUTPUT_KIND_DEPTH] = RN_OUTPUT_DEPTH,
                                       [RN_OUTPUT_KIND_ALPHA] = RN_OUTPUT_ALPHA};
    struct rn_render_options options = {
        .outputs = outputs[rn_name_or(request->output, RN_OUTPUT_KIND_RGB)]};
    rn_settings_put(&rn_render_settings, request->settings, &options.settings);
    enum rn_status status = find_camera(host, request, &options.camera, err);
    if (status) return status;
    if (request->size.width != RN_ABSENT)
        options.camera = rn_camera_reframed(&options.camera, (int)request->size.width,
                                            (int)request->size.height);
    for (int i = 0; i < 3; i++)
        options.background[i] = isnan(request->background[0]) ? info->config.background[i]
                                                              : (float)request->background[i];
    *ret_options = options;
    return RN_OK;
}

// Renders and encodes; fills what `rendered` reports.
static enum rn_status make(struct rn_host *host, const struct rn_wire_render *render,
                           struct rn_watch *watch, struct rn_wire_rendered *rendered,
                           uint8_t **ret_bytes, size_t *ret_size, struct rn_error *err) {
    const struct rn_render_request *request = &render->render;
    struct rn_field *field;
    struct rn_field_info info;
    struct rn_render_options options;
    struct rn_render_result result = {0};
    enum rn_status status = rn_host_field(host, &field, err);
    if (status) return status;
    rn_field_describe(field, &info);
    status = render_options(host, request, &info, &options, err);
    if (!status)
        status =
            rn_budget_render(host, render, &info, field, &options, watch, rendered, &result, err);
    if (status) return status;
    int64_t rendered_ns = rn_clock_ns();
    rendered->step = info.steps;
    rendered->samples = (int64_t)result.stats.samples;
    rendered->width = options.camera.width;
    rendered->height = options.camera.height;
    rendered->format = rn_name_or(request->format, RN_FORMAT_PNG);
    enum rn_output_kind output =
        (enum rn_output_kind)rn_name_or(request->output, RN_OUTPUT_KIND_RGB);
    status =
        rn_picture_encode(&result, output, (enum rn_picture_format)rendered->format,
                          (int)rn_int_or(request->jpeg_quality, 90), INTERACTIVE_PNG_LEVEL,
                          rn_depth_scale(&options.camera, &info.bounds), ret_bytes, ret_size, err);
    rendered->encode_ms = elapsed_ms(rendered_ns);
    rn_budget_encoded(host, render, rendered);
    rn_render_result_finish(&result);
    return status;
}

void rn_picture_serve(struct rn_host *host, const struct rn_wire_render *render,
                      int64_t arrived_ns) {
    struct rn_wire_rendered rendered = {.request = render->request,
                                        .queue_ms = elapsed_ms(arrived_ns),
                                        .training = host->training != NULL,
                                        .expected_psnr = NAN,
                                        .expected_spread = NAN};
    struct rn_watch watch = {.link = &host->link, .job = "", .request = render->request};
    uint8_t *bytes = NULL;
    size_t size = 0;
    struct rn_error err = {0};
    enum rn_status status = RN_OK;
    if (!rn_watch_keep_going(&watch))
        status = rn_error_set(&err, RN_ERROR_CANCELLED, "", "cancelled before it began");
    if (!status) status = make(host, render, &watch, &rendered, &bytes, &size, &err);
    if (!status && size > RN_WIRE_MAX_BLOB)
        status = rn_error_set(&err, RN_ERROR_LIMIT, "#/size", "the picture's file is too large");
    if (status)
        rn_link_fail(&host->link, "", render->request, &err);
    else
        rn_link_post(&host->link, RN_WIRE_RENDERED, &rendered, bytes, size);
    free(bytes);
}

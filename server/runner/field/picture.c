#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "common/math/srgb.h"
#include "server/runner/field/budget.h"
#include "server/runner/field/heat.h"

// The engine's bits are the wire's names in order.
_Static_assert(1u << RN_OUTPUT_KIND_RGB == RN_OUTPUT_RGB &&
                   1u << RN_OUTPUT_KIND_FOOTPRINT == RN_OUTPUT_FOOTPRINT,
               "an output's name and its bit");

#define INTERACTIVE_PNG_LEVEL 2 // zlib: quick rather than small

static double elapsed_ms(int64_t since_ns) {
    return (double)(rn_clock_ns() - since_ns) * 1e-6;
}

double rn_depth_scale(const struct rn_camera *camera, const struct rn_bounds *bounds) {
    return rn_camera_distance(camera, bounds->centre) + bounds->radius;
}

void rn_picture_choose(enum rn_output_kind output, enum rn_picture_format format,
                       struct rn_render_options *options) {
    options->outputs = 1u << output;
    if (format != RN_FORMAT_EXR) return;
    options->outputs = RN_OUTPUT_RGB | RN_OUTPUT_ALPHA | RN_OUTPUT_DEPTH;
    const struct rn_optics *optics = &options->shot.optics;
    if (!rn_optics_spreads(optics) && !(optics->ortho_height > 0))
        options->outputs |= RN_OUTPUT_NORMAL;
    memset(options->background, 0, sizeof options->background);
}

void rn_picture_crop(const double crop[6], struct rn_box *ret_box,
                     struct rn_render_options *options) {
    options->crop = isnan(crop[0]) ? NULL : ret_box;
    memcpy(ret_box->low, crop, sizeof ret_box->low);
    memcpy(ret_box->high, crop + 3, sizeof ret_box->high);
}

// Premultiplied sRGB over black to linear light times alpha.
static enum rn_status to_light(const struct rn_render_result *result, struct rn_picture *ret_light,
                               struct rn_error *err) {
    const float *rgb = result->rgb.values, *alpha = result->alpha.values;
    size_t count = (size_t)result->rgb.width * (size_t)result->rgb.height;
    enum rn_status status =
        rn_picture_init(result->rgb.width, result->rgb.height, 3, ret_light, err);
    for (size_t i = 0; i < 3 * count && !status; i++) {
        float a = alpha[i / 3];
        ret_light->values[i] = a > 0 ? a * rn_srgb_to_linear(fminf(rgb[i] / a, 1)) : 0;
    }
    return status;
}

static enum rn_status encode_exr(const struct rn_render_result *result, uint8_t **ret_bytes,
                                 size_t *ret_size, struct rn_error *err) {
    struct rn_picture light = {0};
    const struct rn_exr_plane planes[] = {{"R", &light, 0, false},
                                          {"G", &light, 1, false},
                                          {"B", &light, 2, false},
                                          {"A", &result->alpha, 0, false},
                                          {"Z", &result->depth, 0, true},
                                          {"N.X", &result->normal, 0, false},
                                          {"N.Y", &result->normal, 1, false},
                                          {"N.Z", &result->normal, 2, false}};
    enum rn_status status = to_light(result, &light, err);
    if (status) return status;
    status = rn_exr_encode(planes, result->normal.values ? 8 : 5,
                           "ripnerf: linear light times alpha; Z is the distance along the ray in "
                           "dataset units, 0 where nothing was hit; N on the dataset's axes",
                           ret_bytes, ret_size, err);
    rn_picture_finish(&light);
    return status;
}

// The output in colours: one of the result's own, or *ret_made.
static enum rn_status to_colours(const struct rn_render_result *result, enum rn_output_kind output,
                                 struct rn_picture *ret_made, const struct rn_picture **ret_colours,
                                 double *ret_high, struct rn_error *err) {
    const struct rn_picture *const maps[] = {[RN_OUTPUT_KIND_COST] = &result->cost,
                                             [RN_OUTPUT_KIND_LEVEL] = &result->level,
                                             [RN_OUTPUT_KIND_FOOTPRINT] = &result->footprint};
    *ret_colours = ret_made;
    if (output == RN_OUTPUT_KIND_NORMAL) return rn_normal_picture(&result->normal, ret_made, err);
    if (output > RN_OUTPUT_KIND_NORMAL)
        return rn_heat_picture(maps[output], ret_made, ret_high, err);
    *ret_colours = output == RN_OUTPUT_KIND_RGB ? &result->rgb : &result->alpha;
    return RN_OK;
}

static enum rn_status encode_bytes(const struct rn_picture *colours,
                                   const struct rn_picture_file *file, uint8_t **ret_bytes,
                                   size_t *ret_size, struct rn_error *err) {
    struct rn_image image;
    enum rn_status status = rn_picture_to_image(colours, &image, err);
    if (status) return status;
    status = file->format == RN_FORMAT_JPEG
                 ? rn_image_encode_jpeg(&image, file->jpeg_quality, ret_bytes, ret_size, err)
                 : rn_image_encode_png(&image, file->png_level, ret_bytes, ret_size, err);
    rn_image_finish(&image);
    return status;
}

enum rn_status rn_picture_encode(const struct rn_render_result *result,
                                 const struct rn_picture_file *file, uint8_t **ret_bytes,
                                 size_t *ret_size, double *ret_high, struct rn_error *err) {
    struct rn_picture made = {0};
    const struct rn_picture *colours;
    *ret_high = NAN;
    if (file->format == RN_FORMAT_EXR) return encode_exr(result, ret_bytes, ret_size, err);
    if (file->output == RN_OUTPUT_KIND_DEPTH)
        return rn_picture_encode_depth_png(&result->depth, (float)file->depth_scale,
                                           file->png_level, ret_bytes, ret_size, err);
    enum rn_status status = to_colours(result, file->output, &made, &colours, ret_high, err);
    if (!status && file->format == RN_FORMAT_PNG16)
        status = rn_picture_encode_png16(colours, file->png_level, ret_bytes, ret_size, err);
    else if (!status)
        status = encode_bytes(colours, file, ret_bytes, ret_size, err);
    rn_picture_finish(&made);
    return status;
}

// The camera, and of a view as it was taken the gains that made its photograph even and the light
// that it was taken in.
static enum rn_status find_camera(struct rn_host *host, const struct rn_render_request *request,
                                  const struct rn_field_info *info, const struct rn_field *field,
                                  struct rn_render_options *options, struct rn_error *err) {
    const struct rn_frame *frame;
    if (request->camera.width) {
        options->camera = request->camera;
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
    options->camera = frame->camera;
    if (rn_name_or(request->lens, RN_LENS_CHOICE_PINHOLE) == RN_LENS_CHOICE_PINHOLE)
        options->camera = rn_camera_without_lens(&frame->camera);
    if (rn_name_or(request->colours, RN_COLOURS_EVEN) != RN_COLOURS_AS_TAKEN) return RN_OK;
    if (info->effects[RN_EFFECT_EXPOSURE].on)
        memcpy(options->shot.gain, frame->gain, sizeof options->shot.gain);
    options->appearance = rn_field_appearance(field, (size_t)(frame - host->dataset->frames));
    return RN_OK;
}

// The engine's options of a request.
static enum rn_status render_options(struct rn_host *host, const struct rn_render_request *request,
                                     const struct rn_field_info *info, const struct rn_field *field,
                                     struct rn_render_options *ret_options, struct rn_error *err) {
    struct rn_render_options options = {.deadline_ns = 0};
    rn_settings_put(&rn_render_settings, request->settings, &options.settings);
    enum rn_status status = rn_optics_of_request(&request->optics, &options.shot.optics, err);
    if (!status) status = find_camera(host, request, info, field, &options, err);
    if (status) return status;
    if (request->size.width != RN_ABSENT)
        options.camera = rn_camera_reframed(&options.camera, (int)request->size.width,
                                            (int)request->size.height);
    for (int i = 0; i < 3; i++)
        options.background[i] = isnan(request->background[0]) ? info->config.background[i]
                                                              : (float)request->background[i];
    rn_picture_choose((enum rn_output_kind)rn_name_or(request->output, RN_OUTPUT_KIND_RGB),
                      (enum rn_picture_format)rn_name_or(request->format, RN_FORMAT_PNG), &options);
    if (request->format == RN_FORMAT_EXR && rn_exr_check(err)) return RN_ERROR_UNSUPPORTED;
    *ret_options = options;
    return RN_OK;
}

// Renders and encodes; fills what `rendered` reports. The caller finishes the result, also on
// failure. `ret_psnr`: expected of the picture, before it is a file.
static enum rn_status make(struct rn_host *host, const struct rn_wire_render *render,
                           struct rn_watch *watch, struct rn_wire_rendered *rendered,
                           struct rn_render_result *ret_result, double *ret_psnr,
                           uint8_t **ret_bytes, size_t *ret_size, struct rn_error *err) {
    const struct rn_render_request *request = &render->render;
    struct rn_field *field;
    struct rn_field_info info;
    struct rn_render_options options;
    struct rn_box box;
    enum rn_status status = rn_host_field_at(host, request->at, &field, err);
    if (status) return status;
    rn_field_describe(field, &info);
    if (!isnan(request->at)) rendered->at = info.train_seconds;
    status = render_options(host, request, &info, field, &options, err);
    rn_picture_crop(request->crop, &box, &options);
    if (!status)
        status = rn_budget_render(host, render, &info, field, &options, watch, rendered, ret_result,
                                  err);
    if (status) return status;
    int64_t rendered_ns = rn_clock_ns();
    rendered->step = info.steps;
    rendered->samples = (int64_t)ret_result->stats.samples;
    rendered->cones = (int64_t)ret_result->stats.cones * ret_result->stats.cones;
    rn_optics_names(&options.shot.optics, rendered->effects, sizeof rendered->effects);
    rendered->width = options.camera.width;
    rendered->height = options.camera.height;
    rendered->format = rn_name_or(request->format, RN_FORMAT_PNG);
    struct rn_picture_file file = {
        .output = (enum rn_output_kind)rn_name_or(request->output, RN_OUTPUT_KIND_RGB),
        .format = (enum rn_picture_format)rendered->format,
        .jpeg_quality = (int)rn_int_or(request->jpeg_quality, RN_JPEG_QUALITY),
        .png_level = INTERACTIVE_PNG_LEVEL,
        .depth_scale = rn_depth_scale(&options.camera, &info.bounds)};
    *ret_psnr = rendered->expected_psnr;
    status = rn_picture_encode(ret_result, &file, ret_bytes, ret_size, &rendered->scale_high, err);
    rendered->encode_ms = elapsed_ms(rendered_ns);
    if (!status) rn_budget_encoded(host, render, &ret_result->rgb, *ret_bytes, *ret_size, rendered);
    return status;
}

void rn_picture_serve(struct rn_host *host, const struct rn_wire_render *render,
                      int64_t arrived_ns) {
    struct rn_wire_rendered rendered = {.request = render->request,
                                        .queue_ms = elapsed_ms(arrived_ns),
                                        .training = host->training != NULL,
                                        .at = NAN,
                                        .scale_high = NAN,
                                        .expected_psnr = NAN,
                                        .expected_spread = NAN,
                                        .kept_ms = NAN};
    struct rn_watch watch = {.link = &host->link, .job = "", .request = render->request};
    struct rn_render_result result = {0};
    uint8_t *bytes = NULL;
    size_t size = 0;
    double psnr = NAN;
    struct rn_error err = {0};
    enum rn_status status = RN_OK;
    if (!rn_watch_keep_going(&watch))
        status = rn_error_set(&err, RN_ERROR_CANCELLED, "", "cancelled before it began");
    if (!status)
        status = make(host, render, &watch, &rendered, &result, &psnr, &bytes, &size, &err);
    if (!status && size > RN_WIRE_MAX_BLOB)
        status = rn_error_set(&err, RN_ERROR_LIMIT, "#/size", "the picture's file is too large");
    if (status)
        rn_link_fail(&host->link, "", render->request, &err);
    else
        rn_link_post(&host->link, RN_WIRE_RENDERED, &rendered, bytes, size);
    if (!status) rn_budget_look(host, render, &result.rgb, bytes, size, psnr);
    rn_render_result_finish(&result);
    free(bytes);
}

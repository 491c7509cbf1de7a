#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "server/api/app.h"

enum rn_status rn_api_check_pixels(int64_t width, int64_t height, const char *pointer,
                                   struct rn_error *err) {
    if (width * height <= RN_MAX_RENDER_PIXELS) return RN_OK;
    return rn_error_set(err, RN_ERROR_LIMIT, pointer,
                        "%lld x %lld is more than the limit of %lld pixels a picture",
                        (long long)width, (long long)height, (long long)RN_MAX_RENDER_PIXELS);
}

// A bad camera or size is refused here: no runner has to be started for it.
static enum rn_status check_picture(const struct rn_render_request *wanted, struct rn_error *err) {
    bool sized = wanted->size.width != RN_ABSENT && wanted->size.height != RN_ABSENT;
    enum rn_status status = RN_OK;
    if (sized) status = rn_api_check_pixels(wanted->size.width, wanted->size.height, "#/size", err);
    if (sized || wanted->camera.width == 0) return status;
    return rn_api_check_pixels(wanted->camera.width, wanted->camera.height, "#/camera", err);
}

// Whether `Accept` lists a media type at all; ranges count, quality values do not.
static bool lists(const char *accept, const char *type) {
    return strcasestr(accept, type) != NULL;
}

// PNG unless the client takes JPEG only. False: neither.
static bool choose_format(const char *accept, enum rn_picture_format *ret_format) {
    *ret_format = RN_FORMAT_PNG;
    if (accept == NULL || lists(accept, "image/png") || lists(accept, "*/*") ||
        lists(accept, "image/*"))
        return true;
    *ret_format = RN_FORMAT_JPEG;
    return lists(accept, "image/jpeg");
}

static bool matches(const char *if_none_match, const char *etag) {
    return if_none_match != NULL && etag[0] != '\0' &&
           (strcmp(if_none_match, "*") == 0 || strstr(if_none_match, etag) != NULL);
}

static void render(struct rn_app *app, const struct rn_render_request *render,
                   struct rn_request *request, struct rn_reply *reply) {
    struct rn_error err = {0};
    struct rn_scene_row scene;
    char etag[RN_ETAG_MAX] = "";
    enum rn_status status = rn_store_resolve(app->store, &rn_scenes, RN_ID_SCENE,
                                             rn_request_param(request, 0), &scene, &err);
    if (rn_api_failed(status, &err, reply)) return;
    status = rn_control_etag(app->control, &scene, render, etag, &err);
    if (status != RN_OK) {
        rn_reply_error(reply, &err);
    } else if (matches(rn_request_header(request, "If-None-Match"), etag)) {
        rn_reply_empty(reply, 304);
        rn_reply_header(reply, "ETag", "%s", etag);
        rn_reply_header(reply, "Cache-Control", "no-cache");
    } else {
        rn_control_render(app->control, &scene, render, etag, request, reply);
    }
    rn_row_finish(&rn_scenes, &scene);
}

void rn_render_scene(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_error err = {0};
    struct rn_field_errors errors = {0};
    struct rn_render_request wanted;
    enum rn_picture_format format;
    size_t size;
    const char *body = (const char *)rn_request_body(request, &size);
    if (rn_render_request_decode(body, size, &wanted, &errors, &err) != RN_OK) {
        rn_reply_invalid(reply, &errors, &err);
        return;
    }
    if (rn_api_failed(check_picture(&wanted, &err), &err, reply)) {
        rn_message_finish(&rn_render_request_table, &wanted);
        return;
    }
    if (!choose_format(rn_request_header(request, "Accept"), &format) && wanted.format < 0) {
        rn_reply_problem(reply, RN_PROBLEM_NOT_ACCEPTABLE,
                         "pictures are image/png or image/jpeg; accept one of them");
    } else {
        rn_render_request_settle(&wanted, format);
        render(context, &wanted, request, reply);
    }
    rn_message_finish(&rn_render_request_table, &wanted);
}

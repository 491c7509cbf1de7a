#include "server/engine/checkpoint/state.h"

#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>

#include "common/math/vector.h"
#include "server/engine/checkpoint/viewing.h"
#include "server/engine/scene/scene.h"

enum kind { KIND_INT, KIND_INT64, KIND_UINT64, KIND_DOUBLE, KIND_BOOL, KIND_TEXT16, KIND_COLOUR };

struct member {
    const char *name;
    enum kind kind;
    size_t offset;
    bool later; // builds before it did not write it: 0 then
};

static struct member member_of(const struct rn_setting *row) {
    static const enum kind kinds[] = {
        [RN_SETTING_BOOL] = KIND_BOOL,     [RN_SETTING_INT] = KIND_INT,
        [RN_SETTING_INT64] = KIND_INT64,   [RN_SETTING_UINT64] = KIND_UINT64,
        [RN_SETTING_NUMBER] = KIND_DOUBLE, [RN_SETTING_CHOICE] = KIND_INT,
        [RN_SETTING_COLOUR] = KIND_COLOUR, [RN_SETTING_TEXT] = KIND_TEXT16};
    return (struct member){row->name, kinds[row->type], row->offset,
                           (row->flags & RN_SETTING_LATER) != 0};
}

#define PROGRESS(name, kind)                                                                       \
    { #name, kind, offsetof(struct rn_progress, name), false }
#define PROGRESS_LATER(name, kind)                                                                 \
    { #name, kind, offsetof(struct rn_progress, name), true }
static const struct member progress_members[] = {
    PROGRESS(step, KIND_INT64),
    PROGRESS(train_seconds, KIND_DOUBLE),
    PROGRESS(evaluate_seconds, KIND_DOUBLE),
    PROGRESS(loss, KIND_DOUBLE),
    PROGRESS(samples, KIND_UINT64),
    PROGRESS(rays, KIND_UINT64),
    PROGRESS(psnr, KIND_DOUBLE),
    PROGRESS(psnr_step, KIND_INT64),
    PROGRESS(nonfinite_rays, KIND_UINT64),
    PROGRESS(steps_rejected, KIND_UINT64),
    PROGRESS(rollbacks, KIND_UINT64),
    PROGRESS_LATER(gained_psnr, KIND_DOUBLE),
    PROGRESS_LATER(gained_seconds, KIND_DOUBLE),
    PROGRESS_LATER(plateau, KIND_BOOL),
    PROGRESS_LATER(given_back, KIND_INT64),
};
#define COUNT(a) (sizeof(a) / sizeof *(a))

static json_t *number(double v) {
    return isfinite(v) ? json_real(v) : json_null();
}

static json_t *encode_member(const struct member *m, const char *base) {
    const void *at = base + m->offset;
    switch (m->kind) {
    case KIND_INT:
        return json_integer(*(const int *)at);
    case KIND_INT64:
        return json_integer(*(const int64_t *)at);
    case KIND_UINT64:
        return json_integer((json_int_t) * (const uint64_t *)at);
    case KIND_DOUBLE:
        return number(*(const double *)at);
    case KIND_BOOL:
        return json_boolean(*(const bool *)at);
    case KIND_TEXT16:
        return json_string(at);
    case KIND_COLOUR: {
        const float *c = at;
        return json_pack("[f,f,f]", (double)c[0], (double)c[1], (double)c[2]);
    }
    }
    return NULL;
}

static bool decode_member(const struct member *m, const json_t *value, char *base) {
    void *at = base + m->offset;
    switch (m->kind) {
    case KIND_INT:
        *(int *)at = (int)json_integer_value(value);
        return json_is_integer(value);
    case KIND_INT64:
        *(int64_t *)at = json_integer_value(value);
        return json_is_integer(value);
    case KIND_UINT64:
        *(uint64_t *)at = (uint64_t)json_integer_value(value);
        return json_is_integer(value);
    case KIND_DOUBLE:
        *(double *)at = json_is_null(value) ? NAN : json_number_value(value);
        return json_is_number(value) || json_is_null(value);
    case KIND_BOOL:
        *(bool *)at = json_is_true(value);
        return json_is_boolean(value);
    case KIND_TEXT16:
        if (json_is_string(value)) snprintf(at, 16, "%s", json_string_value(value));
        return json_is_string(value);
    case KIND_COLOUR:
        for (size_t c = 0; c < 3; c++)
            ((float *)at)[c] = (float)json_number_value(json_array_get(value, c));
        return json_array_size(value) == 3;
    }
    return false;
}

static json_t *encode_all(const struct member *members, size_t count, const void *base) {
    json_t *object = json_object();
    for (size_t i = 0; i < count; i++)
        if (json_object_set_new(object, members[i].name, encode_member(&members[i], base)) != 0) {
            json_decref(object);
            return NULL;
        }
    return object;
}

static enum rn_status decode_all(const struct member *members, size_t count, const json_t *object,
                                 void *base, const char *path, struct rn_error *err) {
    for (size_t i = 0; i < count; i++) {
        const json_t *value = json_object_get(object, members[i].name);
        if (!value && members[i].later) continue;
        if (!decode_member(&members[i], value, base))
            return rn_error_set(err, RN_ERROR_CORRUPT, path,
                                "its state lacks a valid '%s'; use an older checkpoint",
                                members[i].name);
    }
    return RN_OK;
}

static json_t *encode_config(const struct rn_train_config *config) {
    struct member members[RN_TRAIN_SETTINGS];
    for (size_t i = 0; i < RN_TRAIN_SETTINGS; i++)
        members[i] = member_of(&rn_train_settings.rows[i]);
    return encode_all(members, RN_TRAIN_SETTINGS, config);
}

static enum rn_status decode_config(const json_t *object, struct rn_train_config *config,
                                    const char *path, struct rn_error *err) {
    struct member members[RN_TRAIN_SETTINGS];
    for (size_t i = 0; i < RN_TRAIN_SETTINGS; i++)
        members[i] = member_of(&rn_train_settings.rows[i]);
    return decode_all(members, RN_TRAIN_SETTINGS, object, config, path, err);
}

static json_t *encode_effects(const struct rn_effect_record *effects) {
    json_t *list = json_array();
    for (int i = 0; i < RN_EFFECT_COUNT; i++) {
        const struct rn_effect_record *e = &effects[i];
        json_array_append_new(list,
                              json_pack("{s:s,s:b,s:b,s:o,s:o,s:s}", "name", e->name, "on", e->on,
                                        "decided", e->decided, "number", number(e->number),
                                        "threshold", number(e->threshold), "reason", e->reason));
    }
    return list;
}

static double number_of(const json_t *object, const char *name) {
    const json_t *value = json_object_get(object, name);
    return json_is_number(value) ? json_number_value(value) : NAN;
}

// The record of that name. Builds before it wrote the first four, in their order, without names.
static const json_t *find_effect(const json_t *list, size_t effect) {
    const json_t *entry = json_array_get(list, effect);
    size_t i;
    json_t *each;
    json_array_foreach(list, i, each) {
        const char *name = json_string_value(json_object_get(each, "name"));
        if (name && strcmp(name, rn_effect_name((enum rn_effect)effect)) == 0) return each;
    }
    return json_object_get(entry, "name") ? NULL : entry;
}

static void decode_effects(const json_t *list, struct rn_effect_record *effects) {
    for (size_t i = 0; i < RN_EFFECT_COUNT; i++) {
        const json_t *e = find_effect(list, i);
        const char *reason = e ? json_string_value(json_object_get(e, "reason"))
                               : "not recorded by the build that trained it";
        effects[i] = (struct rn_effect_record){
            .name = rn_effect_name((enum rn_effect)i),
            .on = json_is_true(json_object_get(e, "on")),
            .decided = !e || json_is_true(json_object_get(e, "decided")),
            .number = number_of(e, "number"),
            .threshold = number_of(e, "threshold"),
        };
        snprintf(effects[i].reason, sizeof effects[i].reason, "%s", reason ? reason : "");
    }
}

// It stood among the configuration once.
static double decode_finest_cone(const json_t *state) {
    const json_t *value = json_object_get(state, "finest_cone");
    if (!value) value = json_object_get(json_object_get(state, "config"), "finest_cone");
    return json_is_number(value) ? json_number_value(value) : NAN;
}

static json_t *encode_numbers(const double *from, int count) {
    json_t *list = json_array();
    for (int i = 0; i < count; i++)
        json_array_append_new(list, json_real(from[i]));
    return list;
}

static bool decode_numbers(const json_t *list, double *to, int count) {
    for (int i = 0; i < count; i++) {
        const json_t *value = json_array_get(list, (size_t)i);
        to[i] = json_number_value(value);
        if (!json_is_number(value)) return false;
    }
    return (int)json_array_size(list) == count;
}

// The disparity box, where planes cover one.
static void encode_disparity(const struct rn_disparity *s, json_t *state) {
    if (!s->on) return;
    json_t *box =
        json_pack("{s:f,s:o,s:o,s:o,s:o,s:o,s:f,s:f}", "unit", s->unit, "origin",
                  encode_numbers(s->origin, 3), "axes", encode_numbers(s->axes[0], 9), "scale",
                  encode_numbers(s->scale, 3), "shift", encode_numbers(s->shift, 3), "half",
                  encode_numbers(s->half, 3), "near", s->near, "far", s->far);
    json_object_set_new(state, "disparity", box);
}

static enum rn_status decode_disparity(const json_t *state, const char *path,
                                       struct rn_disparity *ret, struct rn_error *err) {
    const json_t *from = json_object_get(state, "disparity");
    if (!from) return RN_OK;
    struct rn_disparity s = {.on = true};
    bool whole = decode_numbers(json_object_get(from, "origin"), s.origin, 3) &&
                 decode_numbers(json_object_get(from, "axes"), s.axes[0], 9) &&
                 decode_numbers(json_object_get(from, "scale"), s.scale, 3) &&
                 decode_numbers(json_object_get(from, "shift"), s.shift, 3) &&
                 decode_numbers(json_object_get(from, "half"), s.half, 3);
    s.unit = json_number_value(json_object_get(from, "unit"));
    s.near = json_number_value(json_object_get(from, "near"));
    s.far = json_number_value(json_object_get(from, "far"));
    if (!whole || !(s.unit > 0 && s.near > 0 && s.far > s.near && s.scale[0] > 0 && s.scale[2] < 0))
        return rn_error_set(
            err, RN_ERROR_CORRUPT, path,
            "its 'disparity' is no box this program knows; use an older checkpoint");
    *ret = s;
    return RN_OK;
}

// Where to begin to look, where a file for viewing tells it.
static void encode_start(const struct rn_viewing *v, json_t *viewing) {
    const struct rn_camera *c = &v->start;
    const double intrinsics[4] = {c->fx, c->fy, c->cx, c->cy};
    if (!v->has_start) return;
    json_object_set_new(viewing, "start",
                        json_pack("{s:o,s:i,s:i,s:o,s:o}", "world_from_camera",
                                  encode_numbers(c->world_from_camera[0], 12), "width", c->width,
                                  "height", c->height, "intrinsics", encode_numbers(intrinsics, 4),
                                  "up", encode_numbers(v->up, 3)));
}

static enum rn_status decode_start(const json_t *viewing, const char *path, struct rn_viewing *v,
                                   struct rn_error *err) {
    const json_t *from = json_object_get(viewing, "start");
    struct rn_camera c = {.width = (int)json_integer_value(json_object_get(from, "width")),
                          .height = (int)json_integer_value(json_object_get(from, "height"))};
    double k[4];
    if (!from) return RN_OK;
    v->has_start =
        decode_numbers(json_object_get(from, "world_from_camera"), c.world_from_camera[0], 12) &&
        decode_numbers(json_object_get(from, "intrinsics"), k, 4) &&
        decode_numbers(json_object_get(from, "up"), v->up, 3) &&
        fabs(rn_dot(v->up, v->up) - 1) < 1e-3;
    if (v->has_start) {
        c.fx = k[0], c.fy = k[1], c.cx = k[2], c.cy = k[3];
        v->has_start = rn_camera_check(&c, path, NULL) == RN_OK;
    }
    v->start = c;
    return v->has_start ? RN_OK
                        : rn_error_set(err, RN_ERROR_CORRUPT, path,
                                       "its 'start' is no camera with a direction that is up; "
                                       "export it again");
}

#define START_SIDE 800  // pixels, the longer one
#define START_SHARE 0.7 // its edges are what only the outer cameras saw

// Where a file for viewing tells none and its planes cover a disparity box: the box's reference
// camera, the mean of those that it was trained from, which sees START_SHARE of the box across.
static void start_in_box(const struct rn_disparity *s, struct rn_viewing *v) {
    const double widest = fmax(s->half[0], s->half[1]);
    struct rn_camera c = {.width = (int)ceil(START_SIDE * s->half[0] / widest),
                          .height = (int)ceil(START_SIDE * s->half[1] / widest)};
    c.fx = c.fy = START_SIDE / (START_SHARE * 2 * widest / s->scale[0]); // of x / z
    c.cx = c.width / 2.0, c.cy = c.height / 2.0;
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++)
            c.world_from_camera[i][j] = s->axes[i][j];
        c.world_from_camera[i][3] = s->origin[i];
        v->up[i] = -s->axes[i][1];
    }
    v->has_start = rn_camera_check(&c, "", NULL) == RN_OK;
    v->start = c;
}

// Of a file for viewing. One that an older build cannot read has another `format`.
static void encode_viewing(const struct rn_viewing *v, json_t *state) {
    json_t *viewing = json_pack("{s:i,s:i,s:o,s:o,s:i,s:s,s:s,s:s,s:s}", "format",
                                RN_VIEWING_FORMAT, "bits", v->bits, "psnr", number(v->psnr),
                                "trained", number(v->trained), "views", v->views, "split", v->split,
                                "dataset", v->dataset, "sha256", v->sha256, "version", v->version);
    if (viewing) encode_start(v, viewing);
    json_object_set_new(state, "viewing", viewing);
}

static void decode_text(const json_t *object, const char *name, char *to, size_t size) {
    const char *text = json_string_value(json_object_get(object, name));
    snprintf(to, size, "%s", text ? text : "");
}

static enum rn_status decode_viewing(const json_t *state, const char *path, struct rn_viewing *ret,
                                     struct rn_error *err) {
    const json_t *from = json_object_get(state, "viewing");
    if (!from) return RN_OK;
    json_int_t format = json_integer_value(json_object_get(from, "format"));
    char version[32];
    decode_text(from, "version", version, sizeof version);
    if (format > RN_VIEWING_FORMAT)
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, path,
                            "was written by a newer ripnerf (%s, format %lld; this one reads %d); "
                            "update this one, or export it there again with an older one",
                            *version ? version : "no version said", (long long)format,
                            RN_VIEWING_FORMAT);
    *ret = (struct rn_viewing){
        .bits = (int)json_integer_value(json_object_get(from, "bits")),
        .psnr = number_of(from, "psnr"),
        .trained = number_of(from, "trained"),
        .views = (int)json_integer_value(json_object_get(from, "views")),
    };
    decode_text(from, "split", ret->split, sizeof ret->split);
    decode_text(from, "dataset", ret->dataset, sizeof ret->dataset);
    decode_text(from, "sha256", ret->sha256, sizeof ret->sha256);
    memcpy(ret->version, version, sizeof version);
    if (format == RN_VIEWING_FORMAT && rn_viewing_has_bits(ret->bits))
        return decode_start(from, path, ret, err);
    return rn_error_set(err, RN_ERROR_CORRUPT, path,
                        "its 'viewing' names no form of planes that this program knows");
}

json_t *rn_checkpoint_state(const struct rn_field *field, const struct rn_counters *counters,
                            const struct rn_viewing *viewing) {
    const struct rn_bounds *b = &field->bounds;
    json_t *levels = json_array();
    for (int l = 0; l < RN_PROGRESS_LEVELS; l++)
        json_array_append_new(levels,
                              json_integer((json_int_t)counters->progress.level_samples[l]));
    json_t *state = json_pack(
        "{s:i,s:o,s:o,s:o,s:o,s:I,s:i,s:f,s:i,s:f,s:s,s:f,s:{s:[f,f,f],s:f,s:i}}", "version", 1,
        "config", encode_config(&field->config), "progress",
        encode_all(progress_members, COUNT(progress_members), &counters->progress), "levels",
        levels, "effects", encode_effects(field->effects), "updates", (json_int_t)counters->updates,
        "next_rays", counters->next_rays, "gradient_scale", (double)counters->gradient_scale,
        "good_steps", counters->good_steps, "gradient_size", (double)counters->gradient_size,
        "kernels", field->kernels, "finest_cone", field->finest_cone, "bounds", "centre",
        b->centre[0], b->centre[1], b->centre[2], "radius", b->radius, "source", (int)b->source);
    if (state) encode_disparity(&field->cpu.disparity, state);
    if (state && counters->pose_turns > 0)
        json_object_set_new(state, "pose_turns", json_integer(counters->pose_turns));
    if (state && counters->outlier_turns > 0)
        json_object_set_new(state, "outlier_turns", json_integer(counters->outlier_turns));
    if (state && viewing) encode_viewing(viewing, state);
    return state;
}

enum rn_status rn_checkpoint_parse_state(const json_t *state, const char *path,
                                         struct rn_checkpoint *c, struct rn_error *err) {
    const json_t *bounds = json_object_get(state, "bounds");
    const char *kernels = json_string_value(json_object_get(state, "kernels"));
    if (json_integer_value(json_object_get(state, "version")) != 1 || !bounds || !kernels)
        return rn_error_set(err, RN_ERROR_CORRUPT, path,
                            "holds no state of a version this program reads (1)");
    enum rn_status status = decode_config(json_object_get(state, "config"), &c->config, path, err);
    if (status == RN_OK)
        status = decode_all(progress_members, COUNT(progress_members),
                            json_object_get(state, "progress"), &c->counters.progress, path, err);
    if (status == RN_OK) status = decode_disparity(state, path, &c->disparity, err);
    if (status == RN_OK) status = decode_viewing(state, path, &c->viewing, err);
    if (c->viewing.bits && !c->viewing.has_start && c->disparity.on)
        start_in_box(&c->disparity, &c->viewing);
    if (status == RN_OK) status = rn_train_config_check(&c->config, err);
    if (status != RN_OK) return status;
    for (size_t l = 0; l < RN_PROGRESS_LEVELS; l++)
        c->counters.progress.level_samples[l] =
            (uint64_t)json_integer_value(json_array_get(json_object_get(state, "levels"), l));
    for (size_t i = 0; i < 3; i++)
        c->bounds.centre[i] =
            json_number_value(json_array_get(json_object_get(bounds, "centre"), i));
    c->bounds.radius = json_number_value(json_object_get(bounds, "radius"));
    c->bounds.source = (enum rn_bounds_source)json_integer_value(json_object_get(bounds, "source"));
    if (!(c->bounds.radius > 0))
        return rn_error_set(err, RN_ERROR_CORRUPT, path, "its scene radius is not positive");
    c->finest_cone = decode_finest_cone(state);
    if (!(c->finest_cone >= 0 && isfinite(c->finest_cone)))
        return rn_error_set(err, RN_ERROR_CORRUPT, path, "its finest cone is out of range");
    decode_effects(json_object_get(state, "effects"), c->effects);
    snprintf(c->kernels, sizeof c->kernels, "%s", kernels);
    c->counters.updates = json_integer_value(json_object_get(state, "updates"));
    c->counters.next_rays = (int)json_integer_value(json_object_get(state, "next_rays"));
    c->counters.gradient_scale = (float)json_number_value(json_object_get(state, "gradient_scale"));
    c->counters.pose_turns = (int)json_integer_value(json_object_get(state, "pose_turns"));
    c->counters.outlier_turns = (int)json_integer_value(json_object_get(state, "outlier_turns"));
    c->counters.good_steps = (int)json_integer_value(json_object_get(state, "good_steps"));
    c->counters.gradient_size = (float)json_number_value(json_object_get(state, "gradient_size"));
    if (!(c->counters.gradient_scale >= 0 && c->counters.gradient_scale <= 65536) ||
        c->counters.good_steps < 0)
        return rn_error_set(err, RN_ERROR_CORRUPT, path, "its gradient scale is out of range");
    if (!(c->counters.gradient_size >= 0 && c->counters.gradient_size < INFINITY))
        return rn_error_set(err, RN_ERROR_CORRUPT, path, "its gradient size is out of range");
    if (c->counters.next_rays < 1 || c->counters.next_rays > RN_MAX_RAYS || c->counters.updates < 0)
        return rn_error_set(err, RN_ERROR_CORRUPT, path, "its step counters are out of range");
    return RN_OK;
}

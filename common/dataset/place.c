// Where the scene is: how it was photographed, its centre and size, and which way is up, from
// cameras, their axes, and the points that they are known to see.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/dataset/reader.h"
#include "common/math/numbers.h"
#include "common/math/symmetric.h"
#include "common/math/vector.h"

#define FORWARD 0.9     // length of the mean view direction of photographs of a wall
#define CONVERGENT 0.25 // of the distance, by which axes miss the point that they are nearest to
#define STEEP_DEG 25    // below the horizon, of a camera in the air
#define BEYOND 0.1      // share of what is seen that lies farther than the cameras stand
#define FEWEST 32       // witnesses that say where a scene is
#define WITNESSES 20000 // that are looked at
#define MOST 0.9        // of them lie in the sphere
#define ALL 0.98        // likewise of an object that is cut out
#define MARGIN 1.1      // of the sphere
#define LEVEL_ROUNDS 5
#define LEVEL 0.05    // sine by which axes that are held level are off
#define MOSTLY 0.3    // of the tops' lengths, that points one way
#define AGREED_DEG 10 // by which up by GPS may differ from the cameras', which is the sharper
#define SIDEWAYS 0.5  // of the mean squares by which they are, from which on cameras lay on a side

const char *const rn_capture_names[] = {"object",  "forward-facing", "room",
                                        "outdoor", "drone",          NULL};
const char *const rn_capture_titles[] = {
    "an object, turned around", "forward-facing, as of a wall",
    "a room, from within",      "something turned around in its surroundings",
    "seen from the air",        NULL};

static void column(const struct rn_camera *camera, int of, double ret[3]) {
    for (int i = 0; i < 3; i++)
        ret[i] = camera->world_from_camera[i][of];
}

// ---- up ----

// The axis of a picture that lies level: its width, or where the camera was held on its side, its
// height.
static void level_axis(const struct rn_camera *camera, const double up[3], double ret[3]) {
    double width[3], height[3];
    column(camera, 0, width);
    column(camera, 1, height);
    bool sideways = fabs(rn_dot(width, up)) > fabs(rn_dot(height, up));
    memcpy(ret, sideways ? height : width, sizeof width);
}

// The direction to which the cameras' level axes are all square; of such directions, where the axes
// all lie along one, the nearest to `up`.
static void straighten(const struct rn_dataset *dataset, double up[3]) {
    double a[3][3] = {{0}}, axes[3][3], found[3], across[3];
    for (size_t f = 0; f < dataset->frame_count; f++) {
        double level[3];
        level_axis(&dataset->frames[f].camera, up, level);
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++)
                a[i][j] += level[i] * level[j] / (double)dataset->frame_count;
    }
    rn_symmetric_axes3(a, axes);
    int least = 0, most = 0;
    for (int i = 1; i < 3; i++) {
        if (a[i][i] < a[least][least]) least = i;
        if (a[i][i] > a[most][most]) most = i;
    }
    if (most == least) most = 2; // all three are alike
    for (int i = 0; i < 3; i++) {
        found[i] = axes[i][least];
        across[i] = axes[i][most];
    }
    double along = rn_dot(found, up), off = rn_dot(across, up);
    if (a[3 - least - most][3 - least - most] > 0.05 && fabs(along) > 0.5) {
        for (int i = 0; i < 3; i++)
            up[i] = copysign(1, along) * found[i];
        return;
    }
    for (int i = 0; i < 3; i++)
        up[i] -= off * across[i];
    rn_make_unit(up);
}

// Where the scene's top is in a picture: where its EXIF says, in pixels that are as they were
// stored, else where the picture's is.
static void top_of(const struct rn_frame *frame, double ret[3]) {
    int held = frame->turn > 1 ? 1 : frame->held;
    bool low = held == 3 || held == 4 || held == 7 || held == 8;
    column(&frame->camera, held >= 5 ? 0 : 1, ret);
    for (int i = 0; i < 3; i++)
        ret[i] = low ? ret[i] : -ret[i];
}

// Straightened; returns the mean of sin^2 by which level axes are off it.
static double straighten_from(const struct rn_dataset *dataset, double up[3]) {
    double off = 0;
    if (!rn_make_unit(up)) memcpy(up, (double[]){0, 0, 1}, 3 * sizeof *up);
    for (int round = 0; round < LEVEL_ROUNDS; round++)
        straighten(dataset, up);
    for (size_t f = 0; f < dataset->frame_count; f++) {
        double level[3];
        level_axis(&dataset->frames[f].camera, up, level);
        off += pow(rn_dot(level, up), 2) / (double)dataset->frame_count;
    }
    return off;
}

// From the pictures' tops; or where their heights are by far more level than their widths, since
// all were taken with the camera on its side, from these. Its sign is that of most tops, else that
// by which cameras look down.
static void find_up(const struct rn_dataset *dataset, double up[3]) {
    double sideways[3] = {0}, axis[3] = {0}, above = 0, below = 0;
    memset(up, 0, 3 * sizeof *up);
    for (size_t f = 0; f < dataset->frame_count; f++) {
        double top[3];
        top_of(&dataset->frames[f], top);
        for (int i = 0; i < 3; i++) {
            up[i] += top[i];
            sideways[i] += dataset->frames[f].camera.world_from_camera[i][0];
        }
    }
    double off = straighten_from(dataset, up);
    if (straighten_from(dataset, sideways) < SIDEWAYS * off && off > LEVEL * LEVEL)
        memcpy(up, sideways, sizeof sideways);
    for (size_t f = 0; f < dataset->frame_count; f++) {
        top_of(&dataset->frames[f], axis);
        above += rn_dot(axis, up) / (double)dataset->frame_count;
        column(&dataset->frames[f].camera, 2, axis);
        below -= rn_dot(axis, up);
    }
    double sign = fabs(above) > MOSTLY ? above : below;
    for (int i = 0; i < 3; i++)
        up[i] *= copysign(1, sign);
}

// ---- what the cameras are known to see ----

struct witnesses {
    double (*items)[3];
    double *work; // as many numbers
    size_t count, capacity;
};

static bool is_within(const struct rn_box *box, const double p[3]) {
    for (int i = 0; i < 3 && box; i++)
        if (p[i] < box->low[i] || p[i] > box->high[i]) return false;
    return true;
}

static void add_witness(struct witnesses *w, const struct rn_box *crop, const double p[3]) {
    if (w->count < w->capacity && is_within(crop, p))
        memcpy(w->items[w->count++], p, sizeof w->items[0]);
}

// What stands at the depths that the source gives, along five rays of a photograph.
static void add_depths(struct witnesses *w, const struct rn_box *crop,
                       const struct rn_frame *frame) {
    const struct rn_camera *camera = &frame->camera;
    static const double at[5][2] = {{0.5, 0.5}, {0, 0}, {1, 0}, {0, 1}, {1, 1}};
    double depths[3] = {frame->near, 2 * frame->near * frame->far / (frame->near + frame->far),
                        frame->far};
    for (int k = 0; k < 15; k++) {
        struct rn_ray ray =
            rn_camera_ray(camera, at[k / 3][0] * camera->width, at[k / 3][1] * camera->height);
        double axis[3], p[3];
        column(camera, 2, axis);
        double along = rn_dot(axis, ray.direction);
        if (!(along > 0.1)) continue;
        for (int i = 0; i < 3; i++)
            p[i] = ray.origin[i] + ray.direction[i] * depths[k % 3] / along;
        add_witness(w, crop, p);
    }
}

// False when memory is out.
static bool gather(const struct rn_dataset *dataset, struct witnesses *w) {
    const struct rn_box *crop = dataset->lie.cropped ? &dataset->lie.crop : NULL;
    size_t count = dataset->points.count, stride = 1 + count / WITNESSES;
    w->capacity = count ? count / stride + 1 : 15 * dataset->frame_count + 1;
    w->items = malloc(w->capacity * sizeof *w->items);
    w->work = malloc((w->capacity + dataset->frame_count) * sizeof *w->work);
    if (!w->items || !w->work) return false;
    for (size_t i = 0; i < count; i += stride)
        add_witness(w, crop, dataset->points.items[i].position);
    for (size_t f = 0; f < dataset->frame_count && !count; f++)
        if (dataset->frames[f].far > 0) add_depths(w, crop, &dataset->frames[f]);
    return true;
}

// The sphere about the middle of the witnesses within `reach` of a point that holds `share` of
// them.
static bool enclose(struct witnesses *w, const double near[3], double reach, double share,
                    struct rn_bounds *bounds) {
    double middle[3];
    size_t count = 0;
    for (int axis = 0; axis < 3; axis++) {
        count = 0;
        for (size_t i = 0; i < w->count; i++)
            if (rn_apart(w->items[i], near) <= reach) w->work[count++] = w->items[i][axis];
        middle[axis] = rn_numbers_quantile(w->work, count, 0.5);
    }
    if (count < FEWEST) return false;
    count = 0;
    for (size_t i = 0; i < w->count; i++)
        if (rn_apart(w->items[i], near) <= reach) w->work[count++] = rn_apart(w->items[i], middle);
    double radius = MARGIN * rn_numbers_quantile(w->work, count, share);
    if (!(radius > 0)) return false;
    memcpy(bounds->centre, middle, sizeof middle);
    bounds->radius = radius;
    return true;
}

// ---- how it was photographed ----

// How far the axis passes the point, in parts of the distance; infinite when it is behind.
static double axis_miss(const struct rn_camera *camera, const double point[3]) {
    double axis[3], offset[3];
    column(camera, 2, axis);
    for (int i = 0; i < 3; i++)
        offset[i] = point[i] - camera->world_from_camera[i][3];
    double along = rn_dot(offset, axis);
    return along > 0 ? sqrt(fmax(0, 1 - along * along / rn_dot(offset, offset))) : INFINITY;
}

// Numbers of all cameras: the median of what `of` says of each.
static double median_of(const struct rn_dataset *dataset, const double with[3], double *work,
                        double (*of)(const struct rn_camera *camera, const double with[3])) {
    for (size_t f = 0; f < dataset->frame_count; f++)
        work[f] = of(&dataset->frames[f].camera, with);
    return rn_numbers_quantile(work, dataset->frame_count, 0.5);
}

static double degrees_below(const struct rn_camera *camera, const double up[3]) {
    double axis[3];
    column(camera, 2, axis);
    return -asin(fmax(-1, fmin(1, rn_dot(axis, up)))) * 180 / M_PI;
}

static double degrees_tilted(const struct rn_camera *camera, const double up[3]) {
    double level[3];
    level_axis(camera, up, level);
    return asin(fmin(1, fabs(rn_dot(level, up)))) * 180 / M_PI;
}

bool rn_dataset_is_cut_out(const struct rn_dataset *dataset) {
    for (size_t f = 0; f < dataset->frame_count; f++)
        if (!dataset->frames[f].has_alpha) return false;
    return true;
}

static enum rn_capture_kind judge(const struct rn_scene_place *place) {
    if (place->cut_out) return RN_CAPTURE_OBJECT;
    bool steep = place->below_deg >= STEEP_DEG;
    if (place->alignment >= FORWARD)
        return steep && place->located.count ? RN_CAPTURE_DRONE : RN_CAPTURE_FORWARD;
    if (place->miss > CONVERGENT) return steep ? RN_CAPTURE_DRONE : RN_CAPTURE_ROOM;
    return place->beyond <= BEYOND ? RN_CAPTURE_OBJECT : RN_CAPTURE_OUTDOOR;
}

static void measure(const struct rn_dataset *dataset, struct witnesses *w,
                    struct rn_scene_place *place) {
    double mean[3] = {0};
    for (size_t f = 0; f < dataset->frame_count; f++)
        for (int i = 0; i < 3; i++)
            mean[i] +=
                dataset->frames[f].camera.world_from_camera[i][2] / (double)dataset->frame_count;
    place->alignment = sqrt(rn_dot(mean, mean));
    place->cut_out = rn_dataset_is_cut_out(dataset);
    place->by_points = dataset->points.count > 0;
    place->miss = median_of(dataset, place->turned_around, w->work, axis_miss);
    place->distance = median_of(dataset, place->turned_around, w->work, rn_camera_distance);
    place->below_deg = median_of(dataset, place->lie.up, w->work, degrees_below);
    place->tilt_deg = median_of(dataset, place->lie.up, w->work, degrees_tilted);
    size_t beyond = 0;
    for (size_t i = 0; i < w->count; i++)
        beyond += rn_apart(w->items[i], place->turned_around) > place->distance;
    place->witnesses = w->count;
    place->beyond = w->count >= FEWEST ? (double)beyond / (double)w->count : NAN;
    place->lie.kind = judge(place);
}

// What is turned around lies nearer than the cameras do; else all that is seen is the scene.
static struct rn_bounds find_bounds(const struct rn_dataset *dataset, struct witnesses *w,
                                    const struct rn_scene_place *place) {
    bool turned = place->lie.kind == RN_CAPTURE_OBJECT || place->lie.kind == RN_CAPTURE_OUTDOOR;
    struct rn_bounds bounds = {.source = place->by_points ? RN_BOUNDS_POINTS : RN_BOUNDS_DEPTHS};
    if (enclose(w, place->turned_around, turned ? place->distance : INFINITY,
                place->cut_out ? ALL : MOST, &bounds))
        return bounds;
    return rn_bounds_from_cameras(dataset,
                                  place->cut_out ? RN_OBJECT_DISTANCES : RN_CAPTURE_DISTANCES);
}

enum rn_status rn_dataset_find_place(const struct rn_dataset *dataset,
                                     struct rn_scene_place *ret_place, struct rn_error *err) {
    struct rn_scene_place place = {.lie = dataset->lie};
    struct witnesses w = {0};
    struct rn_bounds nearest = rn_bounds_from_cameras(dataset, 1);
    memcpy(place.turned_around, nearest.centre, sizeof nearest.centre);
    if (!place.lie.up_given) find_up(dataset, place.lie.up);
    enum rn_status status = rn_dataset_locate(dataset, &place.located, err);
    if (status) return status;
    place.up_located = place.located.count && !place.lie.up_given &&
                       rn_dot(place.located.up, place.lie.up) < cos(AGREED_DEG * M_PI / 180);
    if (place.up_located) memcpy(place.lie.up, place.located.up, sizeof place.lie.up);
    if (gather(dataset, &w)) {
        measure(dataset, &w, &place);
        place.bounds = find_bounds(dataset, &w, &place);
    } else {
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, dataset->name, "out of memory");
    }
    free(w.items);
    free(w.work);
    if (status == RN_OK) *ret_place = place;
    return status;
}

// ---- what is told ----

static const char *side(bool over) {
    return over ? "over" : "under";
}

static void tell_of_what_is_seen(const struct rn_scene_place *place, char *text, size_t capacity) {
    if (place->cut_out)
        snprintf(text, capacity, "an alpha channel cuts it out");
    else if (isnan(place->beyond))
        snprintf(text, capacity, "no points say how far what they see reaches");
    else
        snprintf(text, capacity,
                 "%.0f %% of %zu %s lie farther than the cameras (%s the threshold of %.0f %%)",
                 100 * place->beyond, place->witnesses,
                 place->by_points ? "points" : "places at the poses' depths",
                 side(place->beyond > BEYOND), 100 * BEYOND);
}

static void tell_slope(double below_deg, char *text, size_t capacity) {
    double whole = round(fabs(below_deg));
    if (whole > 0)
        snprintf(text, capacity, "%.0f degree%s %s", whole, whole > 1 ? "s" : "",
                 below_deg > 0 ? "down" : "up");
    else
        snprintf(text, capacity, "straight ahead");
}

void rn_reader_tell_place(struct rn_reader *reader, const struct rn_scene_place *place) {
    char seen[128], slope[32];
    double up[3];
    for (int i = 0; i < 3; i++)
        up[i] = rn_unless_zero(place->lie.up[i], 1);
    tell_of_what_is_seen(place, seen, sizeof seen);
    tell_slope(place->below_deg, slope, sizeof slope);
    rn_problems_add(
        reader->problems, RN_SEVERITY_INFO, reader->folder,
        "%s: view directions have a mean of length %.2f (%s the threshold of %.1f), half "
        "of the axes pass one point within %.0f %% of its distance (%s the threshold of "
        "%.0f %%), they look %s (%s the threshold of %d degrees), %s; up is "
        "%.3g,%.3g,%.3g, %s, half of the cameras askew by %.1f degrees at most",
        rn_capture_titles[place->lie.kind], place->alignment, side(place->alignment >= FORWARD),
        FORWARD, 100 * fmin(place->miss, 9.99), side(place->miss > CONVERGENT), 100 * CONVERGENT,
        slope, side(place->below_deg >= STEEP_DEG), STEEP_DEG, seen, up[0], up[1], up[2],
        place->lie.up_given ? "as given"
        : place->up_located ? "by GPS"
                            : "by the cameras",
        place->tilt_deg);
    if (place->located.count)
        rn_problems_add(reader->problems, RN_SEVERITY_INFO, reader->folder,
                        "by the GPS of %zu of %zu photographs, which is off by %.2g m, a unit is "
                        "%.3g m",
                        place->located.count, place->located.of, place->located.off_m,
                        place->located.metres);
}

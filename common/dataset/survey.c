#include "common/dataset/survey.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/dataset/calls.h"
#include "common/dataset/exposure.h"
#include "common/dataset/grey.h"
#include "common/dataset/reader.h"
#include "common/math/around.h"
#include "common/math/nearest.h"
#include "common/math/numbers.h"
#include "common/math/vector.h"

#define SIDE 960     // pixels, about: the longest side at which sharpness is looked at
#define THUMB 16     // a side of the picture by which photographs are compared
#define NEIGHBOURS 4 // before, and after, with which a photograph's sharpness is compared
#define BLURRED 0.35 // of their median: a photograph that moved or is out of focus
#define SAME 2.0     // mean difference of thumbnails, of 255, of photographs of the same thing
#define NEAR 0.002   // of the cameras' median distance: the same place
#define NEAR_DEG 0.3 // the same direction
#define REACH 64     // photographs of like brightness, or before and after, that are compared
#define OFF_PX 2.0   // mean reprojection error of a photograph that is worth a word
#define GAP_DEG 60   // without a photograph of what is turned around
#define NAMES 8      // told

#define FORWARD "puts planes over the disparity between near and far (effect forward-facing)"
#define ROUND "contracts space to infinity (effect unbounded)"

struct look {
    enum rn_split split; // of the frame, by which, with the next two, it is known again
    int index, scale;
    float sharpness, brightness;
    uint8_t thumb[THUMB * THUMB];
    bool seen, hidden;
};

struct rn_survey {
    const struct rn_frame *first; // of the dataset's frames
    struct look *looks;
    size_t count;
    struct rn_exposures *exposures;
};

void rn_survey_destroy(struct rn_survey **survey) {
    if (!*survey) return;
    rn_exposures_destroy(&(*survey)->exposures);
    free((*survey)->looks);
    free(*survey);
    *survey = NULL;
}

enum rn_status rn_survey_create(const struct rn_dataset *dataset, struct rn_survey **ret_survey,
                                struct rn_error *err) {
    struct rn_survey *survey = calloc(1, sizeof *survey);
    if (survey) survey->looks = calloc(dataset->frame_count + 1, sizeof *survey->looks);
    if (!survey || !survey->looks) {
        rn_survey_destroy(&survey);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, dataset->name, "out of memory");
    }
    survey->count = dataset->frame_count;
    survey->first = dataset->frames;
    for (size_t i = 0; i < survey->count; i++) {
        const struct rn_frame *frame = &dataset->frames[i];
        survey->looks[i] =
            (struct look){.split = frame->split, .index = frame->index, .scale = frame->scale};
    }
    enum rn_status status = rn_exposures_create(dataset, &survey->exposures, err);
    if (status) rn_survey_destroy(&survey);
    if (status == RN_OK) *ret_survey = survey;
    return status;
}

// ---- one photograph ----

// Mean squared Laplacian over the variance, so that little contrast is not taken for blur.
static float sharpness(const float *grey, int width, int height) {
    double sum = 0, squares = 0, bends = 0, count = (double)width * height;
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            const float *p = grey + (size_t)y * (size_t)width + x;
            sum += (double)*p;
            squares += (double)(*p * *p);
            if (x == 0 || y == 0 || x + 1 == width || y + 1 == height) continue;
            float bend = 4 * p[0] - p[-1] - p[1] - p[-width] - p[width];
            bends += (double)(bend * bend);
        }
    double variance = squares / count - sum / count * (sum / count);
    return variance > 1 ? (float)(bends / count / variance) : 0;
}

static void take_thumb(const float *grey, int width, int height, struct look *look) {
    double sum = 0;
    for (int i = 0; i < THUMB * THUMB; i++) {
        int x0 = i % THUMB * width / THUMB, x1 = (i % THUMB + 1) * width / THUMB;
        int y0 = i / THUMB * height / THUMB, y1 = (i / THUMB + 1) * height / THUMB;
        double cell = 0;
        int count = 0;
        for (int y = y0; y < y1; y++)
            for (int x = x0; x < x1; x++, count++)
                cell += (double)grey[(size_t)y * (size_t)width + (size_t)x];
        look->thumb[i] = (uint8_t)(cell / (count ? count : 1));
        sum += cell / (count ? count : 1);
    }
    look->brightness = (float)(sum / (THUMB * THUMB));
}

void rn_survey_look(struct rn_survey *survey, const struct rn_frame *frame,
                    const struct rn_image *image, bool hidden) {
    if (!survey) return;
    struct look *look = &survey->looks[frame - survey->first];
    look->hidden = hidden;
    int cell, width, height;
    rn_exposures_look(survey->exposures, frame, image);
    float *grey = rn_grey(image, SIDE, &cell, &width, &height);
    if (!grey) return; // not measured, then
    look->sharpness = sharpness(grey, width, height);
    take_thumb(grey, width, height, look);
    look->seen = true;
    free(grey);
}

// ---- all of them ----

// What is concluded from: a look, if there was one, for each frame of full size, in order.
struct all {
    const struct rn_dataset *dataset;
    const struct look **looks;
    const struct rn_frame **frames;
    size_t count;
    bool looked; // at some; else all is by cameras alone
    bool named;  // some say by which camera they were taken
    struct rn_problems *problems;
    struct rn_findings found;
};

// Names in a list that is cut where it becomes long.
struct names {
    char text[224];
    size_t used, count;
};

static void add_name(struct names *names, const char *name) {
    if (names->count++ < NAMES && names->used < sizeof names->text - 64)
        names->used += (size_t)snprintf(names->text + names->used, sizeof names->text - names->used,
                                        "%s%.60s", names->count > 1 ? ", " : "", name);
    else if (names->count == NAMES + 1)
        snprintf(names->text + names->used, sizeof names->text - names->used, ", ...");
}

// By size, whichever way it was held, and by what EXIF says of maker, model and zoom; where some of
// a capture's photographs say that, those that do not are of cameras that nobody knows.
static bool same_camera(const struct all *all, const struct rn_frame *a, const struct rn_frame *b) {
    const struct rn_camera *as = &a->camera, *bs = &b->camera;
    bool upright = as->width == bs->width && as->height == bs->height;
    bool turned = as->width == bs->height && as->height == bs->width;
    bool known = a->camera_key || !all->named;
    return known && a->camera_key == b->camera_key && (upright || turned);
}

// The sharpness of the photographs of the same camera on one side of one, nearest first.
static size_t near_sharpness(const struct all *all, size_t i, int side, double *ret_sharpness) {
    size_t count = 0, k = i;
    for (int step = 0; step < REACH && count < NEIGHBOURS; step++) {
        k += (size_t)side; // wraps below the first one
        if (k >= all->count) break;
        if (all->looks[k]->seen && same_camera(all, all->frames[i], all->frames[k]))
            ret_sharpness[count++] = (double)all->looks[k]->sharpness;
    }
    return count;
}

static double centre_distance(const struct rn_camera *a, const struct rn_camera *b) {
    double place[3];
    rn_camera_place(b, place);
    return rn_camera_distance(a, place);
}

// Radians between two cameras' axes.
static double axes_angle(const struct rn_camera *a, const struct rn_camera *b) {
    double cosine = 0;
    for (int i = 0; i < 3; i++)
        cosine += a->world_from_camera[i][2] * b->world_from_camera[i][2];
    return acos(fmax(-1, fmin(1, cosine)));
}

static bool same_place(const struct rn_camera *a, const struct rn_camera *b, double distance) {
    return centre_distance(a, b) < NEAR * distance && axes_angle(a, b) < NEAR_DEG * M_PI / 180;
}

// Whether it is sharp beside those of its camera that look most nearly the same way from most
// nearly the same place: of photographs whose names are in no order, neighbours by name show other
// things.
static bool is_sharp_in_its_place(const struct all *all, size_t i, double distance) {
    struct rn_nearest nearest = {.most = 2 * NEIGHBOURS};
    double sharp[2 * NEIGHBOURS];
    for (size_t k = 0; k < all->count && isfinite(distance); k++) {
        const struct rn_camera *a = &all->frames[i]->camera, *b = &all->frames[k]->camera;
        if (k == i || !all->looks[k]->seen || !same_camera(all, all->frames[i], all->frames[k]))
            continue;
        rn_nearest_offer(&nearest, centre_distance(a, b) / distance + axes_angle(a, b), k);
    }
    size_t count = (size_t)nearest.count;
    for (size_t n = 0; n < count; n++)
        sharp[n] = (double)all->looks[nearest.which[n]]->sharpness;
    return count &&
           (double)all->looks[i]->sharpness >= BLURRED * rn_numbers_quantile(sharp, count, 0.5);
}

// Other cameras, and what else was done to their pictures, are sharp in other ways.
static void find_blurred(struct all *all, double distance) {
    struct names names = {.count = 0};
    size_t alone = 0;
    for (size_t i = 0; i < all->count; i++) {
        double near[2 * NEIGHBOURS];
        if (!all->looks[i]->seen || all->frames[i]->has_alpha) continue; // what is cut out varies
        size_t count = near_sharpness(all, i, -1, near);
        count += near_sharpness(all, i, 1, near + count);
        alone += count < NEIGHBOURS;
        if (count < NEIGHBOURS) continue;
        double usual = rn_numbers_quantile(near, count, 0.5);
        if ((double)all->looks[i]->sharpness < BLURRED * usual &&
            !is_sharp_in_its_place(all, i, distance))
            add_name(&names, all->frames[i]->name);
    }
    all->found.blurred = (double)names.count;
    if (names.count)
        rn_problems_add(all->problems, RN_SEVERITY_WARNING, all->dataset->name,
                        "%zu photograph%s less than %.0f %% of the sharpness of those that the "
                        "same camera took before and after: %s",
                        names.count, names.count == 1 ? " has" : "s have", 100 * BLURRED,
                        names.text);
    if (alone && all->count > NEIGHBOURS)
        rn_problems_add(
            all->problems, RN_SEVERITY_INFO, all->dataset->name,
            "whether %zu of the photographs are sharp is not judged: fewer than %d near "
            "each are of its camera, by size and EXIF",
            alone, NEIGHBOURS);
}

static void find_hidden(const struct all *all) {
    struct names names = {.count = 0};
    for (size_t i = 0; i < all->count; i++)
        if (all->looks[i]->hidden) add_name(&names, all->frames[i]->name);
    if (names.count)
        rn_problems_add(all->problems, RN_SEVERITY_WARNING, all->dataset->name,
                        "%zu photographs are left out as a whole, since their masks are black "
                        "everywhere: %s; what is used must be white",
                        names.count, names.text);
}

static double thumb_difference(const struct look *a, const struct look *b) {
    double sum = 0;
    for (int i = 0; i < THUMB * THUMB; i++)
        sum += abs(a->thumb[i] - b->thumb[i]);
    return sum / (THUMB * THUMB);
}

static int compare_brightness(const void *a, const void *b, void *context) {
    const struct all *all = context;
    float left = all->looks[*(const size_t *)a]->brightness;
    float right = all->looks[*(const size_t *)b]->brightness;
    return (left > right) - (left < right);
}

// Which of two that show the same is a test view of what is trained on; SIZE_MAX: none is, or they
// are of one grey and show nothing.
static size_t tested_by_heart(const struct all *all, size_t a, size_t b) {
    enum rn_split first = all->frames[a]->split, second = all->frames[b]->split;
    const uint8_t *thumb = all->looks[a]->thumb;
    if (memcmp(thumb, thumb + 1, THUMB * THUMB - 1) == 0) return SIZE_MAX;
    if (first == RN_SPLIT_TEST && second == RN_SPLIT_TRAIN) return a;
    if (second == RN_SPLIT_TEST && first == RN_SPLIT_TRAIN) return b;
    return SIZE_MAX;
}

static void tell_tests_by_heart(const struct all *all, const bool *by_heart) {
    struct names names = {.count = 0};
    for (size_t i = 0; i < all->count; i++)
        if (by_heart[i]) add_name(&names, all->frames[i]->name);
    if (names.count)
        rn_problems_add(all->problems, RN_SEVERITY_WARNING, all->dataset->name,
                        "%zu test views are copies of training views: what they score says how "
                        "well these were learnt by heart, not how good new views are. Without the "
                        "file that names them --split every:8 withholds photographs to test with: "
                        "%s",
                        names.count, names.text);
}

// Pairs are looked for among photographs of like brightness; without poses `distance` is infinite.
static void find_duplicates(struct all *all, double distance) {
    struct names names = {.count = 0}, apart = {.count = 0};
    bool *by_heart = calloc(all->count + 1, sizeof *by_heart);
    size_t *order = malloc((all->count + 1) * sizeof *order), count = 0;
    for (size_t i = 0; order && i < all->count; i++)
        if (all->looks[i]->seen) order[count++] = i;
    if (order) qsort_r(order, count, sizeof *order, compare_brightness, all);
    for (size_t i = 0; i < count; i++)
        for (size_t k = i + 1; k < count && k < i + REACH; k++) {
            size_t a = order[i] < order[k] ? order[i] : order[k], b = order[i] + order[k] - a;
            if (all->looks[order[k]]->brightness - all->looks[order[i]]->brightness > (float)SAME)
                break;
            double difference = thumb_difference(all->looks[a], all->looks[b]);
            bool same = same_place(&all->frames[a]->camera, &all->frames[b]->camera, distance);
            char pair[64];
            snprintf(pair, sizeof pair, "%.28s and %.28s", all->frames[a]->name,
                     all->frames[b]->name);
            if (same && difference < SAME) add_name(&names, pair);
            size_t tested = same && difference == 0 ? tested_by_heart(all, a, b) : SIZE_MAX;
            if (by_heart && tested < all->count) by_heart[tested] = true;
            // What is cut out may look the same from all sides.
            if (!same && difference == 0 && !all->frames[a]->has_alpha) add_name(&apart, pair);
        }
    free(order);
    all->found.duplicates = (double)names.count;
    if (by_heart) tell_tests_by_heart(all, by_heart);
    free(by_heart);
    if (names.count)
        rn_problems_add(all->problems, RN_SEVERITY_INFO, all->dataset->name,
                        "%zu pair%s of photographs %s nearly the same%s: %s", names.count,
                        names.count > 1 ? "s" : "", names.count > 1 ? "are" : "is",
                        isfinite(distance) ? ", from the same place" : "", names.text);
    if (apart.count && all->count > 2 && apart.count < all->count)
        rn_problems_add(all->problems, RN_SEVERITY_WARNING, all->dataset->name,
                        "%zu pairs of photographs look the same and have different poses: %s",
                        apart.count, apart.text);
}

// From within a room cameras look any way, over a field each at its own piece, and what cameras
// that face one way see is the scene.
static void find_looking_away(struct all *all) {
    struct names names = {.count = 0};
    enum rn_capture_kind kind = all->dataset->lie.kind;
    bool all_is_held =
        kind == RN_CAPTURE_ROOM || kind == RN_CAPTURE_DRONE || rn_faces_one_way(all->dataset);
    for (size_t i = 0; i < all->count; i++)
        if (!rn_camera_looks_at(&all->frames[i]->camera, &all->dataset->bounds))
            add_name(&names, all->frames[i]->name);
    all->found.looking_away = (double)names.count;
    if (names.count && !all_is_held)
        rn_problems_add(all->problems, RN_SEVERITY_WARNING, all->dataset->name,
                        "%zu of %zu cameras look away from the bounds: %s", names.count, all->count,
                        names.text);
}

static void tell_heights(double low_deg, double high_deg, char *text, size_t capacity) {
    double low = round(low_deg), high = round(high_deg);
    const char *side = low < 0 ? "below" : "above";
    if (low < 0 && high > 0)
        snprintf(text, capacity, "%.0f degrees below to %.0f above the horizon", -low, high);
    else if (low < high)
        snprintf(text, capacity, "%.0f to %.0f degrees %s the horizon", fmin(fabs(low), fabs(high)),
                 fmax(fabs(low), fabs(high)), side);
    else
        snprintf(text, capacity, "%.0f degrees %s the horizon", fabs(low), side);
}

// From which directions what is turned around was photographed.
static void find_coverage(struct all *all) {
    const struct rn_dataset *dataset = all->dataset;
    const double *up = dataset->lie.up, *centre = dataset->bounds.centre;
    double *azimuths = malloc((all->count + 1) * sizeof *azimuths), a[3], b[3];
    bool turned = dataset->lie.kind == RN_CAPTURE_OBJECT || dataset->lie.kind == RN_CAPTURE_OUTDOOR;
    if (!azimuths || !turned || !all->count) {
        free(azimuths);
        return;
    }
    rn_around_axes(up, a, b);
    double low = 90, high = -90, first;
    for (size_t f = 0; f < all->count; f++) {
        double out[3];
        for (int i = 0; i < 3; i++)
            out[i] = all->frames[f]->camera.world_from_camera[i][3] - centre[i];
        double sine = rn_dot(out, up) / sqrt(rn_dot(out, out));
        double elevation = asin(fmax(-1, fmin(1, sine))) * 180 / M_PI;
        azimuths[f] = atan2(rn_dot(out, b), rn_dot(out, a));
        low = fmin(low, elevation);
        high = fmax(high, elevation);
    }
    double gap = 360 - rn_around_arc(azimuths, all->count, &first) * 180 / M_PI;
    free(azimuths);
    all->found.azimuth_gap_deg = gap;
    all->found.elevation_min_deg = low;
    all->found.elevation_max_deg = high;
    char heights[64];
    tell_heights(low, high, heights, sizeof heights);
    rn_problems_add(all->problems, RN_SEVERITY_INFO, dataset->name,
                    "photographed from %.0f of 360 degrees around, %s%s", 360 - gap, heights,
                    gap > GAP_DEG ? "; from the side that no photograph shows it will be made up"
                                  : "");
}

static void find_exposure(struct all *all, struct rn_survey *survey, struct rn_dataset *dataset) {
    rn_exposures_solve(survey->exposures, dataset->frames, dataset->frame_count);
    double spread = rn_exposure_spread(dataset->frames, dataset->frame_count);
    double unrest = rn_exposure_unrest(dataset->frames, dataset->frame_count);
    all->found.exposure_spread = spread;
    if (isfinite(spread))
        rn_problems_add(all->problems, RN_SEVERITY_INFO, dataset->name,
                        "exposures of 90 %% of the photographs differ by %.0f %% at most, measured "
                        "on shared points%s",
                        100 * spread,
                        unrest > RN_EXPOSURE_UNREST ? "; training makes them even (effect exposure)"
                                                    : "");
    double light = rn_light_unrest(dataset->frames, dataset->frame_count);
    if (light > RN_LIGHT_UNREST)
        rn_problems_add(all->problems, RN_SEVERITY_INFO, dataset->name,
                        "the light on shared points differs by %.0f %% from one photograph to the "
                        "next, whatever their exposures: each has an appearance of its own in "
                        "training (effect appearance)",
                        100 * light);
}

// What effects of a training the cameras and masks call for, each with its number and from where on
// it is.
static void find_effects(struct all *all) {
    const struct rn_dataset *d = all->dataset;
    struct rn_lens_shift lens = {0};
    for (size_t f = 0; f < d->frame_count; f++)
        if (d->frames[f].scale == 0) rn_lens_shift_add(&lens, &d->frames[f].camera);
    if (lens.most > RN_LENS_SHIFT)
        rn_problems_add(
            all->problems, RN_SEVERITY_INFO, d->name,
            "the lens moves what is seen by up to %.3g pixels, over the threshold of %.2g: "
            "training follows it (effect distortion)",
            lens.most, RN_LENS_SHIFT);
    double past = rn_share_past(d, &d->bounds, rn_share_left_out(d) > RN_SHARE_LEFT_OUT);
    if (past > RN_SHARE_PAST)
        rn_problems_add(all->problems, RN_SEVERITY_INFO, d->name,
                        "%.0f %% of the pixels look past what all cameras look at, over the "
                        "threshold of %.0f %%: training %s",
                        100 * past, 100 * RN_SHARE_PAST,
                        rn_faces_one_way(d)   ? FORWARD
                        : rn_looks_one_way(d) ? FORWARD " where an import finds these, else " ROUND
                                              : ROUND);
}

static void find_reprojection(struct all *all) {
    struct rn_reprojection r;
    struct names names = {.count = 0};
    double *means = malloc((all->count + 1) * sizeof *means), worst = 0;
    const struct rn_dataset *dataset = all->dataset;
    if (means && dataset->points.sighting_count && !dataset->points.found &&
        rn_dataset_reproject(dataset, &r, NULL) == RN_OK &&
        rn_dataset_reproject_photos(dataset, all->frames, all->count, means) == RN_OK) {
        all->found.reprojection_px = r.mean_px;
        all->found.reprojection_median_px = r.median_px;
        all->found.reprojection_p95_px = r.p95_px;
        for (size_t i = 0; i < all->count; i++) {
            if (isnan(means[i])) continue;
            worst = fmax(worst, means[i]);
            if (means[i] > OFF_PX && means[i] > 3 * r.median_px)
                add_name(&names, all->frames[i]->name);
        }
        all->found.reprojection_worst_px = worst;
        if (names.count)
            rn_problems_add(all->problems, RN_SEVERITY_WARNING, dataset->name,
                            "sparse points are missed by more than %g px on average in %zu "
                            "photographs (%.2f at worst), whose poses are doubtful: %s",
                            OFF_PX, names.count, worst, names.text);
    }
    free(means);
}

static bool gather(struct rn_survey *survey, struct all *all) {
    const struct rn_dataset *dataset = all->dataset;
    all->looks = malloc((dataset->frame_count + 1) * sizeof *all->looks);
    all->frames = malloc((dataset->frame_count + 1) * sizeof *all->frames);
    if (!all->looks || !all->frames) return false;
    for (size_t i = 0; i < survey->count; i++)
        all->looked |= survey->looks[i].seen;
    for (size_t i = 0; i < survey->count; i++) {
        const struct look *look = &survey->looks[i];
        const struct rn_frame *frame =
            rn_dataset_frame(dataset, look->split, look->index, look->scale);
        if (look->scale || !frame) continue;
        all->named |= frame->camera_key != 0;
        all->looks[all->count] = look;
        all->frames[all->count++] = frame;
    }
    return true;
}

#define NOTHING                                                                                    \
    { NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN }

enum rn_status rn_survey_conclude_photos(struct rn_survey *survey, const struct rn_dataset *frames,
                                         struct rn_problems *problems,
                                         struct rn_findings *ret_findings, struct rn_error *err) {
    struct all all = {.dataset = frames, .problems = problems, .found = NOTHING};
    bool whole = gather(survey, &all);
    if (whole && all.looked) find_blurred(&all, INFINITY);
    if (whole && all.looked) find_duplicates(&all, INFINITY);
    if (whole) *ret_findings = all.found;
    free(all.looks);
    free(all.frames);
    return whole ? RN_OK : rn_error_set(err, RN_ERROR_NO_MEMORY, frames->name, "out of memory");
}

enum rn_status rn_survey_conclude(struct rn_survey *survey, struct rn_dataset *dataset,
                                  const struct rn_import_options *kept,
                                  struct rn_problems *problems, struct rn_findings *ret_findings,
                                  struct rn_error *err) {
    struct all all = {.dataset = dataset, .problems = problems, .found = NOTHING};
    struct rn_scene_place place;
    bool whole = gather(survey, &all);
    enum rn_status status =
        whole ? rn_dataset_find_place(dataset, &place, err)
              : rn_error_set(err, RN_ERROR_NO_MEMORY, dataset->name, "out of memory");
    if (status == RN_OK) {
        if (all.looked) find_blurred(&all, place.distance);
        if (all.looked) find_duplicates(&all, place.distance);
        find_hidden(&all);
        find_looking_away(&all);
        find_coverage(&all);
        find_exposure(&all, survey, dataset);
        find_effects(&all);
        find_reprojection(&all);
        all.found.train_bytes = rn_training_cost(dataset, kept).bytes;
        *ret_findings = all.found;
    }
    free(all.looks);
    free(all.frames);
    return status;
}

#include "common/dataset/dataset.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/dataset/points.h"
#include "common/dataset/reader.h"
#include "common/math/vector.h"

#define SEEN_ENOUGH 0.8 // of photographs without alpha; the NeRF-synthetic sphere has 0.9
#define SMALL 0.25      // of the layout's sphere, where what is cut out has its own
#define MARGIN 1.2      // of what is cut out

const char *const rn_bounds_source_names[] = {"given",  "layout",   "cameras", "points",
                                              "depths", "outlines", NULL};
const char *const rn_bounds_source_titles[] = {"as given",
                                               "by its layout",
                                               "from the cameras",
                                               "from its points",
                                               "from the depths that its poses give",
                                               "from the outlines of what is cut out",
                                               NULL};
const char *const rn_downscale_names[] = {"premultiplied", "straight", NULL};

void rn_frame_finish(struct rn_frame *frame) {
    free(frame->name);
    free(frame->path);
    free(frame->mask_path);
    frame->name = frame->path = frame->mask_path = NULL;
}

void rn_dataset_destroy(struct rn_dataset **dataset) {
    if (!*dataset) return;
    for (size_t i = 0; i < (*dataset)->frame_count; i++)
        rn_frame_finish(&(*dataset)->frames[i]);
    for (size_t i = 0; i < (*dataset)->document_count; i++)
        free((*dataset)->documents[i]);
    free((*dataset)->documents);
    rn_points_finish(&(*dataset)->points);
    free((*dataset)->frames);
    free((*dataset)->name);
    free(*dataset);
    *dataset = NULL;
}

static int compare_frames(const void *left, const void *right) {
    const struct rn_frame *a = left, *b = right;
    if (a->split != b->split) return a->split < b->split ? -1 : 1;
    if (a->index != b->index) return a->index < b->index ? -1 : 1;
    return (a->scale > b->scale) - (a->scale < b->scale);
}

static enum rn_status no_training_view(const struct rn_dataset *dataset, const char *where,
                                       const struct rn_problems *problems, struct rn_error *err) {
    const struct rn_problem *first = NULL;
    for (size_t i = 0; problems && i < problems->count && !first; i++)
        if (problems->items[i].severity == RN_SEVERITY_ERROR) first = &problems->items[i];
    return rn_error_set(err, RN_ERROR_INVALID, where,
                        "no usable training view; %d training images were left out%s%s%s%.200s",
                        dataset->unusable[RN_SPLIT_TRAIN], first ? "; the first problem: " : "",
                        first ? first->where : "", first ? " " : "", first ? first->text : "");
}

enum rn_status rn_dataset_seal(struct rn_dataset *dataset, const char *where,
                               const struct rn_problems *problems, struct rn_error *err) {
    if (dataset->frame_count)
        qsort(dataset->frames, dataset->frame_count, sizeof *dataset->frames, compare_frames);
    dataset->scale_count = 0;
    memset(dataset->view_count, 0, sizeof dataset->view_count);
    for (size_t i = 0; i < dataset->frame_count; i++) {
        const struct rn_frame *frame = &dataset->frames[i], *before = frame - 1;
        if (i && compare_frames(before, frame) == 0)
            return rn_error_set(
                err, RN_ERROR_INVALID, where, "two images for view %s:%d at scale %d: %s and %s",
                rn_split_name(frame->split), frame->index, frame->scale, before->path, frame->path);
        if (!i || before->split != frame->split || before->index != frame->index)
            dataset->view_count[frame->split]++;
        if (frame->scale >= dataset->scale_count) dataset->scale_count = frame->scale + 1;
    }
    if (!dataset->view_count[RN_SPLIT_TRAIN])
        return no_training_view(dataset, where, problems, err);
    return RN_OK;
}

// What a photograph without alpha shows beyond the sphere makes its space unbounded.
static void warn_of_what_is_beyond(struct rn_reader *reader) {
    struct rn_dataset *dataset = reader->dataset;
    for (size_t i = 0; i < dataset->frame_count; i++)
        if (dataset->frames[i].has_alpha) return;
    double seen = rn_bounds_seen(dataset, &dataset->bounds);
    if (seen >= SEEN_ENOUGH) return;
    struct rn_bounds wider = rn_bounds_from_cameras(dataset, RN_CAPTURE_DISTANCES);
    rn_problems_add(reader->problems, RN_SEVERITY_WARNING, reader->folder,
                    "the layout's sphere (radius %g about the origin) covers only %.0f %% of the "
                    "training photographs' pixels; where over a tenth of them look past it, all of "
                    "space is trained. A scene that ends is finer in a sphere of its own, "
                    "`import --bounds X,Y,Z,R`: %.6g,%.6g,%.6g,%.6g reaches %g times the cameras' "
                    "mean distance",
                    dataset->format->sphere, 100 * seen, wider.centre[0], wider.centre[1],
                    wider.centre[2], wider.radius, RN_CAPTURE_DISTANCES);
}

// The sphere through the corners of a box.
static struct rn_bounds around(const struct rn_box *box) {
    struct rn_bounds bounds = {.source = RN_BOUNDS_GIVEN};
    double squared = 0;
    for (int i = 0; i < 3; i++) {
        bounds.centre[i] = 0.5 * (box->low[i] + box->high[i]);
        squared += pow(0.5 * (box->high[i] - box->low[i]), 2);
    }
    bounds.radius = sqrt(squared);
    return bounds;
}

// Scenes of other sizes than the benchmark's: a sphere about its centre that fits what is cut out.
static void fit_layout(struct rn_reader *reader) {
    struct rn_bounds *bounds = &reader->dataset->bounds;
    double reach = rn_outline_reach(reader->dataset, bounds->centre), sphere = bounds->radius;
    if (!(reach > sphere || reach < SMALL * sphere)) return;
    bounds->radius = MARGIN * reach;
    rn_problems_add(reader->problems, RN_SEVERITY_INFO, reader->folder,
                    "the layout's sphere (radius %g about the origin) does not fit what alpha "
                    "channels cut out, which reaches %.3g far: its radius is %.3g",
                    sphere, reach, bounds->radius);
}

// The layout's convention, unless no camera at all looks at that sphere.
static void set_layout_bounds(struct rn_reader *reader) {
    struct rn_dataset *dataset = reader->dataset;
    dataset->bounds =
        (struct rn_bounds){.radius = dataset->format->sphere, .source = RN_BOUNDS_LAYOUT};
    for (size_t i = 0; i < dataset->frame_count; i++)
        if (rn_camera_looks_at(&dataset->frames[i].camera, &dataset->bounds)) {
            warn_of_what_is_beyond(reader);
            fit_layout(reader);
            return;
        }
    dataset->bounds = rn_bounds_from_cameras(dataset, RN_OBJECT_DISTANCES);
    rn_problems_add(reader->problems, RN_SEVERITY_WARNING, reader->folder,
                    "no camera looks at the layout's sphere (radius %g about the origin); bounds "
                    "taken from the cameras: radius %g about (%g, %g, %g)",
                    dataset->format->sphere, dataset->bounds.radius, dataset->bounds.centre[0],
                    dataset->bounds.centre[1], dataset->bounds.centre[2]);
}

// What photographs see, or the part of it that alpha channels cut out.
static void set_seen_bounds(struct rn_dataset *dataset, const struct rn_scene_place *place) {
    double reach = place->cut_out ? rn_outline_reach(dataset, place->turned_around) : NAN;
    dataset->bounds = place->bounds;
    if (!(reach > 0)) return;
    dataset->bounds = (struct rn_bounds){.radius = MARGIN * reach, .source = RN_BOUNDS_OUTLINES};
    memcpy(dataset->bounds.centre, place->turned_around, sizeof place->turned_around);
}

// As asked for, as the document says, by the layout, or by what the cameras see.
static void set_bounds(struct rn_reader *reader, const struct rn_scene_place *place) {
    struct rn_dataset *dataset = reader->dataset;
    const struct rn_read_options *options = reader->options;
    if (options && options->bounds.radius > 0) {
        dataset->bounds = options->bounds;
        dataset->bounds.source = RN_BOUNDS_GIVEN;
    } else if (options && options->cropped) {
        dataset->bounds = around(&options->crop);
    } else if (!(dataset->bounds.radius > 0) && dataset->format->sphere > 0) {
        set_layout_bounds(reader);
    } else if (!(dataset->bounds.radius > 0)) {
        set_seen_bounds(dataset, place);
    }
}

// A camera that stands nowhere near the others makes the scene as large as its distance.
static enum rn_status check_bounds(const struct rn_dataset *dataset, struct rn_error *err) {
    const struct rn_bounds *bounds = &dataset->bounds;
    const struct rn_frame *farthest = &dataset->frames[0];
    double distance = 0;
    if (bounds->radius >= RN_BOUNDS_LEAST && bounds->radius <= RN_BOUNDS_MOST) return RN_OK;
    for (size_t i = 0; i < dataset->frame_count; i++) {
        double to_this = rn_camera_distance(&dataset->frames[i].camera, bounds->centre);
        if (!(to_this > distance)) continue;
        distance = to_this;
        farthest = &dataset->frames[i];
    }
    return rn_error_set(err, RN_ERROR_INVALID, farthest->path,
                        "the scene is a sphere with a radius of %.3g, %g to %g can be: this "
                        "photograph's camera stands farthest from its middle, by %.3g; correct its "
                        "pose where it is wrong, or give all poses in another unit",
                        bounds->radius, RN_BOUNDS_LEAST, RN_BOUNDS_MOST, distance);
}

// What is asked for; the rest is found out.
static enum rn_status settle_place(struct rn_reader *reader, struct rn_error *err) {
    struct rn_dataset *dataset = reader->dataset;
    const struct rn_read_options *options = reader->options;
    struct rn_scene_place place;
    if (options && options->up_given) {
        double size = sqrt(rn_dot(options->up, options->up));
        for (int i = 0; i < 3; i++)
            dataset->lie.up[i] = options->up[i] / size;
    }
    if (options && options->cropped) dataset->lie.crop = options->crop;
    if (options) dataset->lie.up_given |= options->up_given;
    if (options) dataset->lie.cropped |= options->cropped;
    if (dataset->lie.known && !options) return RN_OK;
    rn_reader_settle_alpha(reader);
    rn_reader_settle_backdrop(reader);
    enum rn_status status = rn_dataset_find_depths(dataset, err);
    if (status == RN_OK) status = rn_dataset_find_place(dataset, &place, err);
    if (status) return status;
    dataset->lie = place.lie;
    dataset->lie.known = true;
    set_bounds(reader, &place);
    if ((status = check_bounds(dataset, err))) return status;
    if (reader->problems && !(dataset->format->sphere > 0)) rn_reader_tell_place(reader, &place);
    return RN_OK;
}

// A document that is a link whose file is gone is seen by its user, and not by us.
static enum rn_status find_lost_link(const struct rn_reader *reader, struct rn_error *err) {
    enum rn_status status = RN_OK;
    for (size_t i = 0; rn_formats[i] && status == RN_OK; i++) {
        char *path;
        if (asprintf(&path, "%s/%s", reader->folder, rn_formats[i]->signs[0].file) < 0)
            return rn_error_set(err, RN_ERROR_NO_MEMORY, reader->folder, "out of memory");
        if (rn_reader_leads_nowhere(path))
            status = rn_error_set(err, RN_ERROR_NOT_FOUND, path, RN_LEADS_NOWHERE);
        free(path);
    }
    return status;
}

static enum rn_status nothing_found(const struct rn_reader *reader, struct rn_error *err) {
    char signs[256] = "", *inner = rn_formats_find_below(reader->folder);
    enum rn_status status;
    for (size_t i = 0, used = 0; rn_formats[i] && used < sizeof signs; i++)
        if (i == 0 || strcmp(rn_formats[i]->signs[0].file, rn_formats[i - 1]->signs[0].file) != 0)
            used += (size_t)snprintf(signs + used, sizeof signs - used, "%s%s", i ? ", " : "",
                                     rn_formats[i]->signs[0].file);
    if (inner)
        status = rn_error_set(err, RN_ERROR_NOT_FOUND, reader->folder,
                              "holds no dataset, but %s does: give that folder, or look for poses "
                              "anew with --poses find",
                              inner);
    else
        status = rn_error_set(err, RN_ERROR_NOT_FOUND, reader->folder,
                              "holds no dataset: none of these is there: %s", signs);
    free(inner);
    return status;
}

static void forget_documents(struct rn_dataset *dataset) {
    for (size_t i = 0; i < dataset->document_count; i++)
        free(dataset->documents[i]);
    free(dataset->documents);
    dataset->documents = NULL;
    dataset->document_count = 0;
}

static enum rn_status read_format(struct rn_reader *reader, const struct rn_format *format,
                                  struct rn_error *err) {
    reader->dataset->format = format;
    reader->dataset->premultiplied_scales = true;
    enum rn_status status = format->read(reader, err);
    rn_reader_tell_missing(reader);
    const char *masks = reader->options ? reader->options->masks : NULL;
    if (status == RN_OK) status = rn_reader_leave_out_shared(reader, err);
    if (status == RN_OK) status = rn_reader_find_masks(reader, masks, err);
    if (status == RN_OK)
        status = rn_dataset_seal(reader->dataset, reader->folder, reader->problems, err);
    if (status == RN_OK && reader->problems) rn_reader_tell_reprojection(reader);
    return status ? status : settle_place(reader, err);
}

// The first format of those recognised whose documents are all there; one that is incomplete is
// told, and so are those that are left.
static enum rn_status read_recognised(struct rn_reader *reader, struct rn_error *err) {
    const struct rn_format *found[RN_FORMATS_MAX];
    size_t count, i = 0;
    struct rn_error why;
    enum rn_status status = rn_formats_recognise(reader->folder, found, &count, err);
    if (status) return status;
    if (count == 0 && (status = find_lost_link(reader, err)) != RN_OK) return status;
    if (count == 0) return nothing_found(reader, err);
    while ((status = read_format(reader, found[i], &why)) == RN_ERROR_NOT_FOUND && i + 1 < count) {
        rn_problems_add(reader->problems, RN_SEVERITY_WARNING, why.where, "%s; read as %s instead",
                        why.text, found[++i]->title);
        forget_documents(reader->dataset);
    }
    if (status && err) *err = why;
    for (size_t j = i + 1; status == RN_OK && reader->problems && j < count; j++)
        if (strcmp(found[j]->documents[0], found[i]->documents[0]) != 0) {
            rn_problems_add(reader->problems, RN_SEVERITY_INFO, reader->folder,
                            "is read as %s; it also holds a dataset of the format %s (--format %s)",
                            found[i]->title, found[j]->title, found[j]->name);
            rn_reader_compare(reader, found[j]);
        }
    return status;
}

static enum rn_status named_format(const char *name, const struct rn_format **ret_format,
                                   struct rn_error *err) {
    char names[256];
    *ret_format = rn_format_find(name);
    if (*ret_format) return RN_OK;
    rn_format_names(names, sizeof names);
    return rn_error_set(err, RN_ERROR_INVALID, "format", "'%.40s' is none of %s", name, names);
}

// The folder's own name: "/data/lego/" -> "lego".
static char *folder_name(const char *folder) {
    size_t end = strlen(folder);
    while (end > 1 && folder[end - 1] == '/')
        end--;
    size_t begin = end;
    while (begin > 0 && folder[begin - 1] != '/')
        begin--;
    return strndup(folder + begin, end - begin);
}

enum rn_status rn_dataset_read_as(const char *folder, const struct rn_read_options *options,
                                  struct rn_problems *problems, struct rn_dataset **ret_dataset,
                                  struct rn_error *err) {
    struct rn_reader reader = {.folder = folder, .problems = problems, .options = options};
    const struct rn_format *format = NULL;
    reader.dataset = calloc(1, sizeof *reader.dataset);
    reader.reported = json_object();
    if (reader.dataset) reader.dataset->name = folder_name(folder);
    enum rn_status status;
    if (!reader.dataset || !reader.dataset->name || !reader.reported)
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, folder, "out of memory");
    else if (!options || !options->format)
        status = read_recognised(&reader, err);
    else if ((status = named_format(options->format, &format, err)) == RN_OK)
        status = read_format(&reader, format, err);
    json_decref(reader.reported);
    if (status == RN_OK)
        *ret_dataset = reader.dataset;
    else
        rn_dataset_destroy(&reader.dataset);
    return status;
}

enum rn_status rn_dataset_read_whole(const char *folder, struct rn_dataset **ret_dataset,
                                     struct rn_error *err) {
    struct rn_dataset *dataset = NULL;
    enum rn_status status = rn_dataset_read(folder, NULL, &dataset, err);
    for (int split = 0; status == RN_OK && split < RN_SPLIT_COUNT; split++)
        if (dataset->unusable[split] > 0)
            status = rn_error_set(err, RN_ERROR_IO, folder,
                                  "%d of its views cannot be read now; try again",
                                  dataset->unusable[split]);
    if (status == RN_OK)
        *ret_dataset = dataset;
    else
        rn_dataset_destroy(&dataset);
    return status;
}

enum rn_status rn_dataset_read(const char *folder, struct rn_problems *problems,
                               struct rn_dataset **ret_dataset, struct rn_error *err) {
    return rn_dataset_read_as(folder, NULL, problems, ret_dataset, err);
}

const struct rn_frame *rn_dataset_frame(const struct rn_dataset *dataset, enum rn_split split,
                                        int index, int scale) {
    struct rn_frame key = {.split = split, .index = index, .scale = scale};
    if (!dataset->frame_count) return NULL;
    return bsearch(&key, dataset->frames, dataset->frame_count, sizeof key, compare_frames);
}

const struct rn_frame *rn_dataset_start(const struct rn_dataset *dataset) {
    const struct rn_frame *first = NULL;
    for (size_t i = 0; i < dataset->frame_count; i++) {
        const struct rn_frame *frame = &dataset->frames[i];
        bool better = !first || (frame->split == RN_SPLIT_TEST && first->split != RN_SPLIT_TEST);
        if (frame->scale == 0 && better) first = frame;
    }
    return first;
}

static enum rn_status find_by_name(const struct rn_dataset *dataset, const char *view,
                                   enum rn_split split, const char *name, int scale,
                                   const struct rn_frame **ret_frame, struct rn_error *err) {
    const struct rn_frame *found = NULL;
    for (size_t i = 0; i < dataset->frame_count; i++) {
        const struct rn_frame *frame = &dataset->frames[i];
        if (frame->split != split || frame->scale != scale || strcmp(frame->name, name) != 0)
            continue;
        if (found)
            return rn_error_set(err, RN_ERROR_CONFLICT, view,
                                "names several views (indices %d and %d): use the index",
                                found->index, frame->index);
        found = frame;
    }
    int count = dataset->view_count[split];
    if (!found && count == 0)
        return rn_error_set(err, RN_ERROR_NOT_FOUND, view, "the dataset has no %s views",
                            rn_split_name(split));
    if (!found)
        return rn_error_set(err, RN_ERROR_NOT_FOUND, view,
                            "no such view at scale %d; the %s split has %s:0 to %s:%d", scale,
                            rn_split_name(split), rn_split_name(split), rn_split_name(split),
                            count - 1);
    *ret_frame = found;
    return RN_OK;
}

enum rn_status rn_dataset_find_view(const struct rn_dataset *dataset, const char *view, int scale,
                                    const struct rn_frame **ret_frame, struct rn_error *err) {
    const char *colon = strchr(view, ':');
    int split = 0;
    while (colon && split < RN_SPLIT_COUNT) {
        const char *name = rn_split_name((enum rn_split)split);
        if (strlen(name) == (size_t)(colon - view) && strncmp(view, name, strlen(name)) == 0) break;
        split++;
    }
    if (!colon || split == RN_SPLIT_COUNT || !colon[1])
        return rn_error_set(err, RN_ERROR_INVALID, view,
                            "a view is written train:N, val:N or test:N, with a zero-based index "
                            "or an image's name");
    const char *name = colon + 1;
    size_t digits = strspn(name, "0123456789");
    if (!name[digits] && digits <= 7) {
        const struct rn_frame *frame =
            rn_dataset_frame(dataset, (enum rn_split)split, atoi(name), scale);
        if (frame) {
            *ret_frame = frame;
            return RN_OK;
        }
    }
    return find_by_name(dataset, view, (enum rn_split)split, name, scale, ret_frame, err);
}

// validate, import, synth, datasets: photographs before they are a scene.

#include <libgen.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "client/commands/estimate.h"
#include "client/commands/pack.h"
#include "client/commands/scene_file.h"
#include "client/commands/submit.h"
#include "client/commands/upload.h"
#include "client/follow.h"
#include "client/interrupt.h"
#include "client/table.h"
#include "common/base/threads.h"
#include "common/dataset/dataset.h"
#include "common/dataset/photos.h"
#include "common/math/numbers.h"
#include "proto/checks.h"
#include "proto/dataset.h"
#include "proto/report.h"

static const struct rn_option no_options[] = {{0}};

// ---- validate ----

// Only the problems of a report: all there is to say when nothing could be read.
static const struct rn_field_spec problem_fields[] = {
    RN_F_NAME(struct rn_report_problem, severity, RN_REQUIRED, rn_severity_names),
    RN_F_TEXT(struct rn_report_problem, where, RN_REQUIRED, NULL),
    RN_F_TEXT(struct rn_report_problem, text, RN_REQUIRED, NULL)};
static const struct rn_table problem_table =
    RN_TABLE(struct rn_report_problem, "problem", problem_fields);
static const struct rn_field_spec bad_fields[] = {
    RN_F_INT(struct rn_dataset_report_record, errors, RN_REQUIRED, 0, 1e9),
    RN_F_INT(struct rn_dataset_report_record, warnings, RN_REQUIRED, 0, 1e9),
    RN_F_INT(struct rn_dataset_report_record, dropped, RN_REQUIRED, 0, 1e9),
    RN_F_OBJECTS(struct rn_dataset_report_record, problems, problem_count, RN_REQUIRED,
                 &problem_table, RN_REPORT_PROBLEMS_MAX)};
static const struct rn_table bad_table =
    RN_TABLE(struct rn_dataset_report_record, "report", bad_fields);

static void print_problems(FILE *out, const struct rn_dataset_report_record *report) {
    for (size_t i = 0; i < report->problem_count; i++) {
        fprintf(out, "%-7s  ", rn_severity_names[report->problems[i].severity]);
        rn_client_print(out, report->problems[i].where);
        fputs(": ", out);
        rn_client_print(out, report->problems[i].text);
        fputc('\n', out);
    }
    if (report->dropped) fprintf(out, "and %lld more\n", (long long)report->dropped);
}

// Shown, or without being asked for where there is an error.
static void print_json_report(const struct rn_table *table,
                              const struct rn_dataset_report_record *report, bool show) {
    char *text = show || report->errors ? rn_api_encode(table, report) : NULL;
    if (text && show)
        puts(text);
    else if (text)
        rn_client_error_json(text);
    free(text);
}

static void print_report(const char *folder, const struct rn_dataset *dataset,
                         const struct rn_dataset_report_record *report) {
    const struct rn_bounds *bounds = &dataset->bounds;
    const struct rn_split_counts *usable = &report->usable, *bad = &report->unusable;
    int64_t images = usable->train + usable->val + usable->test;
    printf("%s: %s layout\n\n", folder, report->layout);
    printf("             train    val   test\n");
    printf("usable      %6lld %6lld %6lld\n", (long long)usable->train, (long long)usable->val,
           (long long)usable->test);
    printf("unusable    %6lld %6lld %6lld\n\n", (long long)bad->train, (long long)bad->val,
           (long long)bad->test);
    printf("images      %gx%g", report->width.min, report->height.min);
    if (report->width.max > report->width.min || report->height.max > report->height.min)
        printf(" to %gx%g", report->width.max, report->height.max);
    printf(", %lld scale%s, %lld of %lld with alpha\n", (long long)report->scales,
           report->scales == 1 ? "" : "s", (long long)report->with_alpha, (long long)images);
    printf("cameras     %.3g to %.3g from the centre, %.0f %% look at the scene\n",
           report->camera_distance.min, report->camera_distance.max,
           report->looking_at_bounds * 100);
    printf("footprint   %.3g to %.3g at the centre\n", report->footprint.min,
           report->footprint.max);
    rn_print_expected(&report->expected);
    rn_print_choices(report->choices, report->choice_count);
    printf("bounds      centre (%g, %g, %g), radius %g, %s\n\n", bounds->centre[0],
           bounds->centre[1], bounds->centre[2], bounds->radius,
           rn_bounds_source_titles[bounds->source]);
    print_problems(stdout, report);
    printf("%lld error%s, %lld warning%s\n", (long long)report->errors,
           report->errors == 1 ? "" : "s", (long long)report->warnings,
           report->warnings == 1 ? "" : "s");
}

static bool show_checked(void *context, size_t done, size_t total) {
    rn_progress_update(context, (double)done / (double)total, "%zu of %zu images checked", done,
                       total);
    return true;
}

static bool show_made(void *context, size_t done, size_t total) {
    rn_progress_update(context, (double)done / (double)total, "%zu of %zu images made", done,
                       total);
    return !rn_interrupt_seen();
}

// Reads a dataset and decodes its images; what is wrong goes into `problems`. NULL when nothing
// usable is left.
static struct rn_dataset *read_dataset(const char *folder, const struct rn_read_options *options,
                                       const struct rn_import_options *kept, bool quiet,
                                       struct rn_problems *problems,
                                       struct rn_findings *ret_found) {
    struct rn_dataset *dataset = NULL;
    struct rn_survey *survey = NULL;
    struct rn_progress progress;
    struct rn_error err = {0};
    enum rn_status status = rn_dataset_read_as(folder, options, problems, &dataset, &err);
    if (status == RN_OK) status = rn_survey_create(dataset, &survey, &err);
    if (status == RN_OK) {
        rn_progress_init(&progress, !quiet);
        status = rn_dataset_check_images(dataset, rn_usable_cores(), problems, survey, show_checked,
                                         &progress, &err);
        rn_progress_finish(&progress);
    }
    if (status == RN_OK)
        status = rn_survey_conclude(survey, dataset, kept, problems, ret_found, &err);
    rn_survey_destroy(&survey);
    if (status != RN_OK) {
        rn_problems_add(problems, RN_SEVERITY_ERROR, err.where, "%s", err.text);
        rn_dataset_destroy(&dataset);
    }
    return dataset;
}

// Reads a dataset without any daemon. RN_EXIT_INVALID when it cannot be used as it is; *ret_dataset
// is then NULL or what is left. `show` prints the report; without it problems go to stderr where
// there are errors or warnings, or what was asked for is not needed.
static enum rn_exit examine(const char *folder, const struct rn_read_options *options,
                            const struct rn_import_options *kept, bool json, bool show,
                            struct rn_dataset **ret_dataset) {
    struct rn_problems problems = {0};
    struct rn_dataset_report_record report;
    struct rn_error err = {0};
    struct rn_findings found;
    *ret_dataset = read_dataset(folder, options, kept, json, &problems, &found);
    bool unused = *ret_dataset &&
                  kept->test_every != rn_import_settle(*ret_dataset, kept, &problems).test_every;
    bool failed = problems.errors > 0, worth_saying = failed || problems.warnings > 0 || unused;
    enum rn_status status =
        *ret_dataset ? rn_dataset_report_fill(*ret_dataset, &problems, &found, kept, &report, &err)
                     : rn_report_problems_fill(&problems, &report, &err);
    rn_problems_finish(&problems);
    if (status != RN_OK) return rn_client_fail(&err);
    if (json)
        print_json_report(*ret_dataset ? &rn_dataset_report_table : &bad_table, &report, show);
    else if (show && *ret_dataset)
        print_report(folder, *ret_dataset, &report);
    else if (show || worth_saying)
        print_problems(show ? stdout : stderr, &report);
    rn_message_finish(&rn_dataset_report_table, &report);
    return failed ? RN_EXIT_INVALID : RN_EXIT_OK;
}

struct import_options {
    const char *name, *dataset, *alpha, *split, *bounds, *up, *crop, *format, *masks, *poses,
        *backdrop;
    int64_t max_size, scales;
    bool skip_bad;
};

// What is asked for, as the daemon will be; false, with an explanation, where it is not understood.
static bool take_options(const struct import_options *from, struct rn_ingest_options *ret) {
    char name[RN_NAME_MAX];
    if (!rn_take_text("--name", from->name, rn_check_name, name, sizeof name)) return false;
    rn_message_init(&rn_ingest_options_table, ret);
    ret->max_size = from->max_size;
    ret->scales = from->scales;
    ret->alpha = from->alpha ? rn_name_index(rn_downscale_names, from->alpha) : -1;
    ret->backdrop = from->backdrop ? rn_name_index(rn_backdrop_names, from->backdrop) : -1;
#define TAKE(field, check)                                                                         \
    rn_take_text("--" #field, from->field, check, ret->field, sizeof ret->field)
    return TAKE(split, rn_check_split_spec) && TAKE(bounds, rn_check_bounds) &&
           TAKE(up, rn_check_up) && TAKE(crop, rn_check_crop) && TAKE(format, rn_check_format) &&
           TAKE(masks, rn_check_inner_path);
#undef TAKE
}

// ---- photographs without poses ----

// What was found at a path: a dataset, or, where `bare`, photographs or a film without poses.
struct capture {
    struct rn_ingest_options asked;
    struct rn_dataset *dataset;
    struct rn_photos photos;
    bool bare;
};

static void finish_capture(struct capture *capture) {
    rn_dataset_destroy(&capture->dataset);
    rn_photos_finish(&capture->photos);
}

// Whether poses are to be looked for: asked for, a film, or a folder that no document describes.
static bool wants_poses(const char *path, const struct import_options *options) {
    const struct rn_format *found[RN_FORMATS_MAX];
    size_t count = 0;
    if (options->poses && strcmp(options->poses, "auto") != 0)
        return strcmp(options->poses, "find") == 0;
    if (options->format) return false;
    if (rn_is_film(path)) return true;
    if (rn_formats_recognise(path, found, &count, NULL) != RN_OK || count) return false;
    char *inner = rn_formats_find_below(path); // whose poses would be left out
    free(inner);
    if (inner) return false;
    struct rn_photos photos;
    enum rn_status status = rn_photos_read(path, options->masks, NULL, &photos, NULL);
    if (status == RN_OK) rn_photos_finish(&photos);
    return status == RN_OK || status == RN_ERROR_UNSUPPORTED;
}

// As examine, of photographs without poses.
static enum rn_exit examine_photos(const char *path, const struct import_options *options,
                                   bool json, bool show, struct capture *capture) {
    struct rn_problems problems = {0};
    struct rn_dataset_report_record report;
    struct rn_error err = {0};
    struct rn_progress progress;
    struct rn_findings found;
    enum rn_status status = rn_photos_read(path, options->masks, &problems, &capture->photos, &err);
    if (status == RN_OK) {
        rn_progress_init(&progress, !json);
        status = rn_photos_check(&capture->photos, path, rn_usable_cores(), &problems, show_checked,
                                 &progress, &found, &err);
        rn_progress_finish(&progress);
    }
    if (status == RN_OK && !capture->photos.film && !capture->photos.count)
        status = rn_error_set(&err, RN_ERROR_INVALID, path, "holds no photograph that is usable");
    if (status == RN_OK)
        rn_photos_tell(&capture->photos, path, &problems);
    else
        rn_problems_add(&problems, RN_SEVERITY_ERROR, err.where, "%s", err.text);
    bool failed = problems.errors > 0;
    status = rn_report_problems_fill(&problems, &report, &err);
    rn_problems_finish(&problems);
    if (status != RN_OK) return rn_client_fail(&err);
    if (json)
        print_json_report(&bad_table, &report, show);
    else if (show || failed)
        print_problems(show ? stdout : stderr, &report);
    rn_message_finish(&rn_dataset_report_table, &report);
    return failed ? RN_EXIT_INVALID : RN_EXIT_OK;
}

static enum rn_exit examine_capture(const char *path, const struct import_options *options,
                                    bool json, bool show, struct capture *capture) {
    struct rn_read_options how = rn_ingest_reading(&capture->asked);
    capture->bare = wants_poses(path, options);
    if (capture->bare) return examine_photos(path, options, json, show, capture);
    struct rn_import_options kept = rn_ingest_keeping(&capture->asked);
    return examine(path, &how, &kept, json, show, &capture->dataset);
}

// What is asked of photographs is not of a scene, and the other way round.
static enum rn_exit check_scene_options(const struct import_options *o, bool scene) {
    const char *const photographs[] = {o->alpha,  o->split, o->bounds, o->up,      o->crop,
                                       o->format, o->masks, o->poses,  o->backdrop};
    bool asked = o->skip_bad || o->max_size != RN_OPTION_ABSENT || o->scales != RN_OPTION_ABSENT;
    for (size_t i = 0; i < sizeof photographs / sizeof *photographs; i++)
        asked = asked || photographs[i];
    if (scene && asked) return rn_client_usage("import", "takes --name and --dataset of a scene");
    if (!scene && o->dataset)
        return rn_client_usage("--dataset", "is of a scene that was exported (.ripscene)");
    return RN_EXIT_OK;
}

static enum rn_exit validate_scene(const struct rn_client *client, const char *path) {
    uint64_t bytes;
    enum rn_exit code = rn_check_scene_file(path, &bytes);
    if (code != RN_EXIT_OK) return code;
    if (client->json) return rn_client_print_file(path, (int64_t)bytes);
    printf("%s: a scene for viewing, as it was written\n", path);
    return RN_EXIT_OK;
}

static enum rn_exit run_validate(struct rn_client *client, const void *context, const char **args) {
    struct capture capture = {.dataset = NULL};
    bool scene = rn_is_scene_file(args[0]);
    if (!scene && !take_options(context, &capture.asked)) return RN_EXIT_USAGE;
    enum rn_exit code = rn_client_check_source(args[0]);
    if (code != RN_EXIT_OK) return code;
    if (scene) return validate_scene(client, args[0]);
    code = examine_capture(args[0], context, client->json, true, &capture);
    finish_capture(&capture);
    return code;
}

// ---- import ----

#define IMPORT(m) .offset = offsetof(struct import_options, m)
static const struct rn_option import_table[] = {
    {.name = "name",
     .kind = RN_OPTION_TEXT,
     IMPORT(name),
     .value = "N",
     .help = "the dataset's name in the daemon, or the scene's"},
    {.name = "dataset",
     .kind = RN_OPTION_TEXT,
     IMPORT(dataset),
     .value = "D",
     .help = "of a scene: the dataset here that it is compared with"},
    {.name = "max-size",
     .kind = RN_OPTION_INTEGER,
     IMPORT(max_size),
     .value = "PX",
     .min = 1,
     .max = 16384,
     .help = "scale images down until the longest side has PX pixels"},
    {.name = "scales",
     .kind = RN_OPTION_INTEGER,
     IMPORT(scales),
     .value = "K",
     .min = 1,
     .max = 8,
     .help = "keep each image at K sizes, each half of the one before"},
    {.name = "alpha",
     .kind = RN_OPTION_CHOICE,
     IMPORT(alpha),
     .choices = rn_downscale_names,
     .help = "how sizes are averaged; straight as in the published benchmark"},
    {.name = "split",
     .kind = RN_OPTION_TEXT,
     IMPORT(split),
     .value = "SPEC",
     .help = "files, or every:N to make each N-th training view a test view"},
    {.name = "bounds",
     .kind = RN_OPTION_TEXT,
     IMPORT(bounds),
     .value = "X,Y,Z,R",
     .help = "the sphere that holds the scene; else by layout, cameras and points"},
    {.name = "up",
     .kind = RN_OPTION_TEXT,
     IMPORT(up),
     .value = "X,Y,Z",
     .help = "which way is up, or an axis such as z or -y; else by the cameras or GPS"},
    {.name = "crop",
     .kind = RN_OPTION_TEXT,
     IMPORT(crop),
     .value = "BOX",
     .help = "the box that matters, X0,Y0,Z0,X1,Y1,Z1; its sphere is the scene's"},
    {.name = "format",
     .kind = RN_OPTION_TEXT,
     IMPORT(format),
     .value = "NAME",
     .help = "read the folder as this format; else it is recognised by its files"},
    {.name = "masks",
     .kind = RN_OPTION_TEXT,
     IMPORT(masks),
     .value = "DIR",
     .help = "folder of masks below the dataset's, black is left out; else masks"},
    {.name = "poses",
     .kind = RN_OPTION_CHOICE,
     IMPORT(poses),
     .choices = rn_poses_names,
     .help = "find poses with COLMAP, or take a file's; auto: find where no file has them"},
    {.name = "backdrop",
     .kind = RN_OPTION_CHOICE,
     IMPORT(backdrop),
     .choices = rn_backdrop_names,
     .help = "one colour that photographs stand on is cut off, or kept as part of the scene"},
    {.name = "skip-bad",
     .kind = RN_OPTION_FLAG,
     IMPORT(skip_bad),
     .help = "go without photographs that cannot be used"},
    {0}};

// What was found in it, on the way too.
static void print_findings(const struct rn_dataset_record *dataset) {
    struct rn_dataset_report_record report;
    const struct rn_bounds_record *bounds = &dataset->bounds;
    double centre[3];
    for (int i = 0; i < 3; i++)
        centre[i] = rn_unless_zero(bounds->centre[i], bounds->radius);
    if (dataset->capture >= 0) printf("%s, ", rn_capture_titles[dataset->capture]);
    printf("bounds: centre (%.4g, %.4g, %.4g), radius %.4g, %s\n", centre[0], centre[1], centre[2],
           bounds->radius, rn_bounds_source_titles[bounds->source]);
    if (!dataset->report || rn_decode(&rn_dataset_report_table, dataset->report,
                                      strlen(dataset->report), &report, NULL, NULL) != RN_OK)
        return;
    print_problems(stdout, &report);
    rn_message_finish(&rn_dataset_report_table, &report);
}

static enum rn_exit print_dataset(struct rn_client *client, const char *id) {
    enum rn_kind kind;
    struct rn_api_reply reply;
    struct rn_dataset_record dataset;
    enum rn_exit code = rn_api_find(client, RN_KIND_DATASET, id, &kind, &reply);
    if (code != RN_EXIT_OK) return code;
    if (client->json) {
        puts((char *)reply.http.body.data);
    } else if ((code = rn_api_decode(&reply, &rn_dataset_table, &dataset)) == RN_EXIT_OK) {
        printf("dataset %s (%s): %lld views to train, %lld to validate, %lld to test, %lldx%lld, "
               "%lld scale%s\n",
               dataset.name, dataset.id, (long long)dataset.views.train,
               (long long)dataset.views.val, (long long)dataset.views.test,
               (long long)dataset.width, (long long)dataset.height, (long long)dataset.scales,
               dataset.scales == 1 ? "" : "s");
        print_findings(&dataset);
        rn_print_past(&dataset.past);
        rn_message_finish(&rn_dataset_table, &dataset);
    }
    rn_api_reply_finish(&reply);
    return code;
}

static enum rn_exit pack(const char *path, const struct capture *capture, struct rn_tar **ret_tar) {
    struct rn_error err = {0};
    char *copy = strdup(path);
    if (!copy) return rn_client_usage("import", "no memory");
    bool is_file = capture->bare && rn_is_film(path);
    const char *folder = is_file ? dirname(copy) : path;
    enum rn_status status = rn_tar_create(folder, ret_tar, &err);
    if (status == RN_OK && capture->bare) {
        status = rn_pack_photos(*ret_tar, folder, &capture->photos, &err);
    } else if (status == RN_OK) {
        status = rn_pack_dataset(*ret_tar, folder, capture->dataset, &err);
    }
    free(copy);
    return status == RN_OK ? RN_EXIT_OK : rn_client_fail(&err);
}

// Before anything is decoded or sent. A daemon that is away is found out here, too.
static enum rn_exit check_name(struct rn_client *client, const char *name) {
    struct rn_api_reply reply;
    char *path = rn_api_path("datasets", name, "");
    if (!path) return RN_EXIT_FAILED;
    rn_api_send(client, "GET", path, NULL, &reply);
    free(path);
    enum rn_exit code = RN_EXIT_OK;
    if (reply.code == RN_EXIT_OK) {
        code = rn_client_error(RN_EXIT_FAILED, "--name",
                               "there is a dataset '%s' already; choose another name", name);
    } else if (reply.code == RN_EXIT_UNREACHABLE || reply.code == RN_EXIT_UNAUTHORISED) {
        code = rn_api_complain(&reply);
    }
    rn_api_reply_finish(&reply);
    return code;
}

static enum rn_exit run_import(struct rn_client *client, const void *context, const char **args) {
    const struct import_options *options = context;
    struct capture capture = {.dataset = NULL};
    struct rn_tar *tar = NULL;
    char job[RN_ID_MAX];
    bool scene = rn_is_scene_file(args[0]);
    if (!options->name) return rn_name_missing("import", args[0]);
    if (check_scene_options(options, scene) != RN_EXIT_OK) return RN_EXIT_USAGE;
    if (!scene && !take_options(options, &capture.asked)) return RN_EXIT_USAGE;
    if (scene) return rn_import_scene(client, args[0], options->name, options->dataset);
    enum rn_exit code = check_name(client, options->name);
    if (code == RN_EXIT_OK) code = rn_client_check_source(args[0]);
    if (code != RN_EXIT_OK) return code;
    code = examine_capture(args[0], options, client->json, false, &capture);
    bool left = capture.dataset || capture.photos.count;
    if (code == RN_EXIT_INVALID && left && options->skip_bad) code = RN_EXIT_OK;
    if (code != RN_EXIT_OK) {
        rn_client_note("ripnerf: %s: nothing was sent%s", args[0],
                       left ? "; mend what is named above, or go without it: --skip-bad" : "");
    } else {
        code = pack(args[0], &capture, &tar);
    }
    if (capture.bare) capture.asked.poses = RN_POSES_FIND;
    if (code == RN_EXIT_OK) code = rn_upload(client, tar, options->name, &capture.asked, job);
    if (tar) rn_tar_destroy(&tar);
    finish_capture(&capture);
    if (code != RN_EXIT_OK) return code;
    struct rn_follow follow = {.client = client, .quiet = client->json};
    code = rn_follow_job(&follow, job);
    if (code == RN_EXIT_OK) code = print_dataset(client, follow.job.dataset);
    rn_follow_finish(&follow);
    return code;
}

// ---- synth ----

struct synth_options {
    int64_t size, views, movers;
    const char *lens;
    double exposure, aperture, shutter;
    bool capture;
};
#define SYNTH(m) .offset = offsetof(struct synth_options, m)
static const struct rn_option synth_table[] = {
    {.name = "size",
     .kind = RN_OPTION_INTEGER,
     SYNTH(size),
     .value = "N",
     .min = 8,
     .max = 4096,
     .help = "pixels a side (200)"},
    {.name = "views",
     .kind = RN_OPTION_INTEGER,
     SYNTH(views),
     .value = "N",
     .min = 1,
     .max = 10000,
     .help = "training views (60); a quarter as many, 8 at least, to validate and to test"},
    {.name = "lens",
     .kind = RN_OPTION_TEXT,
     SYNTH(lens),
     .value = "K1,K2,P1,P2",
     .help = "a lens that bends the pictures, as OpenCV's; -0.2 alone is K1"},
    {.name = "exposure",
     .kind = RN_OPTION_NUMBER,
     SYNTH(exposure),
     .value = "STOPS",
     .max = 4,
     .help = "photographs are lighter or darker by up to STOPS, but for test views"},
    {.name = "aperture",
     .kind = RN_OPTION_NUMBER,
     SYNTH(aperture),
     .value = "R",
     .max = 1,
     .help = "radius of the lens in the scene's units: test views alone are sharp all over"},
    {.name = "shutter",
     .kind = RN_OPTION_NUMBER,
     SYNTH(shutter),
     .value = "D",
     .max = 1,
     .help = "so far a camera moves while it looks, in the scene's units, but for test views"},
    {.name = "movers",
     .kind = RN_OPTION_INTEGER,
     SYNTH(movers),
     .value = "N",
     .max = RN_SYNTH_MOVERS,
     .help = "people who stand elsewhere in each photograph of a place, in no test view"},
    {.name = "capture",
     .kind = RN_OPTION_FLAG,
     SYNTH(capture),
     .help = "write images/ and sparse/0 with points as COLMAP does, for import --split every:8"},
    {0}};

// "K1,K2,P1,P2" or its beginning.
static bool parse_lens(const char *text, double lens[RN_SYNTH_LENS]) {
    for (int i = 0; i < RN_SYNTH_LENS; i++) {
        char *end;
        lens[i] = strtod(text, &end);
        if (end == text || !isfinite(lens[i])) return false;
        if (!*end) return true;
        if (*end != ',') return false;
        text = end + 1;
    }
    return false;
}

static enum rn_exit run_synth(struct rn_client *client, const void *context, const char **args) {
    const struct synth_options *options = context;
    struct rn_progress progress;
    struct rn_error err = {0};
    struct rn_synth_options synth = {.size = 200, .views = 60, .threads = rn_usable_cores()};
    if (options->size != RN_OPTION_ABSENT) synth.size = (int)options->size;
    if (options->views != RN_OPTION_ABSENT) synth.views = (int)options->views;
    if (options->movers != RN_OPTION_ABSENT) synth.movers = (int)options->movers;
    if (!isnan(options->exposure)) synth.exposure = options->exposure;
    if (!isnan(options->aperture)) synth.aperture = options->aperture;
    if (!isnan(options->shutter)) synth.shutter = options->shutter;
    synth.capture = options->capture;
    if (options->lens && !parse_lens(options->lens, synth.lens))
        return rn_client_usage("--lens", "\"%.80s\" is not K1,K2,P1,P2 or the first of them",
                               options->lens);
    rn_progress_init(&progress, !client->json);
    enum rn_status status = rn_interrupt_catch(&err);
    if (status == RN_OK)
        status = rn_synthesise(args[0], &synth, args[1], show_made, &progress, &err);
    rn_progress_finish(&progress);
    if (status == RN_ERROR_INVALID) {
        char where[64];
        snprintf(where, sizeof where, "--%.60s", err.where);
        return rn_client_usage(strcmp(err.where, "scene") == 0 ? args[0] : where, "%s", err.text);
    }
    if (status != RN_OK) return rn_client_fail(&err);
    struct rn_dataset *dataset = NULL;
    struct rn_import_options kept = {.scales = 1};
    enum rn_exit code = examine(args[1], NULL, &kept, client->json, client->json, &dataset);
    if (code == RN_EXIT_OK && !client->json)
        printf("%s: %d views to train, %d to validate, %d to test\n", args[1],
               dataset->view_count[RN_SPLIT_TRAIN], dataset->view_count[RN_SPLIT_VAL],
               dataset->view_count[RN_SPLIT_TEST]);
    rn_dataset_destroy(&dataset);
    return code;
}

// ---- datasets ----

static void add_dataset_row(struct rn_text_table *table, const void *message) {
    const struct rn_dataset_record *dataset = message;
    char bytes[24];
    rn_format_bytes((double)dataset->size_bytes, bytes, sizeof bytes);
    rn_text_table_row(table, "%s|%s|%lld|%lld|%lld|%lldx%lld|%lld|%s|%s", dataset->name,
                      dataset->id, (long long)dataset->views.train, (long long)dataset->views.val,
                      (long long)dataset->views.test, (long long)dataset->width,
                      (long long)dataset->height, (long long)dataset->scales, bytes,
                      dataset->created_at);
}

static enum rn_exit run_datasets(struct rn_client *client, const void *options, const char **args) {
    static const struct rn_api_list list = {
        .kind = RN_KIND_DATASET,
        .table = &rn_dataset_table,
        .heading = "NAME|ID|>TRAIN|>VAL|>TEST|>SIZE|>SCALES|>ON DISK|CREATED",
        .row = add_dataset_row};
    return rn_api_print_list(client, &list);
}

const struct rn_verb rn_verbs_dataset[] = {
    {.name = "validate",
     .arguments = "DIR|FILM",
     .summary = "check a dataset here, before anything is sent",
     .details = "Recognises the folder's format by its files, reads it and decodes its images.\n"
                "Takes the options of import, so that it says what import would do. Exit code 4\n"
                "when there is an error, 3 when there is nothing of that name.",
     .args_min = 1,
     .args_max = 1,
     .table = import_table,
     .options_size = sizeof(struct import_options),
     .local = true,
     .run = run_validate},
    {.name = "import",
     .arguments = "DIR|FILM|SCENE --name N",
     .summary = "check it, send it, wait until it is there",
     .details =
         "Sends exactly the files that are read: the format's documents and its images. A "
         "dataset with errors is\n"
         "not sent (exit code 4). For photographs or a film without poses, the daemon looks "
         "for\nthem with the program colmap (and ffmpeg), where they are installed.\nA file that "
         "export --as scene wrote becomes a scene, to be looked at and, with --dataset,\n"
         "evaluated; it is not trained further.",
     .args_min = 1,
     .args_max = 1,
     .table = import_table,
     .options_size = sizeof(struct import_options),
     .run = run_import},
    {.name = "synth",
     .arguments = "NAME DIR",
     .summary = "make a dataset with known truth: sphere, still-life, place, ...",
     .details =
         "Procedural scenes, rendered analytically with 64 rays a pixel. sphere, fence, nested "
         "and\n"
         "still-life are objects cut out by alpha; place (around in a room) and window (out of\n"
         "it) are captures without alpha of a place that reaches to the horizon. The depth of\n"
         "each test view lies beside it, as float32 in test/r_N_depth.npy. What photographs have\n"
         "and the truth has not, options add; test views are never darker, blurred or crowded,\n"
         "of a --capture every 8th photograph from the first.",
     .args_min = 2,
     .args_max = 2,
     .table = synth_table,
     .options_size = sizeof(struct synth_options),
     .local = true,
     .run = run_synth},
    {.name = "datasets",
     .arguments = "",
     .summary = "list datasets",
     .table = no_options,
     .run = run_datasets},
    {0}};

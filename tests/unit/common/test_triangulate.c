// Sparse points that an import finds where its source has none, beside a place whose depth is
// known.
#include <math.h>

#include "common/dataset/calls.h"
#include "common/dataset/reader.h"
#include "common/dataset/survey.h"
#include "common/dataset/triangulate.h"
#include "tests/unit/common/dataset_fixture.h"
#include "tests/unit/common/wall.h"

static struct rn_dataset *kept;

static void finish(void) {
    rn_dataset_destroy(&kept);
    teardown();
}

// `dataset`, imported, read again: `kept`.
static void keep(const char *name, int test_every, int threads) {
    struct rn_import_options how = {.scales = 1, .threads = threads, .test_every = test_every};
    const char *target = in_folder(name);
    ck_assert_int_eq(rn_mkdirs(target, 0700, &err), RN_OK);
    ck_assert_int_eq(rn_dataset_import(dataset, "kept", &how, target, &problems, NULL, NULL, &err),
                     RN_OK);
    rn_dataset_destroy(&kept);
    ck_assert_int_eq(rn_dataset_read(target, NULL, &kept, &err), RN_OK);
}

static const struct rn_synth_options place = {.size = 160, .views = 32, .threads = 4, .samples = 4};
static char photographs[64]; // of that place, for all tests

static void take_place(void) {
    strcpy(photographs, "/tmp/ripnerf-test-XXXXXX");
    ck_assert_ptr_nonnull(mkdtemp(photographs));
    ck_assert_int_eq(rn_synthesise("place", &place, photographs, NULL, NULL, &err), RN_OK);
}

static void remove_place(void) {
    ck_assert_int_eq(rn_remove_tree(photographs, &err), RN_OK);
}

static void read_place(void) {
    rn_dataset_destroy(&dataset);
    ck_assert_int_eq(rn_dataset_read(photographs, NULL, &dataset, &err), RN_OK);
}

static void take_others(const char *scene, const struct rn_synth_options *options) {
    const char *target = in_folder("photographs");
    ck_assert_int_eq(rn_synthesise(scene, options, target, NULL, NULL, &err), RN_OK);
    ck_assert_int_eq(rn_dataset_read(target, NULL, &dataset, &err), RN_OK);
}

static const struct rn_frame *frame_of(const struct rn_sighting *sighting) {
    for (size_t i = 0; i < kept->frame_count; i++)
        if ((size_t)kept->frames[i].photo == sighting->photo) return &kept->frames[i];
    ck_abort_msg("a sighting by photograph %u, which is not there", sighting->photo);
}

static double distance_of(const struct rn_sighting *sighting) {
    const struct rn_point *point = &kept->points.items[sighting->point];
    double squares = 0;
    for (int i = 0; i < 3; i++) {
        double d = point->position[i] - frame_of(sighting)->camera.world_from_camera[i][3];
        squares += d * d;
    }
    return sqrt(squares);
}

// The true distance of what is seen there that is nearest to `distance`: at the pixel or beside it,
// where a corner is of an edge.
static double truth_at(const char *scene, const struct rn_sighting *sighting, double distance) {
    const struct rn_frame *frame = frame_of(sighting);
    struct rn_camera camera = frame->camera;
    struct rn_picture depth;
    double best = HUGE_VAL;
    camera.cx -= (double)sighting->x * camera.width - 1.5; // three pixels about it
    camera.cy -= (double)sighting->y * camera.height - 1.5;
    camera.width = camera.height = 3;
    ck_assert_int_eq(rn_synth_depth(scene, &camera, &depth, &err), RN_OK);
    for (int i = 0; i < 9; i++)
        if (fabs((double)depth.values[i] - distance) < fabs(best - distance))
            best = (double)depth.values[i];
    rn_picture_finish(&depth);
    return best;
}

// The share of the sightings whose distance is right within a twentieth.
static double right_share(const char *scene) {
    const struct rn_points *points = &kept->points;
    size_t right = 0;
    for (size_t i = 0; i < points->sighting_count; i++) {
        double distance = distance_of(&points->sightings[i]);
        double truth = truth_at(scene, &points->sightings[i], distance);
        right += fabs(distance / truth - 1) < 0.05;
    }
    return (double)right / (double)points->sighting_count;
}

// By straight cameras, and by ones that bend the picture.
START_TEST(points_lie_where_the_place_is) {
    struct rn_synth_options bent = place;
    bent.lens[0] = -0.1;
    if (_i)
        take_others("place", &bent);
    else
        read_place();
    keep("kept", 0, 4);
    ck_assert_uint_gt(kept->points.count, 1000);
    ck_assert_uint_gt(kept->points.sighting_count, 4 * kept->points.count);
    ck_assert_double_gt(right_share("place"), 0.96);
    ck_assert(problems_tell(RN_SEVERITY_INFO, "were found where photographs look alike"));
}
END_TEST

static size_t read_points(const char *name, uint8_t **ret_bytes) {
    size_t size;
    ck_assert_int_eq(rn_file_read(in_folder(name), 1 << 24, ret_bytes, &size, &err), RN_OK);
    return size;
}

START_TEST(they_are_the_same_for_any_number_of_threads) {
    uint8_t *one, *three;
    read_place();
    keep("one", 0, 1);
    read_place();
    keep("three", 0, 3);
    size_t one_size = read_points("one/points.bin", &one);
    ck_assert_uint_eq(read_points("three/points.bin", &three), one_size);
    ck_assert_mem_eq(one, three, one_size);
    free(one);
    free(three);
}
END_TEST

// The place as a capture without splits, every fourth of which tests.
static void keep_split(const char *name) {
    for (size_t i = 0; i < dataset->frame_count; i++) {
        dataset->frames[i].split = RN_SPLIT_TRAIN;
        dataset->frames[i].index = (int)i;
    }
    dataset->view_count[RN_SPLIT_TEST] = 0;
    keep(name, 4, 4);
    ck_assert_int_gt(kept->view_count[RN_SPLIT_TEST], 8);
}

static enum rn_split split_of(const struct rn_sighting *sighting) {
    return frame_of(sighting)->split;
}

static size_t sightings_in(enum rn_split split) {
    size_t count = 0;
    for (size_t i = 0; i < kept->points.sighting_count; i++)
        count += split_of(&kept->points.sightings[i]) == split;
    return count;
}

START_TEST(photographs_that_are_withheld_see_them) {
    read_place();
    keep_split("kept");
    size_t seen = 0;
    for (size_t f = 0; f < kept->frame_count; f++) {
        size_t count = 0;
        for (size_t i = 0; i < kept->points.sighting_count; i++)
            count += (size_t)kept->frames[f].photo == kept->points.sightings[i].photo;
        if (kept->frames[f].split == RN_SPLIT_TEST) seen += count >= 30;
    }
    ck_assert_uint_ge(10 * seen, 9 * (size_t)kept->view_count[RN_SPLIT_TEST]);
    ck_assert_double_gt(right_share("place"), 0.96);
}
END_TEST

// What those withheld show moves no point, nor is one found or seen elsewhere by it.
START_TEST(photographs_that_are_withheld_say_nothing_of_where_they_are) {
    read_place();
    keep_split("kept");
    struct rn_points before = kept->points;
    size_t trained = sightings_in(RN_SPLIT_TRAIN);
    kept->points = (struct rn_points){0};
    read_place();
    for (size_t i = 0; i < dataset->frame_count; i += 4) { // another picture in their place
        free(dataset->frames[i].path);
        dataset->frames[i].path = strdup(dataset->frames[1].path);
    }
    keep_split("others");
    ck_assert_uint_eq(kept->points.count, before.count);
    for (size_t i = 0; i < before.count; i++) {
        ck_assert_mem_eq(kept->points.items[i].position, before.items[i].position,
                         sizeof before.items[i].position);
        ck_assert_mem_eq(kept->points.items[i].colour, before.items[i].colour, 3);
    }
    ck_assert_uint_eq(sightings_in(RN_SPLIT_TRAIN), trained);
    ck_assert_uint_lt(10 * sightings_in(RN_SPLIT_TEST), before.sighting_count - trained);
    free(before.items);
    free(before.sightings);
}
END_TEST

// Mean logarithm, over what neither cuts, of how much brighter a photograph is than another.
static double brighter(const struct rn_frame *frame, const struct rn_frame *than) {
    struct rn_image images[2];
    double sum = 0;
    size_t count = 0;
    ck_assert_int_eq(rn_frame_decode(frame, NULL, &images[0], &err), RN_OK);
    ck_assert_int_eq(rn_frame_decode(than, NULL, &images[1], &err), RN_OK);
    for (size_t i = 0; i < 4 * (size_t)images[0].width * (size_t)images[0].height; i += 4) {
        uint8_t a = images[0].pixels[i + 1], b = images[1].pixels[i + 1];
        if (a < 30 || b < 30 || a > 240 || b > 240) continue;
        sum += log((double)a / b);
        count++;
    }
    rn_image_finish(&images[0]);
    rn_image_finish(&images[1]);
    return sum / (double)count;
}

// Of `kept` beside `dataset`, the same photographs as they are.
static void check_gains(void) {
    double known[64], found[64], known_mean = 0, found_mean = 0, spread = 0, error = 0;
    size_t count = 0;
    for (size_t i = 0; i < dataset->frame_count; i++) {
        ck_assert_str_eq(dataset->frames[i].name, kept->frames[i].name);
        if (!(kept->frames[i].gain[0] > 0)) continue;
        known[count] = brighter(&kept->frames[i], &dataset->frames[i]);
        found[count] = log(kept->frames[i].gain[1]);
        known_mean += known[count];
        found_mean += found[count];
        count++;
    }
    ck_assert_uint_ge(10 * count, 9 * dataset->frame_count);
    for (size_t i = 0; i < count; i++) {
        double is = known[i] - known_mean / (double)count;
        double off = found[i] - found_mean / (double)count - is;
        spread += is * is / (double)count;
        error += off * off / (double)count;
        ck_assert_double_lt(fabs(off), 0.09);
    }
    ck_assert_double_gt(sqrt(spread), 0.1);
    ck_assert_double_lt(sqrt(error), 0.04);
    ck_assert_double_gt(rn_exposure_unrest(kept->frames, kept->frame_count), RN_EXPOSURE_UNREST);
}

// By what the points look like in each, also in those withheld.
START_TEST(they_say_how_bright_photographs_are) {
    struct rn_synth_options unlike = place;
    unlike.exposure = 0.7;
    take_others("place", &unlike);
    keep("kept", 0, 4);
    read_place(); // as it is
    check_gains();
}
END_TEST

// Of photographs that look one way between known depths nothing else is kept of what was found.
START_TEST(between_known_depths_they_say_nothing_else) {
    struct rn_synth_options window = {.size = 160, .views = 32, .threads = 4, .samples = 4};
    const char *even = in_folder("even");
    ck_assert_int_eq(rn_synthesise("window", &window, even, NULL, NULL, &err), RN_OK);
    window.exposure = 0.7;
    take_others("window", &window);
    for (size_t i = 0; i < dataset->frame_count; i++) {
        dataset->frames[i].near = 1.5;
        dataset->frames[i].far = 60;
    }
    ck_assert(rn_faces_one_way(dataset));
    keep("kept", 0, 4);
    ck_assert(!problems_tell(RN_SEVERITY_INFO, "were found"));
    ck_assert_uint_eq(kept->points.count, 0);
    ck_assert_double_eq(kept->frames[0].near, 1.5);
    rn_dataset_destroy(&dataset);
    ck_assert_int_eq(rn_dataset_read(even, NULL, &dataset, &err), RN_OK);
    check_gains();
}
END_TEST

START_TEST(none_are_looked_for_where_they_say_nothing) {
    struct rn_synth_options few = {.size = 96, .views = 32, .threads = 4, .samples = 1};
    take_others("still-life", &few); // cut out by alpha
    keep("kept", 0, 4);
    ck_assert_uint_eq(kept->points.count, 0);
}
END_TEST

// The nearest and the farthest depth, but the sky's, that photographs of the window show.
static void true_depths(double *ret_near, double *ret_far) {
    *ret_near = HUGE_VAL;
    *ret_far = 0;
    for (size_t i = 0; i < kept->frame_count; i++) {
        const struct rn_camera *camera = &kept->frames[i].camera;
        struct rn_picture depth;
        ck_assert_int_eq(rn_synth_depth("window", camera, &depth, &err), RN_OK);
        for (int p = 0; p < depth.width * depth.height; p++) {
            struct rn_ray ray =
                rn_camera_ray(camera, p % depth.width + 0.5, (double)(p / depth.width) + 0.5);
            double along = 0;
            for (int k = 0; k < 3; k++)
                along += camera->world_from_camera[k][2] * ray.direction[k];
            if (!isfinite(depth.values[p])) continue;
            *ret_near = fmin(*ret_near, along * (double)depth.values[p]);
            *ret_far = fmax(*ret_far, along * (double)depth.values[p]);
        }
        rn_picture_finish(&depth);
    }
}

// By points that the import finds, and by those of a COLMAP model.
START_TEST(photographs_that_look_one_way_have_depths) {
    struct rn_synth_options options = {
        .size = 160, .views = 32, .threads = 4, .samples = 4, .capture = _i > 0};
    double near, far;
    take_others("window", &options);
    if (_i)
        ck_assert_double_gt(dataset->frames[0].near, 0);
    else
        ck_assert_double_eq(dataset->frames[0].far, 0);
    keep("kept", 0, 4);
    true_depths(&near, &far);
    ck_assert_double_gt(kept->frames[0].near, near);
    ck_assert_double_lt(0.85 * kept->frames[0].near, near); // from where training looks
    ck_assert_double_gt(kept->frames[0].far, 10 * near);
    ck_assert_double_lt(kept->frames[0].far, far);
    for (size_t i = 0; i < kept->frame_count; i++) {
        ck_assert_double_eq(kept->frames[i].near, kept->frames[0].near);
        ck_assert_double_eq(kept->frames[i].far, kept->frames[0].far);
    }
    ck_assert(rn_faces_one_way(kept));
}
END_TEST

START_TEST(sightings_of_the_source_stay_as_they_are) {
    struct rn_synth_options few = {
        .size = 64, .views = 16, .threads = 4, .samples = 1, .capture = true};
    take_others(_i ? "window" : "place", &few);
    ck_assert(rn_faces_one_way(dataset) == (_i == 1));
    size_t points = dataset->points.count, sightings = dataset->points.sighting_count;
    keep("kept", 0, 4);
    ck_assert_uint_gt(sightings, 0);
    ck_assert_uint_eq(kept->points.count, points);
    ck_assert_uint_eq(kept->points.sighting_count, sightings);
}
END_TEST

// They lie where the poses have them: also those of a dataset that was imported so.
START_TEST(points_that_are_found_say_nothing_of_poses) {
    struct rn_import_options how = {.scales = 1, .threads = 1};
    struct rn_survey *survey;
    struct rn_findings found;
    read_place();
    keep("kept", 0, 4);
    ck_assert_int_eq(rn_survey_create(dataset, &survey, &err), RN_OK);
    ck_assert_int_eq(rn_survey_conclude(survey, dataset, &how, NULL, &found, &err), RN_OK);
    ck_assert_double_nan(found.reprojection_px);
    rn_survey_destroy(&survey);
    rn_dataset_destroy(&kept);
    ck_assert_int_eq(rn_dataset_read(in_folder("kept"), &problems, &kept, &err), RN_OK);
    ck_assert(!problems_tell(RN_SEVERITY_INFO, "reprojection error"));
}
END_TEST

// Of which no file says who saw them: those that are found come after them, and there is room.
START_TEST(points_of_the_source_are_kept) {
    size_t count = _i ? RN_POINTS_MAX : 1;
    read_place();
    dataset->points.sightings = malloc(1); // none, as of a dataset that was imported
    dataset->points.items = calloc(count, sizeof *dataset->points.items);
    dataset->points.items[0].position[2] = 7;
    dataset->points.count = count;
    keep("kept", 0, 4);
    size_t stayed = _i ? RN_POINTS_MAX / 2 : 1;
    char words[64];
    snprintf(words, sizeof words, " %zu were found", kept->points.count - stayed);
    ck_assert(problems_tell(RN_SEVERITY_INFO, words));
    ck_assert_uint_gt(kept->points.count, stayed + 1000);
    ck_assert_double_eq(kept->points.items[0].position[2], 7);
    for (size_t i = 0; i < kept->points.sighting_count; i++)
        ck_assert_uint_ge(kept->points.sightings[i].point, stayed);
}
END_TEST

// What is found of a wall by `count` of its photographs from one on.
static size_t look_at(struct rn_dataset *wall, size_t first, size_t count) {
    struct rn_triangulation *triangulation;
    size_t found;
    ck_assert_int_eq(rn_triangulation_create(wall, 0, &triangulation, &err), RN_OK);
    for (size_t i = first; i < first + count; i++) {
        struct rn_image image = wall_photograph(&wall->frames[i].camera);
        rn_triangulation_look(triangulation, &wall->frames[i], &image);
        rn_image_finish(&image);
    }
    ck_assert_int_eq(rn_triangulation_solve(triangulation, 2, wall, NULL, NULL, &found, &err),
                     RN_OK);
    rn_triangulation_destroy(&triangulation);
    return found;
}

static double right_share_of(const struct rn_dataset *wall) {
    size_t right = 0;
    for (size_t i = 0; i < wall->points.count; i++)
        right += fabs(wall->points.items[i].position[2] / WALL_AWAY - 1) < 0.02;
    return (double)right / (double)wall->points.count;
}

// Also where the small copies lack a margin of the photographs.
START_TEST(they_are_seen_where_the_photographs_show_them) {
    struct rn_dataset wall = wall_dataset(9, 1, 799, 601);
    struct rn_reprojection found;
    ck_assert_uint_gt(look_at(&wall, 0, 9), 1000);
    ck_assert_double_gt(right_share_of(&wall), 0.99);
    ck_assert_int_eq(rn_dataset_reproject(&wall, &found, &err), RN_OK);
    ck_assert_double_lt(found.p95_px, 1e-3);
    wall_finish(&wall);
}
END_TEST

// By several photographs from each place, of which one says as much as all; more of them from one
// than are looked for.
START_TEST(they_are_seen_from_different_places) {
    size_t each = _i ? 14 : 4;
    struct rn_dataset wall = wall_dataset(9 * each, each, 120, 90);
    ck_assert_uint_gt(look_at(&wall, 0, 9 * each), 1000);
    ck_assert_double_gt(right_share_of(&wall), 0.96);
    const struct rn_points *points = &wall.points;
    for (size_t i = 1; i < points->sighting_count; i++)
        for (size_t k = i; k > 0 && points->sightings[k - 1].point == points->sightings[i].point;
             k--)
            ck_assert_uint_ne(points->sightings[k - 1].photo / each,
                              points->sightings[i].photo / each);
    wall_finish(&wall);
}
END_TEST

// From one place nothing is known to be anywhere, and of photographs that have no insides.
START_TEST(photographs_that_say_nothing_are_none) {
    struct rn_dataset same = wall_dataset(16, 16, 80, 60);
    ck_assert_uint_eq(look_at(&same, 0, 16), 0);
    wall_finish(&same);
    for (int side = 1; side < 12; side++) {
        struct rn_dataset small = wall_dataset(9, 1, side, side);
        ck_assert_uint_eq(look_at(&small, 0, 9), 0);
        wall_finish(&small);
    }
    struct rn_dataset strip = wall_dataset(9, 1, RN_CAMERA_MAX_SIZE, 7);
    ck_assert_uint_eq(look_at(&strip, 0, 9), 0);
    wall_finish(&strip);
}
END_TEST

// Up to so many all photographs are looked at; four beside each other are as few as say something.
START_TEST(beyond_so_many_photographs_are_passed_over) {
    size_t count = RN_TRIANGULATE_PHOTOS + (size_t)_i;
    struct rn_dataset wall = wall_dataset(count, 1, 160, 120);
    size_t found = look_at(&wall, 300, 4);
    if (_i)
        ck_assert_uint_eq(found, 0);
    else
        ck_assert_uint_gt(found, 10);
    wall_finish(&wall);
}
END_TEST

static int at_the_end; // calls of `once` after all photographs

static bool once(void *context, size_t done, size_t total) {
    (void)context;
    return done < total || at_the_end++ == 0;
}

START_TEST(looking_for_them_can_be_cancelled) {
    struct rn_import_options how = {.scales = 1, .threads = 1};
    read_place();
    ck_assert_int_eq(rn_mkdirs(in_folder("kept"), 0700, &err), RN_OK);
    ck_assert_int_eq(
        rn_dataset_import(dataset, "kept", &how, in_folder("kept"), &problems, once, NULL, &err),
        RN_ERROR_CANCELLED);
    ck_assert_int_eq(at_the_end, 2);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("triangulate");
    TCase *c = tcase_create("points");
    tcase_set_timeout(c, 240);
    tcase_add_unchecked_fixture(c, take_place, remove_place);
    tcase_add_checked_fixture(c, setup, finish);
    tcase_add_loop_test(c, points_lie_where_the_place_is, 0, 2);
    tcase_add_test(c, they_are_the_same_for_any_number_of_threads);
    tcase_add_test(c, photographs_that_are_withheld_see_them);
    tcase_add_test(c, photographs_that_are_withheld_say_nothing_of_where_they_are);
    tcase_add_test(c, they_say_how_bright_photographs_are);
    tcase_add_test(c, between_known_depths_they_say_nothing_else);
    tcase_add_test(c, none_are_looked_for_where_they_say_nothing);
    tcase_add_loop_test(c, photographs_that_look_one_way_have_depths, 0, 2);
    tcase_add_loop_test(c, sightings_of_the_source_stay_as_they_are, 0, 2);
    tcase_add_test(c, points_that_are_found_say_nothing_of_poses);
    tcase_add_loop_test(c, points_of_the_source_are_kept, 0, 2);
    tcase_add_test(c, they_are_seen_where_the_photographs_show_them);
    tcase_add_loop_test(c, they_are_seen_from_different_places, 0, 2);
    tcase_add_test(c, photographs_that_say_nothing_are_none);
    tcase_add_loop_test(c, beyond_so_many_photographs_are_passed_over, 0, 2);
    tcase_add_test(c, looking_for_them_can_be_cancelled);
    suite_add_tcase(suite, c);
    return run_suite(suite);
}

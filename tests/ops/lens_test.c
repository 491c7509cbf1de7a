// Photographs through lenses: what a lens changes is seen and undone, and one that changes nothing
// costs nothing.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/dataset/output.h"
#include "common/image/image.h"
#include "server/engine/field/occupancy.h"
#include "server/engine/field/space.h"
#include "tests/ops/train_scene.h"

// The sphere's dataset with another lens; photographs anew where `shown`.
struct lens_case {
    struct rn_dataset dataset;
    struct rn_frame *frames;
};

static void photograph(struct rn_frame *frame, size_t index) {
    struct rn_picture picture;
    struct rn_image image;
    struct rn_error err;
    ck_assert_int_eq(rn_synth_render("sphere", &frame->camera, 4, &picture, &err), RN_OK);
    ck_assert_int_eq(rn_picture_to_image(&picture, &image, &err), RN_OK);
    image.has_alpha = true;
    ck_assert_int_gt(asprintf(&frame->path, "%s/lens_%zu.png", folder, index), 0);
    (void)remove(frame->path);
    ck_assert_int_eq(rn_output_png(&image, frame->path, 1, &err), RN_OK);
    rn_image_finish(&image);
    rn_picture_finish(&picture);
}

static struct lens_case through(enum rn_lens lens, double k1, double p2, bool shown) {
    struct lens_case c = {.dataset = *dataset};
    c.dataset.frames = c.frames = malloc(dataset->frame_count * sizeof *c.frames);
    for (size_t f = 0; f < dataset->frame_count; f++) {
        struct rn_frame *frame = &c.frames[f];
        *frame = dataset->frames[f];
        frame->camera.lens = lens;
        frame->camera.lens_k[0] = k1;
        if (lens == RN_LENS_OPENCV) frame->camera.lens_k[3] = p2;
        if (lens == RN_LENS_FISHEYE) frame->camera.fx = frame->camera.fy = 40;
        ck_assert_int_eq(rn_camera_check(&frame->camera, "", NULL), RN_OK);
        if (shown) photograph(frame, f);
    }
    return c;
}

static void finish(struct lens_case *c, bool shown) {
    for (size_t f = 0; f < c->dataset.frame_count && shown; f++)
        free(c->frames[f].path);
    free(c->frames);
}

static const struct rn_effect_record *distortion(const struct rn_trainer *t) {
    return &t->field->effects[RN_EFFECT_DISTORTION];
}

static const struct {
    enum rn_lens lens;
    double k1;
} lenses[] = {{RN_LENS_OPENCV, -0.6}, {RN_LENS_OPENCV, 1.5}, {RN_LENS_FISHEYE, 0.1}};

static bool meets_hull(const struct rn_trainer *t, const struct rn_march_ray *ray) {
    int cells = t->field->config.field.occupancy, cell[3];
    double step = 0.25 / cells;
    for (int k = 0; (k + 0.5) * step < (double)ray->length; k++) {
        for (int i = 0; i < 3; i++)
            cell[i] = rn_cell_of(
                (double)ray->origin[i] + (double)ray->direction[i] * (k + 0.5) * step, cells);
        if (t->field->hull[(cell[0] * cells + cell[1]) * cells + cell[2]]) return true;
    }
    return false;
}

// Nothing that a photograph shows is carved, rays are drawn from all pixels that see the hull, and
// a good deal is carved.
START_TEST(hull_is_seen_through_the_lens) {
    struct lens_case c = through(lenses[_i].lens, lenses[_i].k1, 0.02, true);
    struct rn_train_config config = config_for(&c.dataset);
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *t = trainer_for(engine, &c.dataset, &config);
    int opaque = 0, seen = 0, cells = config.field.occupancy;
    ck_assert_msg(distortion(t)->on, "%s", distortion(t)->reason);
    ck_assert_double_gt(distortion(t)->number, 0.5);
    for (int f = 0; f < t->train.frame_count; f++) {
        const struct rn_pixel_frame *frame = &t->train.frames[f];
        for (int y = 0; y < frame->camera.height; y += 2)
            for (int x = f % 2; x < frame->camera.width; x += 2) {
                struct rn_march_ray ray = rn_trainer_ray(t, &t->train, frame, x, y, 0.01, 0);
                bool sees = meets_hull(t, &ray), full = ray.alpha == 1;
                ck_assert_msg(sees || !full, "frame %d, pixel %d, %d: its matter is carved", f, x,
                              y);
                ck_assert_msg(!sees || is_live(t, f, x, y), "frame %d, pixel %d, %d is not live", f,
                              x, y);
                opaque += full;
                seen += sees;
            }
    }
    ck_assert_int_gt(opaque, 200);
    ck_assert_int_gt(seen, opaque);
    ck_assert_int_lt((int)t->field->hull_cells, cells * cells * cells / 2);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
    finish(&c, true);
}
END_TEST

static double psnr_of(const struct rn_dataset *d) {
    struct rn_train_config config = config_for(d);
    config.max_steps = 100;
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *t = trainer_for(engine, d, &config);
    run_to_end(t);
    double psnr = held_out_psnr(t);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
    return psnr;
}

// The same photographs, with the lens known and taken for a pinhole's. A tangential one moves the
// sphere to one side in all of them, which no sphere explains.
START_TEST(a_known_lens_gains) {
    struct lens_case c = through(RN_LENS_OPENCV, 0, 0.3, true);
    double known = psnr_of(&c.dataset);
    for (size_t f = 0; f < c.dataset.frame_count; f++) {
        c.frames[f].camera.lens = RN_LENS_PINHOLE;
        c.frames[f].camera.lens_k[3] = 0;
    }
    double unknown = psnr_of(&c.dataset);
    printf("a lens known: %.2f dB, taken for a pinhole's: %.2f dB\n", known, unknown);
    ck_assert_double_gt(known, unknown + 2);
    finish(&c, true);
}
END_TEST

// Ends a training at half its steps and goes on from its checkpoint.
static void interrupt(struct rn_trainer **trainer, struct rn_engine *engine,
                      const struct rn_dataset *d) {
    struct rn_error err;
    char path[128];
    for (int i = 0; i < 25; i++)
        ck_assert(rn_trainer_advance(*trainer, 1, &err) == RN_OK);
    snprintf(path, sizeof path, "%s/lens.ripnerf", folder);
    ck_assert_msg(rn_trainer_save(*trainer, path, &err) == RN_OK, "%s", err.text);
    rn_trainer_destroy(trainer);
    ck_assert_msg(rn_trainer_restore(engine, d, path, 0, trainer, &err) == RN_OK, "%s", err.text);
}

// A lens that moves no pixel by 0.05 is off, and the parameters are those without it; those of an
// interrupted training as well.
START_TEST(a_lens_that_does_nothing_costs_nothing) {
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *trainers[2];
    struct lens_case c = through(RN_LENS_OPENCV, -0.004, 0, false);
    const struct rn_dataset *datasets[2] = {dataset, &c.dataset};
    for (int i = 0; i < 2; i++) {
        struct rn_train_config config = config_for(datasets[i]);
        trainers[i] = trainer_for(engine, datasets[i], &config);
        ck_assert(!distortion(trainers[i])->on && distortion(trainers[i])->decided);
        if (i == 1) interrupt(&trainers[i], engine, datasets[i]);
        run_to_end(trainers[i]);
    }
    ck_assert_double_eq(distortion(trainers[0])->number, 0);
    ck_assert_double_gt(distortion(trainers[1])->number, 0.005);
    const struct rn_parameters *a = &trainers[0]->field->parameters;
    const struct rn_parameters *b = &trainers[1]->field->parameters;
    ck_assert_uint_eq(a->count, b->count);
    ck_assert(memcmp(a->values, b->values, a->count * sizeof *a->values) == 0);
    for (int i = 0; i < 2; i++)
        rn_trainer_destroy(&trainers[i]);
    rn_engine_destroy(&engine);
    finish(&c, false);
}
END_TEST

// The middle (i = 0) or a corner of two cells a side, in the dataset's units, where all of space is
// drawn into a ball: how far out in it.
static double corner_of(const struct rn_field *field, const int first[3], int i, double ret[3]) {
    double y[3], size = 0;
    for (int k = 0; k < 3; k++) {
        double at = first[k] + (i == 0 ? 1 : (i - 1) >> k & 1 ? 2 : 0);
        y[k] = 2 * at / field->config.field.occupancy - 1;
        size += y[k] * y[k];
    }
    size = sqrt(size);
    for (int k = 0; k < 3; k++)
        ret[k] = field->bounds.centre[k] + (size > 0 ? field->bounds.radius * y[k] / size *
                                                           rn_uncontracted(fmin(size, 1 - 1e-6))
                                                     : 0);
    return size;
}

static bool is_shown(const struct rn_trainer *t, const double point[3]) {
    for (int f = 0; f < t->train.frame_count; f++) {
        const struct rn_camera *c = &t->train.frames[f].camera;
        double p[3], at[2];
        rn_camera_axes(c, point, p);
        if (rn_camera_project(c, p, at) && at[0] >= 0 && at[1] >= 0 && at[0] < c->width &&
            at[1] < c->height)
            return true;
    }
    return false;
}

// Where all of space is the field's, cells that no photograph shows are none of it; _i: a lens.
START_TEST(cells_that_no_photograph_shows_are_empty) {
    static const double k1[] = {0, -0.25, 0.1};
    static const enum rn_lens lens[] = {RN_LENS_PINHOLE, RN_LENS_OPENCV, RN_LENS_FISHEYE};
    struct lens_case c = through(lens[_i], k1[_i], 0.01, false);
    for (size_t f = 1; f < c.dataset.frame_count; f++) // all look the same way
        memcpy(c.frames[f].camera.world_from_camera, c.frames[0].camera.world_from_camera,
               sizeof c.frames[0].camera.world_from_camera);
    struct rn_train_config config = config_for(&c.dataset);
    config.field.space = RN_SPACE_UNBOUNDED;
    config.cone_step = false;
    config.auto_effects = false;
    config.effect[RN_EFFECT_DISTORTION] = RN_EFFECT_WANTED;
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *t = trainer_for(engine, &c.dataset, &config);
    int cells = t->field->config.field.occupancy, clumps = cells / 2, counts[2] = {0};
    for (int i = 0; i < clumps * clumps * clumps; i++) {
        int first[3] = {i / clumps / clumps * 2, i / clumps % clumps * 2, i % clumps * 2};
        bool shown = false, within = true;
        for (int k = 0; k < 9; k++) {
            double point[3];
            within &= corner_of(t->field, first, k, point) < 1;
            shown = shown || is_shown(t, point);
        }
        if (!within) continue;
        counts[shown]++;
        ck_assert_int_eq(t->field->hull[rn_cell_index(first[0], first[1], first[2], cells)], shown);
    }
    printf("lens %d: %d blocks are shown, %d are not\n", (int)lens[_i], counts[1], counts[0]);
    ck_assert_int_eq(t->train.frames[0].camera.lens, lens[_i]);
    ck_assert_int_gt(counts[0], 300);
    ck_assert_int_gt(counts[1], 100);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
    finish(&c, false);
}
END_TEST

static void add(TCase *tests) {
    tcase_add_loop_test(tests, hull_is_seen_through_the_lens, 0, sizeof lenses / sizeof *lenses);
    tcase_add_test(tests, a_known_lens_gains);
    tcase_add_test(tests, a_lens_that_does_nothing_costs_nothing);
    tcase_add_loop_test(tests, cells_that_no_photograph_shows_are_empty, 0, 3);
}

int main(void) {
    return run_on_scene("lenses", add);
}

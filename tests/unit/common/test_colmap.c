// COLMAP models: binary and text, poses, lenses, points and who sees them; and models that are cut,
// incomplete or contradict themselves.
#include <math.h>
#include <stdint.h>
#include <sys/resource.h>
#include <unistd.h>

#include "tests/unit/common/dataset_fixture.h"

static struct bytes {
    char data[4096];
    size_t size;
} cameras, images, points;

static void put(struct bytes *to, const void *value, size_t size) {
    ck_assert_uint_le(to->size + size, sizeof to->data);
    memcpy(to->data + to->size, value, size);
    to->size += size;
}
#define PUT(to, type, ...)                                                                         \
    do {                                                                                           \
        const type values[] = {__VA_ARGS__};                                                       \
        put(to, values, sizeof values);                                                            \
    } while (0)

// Two cameras, three photographs (one without keypoints), two points.
static void fill_model(void) {
    cameras.size = images.size = points.size = 0;
    PUT(&cameras, uint64_t, 2);
    PUT(&cameras, uint32_t, 7);
    PUT(&cameras, int32_t, 2); // SIMPLE_RADIAL
    PUT(&cameras, uint64_t, 40, 30);
    PUT(&cameras, double, 50, 21, 14, 0.125);
    PUT(&cameras, uint32_t, 3);
    PUT(&cameras, int32_t, 1); // PINHOLE
    PUT(&cameras, uint64_t, 80, 60);
    PUT(&cameras, double, 100, 120, 40, 30);
    PUT(&images, uint64_t, 3);
    static const char *const names[] = {"b.png", "sub/a b.png", "c.png"};
    for (uint32_t i = 0; i < 3; i++) {
        double half = sqrt(0.5);
        PUT(&images, uint32_t, 10 + i);
        PUT(&images, double, half, 0, half, 0, 1, 2, 3.0 + i); // 90 degrees about y
        PUT(&images, uint32_t, i == 1 ? 3 : 7);
        put(&images, names[i], strlen(names[i]) + 1);
        PUT(&images, uint64_t, i == 2 ? 0 : 2);
        if (i == 2) break;
        PUT(&images, double, 10, 15);
        PUT(&images, uint64_t, 1000);
        PUT(&images, double, 20, 25);
        PUT(&images, uint64_t, i == 0 ? UINT64_MAX : 1001);
    }
    PUT(&points, uint64_t, 2);
    for (uint64_t i = 0; i < 2; i++) {
        PUT(&points, uint64_t, 1001 - i);
        PUT(&points, double, 0.5, 1.5, 2.5 + (double)i);
        PUT(&points, uint8_t, 1, 2, 3);
        PUT(&points, double, 0.75);
        PUT(&points, uint64_t, 1);
        PUT(&points, uint32_t, 10, 0);
    }
}

static void put_photos(void) {
    put_image("images/b.png", 40, 30);
    put_image("images/sub/a b.png", 40, 30); // half the camera's size
    put_image("images/c.png", 40, 30);
}

static void put_model(const char *place) {
    char name[64];
    const struct bytes *all[] = {&cameras, &images, &points};
    static const char *const kinds[] = {"cameras", "images", "points3D"};
    for (int i = 0; i < 3; i++) {
        snprintf(name, sizeof name, "%s%s.bin", place, kinds[i]);
        put_bytes(name, all[i]->data, all[i]->size);
    }
}

static void put_capture(void) {
    fill_model();
    put_model("sparse/0/");
    put_photos();
}

static bool tells(enum rn_severity severity, const char *text) {
    for (size_t i = 0; i < problems.count; i++)
        if (problems.items[i].severity == severity &&
            (strstr(problems.items[i].where, text) || strstr(problems.items[i].text, text)))
            return true;
    return false;
}

static void assert_model(void) {
    ck_assert_str_eq(dataset->format->name, "colmap");
    ck_assert_uint_eq(problems.errors, 0);
    ck_assert_uint_eq(problems.warnings, 1); // points are not where these cameras see them
    ck_assert_uint_eq(dataset->frame_count, 3);
    static const char *const order[] = {"b", "c", "a b"}; // of the names with their folders
    for (int i = 0; i < 3; i++)
        ck_assert_str_eq(dataset->frames[i].name, order[i]);
    const struct rn_camera *bent = &dataset->frames[0].camera, *half = &dataset->frames[2].camera;
    ck_assert_int_eq(bent->lens, RN_LENS_OPENCV);
    ck_assert_double_eq(bent->lens_k[0], 0.125);
    ck_assert_double_eq(bent->cx, 21);
    ck_assert_int_eq(half->lens, RN_LENS_PINHOLE);
    ck_assert_double_eq(half->fx, 50);
    ck_assert_double_eq(half->fy, 60);
    ck_assert_double_eq(half->cx, 20);
    // x of the world is -z of the camera: R = [0 0 1; 0 1 0; -1 0 0], the centre is -R' t
    const double pose[3][4] = {{0, 0, -1, 3}, {0, 1, 0, -2}, {1, 0, 0, -1}};
    for (int i = 0; i < 12; i++)
        ck_assert_double_eq_tol((&bent->world_from_camera[0][0])[i], (&pose[0][0])[i], 1e-15);
}

static void assert_points(void) {
    const struct rn_points *found = &dataset->points;
    ck_assert_uint_eq(found->count, 2);
    ck_assert_uint_eq(found->sighting_count, 3);
    int seen[3] = {0};
    for (size_t i = 0; i < 3; i++) {
        const struct rn_sighting *sighting = &found->sightings[i];
        double z = found->items[sighting->point].position[2];
        bool first = sighting->y * 30 < 20 && sighting->photo == 0;
        seen[sighting->photo]++;
        ck_assert_float_eq(found->items[sighting->point].error, 0.75f);
        if (first) ck_assert_double_eq(z, 3.5); // id 1000 is the second in its file
        if (first) ck_assert_float_eq(sighting->x, 0.25f);
        if (sighting->photo == 2) ck_assert_float_le(sighting->x, 0.25f); // of 80 pixels
    }
    ck_assert_int_eq(seen[0], 1);
    ck_assert_int_eq(seen[2], 2);
}

START_TEST(binary_model) {
    static const char *const places[] = {"sparse/0/", "sparse/", "", "colmap/sparse/0/"};
    fill_model();
    put_model(places[_i]);
    put_photos();
    read_ok(folder);
    assert_model();
    assert_points();
    ck_assert_uint_eq(dataset->document_count, 3);
}
END_TEST

#define CAMERAS_TXT                                                                                \
    "# Camera list\n3 PINHOLE 80 60 100 120 40 30\r\n7 SIMPLE_RADIAL 40 30 50 21 14 0.125\n"
#define IMAGES_TXT                                                                                 \
    "# Image list\n10 0.7071067811865476 0 0.7071067811865476 0 1 2 3 7 b.png\n"                   \
    "10 15 1000 20 25 -1\n"                                                                        \
    "11 0.7071067811865476 0 0.7071067811865476 0 1 2 4 3 sub/a b.png\n"                           \
    "10 15 1000 20 25 1001\n"                                                                      \
    "12 0.7071067811865476 0 0.7071067811865476 0 1 2 5 7 c.png\n\n"
#define POINTS_TXT "1001 0.5 1.5 2.5 1 2 3 0.75 10 0\n1000 0.5 1.5 3.5 1 2 3 0.75 10 0 11 1\n"

static void put_texts(const char *camera_lines, const char *image_lines, const char *point_lines) {
    put_text("sparse/0/cameras.txt", camera_lines);
    put_text("sparse/0/images.txt", image_lines);
    put_text("sparse/0/points3D.txt", point_lines);
    put_photos();
}

START_TEST(text_model) {
    put_texts(CAMERAS_TXT, IMAGES_TXT, POINTS_TXT);
    read_ok(folder);
    assert_model();
    assert_points();
}
END_TEST

static const struct {
    const char *cameras, *images, *points, *where, *text;
} bad_texts[] = {
    {"7 PINHOLE 40 30 50 21\n", IMAGES_TXT, "", "cameras.txt:1", "fewer parameters"},
    {"7 PINHOLE\n", IMAGES_TXT, "", "cameras.txt:1", "CAMERA_ID MODEL"},
    {"-7 PINHOLE 40 30 1 1 1 1\n", IMAGES_TXT, "", "cameras.txt:1", "CAMERA_ID MODEL"},
    {CAMERAS_TXT, "10 1 0 0 0 1 2 3\n", "", "images.txt:1", "IMAGE_ID QW"},
    {CAMERAS_TXT, "10 1 0 0 0 1 2 3 7\n\n", "", "images.txt:1", "NAME"},
    {CAMERAS_TXT, "10 1 0 0 0 1 2 3 7 b.png\n1 2\n", POINTS_TXT, "images.txt:2", "triples"},
    {CAMERAS_TXT, "# none\n", "", "images.txt", "no images"},
    {CAMERAS_TXT, "10 1 0 0 0 1 2 3 7 b.png\n1 2 1000\n10 1 0 0 0 1 2 3 9 gone.png\n1 2 1000\n",
     POINTS_TXT, "images.txt", "two images have the id 10"},
    {CAMERAS_TXT, IMAGES_TXT, "1000 0.5 1.5 x\n", "points3D.txt:1", "POINT3D_ID X"},
};

START_TEST(bad_text) {
    put_texts(bad_texts[_i].cameras, bad_texts[_i].images, bad_texts[_i].points);
    ck_assert_int_eq(rn_dataset_read(folder, &problems, &dataset, &err), RN_ERROR_INVALID);
    ck_assert_msg(strstr(err.where, bad_texts[_i].where) != NULL, "%s", err.where);
    ck_assert_msg(strstr(err.text, bad_texts[_i].text) != NULL, "%s", err.text);
}
END_TEST

// What spoils one photograph: the others stay, the error names it.
static const struct {
    const char *image, *text;
} bad_images[] = {
    {"12 0 0 0 0 1 2 5 7 c.png", "no length"},
    {"12 nan 0 0 0 1 2 5 7 c.png", "no length"},
    {"12 1 0 0 0 inf 2 5 7 c.png", "non-finite"},
    {"12 1 0 0 0 1 2 5 8 c.png", "camera 8"},
    {"12 1 0 0 0 1 2 5 4 c.png", "DIVISION"},
    {"12 1 0 0 0 1 2 5 5 c.png", "NEW_MODEL"},
    {"12 1 0 0 0 1 2 5 6 c.png", "says 60x60 pixels"},
    {"12 1 0 0 0 1 2 5 7 gone.png", "does not exist"},
    {"12 1 0 0 0 1 2 5 7 b.png", "two images"},
    {"12 1 0 0 0 1 2 5 7 ../../c/x.png", "leaves"},
    {"12 1 0 0 0 1 2 5 7 /etc/x.png", "absolute"},
};

START_TEST(bad_image) {
    char *lines;
    ck_assert(asprintf(&lines, "10 1 0 0 0 1 2 3 7 b.png\n\n%s\n\n", bad_images[_i].image) > 0);
    put_texts(CAMERAS_TXT "4 SIMPLE_DIVISION 40 30 1 2 3 4\n5 NEW_MODEL 40 30 1\n"
                          "6 SIMPLE_PINHOLE 60 60 50 30 30\n",
              lines, POINTS_TXT);
    free(lines);
    read_ok(folder);
    ck_assert_uint_eq(problems.errors, 1);
    ck_assert(tells(RN_SEVERITY_ERROR, bad_images[_i].text));
    ck_assert(tells(RN_SEVERITY_ERROR, "images.txt"));
    ck_assert_uint_eq(dataset->frame_count, 1);
}
END_TEST

// An image of another machine's path, found by its name.
START_TEST(absolute_name) {
    put_texts(CAMERAS_TXT, "10 1 0 0 0 1 2 3 7 /home/x/images/c.png\n\n", POINTS_TXT);
    read_ok(folder);
    ck_assert_uint_eq(problems.errors, 0);
    ck_assert(tells(RN_SEVERITY_INFO, "found by its name"));
}
END_TEST

// Cut anywhere, no file passes for whole.
START_TEST(cut_anywhere) {
    static const char *const names[] = {"sparse/0/cameras.bin", "sparse/0/images.bin",
                                        "sparse/0/points3D.bin"};
    put_capture();
    const struct bytes *whole = _i == 0 ? &cameras : _i == 1 ? &images : &points;
    for (size_t size = 0; size < whole->size; size++) {
        put_bytes(names[_i], whole->data, size);
        enum rn_status status = rn_dataset_read(folder, NULL, &dataset, &err);
        ck_assert_msg(status == RN_ERROR_INVALID, "%zu bytes: %d", size, status);
        ck_assert_msg(strstr(err.where, strrchr(names[_i], '/')) != NULL, "%s", err.where);
    }
}
END_TEST

START_TEST(huge_counts) {
    static const char *const names[] = {"sparse/0/cameras.bin", "sparse/0/images.bin",
                                        "sparse/0/points3D.bin"};
    put_capture();
    struct bytes *file = _i == 0 ? &cameras : _i == 1 ? &images : &points;
    uint64_t count = UINT64_C(1) << 63;
    memcpy(file->data, &count, 8);
    put_bytes(names[_i], file->data, file->size);
    ck_assert_int_eq(rn_dataset_read(folder, NULL, &dataset, &err), RN_ERROR_INVALID);
    ck_assert_msg(strstr(err.text, "9223372036854775808 records") != NULL, "%s", err.text);
}
END_TEST

START_TEST(unknown_binary_model) {
    put_capture();
    int32_t model = 99;
    memcpy(cameras.data + 12, &model, 4);
    put_model("sparse/0/");
    ck_assert_int_eq(rn_dataset_read(folder, NULL, &dataset, &err), RN_ERROR_INVALID);
    ck_assert_ptr_nonnull(strstr(err.text, "the model 99"));
}
END_TEST

START_TEST(several_models) {
    put_capture();
    images.size = 0;
    PUT(&images, uint64_t, 1);
    PUT(&images, uint32_t, 10);
    PUT(&images, double, 1, 0, 0, 0, 0, 0, 0);
    PUT(&images, uint32_t, 7);
    put(&images, "b.png", 6);
    PUT(&images, uint64_t, 0);
    put_model("sparse/1/");
    put_text("sparse/0/rigs.bin", "");
    read_ok(folder);
    ck_assert_uint_eq(dataset->frame_count, 3);
    ck_assert(tells(RN_SEVERITY_WARNING, "another model, of 1 photographs"));
    ck_assert(tells(RN_SEVERITY_INFO, "rigs and frames"));
    rn_dataset_destroy(&dataset);
    put_model("sparse/0/"); // the lesser is now the first
    fill_model();
    put_model("sparse/1/");
    read_ok(folder);
    ck_assert_uint_eq(dataset->frame_count, 3);
    ck_assert(tells(RN_SEVERITY_WARNING, "is read instead"));
}
END_TEST

// Without points, or with points that nothing sees, photographs are read all the same.
START_TEST(no_points) {
    put_capture();
    ck_assert_int_eq(unlink(in_folder("sparse/0/points3D.bin")), 0);
    read_ok(folder);
    ck_assert(tells(RN_SEVERITY_WARNING, "no sparse points"));
    ck_assert_uint_eq(dataset->points.count, 0);
    rn_dataset_destroy(&dataset);
    put_text("sparse/0/points3D.txt",
             "5 0 0 0 1 1 1 0.5\n6 nan 0 0 1 1 1 0.5\n7 0 2e12 0 1 1 1 0.5\n");
    read_ok(folder);
    ck_assert(tells(RN_SEVERITY_WARNING, "belong to none"));
    ck_assert_uint_eq(dataset->points.count, 1);
}
END_TEST

START_TEST(incomplete_model) {
    put_capture();
    ck_assert_int_eq(unlink(in_folder("sparse/0/images.bin")), 0);
    ck_assert_int_eq(rn_dataset_read(folder, NULL, &dataset, &err), RN_ERROR_NOT_FOUND);
    ck_assert_ptr_nonnull(strstr(err.text, "sparse/0/images.bin"));
    put_text("transforms.json", "{\"fl_x\":50,\"frames\":[" FRAME("images/b") "]}");
    read_ok(folder);
    ck_assert_str_eq(dataset->format->name, "nerfstudio");
    struct rn_read_options options = {.format = "colmap"};
    rn_dataset_destroy(&dataset);
    ck_assert_int_eq(rn_dataset_read_as(folder, &options, NULL, &dataset, &err),
                     RN_ERROR_NOT_FOUND);
    options.format = "collmap";
    ck_assert_int_eq(rn_dataset_read_as(folder, &options, NULL, &dataset, &err), RN_ERROR_INVALID);
    ck_assert_ptr_nonnull(strstr(err.text, "colmap, opensfm, bundler, llff"));
}
END_TEST

// Two cameras see a point where they say; a third layout in the folder is compared.
START_TEST(agreement) {
    put_texts("7 PINHOLE 40 30 50 60 20 15\n",
              "10 1 0 0 0 0 0 0 7 b.png\n30 21 1000\n11 1 0 0 0 -1 0 0 7 c.png\n23 18 1000\n",
              "1000 1 0.5 5 1 2 3 2.5 10 0 11 0\n"); // seen at (30, 21) and (20, 21)
    put_text("transforms.json", "{}");
    struct rn_read_options options = {.format = "colmap"};
    ck_assert_int_eq(rn_dataset_read_as(folder, &options, &problems, &dataset, &err), RN_OK);
    struct rn_reprojection found;
    ck_assert_int_eq(rn_dataset_reproject(dataset, &found, &err), RN_OK);
    ck_assert_uint_eq(found.points, 1);
    ck_assert_uint_eq(found.sightings, 2);
    ck_assert_double_eq_tol(found.mean_px, sqrt(18) / 2, 1e-5);
    ck_assert_double_eq_tol(found.said_px, 2.5, 1e-6);
    ck_assert(tells(RN_SEVERITY_WARNING, "do not belong together"));
    ck_assert(tells(RN_SEVERITY_INFO,
                    "view directions have a mean of length 1.00 (over the threshold of 0.9)"));
}
END_TEST

// The model is of photographs twice as large as those that are there: its error is told for both.
START_TEST(agreement_in_pixels_of_the_photographs) {
    put_texts("7 PINHOLE 80 60 100 120 40 30\n",
              "10 1 0 0 0 0 0 0 7 b.png\n60 42 1000\n11 1 0 0 0 -1 0 0 7 c.png\n40 42 1000\n",
              "1000 1 0.5 5 1 2 3 2.5 10 0 11 0\n");
    read_ok(folder);
    ck_assert(tells(RN_SEVERITY_INFO,
                    "1.2500 px as the model says (2.5000 px of photographs 2 times as large)"));
    ck_assert(!tells(RN_SEVERITY_INFO, "does not see"));
}
END_TEST

START_TEST(two_layouts) {
    put_capture();
    read_ok(folder);
    struct rn_frame *frame = &dataset->frames[0];
    double(*m)[4] = frame->camera.world_from_camera;
    char *rows;
    ck_assert(asprintf(&rows,
                       "{\"fl_x\":52,\"fl_y\":50,\"cx\":21,\"cy\":14,\"frames\":[{\"file_path\":"
                       "\"images/b.png\",\"transform_matrix\":[[%.17g,%.17g,%.17g,%.17g],"
                       "[%.17g,%.17g,%.17g,%.17g],[%.17g,%.17g,%.17g,%.17g],[0,0,0,1]]}]}",
                       m[0][0], -m[0][1], -m[0][2], m[0][3], m[1][0], -m[1][1], -m[1][2], m[1][3],
                       m[2][0], -m[2][1], -m[2][2], m[2][3]) > 0);
    put_text("transforms.json", rows);
    free(rows);
    rn_dataset_destroy(&dataset);
    read_ok(folder);
    ck_assert_str_eq(dataset->format->name, "nerfstudio");
    ck_assert(tells(RN_SEVERITY_WARNING, "have 1 photographs in common: poses differ by up to 0 "));
    ck_assert(tells(RN_SEVERITY_WARNING, "b: 52 and 50"));
}
END_TEST

// The model's photographs as nerfstudio has them, axes permuted, scaled and shifted; of the first
// one the position is off by `off` of a unit.
static void put_moved_transforms(double off) {
    static const double turn[3][3] = {{1, 0, 0}, {0, 0, 1}, {0, -1, 0}}, shift[3] = {5, -7, 0.5};
    static const char *const files[] = {"b.png", "c.png", "sub/a b.png"}; // as they are sorted
    char frames[4096] = "";
    for (int n = 0; n < 3; n++) {
        double(*m)[4] = dataset->frames[n].camera.world_from_camera;
        size_t at = strlen(frames);
        at += (size_t)snprintf(frames + at, sizeof frames - at,
                               "%s{\"file_path\":\"images/%s\",\"transform_matrix\":[",
                               n ? "," : "", files[n]);
        for (int i = 0; i < 3; i++) {
            double row[4] = {0, 0, 0, shift[i] + (n == 0) * off};
            for (int j = 0; j < 4; j++)
                for (int k = 0; k < 3; k++)
                    row[j] += turn[i][k] * m[k][j] * (j == 3 ? 0.25 : j == 0 ? 1 : -1);
            at += (size_t)snprintf(frames + at, sizeof frames - at, "[%.17g,%.17g,%.17g,%.17g],",
                                   row[0], row[1], row[2], row[3]);
        }
        snprintf(frames + at, sizeof frames - at, "[0,0,0,1]]}");
    }
    char *document;
    ck_assert(asprintf(&document,
                       "{\"fl_x\":50,\"fl_y\":50,\"cx\":20,\"cy\":15,\"w\":40,\"h\":30,"
                       "\"frames\":[%s]}",
                       frames) > 0);
    put_text("transforms.json", document);
    free(document);
}

// One scene in two programs' coordinates: the same poses to 1e-6 of its radius, or by how much not.
START_TEST(moved_layouts) {
    double off = _i ? 0.01 : 0, found;
    put_texts("7 PINHOLE 40 30 50 50 20 15\n",
              "10 0.8 0.2 -0.4 0.4 1 2 3 7 b.png\n\n11 0.5 0.5 -0.5 0.5 -1 0 4 7 c.png\n\n"
              "12 0.6 0 0.8 0 0 -2 5 7 sub/a b.png\n\n",
              "1000 1 0.5 5 1 2 3 2.5 10 0\n");
    read_ok(folder);
    put_moved_transforms(off);
    rn_dataset_destroy(&dataset);
    read_ok(folder);
    const char *text = NULL;
    for (size_t i = 0; i < problems.count; i++)
        if (strstr(problems.items[i].text, "3 photographs in common")) {
            text = strstr(problems.items[i].text, "differ by up to ");
            ck_assert_int_eq(problems.items[i].severity,
                             _i ? RN_SEVERITY_WARNING : RN_SEVERITY_INFO);
        }
    ck_assert_ptr_nonnull(text);
    ck_assert_int_eq(sscanf(text, "differ by up to %lf", &found), 1);
    ck_assert_ptr_nonnull(
        strstr(text, _i ? "turned by 90.0" : "turned by 90.0 degrees, scaled by 0.25 and"));
    if (_i)
        ck_assert_double_gt(found, 1e-3);
    else
        ck_assert_double_lt(found, 1e-12);
}
END_TEST

// Points, who sees them and masks go with an import, whatever becomes of sizes and splits.
START_TEST(imported) {
    put_capture();
    put_png("masks/b.png.png", 40, 30, PNG_COLOR_TYPE_GRAY, 8, PNG_INTERLACE_NONE); // 0x55: black
    put_png("masks/sub/a b.png", 40, 30, PNG_COLOR_TYPE_RGB, 8, PNG_INTERLACE_NONE);
    read_ok(folder);
    ck_assert_uint_eq(problems.errors, 0);
    ck_assert(tells(RN_SEVERITY_INFO, "2 of 3 photographs have masks"));
    struct rn_import_options options = {.max_size = 20, .scales = 2, .test_every = 2, .threads = 1};
    struct rn_dataset *source = dataset;
    dataset = NULL;
    ck_assert_int_eq(
        rn_dataset_import(source, "x", &options, in_folder("out"), NULL, NULL, NULL, &err), RN_OK);
    read_ok(in_folder("out"));
    ck_assert_uint_eq(dataset->points.count, source->points.count);
    ck_assert_mem_eq(dataset->points.items, source->points.items,
                     source->points.count * sizeof *source->points.items);
    ck_assert_uint_eq(dataset->points.sighting_count, 3);
    ck_assert_mem_eq(dataset->points.sightings, source->points.sightings,
                     3 * sizeof *source->points.sightings);
    const struct rn_frame *small = rn_dataset_frame(dataset, RN_SPLIT_TEST, 1, 1);
    ck_assert_str_eq(small->name, "a b");
    ck_assert_int_eq(small->photo, 2);
    ck_assert_ptr_null(rn_dataset_frame(dataset, RN_SPLIT_TRAIN, 1, 0)->mask_path);
    struct rn_image mask;
    ck_assert_int_eq(rn_image_read(small->mask_path, NULL, &mask, &err), RN_OK);
    ck_assert_int_eq(mask.width, 10);
    for (int i = 0; i < 10 * 8 * 4; i++)
        ck_assert_uint_eq(mask.pixels[i], i % 4 == 3 ? 255 : 0);
    rn_image_finish(&mask);
    rn_dataset_destroy(&source);
}
END_TEST

START_TEST(bad_masks) {
    put_capture();
    put_image("masks/b.png.png", 30, 30);
    put_text("masks/c.png", "no picture");
    read_ok(folder);
    ck_assert_uint_eq(problems.errors, 2);
    ck_assert(tells(RN_SEVERITY_ERROR, "the mask has 30x30 pixels"));
    ck_assert(tells(RN_SEVERITY_ERROR, "masks/c.png"));
    ck_assert_uint_eq(dataset->frame_count, 1);
    struct rn_read_options options = {.masks = "elsewhere"};
    rn_dataset_destroy(&dataset);
    ck_assert_int_eq(rn_dataset_read_as(folder, &options, NULL, &dataset, &err), RN_ERROR_INVALID);
    ck_assert_ptr_nonnull(strstr(err.text, "has no mask of any photograph"));
}
END_TEST

// The daemon's own points.bin, cut or spoilt.
START_TEST(bad_points) {
    put_capture();
    read_ok(folder);
    struct rn_import_options options = {.scales = 1, .threads = 1};
    ck_assert_int_eq(
        rn_dataset_import(dataset, "x", &options, in_folder("out"), NULL, NULL, NULL, &err), RN_OK);
    rn_dataset_destroy(&dataset);
    uint8_t *bytes;
    size_t size;
    ck_assert_int_eq(rn_file_read(in_folder("out/points.bin"), 1 << 20, &bytes, &size, &err),
                     RN_OK);
    for (size_t cut = 0; cut < size; cut++) {
        put_bytes("out/points.bin", bytes, cut);
        ck_assert_int_eq(rn_dataset_read(in_folder("out"), NULL, &dataset, &err), RN_ERROR_INVALID);
        ck_assert_ptr_nonnull(strstr(err.where, "points.bin"));
    }
    static const struct {
        size_t at;
        uint8_t byte;
    } spoilt[] = {{0, 'X'}, {15, 0x80}, {31, 0x7f}, {24 + 64, 2}};
    for (size_t i = 0; i < sizeof spoilt / sizeof *spoilt; i++) {
        uint8_t kept = bytes[spoilt[i].at];
        bytes[spoilt[i].at] = spoilt[i].byte;
        if (i == 2) memset(bytes + 24, 0xff, 8); // not a number
        put_bytes("out/points.bin", bytes, size);
        ck_assert_int_eq(rn_dataset_read(in_folder("out"), NULL, &dataset, &err), RN_ERROR_INVALID);
        bytes[spoilt[i].at] = kept;
        if (i == 2) memset(bytes + 24, 0, 8);
    }
    free(bytes);
}
END_TEST

// Forty thousand photographs of fifty keypoints: a file of 50 MB, which never is in memory.
START_TEST(streamed) {
    enum { COUNT = 40000, KEYPOINTS = 50 };
    static const double keypoint[3] = {1, 2, 0}; // of no point, below
    char path[128], first[128];
    put_capture();
    snprintf(first, sizeof first, "%s/images/00000.png", folder);
    FILE *file = fopen(in_folder("sparse/0/images.bin"), "wb");
    fwrite(&(uint64_t){COUNT}, 8, 1, file);
    for (uint32_t i = 0; i < COUNT; i++) {
        char name[32];
        struct bytes record = {.size = 0};
        snprintf(name, sizeof name, "images/%05u.png", i);
        if (i == 0) put_image(name, 40, 30);
        snprintf(path, sizeof path, "%s/%s", folder, name);
        if (i > 0) ck_assert_int_eq(link(first, path), 0);
        PUT(&record, uint32_t, i);
        PUT(&record, double, 1, 0, 0, 0, 0, 0, i);
        PUT(&record, uint32_t, 7);
        put(&record, name + 7, strlen(name + 7) + 1);
        PUT(&record, uint64_t, KEYPOINTS);
        fwrite(record.data, 1, record.size, file);
        for (int k = 0; k < KEYPOINTS; k++) {
            fwrite(keypoint, 16, 1, file);
            fwrite(&(uint64_t){k ? UINT64_MAX : 1000}, 8, 1, file);
        }
    }
    ck_assert_int_eq(fclose(file), 0);
    struct rusage before, after;
    getrusage(RUSAGE_SELF, &before);
    read_ok(folder);
    getrusage(RUSAGE_SELF, &after);
    ck_assert_uint_eq(dataset->frame_count, COUNT);
    ck_assert_uint_eq(dataset->points.sighting_count, COUNT);
#ifndef __SANITIZE_THREAD__ // which keeps several bytes beside each
    ck_assert_int_lt(after.ru_maxrss - before.ru_maxrss, 40000); // KiB
#endif
}
END_TEST

int main(void) {
    Suite *suite = suite_create("colmap");
    TCase *tests = tcase_create("colmap"), *large = tcase_create("large");
    tcase_add_checked_fixture(tests, setup, teardown);
    tcase_add_loop_test(tests, binary_model, 0, 4);
    tcase_add_test(tests, text_model);
    tcase_add_loop_test(tests, bad_text, 0, sizeof bad_texts / sizeof *bad_texts);
    tcase_add_loop_test(tests, bad_image, 0, sizeof bad_images / sizeof *bad_images);
    tcase_add_test(tests, absolute_name);
    tcase_add_loop_test(tests, cut_anywhere, 0, 3);
    tcase_add_loop_test(tests, huge_counts, 0, 3);
    tcase_add_test(tests, unknown_binary_model);
    tcase_add_test(tests, several_models);
    tcase_add_test(tests, no_points);
    tcase_add_test(tests, incomplete_model);
    tcase_add_test(tests, agreement);
    tcase_add_test(tests, agreement_in_pixels_of_the_photographs);
    tcase_add_test(tests, two_layouts);
    tcase_add_loop_test(tests, moved_layouts, 0, 2);
    tcase_add_test(tests, imported);
    tcase_add_test(tests, bad_masks);
    tcase_add_test(tests, bad_points);
    tcase_add_checked_fixture(large, setup, teardown);
    tcase_set_timeout(large, 60);
    tcase_add_test(large, streamed);
    suite_add_tcase(suite, tests);
    suite_add_tcase(suite, large);
    return run_suite(suite);
}

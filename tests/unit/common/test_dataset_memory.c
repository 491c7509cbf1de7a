// Every allocation of our own fails once, in turn: reading, importing and parsing answer
// out-of-memory or succeed whole, and never crash. (Leaks show under a sanitizer. The JSON
// library's own allocations are left alone: version 2.14 does not survive their failure.)
#include <stdarg.h>
#include <unistd.h>

#include "common/dataset/triangulate.h"
#include "common/path/path.h"
#include "tests/unit/common/dataset_fixture.h"
#include "tests/unit/common/wall.h"

static long chosen;    // which allocation is to fail
static long countdown; // allocations until then; 0 = none fails
static bool injected;  // it did fail

static void arm(void) {
    countdown = chosen;
}

static void disarm(void) {
    injected = countdown == 0;
    countdown = 0;
}

static bool fails(void) {
    return countdown > 0 && --countdown == 0;
}

// The linker sends the library's calls here (--wrap).
void *__real_malloc(size_t size);
void *__real_calloc(size_t count, size_t size);
void *__real_realloc(void *old, size_t size);
void *__wrap_malloc(size_t size);
void *__wrap_calloc(size_t count, size_t size);
void *__wrap_realloc(void *old, size_t size);
char *__wrap_strdup(const char *text);
char *__wrap_strndup(const char *text, size_t size);
int __wrap_asprintf(char **ret, const char *fmt, ...);

void *__wrap_malloc(size_t size) {
    return fails() ? NULL : __real_malloc(size);
}

void *__wrap_calloc(size_t count, size_t size) {
    return fails() ? NULL : __real_calloc(count, size);
}

void *__wrap_realloc(void *old, size_t size) {
    return fails() ? NULL : __real_realloc(old, size);
}

char *__wrap_strndup(const char *text, size_t size) {
    size_t length = strnlen(text, size);
    char *copy = __wrap_malloc(length + 1);
    if (!copy) return NULL;
    memcpy(copy, text, length);
    copy[length] = 0;
    return copy;
}

char *__wrap_strdup(const char *text) {
    return __wrap_strndup(text, strlen(text));
}

int __wrap_asprintf(char **ret, const char *fmt, ...) {
    va_list args;
    va_start(args, fmt);
    int length = fails() ? -1 : vasprintf(ret, fmt, args);
    va_end(args);
    return length;
}

static void put_source(void) {
    put_image("train/r_0.png", 8, 6);
    put_image("train/r_1.png", 8, 6);
    put_transforms("train", FRAME("train/r_0") "," FRAME("train/gone") "," FRAME("train/r_1"));
}

static enum rn_status try_read(void) {
    arm();
    enum rn_status status = rn_dataset_read(folder, &problems, &dataset, &err);
    disarm();
    if (status == RN_OK) {
        ck_assert_uint_eq(dataset->frame_count, 2);
        ck_assert_uint_eq(problems.errors, 1);
    } else {
        ck_assert_ptr_null(dataset);
    }
    rn_dataset_destroy(&dataset);
    rn_problems_finish(&problems);
    return status;
}

static enum rn_status try_import(void) {
    struct rn_import_options options = {.scales = 2, .threads = 1};
    struct rn_dataset *source = NULL;
    ck_assert_int_eq(rn_dataset_read(folder, NULL, &source, &err), RN_OK);
    const char *target = in_folder("out"), *result = in_folder("out/dataset.json");
    ck_assert_int_eq(rn_remove_tree(target, &err), RN_OK);
    arm();
    enum rn_status status =
        rn_dataset_import(source, "n", &options, target, &problems, NULL, NULL, &err);
    disarm();
    ck_assert_int_eq(access(result, F_OK) == 0, status == RN_OK);
    ck_assert_uint_eq(problems.errors, 0); // memory is never an image's fault
    rn_problems_finish(&problems);
    rn_dataset_destroy(&source);
    return status;
}

static enum rn_status try_path(void) {
    static const char json[] =
        "{\"path\":{\"axes\":\"opencv\",\"fps\":10,\"interpolation\":\"spline\",\"loop\":false,"
        "\"width\":8,\"height\":8,\"keys\":[{\"time\":0,\"fov_y_deg\":40,"
        "\"world_from_camera\":[[1,0,0,0],[0,1,0,0],[0,0,1,0]]}]}}";
    struct rn_path *path = NULL;
    arm();
    enum rn_status status = rn_path_parse(json, strlen(json), "p.json", &path, &err);
    disarm();
    ck_assert_int_eq(path != NULL, status == RN_OK);
    rn_path_destroy(&path);
    return status;
}

// Without memory for a photograph or its corners it is passed over.
static enum rn_status try_triangulation(void) {
    enum { PHOTOGRAPHS = 4 };
    struct rn_dataset wall = wall_dataset(PHOTOGRAPHS, 1, 80, 60);
    struct rn_triangulation *triangulation;
    struct rn_image images[PHOTOGRAPHS];
    size_t found = 0;
    for (int i = 0; i < PHOTOGRAPHS; i++)
        images[i] = wall_photograph(&wall.frames[i].camera);
    arm();
    enum rn_status status = rn_triangulation_create(&wall, 0, &triangulation, &err);
    for (int i = 0; i < PHOTOGRAPHS; i++)
        rn_triangulation_look(triangulation, &wall.frames[i], &images[i]);
    if (status == RN_OK)
        status = rn_triangulation_solve(triangulation, 1, &wall, NULL, NULL, &found, &err);
    disarm();
    if (!injected) ck_assert_uint_gt(found, 0);
    if (status == RN_OK) ck_assert_uint_eq(wall.points.count, found);
    for (int i = 0; i < PHOTOGRAPHS; i++)
        rn_image_finish(&images[i]);
    rn_triangulation_destroy(&triangulation);
    wall_finish(&wall);
    return status;
}

START_TEST(every_allocation_fails) {
    static enum rn_status (*const attempts[])(void) = {try_read, try_import, try_path,
                                                       try_triangulation};
    put_source();
    chosen = 0;
    do {
        chosen++;
        enum rn_status status = attempts[_i]();
        if (status != RN_OK)
            ck_assert_msg(status == RN_ERROR_NO_MEMORY, "allocation %ld: %s: %s: %s", chosen,
                          rn_status_name(status), err.where, err.text);
        if (!injected) ck_assert_int_eq(status, RN_OK);
    } while (injected && chosen < 100000);
    static const int least[] = {11, 15, 2,
                                20}; // allocations that each makes, so that some did fail
    ck_assert_int_gt(chosen, least[_i]);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("dataset memory");
    TCase *tests = tcase_create("dataset memory");
    tcase_add_checked_fixture(tests, setup, teardown);
    tcase_set_timeout(tests, 60);
    tcase_add_loop_test(tests, every_allocation_fails, 0, 4);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}

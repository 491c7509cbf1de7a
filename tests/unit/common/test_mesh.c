// Surfaces on grids: they lie where the quantity crosses the level, are closed and turned outwards.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/image/mesh.h"
#include "tests/support/suite.h"

#define RADIUS 0.7

// A quantity, and how often it was asked for.
struct shape {
    const struct rn_mesh_grid *grid;
    double (*value)(const double p[3]);
    int next;
};

static enum rn_status slice(void *context, int z, float *ret_values, struct rn_error *err) {
    struct shape *shape = context;
    const struct rn_mesh_grid *g = shape->grid;
    ck_assert_int_eq(z, shape->next++);
    for (int y = 0; y <= g->cells[1]; y++)
        for (int x = 0; x <= g->cells[0]; x++) {
            double at[3] = {x, y, z};
            for (int i = 0; i < 3; i++)
                at[i] = g->low[i] + (g->high[i] - g->low[i]) * at[i] / g->cells[i];
            *ret_values++ = (float)shape->value(at);
        }
    return err && z < 0 ? RN_ERROR_INVALID : RN_OK;
}

static double ball(const double p[3]) {
    return RADIUS - sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
}

// Random, and below every level at the border: all cases of a cell occur, beside each other.
static double noise(const double p[3]) {
    uint64_t bits = 1;
    for (int i = 0; i < 3; i++) {
        if (fabs(p[i]) > 0.99) return -1;
        bits = (bits ^ (uint64_t)lround(p[i] * 1000 + 5000)) * 6364136223846793005u + 1442695041u;
        bits ^= bits >> 29;
    }
    return (double)(bits >> 40) / (1 << 23) - 1;
}

static struct rn_mesh march(double (*value)(const double p[3]), int nx, int ny, int nz) {
    struct rn_mesh mesh = {0};
    struct rn_error err = {0};
    struct rn_mesh_grid grid = {
        .low = {-1, -1, -1}, .high = {1, 1, 1}, .cells = {nx, ny, nz}, .slice = slice};
    struct shape shape = {&grid, value, 0};
    grid.context = &shape;
    ck_assert_msg(rn_mesh_march(&grid, 0, &mesh, &err) == RN_OK, "%s", err.text);
    ck_assert_int_eq(shape.next, nz + 1);
    return mesh;
}

static int compare_edges(const void *a, const void *b) {
    uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return (x > y) - (x < y);
}

// Every edge is passed once each way: the surface is closed, and turned one way all over.
static void check_closed(const struct rn_mesh *mesh) {
    size_t count = 3 * mesh->triangle_count;
    uint64_t *edges = malloc(count * sizeof *edges);
    for (size_t i = 0; i < count; i++) {
        uint64_t from = mesh->triangles[i / 3][i % 3], to = mesh->triangles[i / 3][(i + 1) % 3];
        ck_assert(from < mesh->vertex_count && from != to);
        edges[i] = from << 32 | to;
    }
    qsort(edges, count, sizeof *edges, compare_edges);
    for (size_t i = 0; i < count; i++) {
        uint64_t back = edges[i] << 32 | edges[i] >> 32;
        ck_assert(i == 0 || edges[i] != edges[i - 1]);
        ck_assert_ptr_nonnull(bsearch(&back, edges, count, sizeof *edges, compare_edges));
    }
    free(edges);
}

// By Gauss: positive where triangles are counterclockwise from outside.
static double volume(const struct rn_mesh *mesh) {
    double sum = 0;
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        double p[3][3];
        for (int i = 0; i < 9; i++)
            p[i / 3][i % 3] = (double)mesh->vertices[mesh->triangles[t][i / 3]].position[i % 3];
        for (int i = 0; i < 3; i++) {
            int j = (i + 1) % 3, k = (i + 2) % 3;
            sum += p[0][i] * (p[1][j] * p[2][k] - p[1][k] * p[2][j]) / 6;
        }
    }
    return sum;
}

START_TEST(a_ball_is_closed_and_round) {
    struct rn_mesh mesh = march(ball, 24, 30, 36);
    float(*normals)[3] = malloc(mesh.vertex_count * sizeof *normals);
    size_t flat = 0;
    check_closed(&mesh);
    double whole = 4.0 / 3 * M_PI * pow(RADIUS, 3), inside = volume(&mesh);
    ck_assert_double_gt(inside, 0.98 * whole);
    ck_assert_double_lt(inside, whole);
    // Linear between points h apart, along edges of up to sqrt(3) h: within their sagitta.
    double h = 2.0 / 24, most = 3 * h * h / (8 * (RADIUS - h));
    rn_mesh_normals(&mesh, normals);
    for (size_t v = 0; v < mesh.vertex_count; v++) {
        const float *p = mesh.vertices[v].position;
        double r = sqrt((double)(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]));
        ck_assert_double_lt(fabs(r - RADIUS), most);
        double outwards = 0;
        for (int i = 0; i < 3; i++)
            outwards += (double)(normals[v][i] * p[i]) / r;
        // Where the level passes through a point of the grid all triangles of a vertex may be that
        // point.
        flat += outwards == 0;
        ck_assert(outwards == 0 || outwards > 0.8);
    }
    ck_assert_uint_lt(flat, mesh.vertex_count / 50);
    free(normals);
    rn_mesh_finish(&mesh);
}
END_TEST

START_TEST(noise_is_closed) {
    struct rn_mesh mesh = march(noise, 16, 12, 14);
    ck_assert(mesh.triangle_count > 5000);
    check_closed(&mesh);
    ck_assert_double_gt(volume(&mesh), 0.5);
    rn_mesh_finish(&mesh);
}
END_TEST

static double nothing(const double p[3]) {
    return p[0] > 5 ? 1 : -1;
}

START_TEST(files_hold_what_is_meshed) {
    struct rn_mesh mesh = march(ball, 4, 4, 4), empty = march(nothing, 1, 1, 1);
    struct rn_error err = {0};
    uint8_t *bytes;
    size_t size;
    char begin[400];
    ck_assert_int_eq(rn_mesh_encode_ply(&mesh, &bytes, &size, &err), RN_OK);
    int length =
        snprintf(begin, sizeof begin, "ply\nformat binary_little_endian 1.0\nelement vertex %zu\n",
                 mesh.vertex_count);
    ck_assert(memcmp(bytes, begin, (size_t)length) == 0);
    uint8_t *body = (uint8_t *)strstr((char *)bytes, "end_header\n") + 11;
    ck_assert_uint_eq((size_t)(bytes + size - body),
                      15 * mesh.vertex_count + 13 * mesh.triangle_count);
    uint8_t *face = bytes + size - 13;
    ck_assert_int_eq(face[0], 3);
    ck_assert(memcmp(face + 1, mesh.triangles[mesh.triangle_count - 1], 12) == 0);
    free(bytes);
    ck_assert_int_eq(rn_mesh_encode_obj(&mesh, &bytes, &size, &err), RN_OK);
    size_t vertices = 0, faces = 0, most = 0;
    for (char *line = strtok((char *)bytes, "\n"); line; line = strtok(NULL, "\n")) {
        unsigned v[3];
        vertices += line[0] == 'v';
        if (sscanf(line, "f %u %u %u", &v[0], &v[1], &v[2]) != 3) continue;
        faces++;
        for (int i = 0; i < 3; i++) {
            ck_assert_uint_ge(v[i], 1);
            most = v[i] > most ? v[i] : most;
        }
    }
    ck_assert(vertices == mesh.vertex_count && faces == mesh.triangle_count && most == vertices);
    free(bytes);
    ck_assert_int_eq(rn_mesh_encode_obj(&empty, &bytes, &size, &err), RN_OK);
    ck_assert(empty.vertex_count == 0 && size == 0);
    free(bytes);
    rn_mesh_finish(&mesh);
    rn_mesh_finish(&empty);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("mesh");
    TCase *tests = tcase_create("mesh");
    tcase_add_test(tests, a_ball_is_closed_and_round);
    tcase_add_test(tests, noise_is_closed);
    tcase_add_test(tests, files_hold_what_is_meshed);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}

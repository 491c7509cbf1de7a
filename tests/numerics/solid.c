// Case 4: planes from solids: orthonormal to 1 ULP, and as symmetric as the solid.
#include "server/engine/field/solid.h"
#include "tests/numerics/exact.h"
#include "tests/support/numerics.h"

static exact exact_dot(const double a[3], const double b[3]) {
    exact sum = number(0);
    for (int i = 0; i < 3; i++)
        sum = plus(sum, times(number(a[i]), number(b[i])));
    return sum;
}

static struct rn_solid solid_of(int planes, enum rn_orientation orientation, uint64_t seed) {
    struct rn_solid solid;
    if (rn_solid_init(planes, orientation, seed, &solid, NULL) != RN_OK) {
        fprintf(stderr, "%d planes refused\n", planes);
        exit(1);
    }
    return solid;
}

static void see_plane(struct numerics_case cases[2], const struct rn_solid *solid, int k,
                      int orientation) {
    const double *frame[3] = {solid->normal[k], solid->axis_u[k], solid->axis_v[k]};
    for (int a = 0; a < 3; a++)
        for (int b = a; b < 3; b++) {
            exact_reset();
            exact product = exact_dot(frame[a], frame[b]);
            if (a == b) product = root(product);
            numerics_see(&cases[a != b], exact_distance(a == b, product) / 0x1p-52,
                         "%d planes, orientation %d, plane %d, vectors %d %d", solid->planes,
                         orientation, k, a, b);
        }
}

static int check_orthonormal(struct numerics_random *random) {
    struct numerics_case cases[2] = {
        {"4 solid unit vectors", "all orientations, 1..16 planes", "ULP of 1", 1, 0, ""},
        {"4 solid right angles", "all orientations, 1..16 planes", "ULP of 1", 1, 0, ""}};
    for (int orientation = 0; orientation < 4; orientation++)
        for (int planes = 1; planes <= RN_MAX_PLANES; planes++)
            for (int draw = 0; draw < (orientation < 2 ? 1 : 20); draw++) {
                if (orientation == 0 && planes != 3 && planes != 4 && planes != 6 && planes != 10)
                    continue;
                struct rn_solid solid = solid_of(planes, (enum rn_orientation)orientation,
                                                 (uint64_t)numerics_uniform(random, 0, 1e15));
                for (int k = 0; k < planes; k++)
                    see_plane(cases, &solid, k, orientation);
            }
    return numerics_close(&cases[0]) + numerics_close(&cases[1]);
}

// Rotations as matrices; a group is built by multiplying its generators until nothing is new.
struct group {
    int count;
    double element[60][3][3];
};

static void multiply(double a[3][3], double b[3][3], double ret[3][3]) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            ret[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j];
}

static bool group_add(struct group *group, double m[3][3]) {
    for (int e = 0; e < group->count; e++) {
        double distance = 0;
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++)
                distance = fmax(distance, fabs(m[i][j] - group->element[e][i][j]));
        if (distance < 1e-6) return false;
    }
    if (group->count == 60) {
        fprintf(stderr, "a group of more than 60 rotations\n");
        exit(1);
    }
    for (int i = 0; i < 9; i++)
        group->element[group->count][i / 3][i % 3] = m[i / 3][i % 3];
    group->count++;
    return true;
}

// Rotation by `angle` about a unit axis (Rodrigues).
static void rotation(const double axis[3], double angle, double ret[3][3]) {
    double c = cos(angle), s = sin(angle);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            int k = 3 - i - j;
            double skew = i == j ? 0 : (j - i + 3) % 3 == 1 ? -axis[k] : axis[k];
            ret[i][j] = (i == j ? c : 0) + (1 - c) * axis[i] * axis[j] + s * skew;
        }
}

// The 24 rotations of the cube, or the 60 of the icosahedron with vertices (0, 1, phi), ....
static struct group rotations(bool cube) {
    double generator[2][3][3], product[3][3];
    double phi = (1 + sqrt(5)) / 2, norm = sqrt(1 + phi * phi);
    double vertex[3] = {0, 1 / norm, phi / norm}, diagonal[3], z[3] = {0, 0, 1};
    for (int i = 0; i < 3; i++)
        diagonal[i] = 1 / sqrt(3);
    rotation(diagonal, 2 * acos(-1) / 3, generator[0]);
    rotation(cube ? z : vertex, 2 * acos(-1) / (cube ? 4 : 5), generator[1]);
    struct group group = {0};
    group_add(&group, generator[0]);
    for (int e = 0; e < group.count; e++)
        for (int g = 0; g < 2; g++) {
            multiply(generator[g], group.element[e], product);
            group_add(&group, product);
        }
    return group;
}

// Trace and determinant of the covariance seen on each plane.
static void project(const struct rn_solid *solid, double s[3][3], double (*ret)[2]) {
    for (int k = 0; k < solid->planes; k++) {
        const double *axis[2] = {solid->axis_u[k], solid->axis_v[k]};
        double c[2][2] = {{0}};
        for (int a = 0; a < 4; a++)
            for (int i = 0; i < 9; i++)
                c[a / 2][a % 2] += axis[a / 2][i / 3] * s[i / 3][i % 3] * axis[a % 2][i % 3];
        ret[k][0] = c[0][0] + c[1][1];
        ret[k][1] = c[0][0] * c[1][1] - c[0][1] * c[1][0];
    }
}

// How far one set of (trace, determinant) is from being a permutation of another: each pair takes
// its nearest free partner.
static double unmatched(int n, double (*a)[2], double (*b)[2]) {
    bool taken[RN_MAX_PLANES] = {false};
    double worst = 0;
    for (int i = 0; i < n; i++) {
        int best = -1;
        double least = INFINITY;
        for (int j = 0; j < n; j++) {
            double distance = fmax(fabs(a[i][0] - b[j][0]), fabs(a[i][1] - b[j][1]));
            if (taken[j] || distance >= least) continue;
            least = distance;
            best = j;
        }
        if (best >= 0) taken[best] = true;
        worst = fmax(worst, least);
    }
    return worst;
}

static int check_symmetry(int planes, struct numerics_random *random) {
    bool cube = planes < 6;
    struct group group = rotations(cube);
    struct rn_solid solid = solid_of(planes, RN_ORIENTATION_PLATONIC, 0);
    char name[80], range[80];
    snprintf(name, sizeof name, "4 solid projections permute, %d planes", planes);
    snprintf(range, sizeof range, "%d rotations x 50 covariances of norm 1", group.count);
    struct numerics_case c = {name, range, "ULP of 1", 32, 0, ""};
    if (group.count != (cube ? 24 : 60))
        numerics_see(&c, INFINITY, "a group of %d rotations", group.count);
    for (int n = 0; n < 50; n++) {
        double d[3], s[3][3], half[3][3], turned[3][3], back[3][3], before[16][2], after[16][2];
        numerics_direction(random, d);
        double flat = numerics_spread(random, 1e-8, 1);
        for (int i = 0; i < 9; i++)
            s[i / 3][i % 3] = (1 - flat) * d[i / 3] * d[i % 3] + (i % 4 == 0 ? flat : 0);
        project(&solid, s, before);
        for (int e = 0; e < group.count; e++) {
            for (int i = 0; i < 9; i++)
                back[i / 3][i % 3] = group.element[e][i % 3][i / 3];
            multiply(group.element[e], s, half);
            multiply(half, back, turned);
            project(&solid, turned, after);
            numerics_see(&c, unmatched(planes, before, after) / 0x1p-52,
                         "axis %.9g %.9g %.9g, ratio %.3g, rotation %d", d[0], d[1], d[2], flat, e);
        }
    }
    return numerics_close(&c);
}

int main(void) {
    struct numerics_random random = numerics_random();
    int failed = check_orthonormal(&random);
    failed += check_symmetry(3, &random) + check_symmetry(4, &random);
    failed += check_symmetry(6, &random) + check_symmetry(10, &random);
    return failed > 0;
}

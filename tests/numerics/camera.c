// Case 7: cameras: rays, cone radii and fields of view at the ends of what lenses and files have.
#include "common/math/camera.h"

#include "tests/numerics/exact.h"
#include "tests/support/numerics.h"

// A rotation, rounded, from a random unit quaternion; a far position.
static void draw_pose(struct numerics_random *random, double pose[3][4]) {
    double q[4], norm = 0;
    for (int i = 0; i < 4; i++) {
        q[i] = numerics_uniform(random, -1, 1);
        norm += q[i] * q[i];
    }
    for (int i = 0; i < 4; i++)
        q[i] /= sqrt(norm);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            int k = 3 - i - j;
            double skew = i == j ? 0 : (j - i + 3) % 3 == 1 ? -q[k] : q[k];
            pose[i][j] = 2 * (q[i] * q[j] + q[3] * skew) + (i == j ? 2 * q[3] * q[3] - 1 : 0);
        }
    for (int i = 0; i < 3; i++)
        pose[i][3] = numerics_uniform(random, -1e6, 1e6);
}

static struct rn_camera draw_camera(struct numerics_random *random, int n) {
    static const int sides[] = {1, 2, 11, 800, 1920, RN_CAMERA_MAX_SIZE};
    static const double focals[] = {1e-3, 1e6};
    struct rn_camera camera = {
        .lens = RN_LENS_PINHOLE, .width = sides[n % 6], .height = sides[n / 6 % 6]};
    double fov = numerics_spread(random, 0.01, 179) * acos(-1) / 180;
    camera.fx = n % 7 < 2 ? focals[n % 7] : 0.5 * camera.width / tan(fov / 2);
    camera.fy = n % 11 < 2 ? focals[n % 11] : camera.fx * numerics_spread(random, 0.5, 2);
    camera.cx = n % 3 ? camera.width * numerics_uniform(random, -2, 3) : 0.5 * camera.width;
    camera.cy = n % 3 ? camera.height * numerics_uniform(random, -2, 3) : 0.5 * camera.height;
    draw_pose(random, camera.world_from_camera);
    return camera;
}

// R (x, y, 1) / |(x, y, 1)| of the camera as represented.
static void exact_direction(const struct rn_camera *camera, double px, double py, exact ret[3]) {
    exact x = over(minus(number(px), number(camera->cx)), number(camera->fx));
    exact y = over(minus(number(py), number(camera->cy)), number(camera->fy));
    exact norm = root(plus(plus(square(x), square(y)), number(1)));
    for (int i = 0; i < 3; i++) {
        const double *row = camera->world_from_camera[i];
        exact sum = plus(times(number(row[0]), x), times(number(row[1]), y));
        ret[i] = over(plus(sum, number(row[2])), norm);
    }
}

static int check_rays(struct numerics_random *random) {
    const char *range = "fields 0.01..179 degrees, focals 1e-3..1e6, images 1..16384, principal "
                        "points -2..3 images off";
    struct numerics_case direction = {"7 camera ray direction", range, "ULP of 1", 4, 0, ""};
    struct numerics_case radius = {"7 camera cone radius", range, "ULP", 4, 0, ""};
    for (int n = 0; n < 20000; n++) {
        struct rn_camera camera = draw_camera(random, n);
        double px = (int)numerics_uniform(random, 0, camera.width) + 0.5;
        double py = (int)numerics_uniform(random, 0, camera.height) + 0.5;
        struct rn_ray ray = rn_camera_ray(&camera, px, py);
        exact_reset();
        exact truth[3];
        exact_direction(&camera, px, py, truth);
        for (int i = 0; i < 3; i++)
            numerics_see(&direction, exact_distance(ray.direction[i], truth[i]) / 0x1p-52,
                         "%d x %d, focals %.9g %.9g, centre %.9g %.9g, pixel %.9g %.9g",
                         camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy,
                         px, py);
        exact area = over(number(1), times(number(camera.fx), number(camera.fy)));
        numerics_see(&radius, exact_ulps(ray.radius, root(over(area, exact_pi())), 53),
                     "focals %.17g %.17g", camera.fx, camera.fy);
    }
    return numerics_close(&direction) + numerics_close(&radius);
}

static int check_fields(struct numerics_random *random) {
    struct numerics_case fov = {
        "7 camera field of view", "0.01..179 degrees, images 1..16384", "ULP", 4, 0, ""};
    struct numerics_case focal = {
        "7 camera focal length", "0.01..179 degrees, images 1..16384", "ULP", 4, 0, ""};
    for (int n = 0; n < 20000; n++) {
        double angle = numerics_spread(random, 0.01, 179) * (acos(-1) / 180);
        int size = (int)numerics_spread(random, 1, RN_CAMERA_MAX_SIZE + 1);
        exact_reset();
        exact truth = over(number(0.5 * size), tangent(number(angle / 2)));
        double got = rn_camera_focal_from_fov(angle, size);
        numerics_see(&focal, exact_ulps(got, truth, 53), "angle %.17g size %d", angle, size);
        struct rn_camera camera = {.width = size, .height = size, .fx = got, .fy = got};
        truth = times(number(2), arc_tangent(over(number(size), times(number(2), number(got)))));
        numerics_see(&fov,
                     exact_ulps(rn_camera_fov_from_focal(camera.fy, camera.height), truth, 53),
                     "focal %.17g size %d", got, size);
    }
    return numerics_close(&fov) + numerics_close(&focal);
}

int main(void) {
    struct numerics_random random = numerics_random();
    return check_rays(&random) + check_fields(&random) > 0;
}

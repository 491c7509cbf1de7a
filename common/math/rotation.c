#include "common/math/rotation.h"

#include <math.h>
#include <string.h>

void rn_rotation_from_vector(const double by[3], double pose[3][4]) {
    double angle = sqrt(by[0] * by[0] + by[1] * by[1] + by[2] * by[2]);
    double s = angle > 1e-12 ? sin(angle) / angle : 1;
    double c = angle > 1e-6 ? (1 - cos(angle)) / (angle * angle) : 0.5;
    const double cross[3][3] = {{0, -by[2], by[1]}, {by[2], 0, -by[0]}, {-by[1], by[0], 0}};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            pose[i][j] = (i == j) * cos(angle) + s * cross[i][j] + c * by[i] * by[j];
}

bool rn_rotation_from_quaternion(const double q[4], double pose[3][4]) {
    double length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (!(length > 1e-6) || !isfinite(length)) return false;
    double w = q[0] / length, x = q[1] / length, y = q[2] / length, z = q[3] / length;
    const double r[3][3] = {{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
                            {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
                            {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)}};
    for (int i = 0; i < 3; i++)
        memcpy(pose[i], r[i], sizeof r[i]);
    return true;
}

void rn_rotation_to_quaternion(const double m[3][4], double ret[4]) {
    double trace = m[0][0] + m[1][1] + m[2][2], q[4];
    int i = m[1][1] > m[0][0] ? 1 : 0;
    if (m[2][2] > m[i][i]) i = 2;
    if (trace > m[i][i]) {
        q[0] = 1 + trace;
        q[1] = m[2][1] - m[1][2];
        q[2] = m[0][2] - m[2][0];
        q[3] = m[1][0] - m[0][1];
    } else {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        q[0] = m[k][j] - m[j][k];
        q[1 + i] = 1 + m[i][i] - m[j][j] - m[k][k];
        q[1 + j] = m[j][i] + m[i][j];
        q[1 + k] = m[k][i] + m[i][k];
    }
    double length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int c = 0; c < 4; c++)
        ret[c] = q[c] / length;
}

double rn_rotation_skew(const double pose[3][4]) {
    double worst = 0;
    for (int i = 0; i < 3; i++)
        for (int j = i; j < 3; j++) {
            double dot = -(i == j);
            for (int k = 0; k < 3; k++)
                dot += pose[k][i] * pose[k][j];
            worst = fmax(worst, fabs(dot));
        }
    return worst;
}

double rn_rotation_determinant(const double m[3][4]) {
    return m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) -
           m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0]) +
           m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]);
}

void rn_pose_invert(const double pose[3][4], double ret[3][4]) {
    for (int i = 0; i < 3; i++) {
        ret[i][3] = 0;
        for (int j = 0; j < 3; j++) {
            ret[i][j] = pose[j][i];
            ret[i][3] -= pose[j][i] * pose[j][3];
        }
    }
}

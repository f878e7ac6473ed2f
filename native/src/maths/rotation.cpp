// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "maths/rotation.h"

namespace st {

Quaternion quaternion_from_matrix(const Matrix3 &R) {
    const double xx = R[0][0], yy = R[1][1], zz = R[2][2], trace = xx + yy + zz;
    Quaternion q;
    if (xx >= yy && xx >= zz && xx >= trace) {
        q = {1 + xx - yy - zz, R[0][1] + R[1][0], R[0][2] + R[2][0], R[2][1] - R[1][2]};
    } else if (yy >= zz && yy >= trace) {
        q = {R[0][1] + R[1][0], 1 - xx + yy - zz, R[1][2] + R[2][1], R[0][2] - R[2][0]};
    } else if (zz >= trace) {
        q = {R[0][2] + R[2][0], R[1][2] + R[2][1], 1 - xx - yy + zz, R[1][0] - R[0][1]};
    } else {
        q = {R[2][1] - R[1][2], R[0][2] - R[2][0], R[1][0] - R[0][1], 1 + trace};
    }
    return normalised(q.w < 0 ? Quaternion{-q.x, -q.y, -q.z, -q.w} : q);
}

Matrix3 turn_matrix(const Matrix3 &R, const Vector3 &g) {
    const double scale = 2 / (1 + dot(g, g));
    Matrix3 turned;
    for (int i = 0; i < 3; ++i) {
        // A row r times [g]x is r x g.
        const Vector3 p = cross({{R[i][0], R[i][1], R[i][2]}}, g), q = cross(p, g);
        for (int k = 0; k < 3; ++k) {
            turned[i][k] = R[i][k] + scale * (p[k] + q[k]);
        }
    }
    return turned;
}

double angle_between(const Vector3 &a, const Vector3 &b) {
    const double half = norm(Vector3{{a[0] - b[0], a[1] - b[1], a[2] - b[2]}}) / 2;
    return 2 * std::asin(half < 1 ? half : 1.0);
}

Quaternion quaternion_from_axes(const Vector3 &z, const Vector3 &towards_y) {
    const double along = dot(z, towards_y);
    Vector3 y;
    for (int i = 0; i < 3; ++i) {
        y[i] = towards_y[i] - z[i] * along;
    }
    y = scaled(y, 1 / norm(y));
    const Vector3 x = cross(y, z);
    return quaternion_from_matrix({{{x[0], y[0], z[0]}, {x[1], y[1], z[1]}, {x[2], y[2], z[2]}}});
}

}  // namespace st

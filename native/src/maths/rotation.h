// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Rotations. Quaternions are Hamilton, order x, y, z, w; q_icrf_from_sensor rotates sensor vectors
// into ICRF: v_icrf = R(q) v_sensor. Rotation vectors are in rad.

#pragma once

#include <cmath>

#include "maths/matrix.h"

namespace st {

struct Quaternion {
    double x, y, z, w;
};

/// Return the Hamilton product a b: first the rotation b, then a.
inline Quaternion multiply(const Quaternion &a, const Quaternion &b) {
    return {a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
            a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
            a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
            a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z};
}

/// Return the inverse rotation.
inline Quaternion conjugate(const Quaternion &q) {
    return {-q.x, -q.y, -q.z, q.w};
}

inline double dot(const Quaternion &a, const Quaternion &b) {
    return a.x * b.x + a.y * b.y + a.z * b.z + a.w * b.w;
}

inline Quaternion normalised(const Quaternion &q) {
    const double scale = 1 / std::sqrt(dot(q, q));
    return {q.x * scale, q.y * scale, q.z * scale, q.w * scale};
}

/// Return q or -q, whichever is nearer to the one before.
inline Quaternion sign_continuous(const Quaternion &q, const Quaternion &previous) {
    return dot(q, previous) < 0 ? Quaternion{-q.x, -q.y, -q.z, -q.w} : q;
}

/// Return q = [v sin(a / 2) / a, cos(a / 2)] of a rotation vector v of length a.
inline Quaternion quaternion_from_rotation_vector(const Vector3 &v) {
    const double half = norm(v) / 2;
    // The limit of sin(a / 2) / a at zero.
    const double scale = half > 0 ? std::sin(half) / (2 * half) : 0.5;
    return {v[0] * scale, v[1] * scale, v[2] * scale, std::cos(half)};
}

/// Return the rotation vector of q, of length pi at most: 2 atan2(|q_v|, q_w) q_v / |q_v|.
inline Vector3 rotation_vector_from_quaternion(Quaternion q) {
    if (q.w < 0) {
        q = {-q.x, -q.y, -q.z, -q.w};
    }
    const double sine = std::sqrt(q.x * q.x + q.y * q.y + q.z * q.z);
    const double scale = sine > 0 ? 2 * std::atan2(sine, q.w) / sine : 2.0;
    return {{scale * q.x, scale * q.y, scale * q.z}};
}

/// Return R(q) of a unit quaternion.
inline Matrix3 matrix_from_quaternion(const Quaternion &q) {
    const auto [x, y, z, w] = q;
    return {{{1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)},
             {2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)},
             {2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)}}};
}

/// Return exp([v]x) of a rotation vector v.
inline Matrix3 matrix_from_rotation_vector(const Vector3 &v) {
    return matrix_from_quaternion(quaternion_from_rotation_vector(v));
}

/// Return the quaternion, w >= 0, of a rotation matrix (Shepperd, J. Guid. Control 1, 1978).
///
/// 4 q q^T is linear in the matrix. Its row with the largest diagonal element is the quaternion up
/// to scale, without loss of precision.
Quaternion quaternion_from_matrix(const Matrix3 &R);

/// Return q after a turn by a rotation vector about sensor axes.
inline Quaternion turned(const Quaternion &q, const Vector3 &rotation) {
    return normalised(multiply(q, quaternion_from_rotation_vector(rotation)));
}

/// Return the rotation vector about the axes of q to another attitude: other = turned(q, v).
inline Vector3 rotation_between(const Quaternion &q, const Quaternion &other) {
    return rotation_vector_from_quaternion(multiply(conjugate(q), other));
}

/// Return the rotation vector about sensor axes from truth to estimate.
inline Vector3 attitude_error(const Quaternion &estimate, const Quaternion &truth) {
    return rotation_between(truth, estimate);
}

/// Return R (I + 2 ([g]x + [g]x^2) / (1 + g.g)): R turned about its sensor axes by a Rodrigues
/// (Gibbs) vector g, whose length is the tangent of half the angle. A rotation at any size of g.
Matrix3 turn_matrix(const Matrix3 &R, const Vector3 &g);

/// Return R^T v: a direction of ICRF on the axes of the sensor.
inline Vector3 sensor_direction(const Matrix3 &R, const Vector3 &v) {
    return {{R[0][0] * v[0] + R[1][0] * v[1] + R[2][0] * v[2],
             R[0][1] * v[0] + R[1][1] * v[1] + R[2][1] * v[2],
             R[0][2] * v[0] + R[1][2] * v[1] + R[2][2] * v[2]}};
}

/// Return the angle between unit vectors, also a small one exactly: 2 asin(|a - b| / 2).
double angle_between(const Vector3 &a, const Vector3 &b);

/// Return the quaternion of axes z, a unit vector, and y, in the plane of both vectors.
Quaternion quaternion_from_axes(const Vector3 &z, const Vector3 &towards_y);

/// Return R P R^T: a covariance about sensor axes on ICRF axes.
inline Matrix3 covariance_icrf(const Quaternion &q, const Matrix3 &P) {
    const Matrix3 R = matrix_from_quaternion(q);
    return R * P * transposed(R);
}

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "attitude/attitude_at.h"

#include <cmath>

#include "attitude/results.h"

namespace st {
namespace {

double trace(const Matrix3 &P) {
    return P[0][0] + P[1][1] + P[2][2];
}

Matrix3 times(double factor, const Matrix3 &P) {
    Matrix3 scaled;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            scaled[i][j] = factor * P[i][j];
        }
    }
    return scaled;
}

}  // namespace

st_attitude attitude_at(const st_attitude &attitude, int64_t stamp_ns) {
    const double dt_s = static_cast<double>(stamp_ns - attitude.stamp_ns) * 1e-9;
    const Matrix3 by_rate = times(dt_s * dt_s, matrix_of(attitude.rate_covariance));
    Matrix3 P = matrix_of(attitude.covariance_rad2), C = matrix_of(attitude.cross_covariance);
    const bool has_cross = !std::isnan(C[0][0]);
    if (has_cross) {
        P = P + times(dt_s, C + transposed(C)) + by_rate;
        C = C + times(dt_s, matrix_of(attitude.rate_covariance));
    } else if (trace(by_rate) > 0) {
        const double own = std::sqrt(trace(P)), other = std::sqrt(trace(by_rate));
        P = times(1 + other / own, P) + times(1 + own / other, by_rate);
    }
    const double *sigma =
        dt_s > 0 ? attitude.acceleration_sigma_rad_s2 : attitude.acceleration_sigma_before_rad_s2;
    Vector3 turn;
    st_attitude at = attitude;
    for (int i = 0; i < 3; ++i) {
        const double rate = attitude.rate_rad_s[i], mean = attitude.acceleration_rad_s2[i];
        const double jerk = attitude.jerk_rad_s3[i], moved = sigma[i] * dt_s;
        turn[i] = (rate + mean * (dt_s / 2) + jerk * (dt_s * dt_s / 6)) * dt_s;
        at.rate_rad_s[i] = rate + (mean + jerk * (dt_s / 2)) * dt_s;
        at.acceleration_rad_s2[i] = mean + jerk * dt_s;
        at.rate_covariance[i][i] += moved * moved;
        if (dt_s != 0) {
            at.protection_rad[i] = INFINITY;
        }
    }
    // The error is about axes that turn with the sensor.
    const Matrix3 A = transposed(matrix_from_rotation_vector(turn));
    P = A * P * transposed(A);
    for (int i = 0; i < 3; ++i) {
        const double moved = sigma[i] * dt_s * dt_s / 2;
        P[i][i] += moved * moved;
    }
    set(P, at.covariance_rad2);
    if (has_cross) {
        set(A * C, at.cross_covariance);
    }
    set(multiply(quaternion_of(attitude.quaternion), quaternion_from_rotation_vector(turn)),
        at.quaternion);
    at.stamp_ns = stamp_ns;
    return at;
}

}  // namespace st

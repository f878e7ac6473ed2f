// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "identify/best_fit.h"

#include "maths/rotation.h"
#include "maths/symmetric.h"

namespace st {
namespace {

// Least gap of the eigenvalues of Davenport's matrix that is observable. Below it double precision
// no longer holds the third axis. Two stars of equal weight reach it 0.3 arcsec apart.
constexpr double MIN_GAP = 1e-12;
constexpr double CONVERGED2 = 1e-20;  // rad^2

/// Return axes by rows: a vector, the normal of the plane of two, and across.
Matrix3 frame(const Vector3 &first, const Vector3 &second) {
    Vector3 normal = cross(first, second);
    normal = scaled(normal, 1 / norm(normal));
    Vector3 across = cross(first, normal);
    across = scaled(across, 1 / norm(across));
    Matrix3 axes;
    for (int k = 0; k < 3; ++k) {
        axes[0][k] = first[k];
        axes[1][k] = normal[k];
        axes[2][k] = across[k];
    }
    return axes;
}

/// Return the inverse Fisher information of the directions that are predicted.
Covariance inverse_information(const Matrix3 &R, const Directions &stars) {
    Matrix3 F{};
    for (int i = 0; i < stars.count; ++i) {
        const Vector3 p = sensor_direction(R, stars.icrf[i]);
        const double x = p[0], y = p[1], z = p[2], w = stars.weight[i];
        F[0][0] += w * (y * y + z * z);
        F[1][1] += w * (x * x + z * z);
        F[2][2] += w * (x * x + y * y);
        F[0][1] -= w * x * y;
        F[0][2] -= w * x * z;
        F[1][2] -= w * y * z;
    }
    const Adjugate a = adjugate(F);
    const double determinant = F[0][0] * a.xx + F[0][1] * a.xy + F[0][2] * a.xz;
    const double trace = F[0][0] + F[1][1] + F[2][2], minors = a.xx + a.yy + a.zz;
    // The least eigenvalue is half the gap, for weights whose sum is half the trace.
    if (!(determinant > MIN_GAP / 4 * trace * minors)) {
        return {{}, 0.0};
    }
    const double d = determinant;
    return {{{{a.xx / d, a.xy / d, a.xz / d},
              {a.xy / d, a.yy / d, a.yz / d},
              {a.xz / d, a.yz / d, a.zz / d}}},
            d};
}

}  // namespace

Matrix3 triad(const Directions &stars, int first, int second) {
    const Matrix3 sensor = frame(stars.sensor[first], stars.sensor[second]);
    return transposed(frame(stars.icrf[first], stars.icrf[second])) * sensor;
}

Covariance refine(Matrix3 &R, const Directions &stars, int most_steps) {
    Covariance covariance{};
    for (int step = 0; step < most_steps; ++step) {
        covariance = inverse_information(R, stars);
        if (!(covariance.determinant > 0)) {
            return {{}, 0.0};
        }
        Vector3 g{};
        for (int i = 0; i < stars.count; ++i) {
            const Vector3 c = cross(stars.sensor[i], sensor_direction(R, stars.icrf[i]));
            for (int k = 0; k < 3; ++k) {
                g[k] += stars.weight[i] * c[k];
            }
        }
        const Vector3 turn = covariance.P * g;
        R = turn_matrix(R, scaled(turn, 0.5));
        if (dot(turn, turn) < CONVERGED2) {
            break;
        }
    }
    return covariance;
}

}  // namespace st

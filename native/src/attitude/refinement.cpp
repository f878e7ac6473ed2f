// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "attitude/refinement.h"

#include "maths/rotation.h"
#include "maths/symmetric.h"

namespace st {
namespace {

constexpr double CONVERGED2 = 1e-20;  // rad^2

}  // namespace

Matrix3 information(const Vector3 *directions, const double *weight, int count) {
    Matrix3 F{};
    for (int i = 0; i < count; ++i) {
        add_information(directions[i], weight[i], F);
    }
    return symmetric(F);
}

Covariance inverse_information(const Matrix3 &F) {
    const Adjugate a = adjugate(F);
    const double determinant = F[0][0] * a.xx + F[0][1] * a.xy + F[0][2] * a.xz;
    // The least eigenvalue is half the gap, for weights whose sum is half the trace.
    const double trace = F[0][0] + F[1][1] + F[2][2], minors = a.xx + a.yy + a.zz;
    if (!(determinant > MIN_GAP / 4 * trace * minors)) {
        return {{}, 0.0};
    }
    const double d = determinant;
    return {{{{a.xx / d, a.xy / d, a.xz / d},
              {a.xy / d, a.yy / d, a.yz / d},
              {a.xz / d, a.yz / d, a.zz / d}}},
            d};
}

Covariance refine(Matrix3 &R, const Directions &stars, int most_steps) {
    Covariance covariance{};
    for (int step = 0; step < most_steps; ++step) {
        Matrix3 F{};
        Vector3 g{};
        for (int i = 0; i < stars.count; ++i) {
            const Vector3 p = sensor_direction(R, stars.icrf[i]);
            add_information(p, stars.weight[i], F);
            const Vector3 c = cross(stars.sensor[i], p);
            for (int k = 0; k < 3; ++k) {
                g[k] += stars.weight[i] * c[k];
            }
        }
        covariance = inverse_information(symmetric(F));
        if (!(covariance.determinant > 0)) {
            return covariance;
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

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/rolling_shutter.h"

#include "maths/symmetric.h"
#include "track/innovation.h"

namespace st {

namespace {

constexpr int LEAST_STARS = 6;
constexpr double LEAST_SHEAR_S =
    1e-6;  // spread of the delays from which on a rate moves stars apart

}  // namespace

Point at_frame_time(const Lens &lens, const Point &uv, double delay_s, const Vector3 &rate_rad_s,
                    const Vector3 &acceleration_rad_s2) {
    const Flow J = image_flow(lens, undistorted(lens, uv));
    Point moved = uv;
    for (int axis = 0; axis < 3; ++axis) {
        const double turn = delay_s * (rate_rad_s[axis] + acceleration_rad_s2[axis] * delay_s / 2);
        moved.x -= J[0][axis] * turn;
        moved.y -= J[1][axis] * turn;
    }
    return moved;
}

bool fit_rate(const Lens &lens, const DelayedStars &stars, const Quaternion &quaternion,
              Vector3 &rate_rad_s) {
    if (stars.count < LEAST_STARS) {
        return false;
    }
    double least_s = stars.delay_s[0], most_s = stars.delay_s[0];
    const Matrix3 R = matrix_from_quaternion(quaternion);
    // Of [turn, rate]: sums of J^T J, d J^T J and d^2 J^T J make the normal equations.
    NormalEquations3 turn{}, cross{}, rate{};
    for (int k = 0; k < stars.count; ++k) {
        const double d = stars.delay_s[k], variance = stars.sigma_px[k] * stars.sigma_px[k];
        least_s = d < least_s ? d : least_s;
        most_s = d > most_s ? d : most_s;
        const Point plane = plane_point(lens.equidistant, sensor_direction(R, stars.icrf[k]));
        const Point predicted = pixel_of(lens, plane);
        const Innovation residual{{stars.uv[k].x - predicted.x, stars.uv[k].y - predicted.y},
                                  round_error(variance)};
        const Flow J = image_flow(lens, plane);
        turn.add(J, residual, 1.0);
        cross.add(J, residual, d);
        rate.add(J, residual, d * d);
    }
    const Information both = turn_and_rate(turn, cross, rate);
    Matrix<6, 6> L;
    if (most_s - least_s < LEAST_SHEAR_S || !cholesky(both.information, L)) {
        return false;
    }
    Matrix<6, 1> right;
    for (int i = 0; i < 6; ++i) {
        right[i][0] = both.vector[i];
    }
    const Matrix<6, 1> solution = solved(L, right);
    rate_rad_s = {{solution[3][0], solution[4][0], solution[5][0]}};
    return true;
}

}  // namespace st

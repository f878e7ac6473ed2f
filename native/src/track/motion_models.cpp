// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/motion_models.h"

#include <cmath>

#include "maths/symmetric.h"

namespace st {

StarMotion constant_velocity(double dt_s, const Point &acceleration_px_s2) {
    const double half = dt_s * dt_s / 2;
    StarMotion motion{};
    motion.transition = {{{1, dt_s, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, dt_s}, {0, 0, 0, 1}}};
    const double effect[2][2] = {{half * acceleration_px_s2.x, dt_s * acceleration_px_s2.x},
                                 {half * acceleration_px_s2.y, dt_s * acceleration_px_s2.y}};
    for (int axis = 0; axis < 2; ++axis) {
        for (int i = 0; i < 2; ++i) {
            for (int j = 0; j < 2; ++j) {
                motion.noise[2 * axis + i][2 * axis + j] = effect[axis][i] * effect[axis][j];
            }
        }
    }
    return motion;
}

namespace {

using Matrix2 = Matrix<2, 2>;

double sinc(double x) {
    return x != 0 ? std::sin(x) / x : 1.0;
}

/// Return (sin x - x + x^3 / 6) / x^5, which has a limit at 0.
double fifth_remainder(double x) {
    if (std::fabs(x) > 2) {
        return (std::sin(x) - x + x * x * x / 6) / (x * x * x * x * x);
    }
    // Of the sine from the fifth power on, the highest first.
    double total = 0.0;
    for (int power = 27; power > 4; power -= 2) {
        double factorial = 1.0;
        for (int k = 2; k <= power; ++k) {
            factorial *= k;
        }
        total = 1 / factorial - total * x * x;
    }
    return total;
}

/// The integrals of a a^T, b b^T and a b^T over the step.
///
/// An impulse at time t before the end of the step changes position and velocity along itself by
/// a = [sin(wt) / w, cos(wt)], and across itself by b = [(1 - cos(wt)) / w, sin(wt)]; angle is w dt.
struct TurnedNoise {
    Matrix2 own, other, between;
};

TurnedNoise turned_noise(double dt_s, double angle) {
    const double square = angle * angle;
    const double sinc2 = sinc(angle) * sinc(angle);
    const double half2 = sinc(angle / 2) * sinc(angle / 2), half = half2 * half2;
    const double fifth = fifth_remainder(angle), fifth_of_double = fifth_remainder(2 * angle);
    // (2 angle - sin(2 angle)) / (2 angle)^3, and the same of angle.
    const double third_of_double = 1.0 / 6 - 4 * square * fifth_of_double;
    const double third = 1.0 / 6 - square * fifth;
    TurnedNoise noise = {
        {{{2 * third_of_double, sinc2 / 2}, {sinc2 / 2, 1 - 2 * third_of_double * square}}},
        {{{2 * (4 * fifth_of_double - fifth) * square, half / 8 * square},
          {half / 8 * square, 2 * third_of_double * square}}},
        {{{half / 8 * angle, 2 * third_of_double * angle},
          {(2 * third_of_double - third) * angle, sinc2 / 2 * angle}}}};
    const double scale[2][2] = {{dt_s * dt_s * dt_s, dt_s * dt_s}, {dt_s * dt_s, dt_s}};
    for (int i = 0; i < 2; ++i) {
        for (int j = 0; j < 2; ++j) {
            noise.own[i][j] *= scale[i][j];
            noise.other[i][j] *= scale[i][j];
            noise.between[i][j] *= scale[i][j];
        }
    }
    return noise;
}

}  // namespace

StarMotion coordinated_turn(double dt_s, double rate_rad_s, const Point &density) {
    const double angle = rate_rad_s * dt_s;
    const double sine = std::sin(angle), cosine = std::cos(angle);
    const double half = sinc(angle / 2);
    const double along = dt_s * sinc(angle), across = dt_s * angle / 2 * (half * half);
    StarMotion motion;
    motion.transition = {{{1.0, along, 0.0, -across},
                          {0.0, cosine, 0.0, -sine},
                          {0.0, across, 1.0, along},
                          {0.0, sine, 0.0, cosine}}};
    const TurnedNoise noise = turned_noise(dt_s, angle);
    const double u = density.x * density.x, v = density.y * density.y;
    for (int i = 0; i < 2; ++i) {
        for (int j = 0; j < 2; ++j) {
            motion.noise[i][j] = u * noise.own[i][j] + v * noise.other[i][j];
            motion.noise[2 + i][2 + j] = u * noise.other[i][j] + v * noise.own[i][j];
            motion.noise[i][2 + j] = u * noise.between[i][j] - v * noise.between[j][i];
            motion.noise[2 + j][i] = motion.noise[i][2 + j];
        }
    }
    return motion;
}

Flow flow_of(const Lens &lens, const Vector3 &direction) {
    return image_flow(lens, plane_point(lens.equidistant, direction));
}

Covariance2 pixel_covariance(const Flow &J, const Matrix3 &P) {
    Covariance2 covariance{};
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            covariance.uu += J[0][i] * P[i][j] * J[0][j];
            covariance.uv += J[0][i] * P[i][j] * J[1][j];
            covariance.vv += J[1][i] * P[i][j] * J[1][j];
        }
    }
    return covariance;
}

void moved_by(const Lens &lens, const Point &uv, double variance_px2, const Vector3 &rate_rad_s,
              const Matrix3 &rate_covariance, StarState &state, StarCovariance &covariance) {
    const Flow J = flow_of(lens, unproject(lens, uv));
    const Point velocity = velocity_of(J, rate_rad_s);
    const Covariance2 moved = pixel_covariance(J, rate_covariance);
    state = {{uv.x, velocity.x, uv.y, velocity.y}};
    covariance = {{{variance_px2, 0, 0, 0},
                   {0, moved.uu, 0, moved.uv},
                   {0, 0, variance_px2, 0},
                   {0, moved.uv, 0, moved.vv}}};
}

StarState turn_curvature(const Lens &lens, const Point &uv, const Vector3 &rate_rad_s, double dt_s,
                         const Matrix3 &turn) {
    const Point begin = undistorted(lens, uv);
    // R^T d: the direction on the axes after the turn.
    const Point end =
        plane_point(lens.equidistant, sensor_direction(turn, ray(lens.equidistant, begin)));
    if (std::isnan(end.x)) {
        return {{NAN, NAN, NAN, NAN}};
    }
    const Point after = distort(lens.terms, end);
    const Point before_rate = velocity_of(image_flow(lens, begin), rate_rad_s);
    const Point after_rate = velocity_of(image_flow(lens, end), rate_rad_s);
    return {
        {after.x * lens.fx + lens.cx - uv.x - before_rate.x * dt_s, after_rate.x - before_rate.x,
         after.y * lens.fy + lens.cy - uv.y - before_rate.y * dt_s, after_rate.y - before_rate.y}};
}

Matrix<4, 4> rolled(const Lens &lens, double rate_rad_s, double dt_s) {
    const double aspect = lens.fx / lens.fy;
    const double sine = std::sin(rate_rad_s * dt_s), cosine = std::cos(rate_rad_s * dt_s);
    const Matrix2 turn = {{{cosine, sine * aspect}, {-sine / aspect, cosine}}};
    const Matrix2 flow = {{{0.0, rate_rad_s * aspect}, {rate_rad_s * (-1 / aspect), 0.0}}};
    const Matrix2 gained = flow * turn;
    Matrix<4, 4> transition{};
    for (int i = 0; i < 2; ++i) {
        for (int j = 0; j < 2; ++j) {
            transition[2 * i][2 * j] = transition[2 * i + 1][2 * j + 1] = turn[i][j];
            transition[2 * i + 1][2 * j] = gained[i][j];
        }
    }
    return transition;
}

bool body_rate(const NormalEquations3 &sums, Vector3 &rate_rad_s, Matrix3 &rate_covariance) {
    if (!is_positive_definite(sums.information)) {
        return false;
    }
    rate_covariance = inverse(sums.information);
    rate_rad_s = rate_covariance * sums.vector;
    return true;
}

}  // namespace st

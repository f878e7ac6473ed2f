// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// How star images move: constant velocity, coordinated turn, and under a turn of the camera.
//
// The state of one star is [u, u_rate, v, v_rate] in px and px/s. Under the body rate w (rad/s,
// sensor axes) a direction d in the sensor frame changes by -w x d.

#pragma once

#include "camera/lens.h"
#include "maths/covariance2.h"
#include "maths/matrix.h"
#include "track/innovation.h"

namespace st {

using StarState = Vector<4>;
using StarCovariance = Matrix<4, 4>;

/// Transition and process noise of a step.
struct StarMotion {
    Matrix<4, 4> transition, noise;
};

/// Constant velocity: white acceleration of 1 sigma (u, v) in px/s^2, constant within the step,
/// Q = E diag(s^2) E^T (Sadeghi, Sabahi and Saberali). dt_s > 0.
StarMotion constant_velocity(double dt_s, const Point &acceleration_px_s2);

/// Coordinated turn: the velocity turns by rate_rad_s from u towards v, as that of all stars does
/// when the camera turns about its boresight by -rate_rad_s (body rate z).
///
/// density are the square roots of the spectral densities (u, v) of white noise that acts throughout
/// the step, px/s^1.5: Q = integral of e^(At) diag(0, s^2) e^(At)^T over the step (Sadeghi, Sabahi
/// and Saberali). A 1 sigma of constant_velocity() compares to s / sqrt(dt_s). Any finite rate,
/// dt_s > 0.
StarMotion coordinated_turn(double dt_s, double rate_rad_s, const Point &density);

/// Return the image motion per body rate of a direction; NaN behind the camera.
Flow flow_of(const Lens &lens, const Vector3 &direction);

/// Return J w: the velocity in px/s under a body rate.
inline Point velocity_of(const Flow &J, const Vector3 &rate_rad_s) {
    return {J[0][0] * rate_rad_s[0] + J[0][1] * rate_rad_s[1] + J[0][2] * rate_rad_s[2],
            J[1][0] * rate_rad_s[0] + J[1][1] * rate_rad_s[1] + J[1][2] * rate_rad_s[2]};
}

/// Return J P J^T in px^2 of an attitude covariance P in rad^2.
Covariance2 pixel_covariance(const Flow &J, const Matrix3 &P);

/// Fill state and covariance of a star seen at uv, of variance px^2 per axis, which the body moves
/// with a rate of a covariance in rad^2/s^2.
void moved_by(const Lens &lens, const Point &uv, double variance_px2, const Vector3 &rate_rad_s,
              const Matrix3 &rate_covariance, StarState &state, StarCovariance &covariance);

/// Return what a steady turn adds to a constant velocity prediction of a star at uv.
///
/// Stars run on curves across the image, most of all under roll: without this term a filter lags
/// behind them. turn is exp([w dt]x). NaN for a star that the turn puts behind the camera.
StarState turn_curvature(const Lens &lens, const Point &uv, const Vector3 &rate_rad_s, double dt_s,
                         const Matrix3 &turn);

/// Return the transition of a star, as seen from the principal point, by a known roll.
///
/// Position and velocity turn by rate_rad_s dt_s (body rate z), and the velocity gains that of the
/// image under rate_rad_s. With F of the motion without the roll the state becomes
/// rolled(rate, dt) F rolled(-rate before, 0) X: equation 18 of Sadeghi, Sabahi and Saberali.
Matrix<4, 4> rolled(const Lens &lens, double rate_rad_s, double dt_s);

/// Fill the body rate that moves stars at the velocities of weighted least squares, and its
/// covariance; false where less than two stars fix it.
bool body_rate(const NormalEquations3 &sums, Vector3 &rate_rad_s, Matrix3 &rate_covariance);

}  // namespace st

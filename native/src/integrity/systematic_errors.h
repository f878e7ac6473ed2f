// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The covariance that systematic errors of the stars add to an attitude fitted to them.
//
// The attitude is fitted to stars with directions p on sensor axes and weights w = 1 / sigma^2. Its
// Fisher information is F = sum w (I - p p^T).

#pragma once

#include "camera/lens.h"
#include "maths/rotation.h"

namespace st {

/// Stars (count): unit vectors on sensor axes, errors sigma_rad per axis, and proper motions, rad a
/// year on ICRS axes, null where unknown.
struct FittedStars {
    int count;
    const Vector3 *sensor;
    const double *sigma_rad;
    const Vector3 *motion_rad_year;
};

/// Return the covariance rad^2 by an unknown velocity, of 1 sigma on each axis.
///
/// A velocity v shifts a star by (v - (v.p) p) / c, which turns the best fit by F^-1 (s x v) / c with
/// s = sum w p: about the axes across the boresight by v / c, about the boresight by some v / c times
/// the angle of the field. The covariance of the turn is (sigma_v / c)^2 F^-1 (s^2 I - s s^T) F^-1.
Matrix3 velocity_covariance(double velocity_sigma_m_s, const FittedStars &stars);

/// Return the covariance rad^2 by errors of the lens, of 1 sigma per axis and star.
///
/// The errors are independent between stars and the same in each frame: sigma_l^2 F^-1 G F^-1, with G
/// = sum w^2 (I - p p^T). A scale, the relative error of the distances from the axis z, moves stars
/// by scale (p - z), which turns the best fit by scale F^-1 sum w p_z (-p_y, p_x, 0).
Matrix3 lens_covariance(double lens_sigma_rad, double scale, const FittedStars &stars);

/// Return the covariance rad^2 by an error of the epoch of the stars, zero where nothing is known.
///
/// Proper motions m turn the best fit by F^-1 sum w (p x m) in a year.
Matrix3 epoch_covariance(const Quaternion &attitude, double sigma_years, const FittedStars &stars);

}  // namespace st

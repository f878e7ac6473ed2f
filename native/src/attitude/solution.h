// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// From directions of stars to an attitude with covariance and residuals, by four solvers.

#pragma once

#include "attitude/refinement.h"
#include "maths/arena.h"
#include "maths/rotation.h"
#include "startracker.h"

namespace st {

/// A rotation to ICRF, and how well it is determined: the gap between the two largest eigenvalues of
/// Davenport's matrix, of weights whose sum is 1. It is twice the weighted mean square sine of the
/// stars' angles from the axis that is observed worst; at 0 the rotation is not unique.
struct BestRotation {
    Matrix3 R;
    double gap;
};

/// Return the rotation that maximises sum w icrf . R sensor, weights of sum 1.
///
/// davenport: the eigenvector of the largest eigenvalue of K (Davenport 1968; Keat 1977; Markley and
/// Mortari, J. Astronaut. Sci. 48, 2000, eq. 13). svd: by the singular vectors of the attitude
/// profile (Markley, J. Astronaut. Sci. 36, 1988). quest: by Newton's method (Shuster and Oh, J.
/// Guid. Control 4, 1981), from the TRIAD attitude of two stars that sigma_rad (count) chooses; its
/// gap is a lower limit, exact in the limit of zero.
BestRotation davenport(const Directions &stars);
BestRotation svd(const Directions &stars);
BestRotation quest(const Directions &stars, const double *sigma_rad);

/// An attitude of stars, or the reason why there is none.
///
/// covariance rad^2 is that of the solver at errors of sigma_rad, whatever the residuals;
/// residual_rad (stars) is the angle between each star and its catalogue direction; chi2 sums the
/// squares of residual over sigma.
struct Solution {
    st_reason reason;  // ST_NO_REASON where there is an attitude
    int stars;
    Quaternion quaternion;  // q_icrf_from_sensor, w >= 0
    Matrix3 covariance;
    double chi2;
    double *residual_rad;
};

/// Return the attitude of directions to the same stars (count), of any length, and errors sigma_rad
/// (count) about either axis across them; the catalogue counts as exact. The residuals are in memory
/// of the arena.
Solution solve(st_solver solver, const Vector3 *sensor, const Vector3 *icrf,
               const double *sigma_rad, int count, Arena &arena);

/// Bytes that solve() takes, with those of the residuals.
size_t solve_bytes(int count);

/// Return the least covariance rad^2 of any unbiased attitude of unit vectors (count) with errors
/// sigma_rad (count): the inverse Fisher information; determinant 0 where it is singular.
Covariance cramer_rao(const Vector3 *sensor, const double *sigma_rad, int count);

/// Return the chi2 that such a solution has on average, 2 N - 6 + tr(F P), with F the Fisher
/// information and P the covariance. For the best fit P = F^-1, and it is 2 N - 3.
double mean_chi2(const Solution &solution, const Vector3 *icrf, const double *sigma_rad);

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The best fit of a rotation to directions of stars, from an initial one; its covariance.

#pragma once

#include "maths/matrix.h"

namespace st {

/// Steps of Gauss and Newton: each doubles the digits; a few arcseconds become rounding in two.
constexpr int CONVERGED_STEPS = 5;

/// Least gap of the eigenvalues of Davenport's matrix that is observable. Below it double precision
/// no longer holds the third axis: rounding alone (2e-16) would turn it by 2e-4 rad. Two stars of
/// equal weight reach it 0.3 arcsec apart.
constexpr double MIN_GAP = 1e-12;

/// Directions of the same stars on sensor axes and in ICRF, unit vectors, with weights 1/sigma^2.
struct Directions {
    int count;
    Vector3 *sensor, *icrf;
    double *weight;
};

/// A covariance, and the determinant of the information: 0 where the rotation is not observable.
struct Covariance {
    Matrix3 P;
    double determinant;
};

/// Add w (I - p p^T) of a unit vector p to an upper triangle; symmetric() fills in the lower one.
inline void add_information(const Vector3 &p, double w, Matrix3 &F) {
    const double x = p[0], y = p[1], z = p[2];
    F[0][0] += w * (y * y + z * z);
    F[1][1] += w * (x * x + z * z);
    F[2][2] += w * (x * x + y * y);
    F[0][1] -= w * x * y;
    F[0][2] -= w * x * z;
    F[1][2] -= w * y * z;
}

/// Return the matrix of an upper triangle.
inline Matrix3 symmetric(Matrix3 F) {
    F[1][0] = F[0][1];
    F[2][0] = F[0][2];
    F[2][1] = F[1][2];
    return F;
}

/// Return the Fisher information F = sum w (I - p p^T) of unit vectors p and weights (count).
Matrix3 information(const Vector3 *directions, const double *weight, int count);

/// Return the inverse of a Fisher information (Shuster and Oh, J. Guid. Control 4, 1981, eq. 98);
/// determinant 0 where by MIN_GAP the rotation is not observable, and P is not an inverse.
Covariance inverse_information(const Matrix3 &F);

/// Refine a matrix to ICRF in place to the best fit, by at most so many steps of Gauss and Newton on
/// sum w |sensor - R^T icrf|^2 (Wahba's problem). Return the covariance at unit weight, of the
/// predicted directions.
Covariance refine(Matrix3 &R, const Directions &stars, int most_steps);

}  // namespace st

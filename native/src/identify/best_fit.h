// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The rotation that fits directions of stars best.

#pragma once

#include "maths/matrix.h"

namespace st {

/// Directions of the same stars on sensor axes and in ICRF, unit vectors, with weights 1/sigma^2.
struct Directions {
    int count;
    Vector3 *sensor, *icrf;
    double *weight;
};

/// A covariance, and the determinant of the information, 0 where no rotation is observable.
struct Covariance {
    Matrix3 P;
    double determinant;
};

/// Return the matrix to ICRF that fits two of the directions, the first exactly (Black, AIAA
/// Journal 2, 1964). The two must not be parallel.
Matrix3 triad(const Directions &stars, int first, int second);

/// Refine a matrix to ICRF in place, by at most so many steps of Gauss and Newton on
/// sum w |sensor - R^T icrf|^2 (Wahba's problem). Return the inverse of the Fisher information
/// sum w (I - p p^T) of the predicted directions p (Shuster and Oh, J. Guid. Control 4, 1981).
Covariance refine(Matrix3 &R, const Directions &stars, int most_steps);

constexpr int CONVERGED_STEPS = 5;

}  // namespace st

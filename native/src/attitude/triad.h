// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// A rotation from two directions: exact in the first, within the plane of both.
//
// Black, AIAA Journal 2 (1964); covariance of Shuster and Oh, J. Guid. Control 4 (1981).

#pragma once

#include "attitude/refinement.h"

namespace st {

/// Return the matrix to ICRF that fits two of the directions, the first exactly. The two must not be
/// parallel.
Matrix3 triad(const Directions &stars, int first, int second);

/// Two stars: the trace of the covariance of their TRIAD attitude in rad^2, and the square of the
/// sine between them, the geometric mean of the sensor's and the catalogue's. -1, infinity and 0
/// where all stars are parallel.
struct StarPair {
    int first, second;
    double variance, sine2;
};

/// Return the best second star for a first one, by the errors sigma_rad (count).
StarPair best_partner(const Directions &stars, const double *sigma_rad, int first);

/// Return the two stars whose TRIAD attitude varies least. Of two, the more accurate is the first.
StarPair best_pair(const Directions &stars, const double *sigma_rad);

/// Return the covariance rad^2 of the TRIAD attitude of two true directions about their axes.
Matrix3 triad_covariance(const Vector3 &first, const Vector3 &second, double first_sigma_rad,
                         double second_sigma_rad);

}  // namespace st

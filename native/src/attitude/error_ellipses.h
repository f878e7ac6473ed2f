// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The best fit to stars whose errors are not round, as those of streaks.
//
// A star at p is measured as s by the pixels u with covariance R. With D = ds/du and its
// pseudo-inverse D+, its residual is r = D+ (s - p) px. A turn of the sensor by a small rotation
// vector x moves p by p x x, so that r changes by -A x, A = D+ [p]x. The best turn minimises
// sum (r - A x)^T R^-1 (r - A x), and its covariance is (sum A^T R^-1 A)^-1.

#pragma once

#include "attitude/solution.h"
#include "camera/lens.h"
#include "maths/covariance2.h"

namespace st {

/// Fit an attitude that is the best one for round errors again where those of stars are not round:
/// pixels uv with covariances error (stars of the solution) and catalogue directions icrf.
void fit_error_ellipses(const Lens &lens, const Point *uv, const Covariance2 *error,
                        const Vector3 *icrf, Solution &solution, Arena &work);

/// Bytes of work memory of so many stars.
size_t error_ellipses_bytes(int count);

}  // namespace st

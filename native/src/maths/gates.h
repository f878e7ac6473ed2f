// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Gates of chi-square.

#pragma once

namespace st {

/// Return what chi-square of dof degrees of freedom, any number from 1 on, exceeds with a
/// probability from 1e-12 to 0.3; good to 1e-12 of itself.
///
/// Newton's method for the logarithm of the regularised gamma function Q(dof / 2, x / 2), by its
/// continued fraction (Abramowitz and Stegun, 6.5.31).
double gate(double probability, double dof);

}  // namespace st

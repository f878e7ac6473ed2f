// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// What the chi-square of a fit says of the model: factors of errors, and of no star.

#pragma once

#include <cmath>

namespace st {

constexpr double MISFIT_SIGMAS = 3.0;  // of chi-square, from which on errors are inflated
constexpr double CHANCE_SIGMAS = 2.0;
constexpr double MOST_MISFIT = 0.2;  // share of the flux of a star that its model leaves

/// Return the factor of an error: sqrt(chi2 / dof) for a misfit beyond chance, else 1.
inline double inflation(double chi2, int dof) {
    const double ratio = chi2 / dof;
    return ratio > 1 + MISFIT_SIGMAS * std::sqrt(2.0 / dof) ? std::sqrt(ratio) : 1.0;
}

/// Return the share of the flux, squared over noise, that a model leaves; variance is that of the
/// flux. What chi-square has by chance is not part of it: of a faint star that would be most.
inline double misfit(double chi2, int dof, double flux, double variance) {
    const double excess = chi2 - (dof + CHANCE_SIGMAS * std::sqrt(2.0 * dof));
    return (excess < 0.0 ? 0.0 : excess) / (flux * flux / variance);
}

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Protection level: a bound of the error per axis that hides no more than a stated probability.
//
// Solution separation as in multiple-hypothesis receiver autonomous integrity monitoring (RAIM;
// Pervan, Pullen and Christie, Navigation 45, 1998; Blanch et al., IEEE Trans. AES 51, 2015). The
// hypotheses are that no star is false, and for each star that it is: a blend, a planet or dust that
// no test has rejected. Without star i, of Fisher information F_i = w_i (I - p_i p_i^T), the attitude
// is
//
//     x_i = x - (F - F_i)^-1 w_i (p_i x r_i),  P_i = P + (F - F_i)^-1 - F^-1
//
// with r_i the residual of the star, F = sum F_i and P the published covariance. If the star is false
// x_i is right, so the error of x on an axis exceeds |x - x_i| + k sigma_i in the share 2 Q(k) of all
// cases. A third of the probability is that of the first hypothesis, one is shared by the stars and
// one by pairs of false stars, for which the two largest separations and variances add up:
//
//     protection = max(k_0 sigma, max_i(|x - x_i| + k_1 sigma_i), pairs)
//
// Three false stars at a time are not tested: their probability is subtracted first.

#pragma once

#include "maths/matrix.h"

namespace st {

/// Probability, of each frame, that the error of an axis exceeds the level; that of a star to be false
/// without a test that has rejected it.
struct FalseStars {
    double misleading_probability, false_star_probability;
};

/// A star of an attitude: unit vector on sensor axes, its error per axis, and how far it is from the
/// catalogue.
struct StarError {
    Vector3 sensor;
    double sigma_rad, residual_rad;
};

/// k of no, one and two false stars, NaN where two are too rare; not valid where the probability
/// cannot be kept.
struct Multipliers {
    bool valid;
    double none, one, two;
};

Multipliers multipliers(int count, int rejected, const FalseStars &probabilities);

/// Return the bound rad of the errors about sensor axes, of an attitude of covariance rad^2 and its
/// stars (count); rejected counts stars that were found to be false. Infinite where the stars are too
/// few to do without one, or so many may be false that the probability cannot be kept.
Vector3 protection_level(const Matrix3 &covariance, const StarError *stars, int count,
                         const FalseStars &probabilities, int rejected);

/// Whether a matrix is finite, symmetric and positive definite.
bool is_covariance(const Matrix3 &P);

}  // namespace st

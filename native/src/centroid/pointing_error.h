// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Error of the pointing that all stars of an image share: motion that is not uniform in the
// exposure.
//
// A camera that is kicked or vibrates during the exposure draws the same figure of every star. A fit
// finds the brightest part of it, the same part of every star, so that no residual shows the error.
// What the fits leave, over the flux and about the fitted position d = 0, is the same image of all
// stars, L(d), with neighbours and hits of single ones.
//
// Flux that is the same on both sides does not move a star, whatever the shape of its image: rings
// of an aperture or a defocused lens, a wing, the spikes of a spider. What counts is the odd part of
// each star, resampled about its fitted centre,
//
//     A(d) = L(d) - L(-d)
//
// Where two parts are equally bright, some stars are fitted at the one, some at the other, which
// changes the sign of A: it is made that of the brightest star. Of the stars an upper quantile
// counts, which neighbours and hits of single ones do not move, if most have it in their own images.
// Where A exceeds its noise, A > 0 is flux next to the fitted star, of a total of 1 + sum A. The
// mean pointing of the exposure is off by b = sum A d / (1 + sum A). The covariance of the
// correlated error is
//
//     C = b b^T + UNCERTAIN^2 M,  M = sum A d d^T / (1 + sum A)
//
// where flux that is wrong by a share UNCERTAIN of itself moves b by less than UNCERTAIN sqrt(M).
// The stars are not moved by b: whether its flux exceeds the noise changes from image to image.

#pragma once

#include "centroid/background.h"
#include "centroid/image.h"
#include "centroid/streak_fit.h"
#include "maths/arena.h"

namespace st {

using Matrix2 = Matrix<2, 2>;

/// Return the covariance px^2 of the correlated error of an image, zero without any. Fitted stars
/// (count) are the brightest first. The arena needs pointing_error_bytes().
Matrix2 pointing_error(const Image &image, const Mesh &mesh, double full_scale_dn,
                       const StreakStar *stars, int count, bool streaked, Arena &arena);

size_t pointing_error_bytes();

}  // namespace st

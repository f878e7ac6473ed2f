// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Whether a fitted spot has the shape of a star: size and elongation.

#pragma once

#include "centroid/gaussian_fit.h"

namespace st {

/// M_xx - M_yy and 2 M_xy of a spot, its size M_xx + M_yy and the variance of the first two.
struct SpotMoments {
    double straight, oblique, size, variance;
};

/// What no star is: narrow are hot pixels and cosmic-ray hits, wide blurred spots.
struct Width {
    bool narrow, wide;
};

/// Test whether half or twice the width describes a spot better by a margin of chi-square.
/// work is that of its fit; its profiles are overwritten.
Width test_width(const Star &star, double chi2, FitWork &work);

/// Return the second moments of a spot, of its window and model in work.
///
/// With weights g(x) g(y), a Gaussian twice as wide as a star, flux D and coordinates from the
/// position of the star, the elongation (a - b) / (a + b) of the moments a, b along the axes of the
/// spot is
///
///     sqrt((M_xx - M_yy)^2 + (2 M_xy)^2) / (M_xx + M_yy),  M_xy = sum g(x) g(y) D x y
///
/// M_xx + M_yy counts a pixel with no less than the model's flux.
SpotMoments spot_moments(const Star &star, const FitWork &work);

/// Whether a spot is a streak: its elongation exceeds a limit by three standard deviations of the
/// numerator.
bool is_elongated(const SpotMoments &moments);

/// Whether spots are elongated together, though each alone may pass as round.
///
/// Round spots have numerators of mean zero: a weighted sum of all is large only if they are
/// streaks.
class Smear {
public:
    void add(const SpotMoments &moments);
    bool is_one() const;

private:
    double straight_ = 0.0, oblique_ = 0.0, size_ = 0.0, variance_ = 0.0;
};

}  // namespace st

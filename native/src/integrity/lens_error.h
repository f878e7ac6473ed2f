// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Errors of star positions that stay from frame to frame, measured by the residuals.
//
// A lens that differs from the camera model, coma, or an image that is not Gaussian moves a star by
// nearly the same in the next frame. A filter averages noise over frames, but not these. Where all
// noise is white the residuals of the filter are white as well: the mean product of a star's
// residuals in two frames in a row is the variance of what stays. A rotation of all stars is removed
// before, being no matter of the lens; it takes a share of the stars' own errors with it.
//
// Part of what stays may be a scale: a wrong focal length, or the tails of coma, which all point away
// from the axis. Such errors do not average out over stars whose mean position is not the axis. The
// scale k, r = k d for residuals r at d from the axis, is fitted to all frames, and the next ones are
// predicted with it: the focal length is 1 + k times as long. The errors that stay are those in
// addition to it.

#pragma once

#include "integrity/detected_star.h"
#include "maths/arena.h"

namespace st {

/// Stars of the last frame that are remembered: no tracker has more tracks.
constexpr int MOST_REMEMBERED = 500;

/// A star of the last frame: its residual without rotation and scale, and the variance of its
/// centroid.
struct RememberedStar {
    int32_t star;
    Point residual;
    double variance_px2;
};

/// What is known of the lens. value_px is the error that stays, its sigma per axis, in addition
/// to that of scale, the relative error of the distance of stars from the axis; both are zero
/// where they are not significant. scale_sigma is the error of the scale, zero without any. All
/// zero at the start.
struct LensError {
    double value_px, scale, scale_sigma;

    // Sums over the frames before: r^T W d and d^T W d of residuals r and distances d from the axis
    // without the rotation, W = 1 / sigma^2;
    double outwards, square;
    // over pairs of residuals of a star in two frames in a row: of their weighted products, of the
    // weighted share of the variance that they hold, and of the variance of the product by chance.
    double product, weight, chance;
    int remembered;
    RememberedStar last[MOST_REMEMBERED];
};

/// Add the residuals of a frame, of catalogue entries star (count), that corrected_lens() has
/// predicted. Return whether there is a scale for the first time.
bool add_frame(const Lens &lens, const int32_t *star, const DetectedStar *stars, int count,
               LensError &error, Arena &arena);

/// Return the lens of a camera with the scale that was estimated.
Lens corrected_lens(const Lens &lens, const LensError &error);

/// Bytes of work memory of so many stars.
size_t lens_error_bytes(int count);

}  // namespace st

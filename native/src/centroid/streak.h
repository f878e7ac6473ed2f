// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Streak of a star that moves during the exposure: its length and direction over the image.
//
// A turn of the camera moves all stars together. To first order the streak (du, dv) of a star at
// (u, v) is that of the middle of the image plus what the roll adds,
//
//     du = u_px - roll (v - v0),  dv = v_px + roll (u - u0).
//
// A streak and its opposite are the same: an image does not show the direction of time.

#pragma once

#include <cmath>

#include "centroid/image.h"

namespace st {

constexpr double SHORTEST_PX = 1.0;  // a shorter one is fitted as a point

struct Streak {
    double u_px, v_px;  // at the pixel u0, v0
    double roll;        // rad during the exposure
    double u0, v0;

    /// Return the streak of a star at a place, px.
    Place at(Place star) const {
        return {u_px - roll * (star.v - v0), v_px + roll * (star.u - u0)};
    }

    /// Return the length in the middle of the image.
    double length_px() const { return std::hypot(u_px, v_px); }

    /// Return the length in the farthest corner of an image whose middle is u0, v0.
    double longest_px() const { return length_px() + std::fabs(roll) * std::hypot(u0, v0); }

    /// Return the streak of an exposure that is longer by a factor.
    Streak scaled(double factor) const {
        return {factor * u_px, factor * v_px, factor * roll, u0, v0};
    }

    /// Whether another streak is the same, or its opposite, but for its error.
    bool is_close(const Streak &other) const;

    /// Return the streak of images that are moved along both, by their second moments. What both
    /// spread across it is left to the PSF; the roll is that of the longer one.
    Streak joined(const Streak &other) const;
};

/// Return the common streak of stars at places with streaks (count), by least squares.
///
/// The streaks point into the same half plane, weight (count) is 1 / variance, width and height are
/// those of the image. The roll is estimated from four stars on; it is zero for fewer.
Streak fit_streak(const Place *places, const Place *streaks, const double *weight, int count,
                  int width, int height);

}  // namespace st

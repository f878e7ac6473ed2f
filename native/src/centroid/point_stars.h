// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Stars that are points: fits of a Gaussian to peaks, and which of them are not stars.

#pragma once

#include "centroid/frame.h"
#include "centroid/gaussian_fit.h"
#include "centroid/rejection.h"
#include "centroid/weighted_mean.h"
#include "maths/arena.h"
#include "startracker.h"

namespace st {

constexpr double EDGE_SIGMAS = 1.5;  // closest distance of a star to the edge, in PSF sigmas
// Of the threshold: the fit frees position and level too, so its signal to noise is lower.
constexpr double FAINT = 0.85;

/// How points are measured: method, and the pixels of a star where that is not ST_GAUSSIAN.
struct PointOptions {
    st_centroid_method method;
    Segmentation segmentation;
    double threshold_sigmas;
};

/// Fit stars of this PSF sigma to peaks, count of them, highest first. Append the good ones to
/// stars, brightest first and at most so many, and the others to rejections. Return whether all are
/// smeared. A rough fit rejects what is not a star and measures the noise of the final one.
///
/// The arena needs points_bytes(count).
bool measure_points(const Frame &frame, const Peak *peaks, int count, double sigma_px,
                    const PointOptions &options, int most, List<st_centroid> &stars,
                    Rejections &rejections, Arena &arena);

/// Bytes of memory that measure_points() needs for count peaks; fit_free_sigma() needs no more.
size_t points_bytes(int count);

/// A star of another PSF sigma; is_star is whether it has the shape and the place of its spot.
struct FreeStar {
    Fit<5> fit;
    bool is_star;
};

/// Fit stars of another PSF sigma each, from sigma_px on, to those of count peaks that are not
/// saturated and have more than a lone pixel. Fill stars (count); return how many there are.
int fit_free_sigma(const Frame &frame, const Peak *peaks, int count, const NoiseModel &noise,
                   double sigma_px, int iterations, FreeStar *stars, Arena &arena);

}  // namespace st

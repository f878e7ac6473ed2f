// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Association of image stars with catalogue stars, and the attitude and focal length that fit.
//
// Image stars are points in undistorted coordinates of the sensor frame, of the nominal focal
// length; divided by the focal ratio they are those of the fitted one.

#pragma once

#include <cstdint>

#include "attitude/triad.h"
#include "identify/image_stars.h"
#include "identify/patterns.h"

namespace st {

/// Which catalogue star each image star is, and what fits them.
struct StarMatch {
    int32_t *star;       // of each image star, -1 for none
    double *residual;    // distance in undistorted coordinates, NaN for none
    double focal_ratio;  // fitted focal length over that of the camera
    Matrix3 R;           // sensor vectors to ICRF
};

/// Return memory for the association of so many image stars.
StarMatch star_match(int most, Arena &arena);

/// Copy what belongs to count image stars.
void copy(const StarMatch &from, int count, StarMatch &to);

/// Return how many image stars have a catalogue star.
int count_matched(const StarMatch &found, int count);

/// Associate all image stars when those of base are the catalogue stars star, both of some length.
/// Return whether four stars or more agree, within a radius in undistorted coordinates, with an
/// attitude and a scale within scale_error.
bool align(const Patterns &sky, bool equidistant, const ImageStars &stars, const int32_t *base,
           const int32_t *star, int based, double radius, double scale_error, StarMatch &found,
           Arena &work);

/// The attitude of an association, its covariance in rad^2 about sensor axes, and chi2.
struct AttitudeFit {
    Quaternion q;
    Matrix3 P;
    double chi2;
};

/// Return the best fit to an association; angle_rad of each image star is that to its catalogue
/// star, NaN for none. Infinite covariance of fewer than two stars.
AttitudeFit fit_attitude(const Patterns &sky, bool equidistant, const ImageStars &stars,
                         const StarMatch &found, double *angle_rad, Arena &work);

/// Return where a star is in undistorted coordinates.
inline Point seen_at(bool equidistant, const Matrix3 &R, const double *direction) {
    return plane_point(equidistant,
                       sensor_direction(R, {{direction[0], direction[1], direction[2]}}));
}

/// Return the direction in ICRF of undistorted coordinates, of the nominal focal length.
inline Vector3 icrf_direction(bool equidistant, const StarMatch &found, const Point &seen) {
    return found.R * ray(equidistant, {seen.x / found.focal_ratio, seen.y / found.focal_ratio});
}

}  // namespace st

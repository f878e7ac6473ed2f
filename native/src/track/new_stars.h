// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Catalogue stars without a track, found among the centroids by the attitude.

#pragma once

#include "track/bank.h"
#include "track/in_view.h"

namespace st {

/// Below rotation_fit's OUTLIER_SIGMA, so that a new star is not an outlier in the next frame.
constexpr double NEW_STAR_SIGMA = 4.0;

/// Of the brightness of a variable: a sine has its extremes at 1.4.
constexpr double VARIABLE_SIGMAS = 2.0;

/// Largest gate of a new star, whatever the covariance of the attitude.
constexpr double MAX_DISTANCE_PX = 5.0;

/// A centroid that is free to be a star: its index in the frame, place, flux and 1 sigma per axis.
struct FreeCentroid {
    int32_t centroid;
    Point uv;
    double flux_dn, sigma_px;
};

struct NewStar {
    int32_t star, centroid;
};

/// Return the median magnitude of 1 DN by the detected stars of a bank; NaN without any, or where
/// one has no positive flux.
double zero_point(const TrackList &bank, const SkyFile &file, Arena &work);

/// Return the bytes of work memory of match_new_stars(), for so many stars in view.
size_t match_new_stars_bytes(int stars, int centroids);

/// List the unambiguous pairs of stars and centroids, by the brightness of the stars.
///
/// zero_point is the magnitude of 1 DN; covariance that of the attitude, rad^2 on sensor axes. A pair
/// agrees in position and magnitude, and neither of the two agrees with any other. Of a variable
/// star the magnitude is uncertain by VARIABLE_SIGMAS more. A crowded star makes pairs ambiguous
/// and is in none itself. lens is that of the camera.
void match_new_stars(const ApparentSky &sky, const Quaternion &attitude, const Matrix3 &covariance,
                     const Lens &lens, const FreeCentroid *free, int count, double zero_point,
                     double magnitude_tolerance, StarsInView &view, List<NewStar> &found,
                     Arena &work);

}  // namespace st

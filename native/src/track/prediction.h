// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Where the stars in view will be.

#pragma once

#include "integrity/expected_stars.h"
#include "track/in_view.h"

namespace st {

/// Distance from the edge of the image from which on stars are seen in full.
constexpr double BORDER_PX = 5.0;

/// Predictions per star that is followed: some stars are blended or too faint.
constexpr double SPARE_STARS = 1.5;

/// List the single stars up to a magnitude, and how they move at a body rate.
void visible_stars(const ApparentSky &sky, const Quaternion &attitude, const Vector3 &rate_rad_s,
                   double faintest, StarsInView &view, List<ExpectedStar> &visible);

/// List the brightest stars in the image, how they move, and their errors sqrt(tr(J P J^T) / 2) by
/// the covariance P of the attitude; as many as the list has room for.
void predict_stars(const ApparentSky &sky, const Quaternion &attitude, const Matrix3 &covariance,
                   const Vector3 &rate_rad_s, double faintest, StarsInView &view,
                   List<st_prediction> &predicted);

}  // namespace st

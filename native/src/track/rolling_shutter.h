// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Centroids of a rolling shutter: each is exposed at the time of its own row.
//
// A star is exposed d = delay_s after the time of the frame. At the rate w and the acceleration a
// it is then J (w d + a d^2 / 2) away from where it was at that time, J the image flow.

#pragma once

#include "camera/lens.h"
#include "maths/arena.h"

namespace st {

/// Return where a centroid, exposed delay_s late, was at the time of the frame.
Point at_frame_time(const Lens &lens, const Point &uv, double delay_s, const Vector3 &rate_rad_s,
                    const Vector3 &acceleration_rad_s2);

/// Identified centroids (count): directions on ICRF axes, places, sigma per axis and delays.
struct DelayedStars {
    int count;
    const Vector3 *icrf;
    const Point *uv;
    const double *sigma_px, *delay_s;
};

/// Fill in the body rate that explains the residuals of stars exposed row by row, of an attitude:
/// each residual is J (turn + rate delay), least squares for both. False for too few stars, or
/// without delays.
bool fit_rate(const Lens &lens, const DelayedStars &stars, const Quaternion &quaternion,
              Vector3 &rate_rad_s);

}  // namespace st

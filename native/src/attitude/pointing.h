// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// An error of the pointing that all stars of an image share, as one of the attitude.

#pragma once

#include "camera/lens.h"
#include "maths/covariance2.h"

namespace st {

/// Return the covariance rad^2 about sensor axes of a shift of all stars, common.
///
/// In the middle of the image a turn x, y of the sensor moves stars by (-f_u y, f_v x) px. Where the
/// body turns, a shift along the flow f of the stars is one of time, by f / f^2, which turns the body
/// about the boresight as well: rate, null for a body at rest. That a shift is one of time is as
/// likely as not: a kick moves the stars in any direction.
Matrix3 pointing_covariance(const Lens &lens, const Covariance2 &correlated,
                            const Vector3 *rate_rad_s);

/// Return the covariance px^2 of the error of a centroid that all of its image share.
inline Covariance2 correlated_error_of(const st_centroid &centroid) {
    return {centroid.common_uu_px2, centroid.common_uv_px2, centroid.common_vv_px2};
}

inline bool is_finite(const Covariance2 &R) {
    return std::isfinite(R.uu) && std::isfinite(R.uv) && std::isfinite(R.vv);
}

/// Fill in the covariance px^2 of the error that all centroids (count) share; false without one.
bool correlated_error(const st_centroid *centroids, int count, Covariance2 &correlated);

/// Return the angle of a pixel at the centre, the mean of both axes.
inline double pixel_angle(const Lens &lens) {
    return 1 / std::sqrt(lens.fx * lens.fy);
}

}  // namespace st

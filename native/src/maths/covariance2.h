// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Covariances of places in the image.

#pragma once

#include "startracker.h"

namespace st {

/// Symmetric, 2 x 2, in px^2.
struct Covariance2 {
    double uu, uv, vv;
};

inline Covariance2 operator+(const Covariance2 &a, const Covariance2 &b) {
    return {a.uu + b.uu, a.uv + b.uv, a.vv + b.vv};
}

inline double determinant(const Covariance2 &R) {
    return R.uu * R.vv - R.uv * R.uv;
}

/// Return the same error on each axis.
inline Covariance2 round_error(double variance) {
    return {variance, 0.0, variance};
}

/// Return the error of a centroid, with variances of at least a floor.
inline Covariance2 error_of(const st_centroid &centroid, double floor_px2) {
    const double uu = centroid.cov_uu_px2, vv = centroid.cov_vv_px2;
    return {uu > floor_px2 ? uu : floor_px2, centroid.cov_uv_px2, vv > floor_px2 ? vv : floor_px2};
}

/// Return the error that all centroids (count) of a frame share, that of the largest; zero for none.
inline Covariance2 correlated_error(const st_centroid *centroids, int count) {
    Covariance2 correlated{};
    for (int j = 0; j < count; ++j) {
        const st_centroid &one = centroids[j];
        if (one.common_uu_px2 + one.common_vv_px2 > correlated.uu + correlated.vv) {
            correlated = {one.common_uu_px2, one.common_uv_px2, one.common_vv_px2};
        }
    }
    return correlated;
}

}  // namespace st

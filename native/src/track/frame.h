// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The centroids of a frame, and what a frame does to the tracks.

#pragma once

#include "integrity/detected_star.h"
#include "maths/arena.h"
#include "maths/rotation.h"
#include "startracker.h"

namespace st {

/// The centroids of a frame, and the least and the largest exposure it may have had.
struct CentroidFrame {
    const st_centroid *centroid;
    int count;
    double exposure_s[2];

    const st_centroid *begin() const { return centroid; }
    const st_centroid *end() const { return centroid + count; }
};

/// Return the 1-sigma error of a centroid per axis, at least a floor.
inline double sigma_of(const st_centroid &centroid, double floor_px) {
    return centroid.sigma_px > floor_px ? centroid.sigma_px : floor_px;
}

/// Whether rows are exposed one after another.
bool is_rolling(const CentroidFrame &frame);

/// Whether the errors are those of streaks: not the same along and across.
bool are_streaks(const CentroidFrame &frame);

/// What a frame did to the tracks. Lists are in the memory of the frame.
///
/// Good when enough stars agree on an attitude within the limits. has_fit: there is an attitude, with
/// a row of normalised for each track of the bank: the distance of its centroid in sigma. scale is
/// that of RotationFit. frame are the centroids at the time of the frame, unassociated masks those in
/// no gate; detected are the residuals, of a model that has them.
struct FrameUpdate {
    bool good, has_fit;
    Quaternion quaternion;
    Matrix3 covariance;
    int inliers;
    double residual_px, chi2, scale;
    const double *normalised;
    CentroidFrame frame;
    const bool *unassociated;
    bool has_residuals;
    List<DetectedStar> detected;
};

}  // namespace st

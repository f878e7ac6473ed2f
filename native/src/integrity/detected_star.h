// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The detected stars of a frame, and how far they are from the attitude that was found.

#pragma once

#include <cstdint>

#include "camera/lens.h"
#include "maths/covariance2.h"

namespace st {

/// A detected star: track is its place in the bank; uv, residual by the attitude, and error are of its
/// centroid; flow is the image motion per body rate, velocity that in px/s.
struct DetectedStar {
    int32_t track;
    Point uv, residual;
    Covariance2 error;
    Flow flow;
    Point velocity;
};

}  // namespace st

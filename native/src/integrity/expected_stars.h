// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Whether the stars that should be seen are, or are elsewhere.
//
// Where parts of an image show attitudes further apart than the gates, stars are missed whose images
// lie all by the same shift, or by the same time, from where they should be.

#pragma once

#include "camera/lens.h"
#include "maths/arena.h"
#include "startracker.h"

namespace st {

/// A star that should be seen: its pixel by the attitude, and its motion in px/s.
struct ExpectedStar {
    Point uv, velocity;
};

/// Return what contradicts an attitude among stars (count) that should be seen; ST_NO_REASON for
/// nothing. uv (centroids) are all centroids; a star is seen by one within present_px. Stars that are
/// hidden are not a contradiction; stars that are elsewhere are.
st_reason contradiction_of(const ExpectedStar *stars, int count, const Point *uv, int centroids,
                           double present_px, Arena &arena);

/// Bytes of work memory.
size_t contradiction_bytes(int count, int centroids);

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The tracks after a frame, by the attitude that it corrected.

#pragma once

#include "integrity/detected_star.h"
#include "track/bank.h"

namespace st {

/// List the detected stars among confirmed tracks whose states are those by the attitude.
///
/// icrf and distance (count of bank) are the stars' directions, and the distances of their centroids
/// best (count of bank) by the corrected attitude, not finite where a star was missed.
void detected_stars(const Lens &lens, const Quaternion &attitude, const Vector3 &rate_rad_s,
                    const TrackList &bank, const Vector3 *icrf, const double *distance,
                    const int32_t *best, const Places &centroids, List<DetectedStar> &detected);

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The body rate by the centroids of two frames, before any star is known.

#pragma once

#include "camera/lens.h"
#include "maths/arena.h"

namespace st {

/// Return the bytes of work memory of rate_between_frames().
size_t frame_motion_bytes(int before_count, int after_count);

/// Fill in the body rate that moves most bright centroids of a frame to the next one, dt_s later;
/// false where too few agree.
///
/// The displacement that most pairs of equal flux share finds the pairs, whose displacements are
/// J w (dt_s + the difference of their delays), J the image motion per body rate.
bool rate_between_frames(const Lens &lens, const st_centroid *before, int before_count,
                         const st_centroid *after, int after_count, double dt_s,
                         Vector3 &rate_rad_s, Arena &work);

}  // namespace st

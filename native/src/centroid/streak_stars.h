// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Stars that are streaks: fits of the motion of the exposure, and which are not stars.

#pragma once

#include "centroid/frame.h"
#include "centroid/rejection.h"
#include "centroid/streak.h"
#include "maths/arena.h"
#include "startracker.h"

namespace st {

/// Fit streaks of this PSF sigma that are near places (count); append the good ones to stars, in
/// their order, and the others to rejections. The arena needs streak_stars_bytes(count).
void measure_streaks(const Frame &frame, const Place *places, int count, const Streak &streak,
                     double sigma_px, double threshold_sigmas, List<st_centroid> &stars,
                     Rejections &rejections, Arena &arena);

size_t streak_stars_bytes(int count);

}  // namespace st

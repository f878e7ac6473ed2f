// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The matched filter of a streak: around each pixel the flux of a streak there.
//
// It takes a product for each pixel of the streak, a thousand where that is long. The image at half
// the size, filtered at a sixteenth of the work, tells where a peak may be: only there, and in the
// rows that show the noise, is the image itself filtered.

#pragma once

#include "centroid/image.h"
#include "centroid/streak.h"
#include "maths/arena.h"

namespace st {

/// Replace an image less its background by the flux of a streak around each pixel, 0 where that is
/// less than so many times its noise; return this noise. Rows of which the noise is measured are
/// filtered as a whole. The arena needs streak_filter_bytes().
double filter_streaks(const Plane<float> &plane, const Streak &streak, double sigma_px,
                      double threshold_sigmas, Arena &arena);

/// Bytes of memory for an image of this size.
size_t streak_filter_bytes(int width, int height);

}  // namespace st

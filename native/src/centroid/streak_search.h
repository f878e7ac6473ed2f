// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Search of a smeared image: the common streak of its stars, and the stars by a matched filter.
//
// 1. Spots of the thresholded image have second moments; those of a streak differ by L^2 / 12. The
//    streak on which most of the brightest spots agree is that of the stars.
// 2. Fits of the brightest of them, with width, length and direction free, refine it.
// 3. The image is filtered with the shape of that streak, which collects all of its flux: peaks of
//    the result are stars.

#pragma once

#include "centroid/frame.h"
#include "centroid/streak.h"
#include "maths/arena.h"

namespace st {

constexpr int MOST_STREAK_PEAKS = 1000;

struct FoundStreak {
    Streak streak;
    double sigma_px;  // width of the stars
    bool is_found;    // false where too few spots agree on one
};

/// Return the common streak of the stars of a frame; sigma_px is an initial width. The arena needs
/// streak_search_bytes().
FoundStreak estimate_streak(const Frame &frame, double sigma_px, Arena &arena);

/// Fill places, of room for MOST_STREAK_PEAKS, with the peaks of a frame after a filter of the
/// streak, the brightest first; return how many there are. The arena needs streak_search_bytes().
int search_streaks(const Frame &frame, const Streak &streak, double sigma_px,
                   double threshold_sigmas, Place *places, Arena &arena);

/// Bytes of memory for both, for images of this size.
size_t streak_search_bytes(int width, int height);

}  // namespace st

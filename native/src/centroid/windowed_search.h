// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Peaks near predicted positions: no search of the whole image.

#pragma once

#include "centroid/background.h"
#include "centroid/detection.h"
#include "centroid/image.h"
#include "maths/arena.h"

namespace st {

constexpr double MOST_RADIUS_OF_SEARCH_PX = 32.0;

/// Append the peaks within radius_px, at most MOST_RADIUS_OF_SEARCH_PX, of places, and fill found
/// with 1 for the places that have one, else 0. share is the least one of hits.h.
///
/// The highest value must exceed the threshold and the pixels around it, and no two places share
/// one. Return whether some of the peaks are hits.
bool peaks_near(const Image &image, const Kernel &kernel, const Mesh &mesh,
                const Threshold &threshold, const Place *places, const double *radius_px,
                int count, double share, List<Peak> &peaks, uint8_t *found, Arena &arena);

}  // namespace st

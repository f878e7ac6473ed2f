// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The most significant peaks of an image, however low they are.
//
// A threshold that keeps the noise out keeps faint stars out as well: where the background is cut
// off at zero or finer than a level of the image, it has no noise to measure, and where a star of
// 5 sigma counts, six of forty spots are stars. Whoever verifies a list with an honest probability
// of chance needs no threshold but a short list in which the stars come first: the peaks of the
// image after the matched filter, by their height over the noise around them.

#pragma once

#include "centroid/image.h"
#include "maths/arena.h"
#include "startracker.h"

namespace st {

constexpr int HIGHEST_PEAKS = 30;

/// Append the peaks of an image with the largest ratio of height to noise, HIGHEST_PEAKS at most,
/// the brightest first.
void find_highest_peaks(const Image &image, List<st_centroid> &stars, Arena &arena);

}  // namespace st

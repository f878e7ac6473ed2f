// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// A Gaussian filter of whole images, for those that a search for points does not explain.

#pragma once

#include "centroid/image.h"
#include "maths/arena.h"

namespace st {

/// Replace a plane by itself after a Gaussian filter of this sigma, at most 4 px, which is cut off
/// at 4 sigma; the image is mirrored at its borders.
void blur(const Plane<float> &plane, double sigma_px, Arena &arena);

}  // namespace st

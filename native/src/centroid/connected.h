// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Spots that are connected: pixels that touch by a side or a corner.

#pragma once

#include "centroid/image.h"
#include "maths/arena.h"

namespace st {

/// A pixel above a threshold, and the number of the spot it belongs to.
struct SpotPixel {
    int u, v, spot;
};

/// Number the spots of pixels, which are in the order of an image of this width; return how many
/// there are. They are numbered in the order of their first pixels. Union of sets with halved paths
/// (Tarjan, J. ACM 22, 1975).
int connect(SpotPixel *pixels, int count, int width, Arena &arena);

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Spots that are connected: pixels that touch by a side or a corner.

#pragma once

#include "centroid/image.h"
#include "maths/arena.h"

namespace st {

/// Number the spots of a plane: pixels that are not 0 get the number of their spot, from 1 on, in
/// the order of the first pixels of the spots. Return how many there are.
///
/// Union of sets with halved paths (Tarjan, J. ACM 22, 1975), over the image row by row.
int connect(const Plane<int32_t> &spot, Arena &arena);

}  // namespace st

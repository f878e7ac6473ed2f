// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Detection of stars as peaks of the smoothed image, and the full scale of the camera.

#pragma once

#include "centroid/background.h"
#include "centroid/image.h"
#include "centroid/smoothing.h"
#include "maths/arena.h"

namespace st {

/// Height of a peak above the background: sigmas of the noise, and no less than dn.
struct Threshold {
    double sigmas, dn;
};

/// A peak of the smoothed image, what detection hands to the fits: height and level in DN, the
/// height above the level; noise 1 sigma in DN. top_u, top_v px are the offset from the pixel to
/// the top of a parabola through the peak and its neighbours.
struct Peak {
    int u, v;
    double top_u, top_v;
    double height, level, noise;
};

/// Result of a search: peaks, highest first; found, the number of all, listed or not. discs and
/// lines are peaks left out: they belong to something large, such as the Moon, or to a line, such
/// as a trail or a saturated column. row_max are the brightest pixels of the rows.
struct Search {
    List<Peak> peaks;
    List<Pixel> discs, lines;
    int found;
    uint16_t *row_max;

    /// Whether there are more peaks than are listed: noise, a pattern, or a dense field.
    bool too_many() const { return found > peaks.count; }
};

}  // namespace st

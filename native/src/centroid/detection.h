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

/// Peaks that are listed of an image, the highest: one in PX_PER_PEAK, and FEW_PEAKS of any.
int most_peaks(int width, int height);

/// Return the local maxima of an image after smoothing that exceed the threshold, at most capacity
/// of them. Lists are of the arena.
///
/// Peaks within or on the rim of something bright and large, such as the Moon, and peaks along a
/// line are left out: their noise would otherwise make more peaks than the sky has stars.
Search find_peaks(const Image &image, const Kernel &kernel, const Mesh &mesh,
                  const Threshold &threshold, int capacity, Arena &arena);

/// Return the top, between -0.5 and 0.5, of a parabola through values at -1, 0 and 1.
inline double parabola_top(double before, double here, double after) {
    double bend = 2 * here - before - after;
    bend = bend > 1e-6 ? bend : 1e-6;
    const double top = (after - before) / (2 * bend);
    return top < -0.5 ? -0.5 : top < 0.5 ? top : 0.5;
}

/// Return the DN at which the image saturates, infinity when nothing in it is saturated.
///
/// row_max are the brightest pixels of the rows. The brightest pixel is at full scale when it has
/// the largest value of this depth or of a 10, 12 or 14 bit camera (in the low or the high bits), or
/// when it belongs to a flat top, as where a camera clips at a lower level.
double full_scale(const Image &image, const uint16_t *row_max, double background_dn);

}  // namespace st

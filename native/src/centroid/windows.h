// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Square cut-outs around the peaks, and which of them share flux.
//
// A window is cut when its star is fitted and none is stored: the memory of the fits does not grow
// with the width of the stars.

#pragma once

#include "centroid/detection.h"
#include "centroid/frame.h"
#include "centroid/psf.h"
#include "maths/arena.h"
#include "maths/lanes.h"

namespace st {

constexpr int CORE_RADIUS_PX = 2;
constexpr double LONE_PIXEL = 0.3;  // less flux than this share of a pixel in the eight around it
constexpr double RADIUS_SIGMAS = 3.5;
constexpr int LEAST_RADIUS_PX = 3, MOST_RADIUS_PX = 30;
constexpr int MOST_SIDE_PX = 2 * MOST_RADIUS_PX + 1;
constexpr int MOST_AREA_PX = MOST_SIDE_PX * MOST_COLUMNS;
static_assert(MOST_SIDE_PX <= MOST_COLUMNS);

/// count x count pixels, rows v and columns u; rows are filled up to a multiple of LANES.
///
/// data (count, filled) DN above the mesh background; used (count, filled) is 1, or 0 outside the
/// image or the window and where saturated; left and top are u and v of the first pixel; variance
/// DN^2 of one background pixel.
struct Window {
    int count, filled, left, top;
    double variance;
    alignas(16) float data[MOST_AREA_PX];
    alignas(16) float used[MOST_AREA_PX];

    int area() const { return count * filled; }
    /// Where row y of data, used or another array of the window begins.
    ptrdiff_t row(int y) const { return static_cast<ptrdiff_t>(y) * filled; }
    int pixels_used() const;
};

/// Return half the side of windows for stars of this PSF sigma.
int window_radius(double sigma_px);

/// Fill the window of a peak. The slope of the background, which would move a star towards the
/// brighter side, is that of the mesh. Pixels from full_scale_dn of the frame on are saturated.
void cut_window(const Frame &frame, const Peak &peak, int radius, Window &window);

/// Whether the middle pixel of a window has hardly any flux around it.
bool lone_pixel(const Window &window);

/// Return the number of pixels within CORE_RADIUS_PX of a peak that are saturated or outside.
int saturated_core(const Frame &frame, const Peak &peak);

/// Return initial parameters of a star of this PSF sigma at a peak.
Star initial_star(const Kernel &kernel, const Peak &peak, double sigma_px);

/// Which of windows of one size share flux: those whose corners are less than their side away
/// along both axes. corner (count) is in the order of the stars.
class Neighbours {
public:
    /// Sort the stars down the image, in memory of the arena: neighbours_bytes(count).
    Neighbours(const Pixel *corner, int count, int side_px, Arena &arena);

    bool lone(int i) const {
        bool alone = true;
        each(i, [&alone](int) { alone = false; });
        return alone;
    }

    /// Call function(j) for all stars j that have flux in window i.
    template <class Function>
    void each(int i, Function function) const {
        int k = place_[i];
        while (k > 0 && corner_[i].v - corner_[order_[k - 1]].v < side_px_) {
            --k;
        }
        for (; k < count_ && corner_[order_[k]].v - corner_[i].v < side_px_; ++k) {
            const int j = order_[k], across = corner_[j].u - corner_[i].u;
            if (j != i && across < side_px_ && -across < side_px_) {
                function(j);
            }
        }
    }

private:
    const Pixel *corner_;
    int count_, side_px_;
    int *order_, *place_;
};

}  // namespace st

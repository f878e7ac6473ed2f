// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Square cut-outs around the peaks, and which of them share flux.

#pragma once

#include "centroid/background.h"
#include "centroid/detection.h"
#include "centroid/image.h"
#include "centroid/smoothing.h"
#include "maths/arena.h"

namespace st {

constexpr int LANES = 8;  // pixels processed at a time
constexpr int CORE_RADIUS_PX = 2;

/// stars windows of count x count pixels, rows v and columns u; their rows are filled up to filled
/// pixels, a multiple of LANES.
///
/// data (stars, count, filled) DN above the mesh background; used (stars, count, filled), 0 outside
/// the image or the window and where saturated; corner u, v of the first pixel; variance DN^2 of
/// one background pixel. Stars source[first[i]] .. source[first[i + 1] - 1] have flux in window i.
struct Windows {
    int stars, count, filled;
    float *data;
    uint8_t *used;
    Pixel *corner;
    double *variance;
    int *first, *source;

    int area() const { return count * filled; }
    const float *data_of(int i) const { return data + static_cast<ptrdiff_t>(i) * area(); }
    const uint8_t *used_of(int i) const { return used + static_cast<ptrdiff_t>(i) * area(); }
};

/// Return the windows for stars of this PSF sigma at chosen peaks, count of them, in arrays of the
/// arena, which has room for them: window_bytes().
///
/// The slope of the background, which would move a star towards the brighter side, is that of the
/// mesh. full_scale in DN is the value from which on pixels are saturated.
Windows cut_windows(const Image &image, const Mesh &mesh, const Kernel &kernel, double full_scale,
                    const Peak *peaks, const int *chosen, int count, double sigma_px,
                    Arena &arena);

/// Bytes of the windows of count stars of this PSF sigma.
size_t window_bytes(int count, double sigma_px);

/// Return the number of unused pixels within CORE_RADIUS_PX of the peak of window i.
int saturated_core(const Windows &windows, int i);

}  // namespace st

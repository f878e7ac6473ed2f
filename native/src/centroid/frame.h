// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// One image with its background and its peaks.

#pragma once

#include "centroid/background.h"
#include "centroid/detection.h"
#include "centroid/image.h"
#include "centroid/smoothing.h"

namespace st {

/// Image, the matched filter of its stars, its background and its peaks. Pixels from full_scale_dn
/// on are saturated; infinity where none is.
struct Frame {
    Image image;
    Kernel kernel;
    Mesh mesh;
    Search search;
    double full_scale_dn;

    /// Median level.
    double background_dn() const { return mesh.median_level; }

    /// Median noise of a pixel, 1 sigma.
    double noise_dn() const { return mesh.median_noise / kernel.noise_gain; }
};

}  // namespace st

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

/// Measure the background of an image, as measure_background(). has_hits is whether the image had
/// hits on so many pixels that they count in the noise after the filter.
Mesh mesh_of(const Image &image, const Kernel &kernel, bool has_hits, double *level, double *noise,
             Arena &arena);

/// Return the frame of an image with a filter of this PSF sigma, with at most so many peaks, in the
/// arena.
Frame prepare(const Image &image, double filter_sigma_px, const Threshold &threshold, int peaks,
              bool has_hits, Arena &arena);

/// Whether all pixels of a frame are equal.
bool is_blank(const Frame &frame);

/// Whether most pixels of a frame are at full scale.
bool is_saturated(const Frame &frame);

}  // namespace st

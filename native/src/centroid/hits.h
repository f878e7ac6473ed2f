// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Pixels hit by particles, and hot pixels: sharper than any star image.
//
// The flux of a star of PSF sigma falls into the pixels around its brightest one. Of the four next
// to it, the third brightest has at least a share r(sigma) of it, wherever the star is within its
// pixel; a hit leaves three of the four dark, or all. A lens is sharper here than there: r is that
// of a star narrower than the median.

#pragma once

#include "centroid/background.h"
#include "centroid/detection.h"
#include "centroid/image.h"
#include "centroid/rejection.h"
#include "maths/arena.h"

namespace st {

/// Return r of the narrowest stars where the median one has this PSF sigma.
double least_share(double sigma_px);

/// Whether a peak is sharper than a star, for the least share of the third brightest neighbour;
/// noise_dn is that of a background pixel.
bool is_hit(const Image &image, const Peak &peak, double noise_dn, double share);

/// Whether a peak is one pixel, with hardly any flux around it.
bool is_single(const Image &image, const Peak &peak);

/// Whether peaks, highest first, are hits for the most part. Stars are distinguished even if they
/// are narrower than a pixel: some lie between two pixels.
bool is_storm(const Image &image, const List<Peak> &peaks);

/// Take the hits out of an image, whose pixels are clean, of its stride, and add these pixels to
/// the rejections, in the order of the image.
///
/// A pixel brighter than its eight neighbours and sharper than a star of this PSF sigma gets their
/// median; then the next one of the same track is the brightest.
void remove_hits(const Image &image, uint16_t *clean, const Mesh &mesh, double noise_dn,
                 double sigma_px, Rejections &rejections, Arena &arena);

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The matched filter of stars, row by row: the filtered image is never stored as a whole.

#pragma once

#include "centroid/image.h"

namespace st {

constexpr int MOST_WEIGHTS = 11;  // of the widest filter, of sigma 5 px

/// A Gaussian along rows and columns; weights are its middle and one side, radius, an even number,
/// is the last of them. noise_gain is the ratio of white noise after to before the filter; pairs
/// the share of the weights along a line that can be written as means of two neighbours.
struct Kernel {
    float weights[MOST_WEIGHTS];
    int radius;
    double sigma_px, noise_gain, pairs;
};

/// Return the filter for stars of this PSF sigma, of no more than 5 px: a Gaussian of the PSF sigma
/// is the matched filter of stars; a sigma wrong by a factor q keeps 2 q / (1 + q^2) of the signal
/// to noise ratio.
Kernel gaussian_kernel(double sigma_px);

/// Return the place of an index in an image that is mirrored at its borders.
inline int mirrored(int index, int count) {
    if (0 <= index && index < count) {
        return index;
    }
    const int period = count > 1 ? 2 * count - 2 : 1;
    index = (index < 0 ? -index : index) % period;
    return index < period - index ? index : period - index;
}

/// Fill line (width + 2 radius) with the middle one of rows (2 radius + 1) of an image after the
/// filter along the columns; it extends the radius beyond the image, which is mirrored.
void filter_down(const uint16_t *const *rows, const Kernel &kernel, int width, float *line);
void filter_down(const float *const *rows, const Kernel &kernel, int width, float *line);

/// Fill target[begin] .. target[end - 1] with line, a result of filter_down(), after the filter
/// along the row.
void filter_across(const float *line, const Kernel &kernel, int begin, int end, float *target);

/// Return the filtered image at one pixel.
double filtered_at(const Image &image, const Kernel &kernel, int u, int v);

}  // namespace st

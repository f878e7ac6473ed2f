// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Centroids as weighted means of the pixels above a threshold, and their errors.
//
// Gao and Cui 2016: u = sum(x G) / sum(G) over the window of a star. The weight G of a pixel with
// grey value g is 1, g, g^2 or g - t where g >= t, the threshold, and 0 elsewhere.

#pragma once

#include "centroid/gaussian_fit.h"
#include "centroid/image.h"
#include "startracker.h"

namespace st {

/// Which pixels belong to a star: threshold_dn if positive, else a threshold of each window. That is
/// 3 sigma of noise, and if iterative no less than the iterative threshold. All are above the
/// local background and multiplied by factor.
struct Segmentation {
    double threshold_dn;
    bool iterative;
    double factor;
};

/// The grey values of a window, (count, count), and the variances of their weights.
struct GreyWork {
    double grey[MOST_SIDE_PX * MOST_SIDE_PX], variance[MOST_SIDE_PX * MOST_SIDE_PX];
    Profile<double> columns, rows;
};

struct WeightedMean {
    double u, v, sigma_px;
};

/// Return the position of a star, whose fit is in work, and its 1-sigma error per axis; NaN where no
/// pixel is left. method is not ST_GAUSSIAN.
///
/// The fitted flux of neighbours is subtracted first. The error is computed for a star of the fitted
/// flux and width: the noise of the mean together with its bias by pixels and threshold, rms over
/// the positions of the star within a pixel.
WeightedMean weighted_mean(st_centroid_method method, const Star &star, const NoiseModel &noise,
                           const Segmentation &segmentation, const FitWork &work,
                           GreyWork &grey_work);

/// Return the value that is the mean of the means of count pixels below and above it. The iteration
/// starts halfway between the darkest and the brightest pixel.
double iterative_threshold(const double *grey, int count);

}  // namespace st

// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The innovations of a frame of stars as one measurement of attitude or rate.

#pragma once

#include "camera/lens.h"
#include "filter/attitude_state.h"
#include "track/association.h"

namespace st {

/// Mean and covariance of the innovation of a star, if it is detected.
struct Innovation {
    Point z;
    Covariance2 R;
};

/// Return that of a track about its prediction: the moments of the mixture of its centroids, with
/// beta_j the association probability over 1 - beta_0. Zeros for a star that was surely missed.
Innovation combined_innovation(const Point &predicted, const Places &centroids,
                               const Association &association, int track);

/// Sums of weighted least squares: information sum w H^T R^-1 H and vector sum w H^T R^-1 z.
struct NormalEquations3 {
    Matrix3 information;
    Vector3 vector;

    /// Add a star of the image flow H; of weight 0 it is left out.
    void add(const Flow &H, const Innovation &star, double weight);
};

}  // namespace st

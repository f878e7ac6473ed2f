// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The innovations of a frame of stars as one measurement of attitude or rate.

#pragma once

#include "camera/lens.h"
#include "filter/attitude_state.h"
#include "maths/covariance2.h"
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

/// Return the information of [turn, rate] by sums of weights w, w d and w d^2, of stars that are
/// exposed d after the time of the frame: each measures both by [H, d H].
inline Information turn_and_rate(const NormalEquations3 &turn, const NormalEquations3 &cross,
                                 const NormalEquations3 &rate) {
    Information both{6, {}, {}};
    set_block(both.information, 0, 0, turn.information);
    set_block(both.information, 0, 3, cross.information);
    set_block(both.information, 3, 0, transposed(cross.information));
    set_block(both.information, 3, 3, rate.information);
    for (int axis = 0; axis < 3; ++axis) {
        both.vector[axis] = turn.vector[axis];
        both.vector[3 + axis] = cross.vector[axis];
    }
    return both;
}

}  // namespace st

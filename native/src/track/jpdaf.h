// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The JPDA filter of Sadeghi, Sabahi and Saberali: prediction, association, update of tracks, each
// with a filter of position and velocity on the image.

#pragma once

#include "track/association.h"
#include "track/motion_models.h"

namespace st {

/// Step 1: make state and covariance F x and F P F^T + Q.
void predict(const Matrix<4, 4> &F, const Matrix<4, 4> &Q, StarState &x, StarCovariance &P);

/// Steps 2 to 6, with one of three factors of phi false centroids in a joint event: lambda^phi of a
/// Poisson process of density lambda, that of those in no gate; phi! / V^phi of a density that is not
/// known, with the area V of all gates; or none, where the matrix of all sums is normalised by rows
/// and columns at once.
///
/// confirmed (count of predicted) may be null; it has the centroid of each star whose
/// predicted place another test has confirmed, -1 for a star without, which is missed: only these
/// centroids are associated, with any of the confirmed stars.
void associate_stars(const Places &predicted, const Places &centroids,
                     const DetectionModel &detection, st_association factor,
                     const int32_t *confirmed, Association &association, Arena &work);

/// Return the bytes of work memory of associate_stars().
size_t associate_stars_bytes(int tracks, int centroids);

/// Steps 7 to 9: make state and covariance of track n mean and covariance of the mixture of its
/// updates by single centroids uv of variance px^2 per axis.
///
/// With one variance for all centroids these are the combined innovation and the covariance of the
/// innovations; with different ones each centroid has its own gain.
void update(const Association &association, int n, const Point *uv, const double *variance,
            StarState &x, StarCovariance &P);

}  // namespace st

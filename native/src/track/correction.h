// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// A predicted attitude, corrected by all centroids of a frame at once.

#pragma once

#include "camera/lens.h"
#include "filter/attitude_state.h"
#include "maths/arena.h"
#include "track/association.h"
#include "track/motion_models.h"

namespace st {

/// The stars that are followed: directions (count) on ICRF axes, and which may correct the
/// attitude.
struct FollowedStars {
    int count;
    const Vector3 *icrf;
    const bool *usable;
};

/// Least inliers of a correction, and the residual over its sigma from which on a star is an
/// outlier.
struct CorrectionLimits {
    int min_stars;
    double outlier_sigmas;
};

/// A predicted attitude, corrected by a frame. Lists are in the memory given to correct().
///
/// Of the count stars that are predicted in the image: star is which of those followed, predicted
/// is where, inlier whether it was detected and corrects the attitude; normalised is the distance
/// of its most probable centroid from its position by the corrected state in sigma, distance_px
/// the same in px, along a streak as many sigma of the narrow direction, both infinity where it
/// was missed; best is that centroid, -1 where there is none in its gate.
///
/// agreed is false when there are too few inliers. innovation is the measured turn, whitened by
/// its covariance: its square is the normalised innovation squared, of 3 degrees of freedom. The
/// stars measure the turn from the predicted attitude, of covariance turn_covariance: measured.
/// With a rolling shutter they measure the rate as well, and turn contains the error of the
/// corrected rate; an error e of the acceleration that brought the rows to one time changes what
/// they measure by by_acceleration e, zero without a rolling shutter.
///
/// stars counts the usable stars in the image, inliers those of the fit; of these residual_px is
/// the rms of distance_px, chi2 the sum of normalised squared, typical the median of normalised,
/// and precise that of the half with the least errors; NaN where there are too few.
struct Correction {
    bool agreed;
    int count;
    int32_t *star, *best;
    Point *predicted;
    bool *inlier;
    double *distance_px, *normalised;
    Association association;

    AttitudeState state;
    Information measured;
    Matrix<6, 3> by_acceleration;
    Vector3 turn;
    Matrix3 turn_covariance;
    Vector3 innovation;
    int stars, inliers;
    double residual_px, chi2, typical, precise;
};

/// Return the bytes of memory that correct() takes for its lists, and for work.
size_t correction_bytes(int stars, int centroids);
size_t correction_work_bytes(int stars, int centroids);

/// Associate centroids with predicted stars and correct the attitude by the inliers.
///
/// One outlier is removed at a time, the worst: it biases the attitude and with it the residuals
/// of all others. Of a rolling shutter centroids are where the predicted rate has the stars at the
/// time of the frame, delay_s after which they are exposed; null without.
Correction correct(const Lens &lens, const FollowedStars &stars, const CorrectionLimits &limits,
                   const AttitudeState &predicted, const Places &centroids, const double *delay_s,
                   const DetectionModel &detection, Arena &memory, Arena &work);

/// Position and velocity of a star in the image.
struct ImageMotion {
    StarState state;
    StarCovariance covariance;
};

/// Return them of a direction on ICRF axes: the image flow times attitude and rate, and so their
/// errors. R is the matrix of the quaternion of the state.
ImageMotion on_image(const Lens &lens, const Matrix3 &R, const Vector3 &icrf,
                     const AttitudeState &state);

}  // namespace st
